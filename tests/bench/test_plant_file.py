"""Plant files: what they say is what is simulated; what no muscle can be is refused at its place; no traceback."""

import copy
import json
import math
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.bench.interface import device_from
from pmabench.bench.plant import read_plant
from pmabench.model.driven import Actuator
from pmabench.model.overrides import Overrides
from pmabench.model.presets import changed, preset, setup_of
from pmabench.model.regulator import constant
from tests.bench.benches import BENCHES, ROOT, SPECIMEN

PLANTS = ROOT / "fixtures" / "plants"
PAGE = (ROOT / "docs" / "plants.md").read_text()
MUSCLE = re.search(r"```yaml\n(# muscle\.yaml\n.*?)```", PAGE, re.DOTALL)[1]


def written(folder: Path, text: str, name: str = "muscle.yaml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def setup(folder: Path, text: str):
    return setup_of(read_plant(written(folder, text)).numbers)


def refused(folder: Path, text: str) -> list[str]:
    with pytest.raises(InvalidFile) as caught:
        read_plant(written(folder, text))
    assert all(problem.line > 0 for problem in caught.value.problems), caught.value
    return [f"{problem.line}:{problem.column} {problem.message}" for problem in caught.value.problems]


@pytest.mark.parametrize("name", ["paper0", "paper0-air", "serres2009", "daerden", "contractor-30", "real"])
def test_the_shipped_files_are_the_presets_to_the_last_bit(name):
    found = setup_of(read_plant(PLANTS / f"{name}.yaml").numbers)
    assert found == preset(name, "bench")
    assert changed(found, "ideal") == preset(name, "ideal")


def test_the_shipped_file_of_paper_1_is_its_preset_and_relaxes_as_it_does():
    """tau_r = D_r / S is no polynomial: straight lines between 31 points, within 0.2 %."""
    found, known = setup_of(read_plant(PLANTS / "dmsp-40-305.yaml").numbers), preset("dmsp-40-305", "bench")
    P = np.linspace(0.0, 6e5, 601)
    for symbol in ("F_ce", "K", "B_c", "B_r"):
        values, wanted = (getattr(one.muscle, symbol).values(P) for one in (found, known))
        assert values == pytest.approx(wanted, rel=1e-12)
    assert found.muscle.tau_r.values(P) == pytest.approx(known.muscle.tau_r.values(P), rel=2e-3)
    for name in ("friction", "length", "stop"):
        assert getattr(found.muscle, name) == getattr(known.muscle, name)
    assert (found.regulator, found.noise, found.follow_lag) == (known.regulator, known.noise, known.follow_lag)
    ends = []
    for one in (found, known):
        plant = changed(one, "ideal").free(force=5.0)
        plant.command((*constant(0.0, 5e5), *constant(5.0, 0.0)))
        ends.append(plant.advance(8.0, np.linspace(5.5, 8.0, 6)).x)
    assert ends[0] == pytest.approx(ends[1], rel=2e-3)
    assert ends[0][0] == pytest.approx(ends[0][-1] * math.exp(2.5 / 1.3675), rel=0.02), "by tau_r at 5 bar, not at 0"


def test_a_plant_file_says_itself_where_f_ce_is_taken():
    found = setup_of(read_plant(PLANTS / "dmsp-40-305.yaml").numbers)
    with pytest.raises(ValueError, match="fce_eval is not for the muscle"):
        changed(found, "bench", Overrides(fce_eval="xmax"))


def test_each_way_to_write_a_coefficient(tmp_path):
    muscle = setup(tmp_path, MUSCLE).muscle
    P = np.linspace(0, 500e3, 1001)
    kPa = P / 1e3
    force = np.interp(kPa, [0, 60, 100, 200, 300, 400, 500], [0, 0, 30, 101, 170, 235, 295])
    assert muscle.F_ce.values(P) == pytest.approx(force, abs=1e-9)
    assert muscle.K.values(P) == pytest.approx(1e3 * (3.1 - 5e-4 * kPa + 9e-6 * kPa**2), rel=1e-12)
    assert muscle.B_c.values(P) == pytest.approx(1e3 * (0.62 + 0.11 * (kPa - 250) / 150), rel=1e-12)
    assert muscle.B_r.values(P) == pytest.approx(1e3 * np.where(kPa < 250, 0.55, 0.25 + 0.0012 * kPa), rel=1e-12)


def test_a_polynomial_of_higher_order_about_a_centre(tmp_path):
    numbers = [4.0, 0.3, -0.2, 0.11, 0.07, -0.02]
    wanted = f"K: {{coefficients: {numbers}, unit: N/mm, pressure: bar, centre: 2.5 bar, scale: 0.12 MPa}}"
    muscle = setup(tmp_path, re.sub(r"(?m)^K: .*$", wanted, MUSCLE)).muscle
    P = np.linspace(0, 500e3, 101)
    assert muscle.K.values(P) == pytest.approx(1e3 * np.polyval(numbers[::-1], (P - 250e3) / 120e3), rel=1e-11)


def test_below_its_domain_a_force_goes_straight_to_zero_and_others_keep_their_value(tmp_path):
    text = re.sub(r"points: .*", "{coefficients: [-2, 0.6], unit: N, pressure: kPa, domain: [1 bar, 5 bar]}", MUSCLE)
    text = text.replace("F_ce:                         # contractile force without contraction\n  ", "F_ce: ")
    text = re.sub(r"(?m)^K: .*$", "K: {points: [[150 kPa, 3 N/mm], [500 kPa, 5 N/mm]]}", text)
    text = re.sub(r"(?m)^B_c: .*$", "B_c: 0.7 N.s/mm", text)
    muscle = setup(tmp_path, text).muscle
    assert [muscle.F_ce(P) for P in (0.0, 50e3, 100e3, 200e3)] == pytest.approx([0, 29, 58, 118])
    assert [muscle.K(P) for P in (0.0, 150e3, 325e3)] == pytest.approx([3000, 3000, 4000])
    assert muscle.B_c(123e3) == pytest.approx(700)


def test_everything_else_in_the_file_is_simulated(tmp_path):
    found = setup(tmp_path, MUSCLE + "follow_lag: 4 ms\n")
    regulator, friction, noise = found.regulator, found.muscle.friction, found.noise
    assert (friction.F_s, friction.F_c, friction.speed) == (5, 3, pytest.approx(1e-3))
    assert (regulator.dead_time, regulator.lag, regulator.vent_ratio) == pytest.approx((0.03, 0.08, 1.4))
    assert (noise.pressure, noise.displacement, noise.force) == pytest.approx((400, 3e-6, 0.2))
    assert (found.muscle.length, found.muscle.stop, found.follow_lag) == pytest.approx((0.2, 0.06, 0.004))
    leaky = setup(tmp_path, re.sub(r"vent_ratio: 1.4", "leak: 2 %/s, dead_band: 1 kPa", MUSCLE)).regulator
    assert (leaky.leak, leaky.dead_band) == pytest.approx((0.02, 1000))


def test_a_variant_includes_the_muscle_that_it_changes(tmp_path):
    written(tmp_path, MUSCLE)
    plant = read_plant(written(tmp_path, "include: muscle.yaml\nname: twice\nB_c: 1.5 N.s/mm\n", "twice.yaml"))
    assert setup_of(plant.numbers).muscle.B_c(2e5) == pytest.approx(1500)
    assert "silicone 12-200" in plant.text, "the snapshot holds both"


def line_of(text: str, key: str) -> int:
    return 1 + [line.startswith(key) for line in text.splitlines()].index(True)


REFUSED = {
    "stiffness below zero": (
        "K", "K: {coefficients: [3.1, -0.03, 6.0e-5], unit: N/mm, pressure: kPa}",
        "K falls to -0.65 N/mm at 250 kPa; it must be at least 0.001 N/mm from 0 kPa to highest_pressure, 500 kPa",
    ),
    "damping below zero at the end": (
        "B_r", "B_r: {coefficients: [1, -0.0021], unit: N.s/mm, pressure: kPa}", "B_r falls to -0.05 N·s/mm at 500 kPa",
    ),
    "no damping at all": ("B_c", "B_c: 0 N.s/mm", "at least 0.001 N·s/mm"),
    "a force that pushes": (
        "F_ce", "F_ce: {coefficients: [-49, 1.08], unit: N, pressure: kPa}",
        "F_ce falls to -49 N at 0 kPa; it must be never below zero from 0 kPa to highest_pressure, 500 kPa; "
        "a muscle cannot push: give 0 as a separate piece up to the break at 45.37037037 kPa",
    ),
    "a force without air": (
        "F_ce", "F_ce: {coefficients: [44.6, 2.91], unit: N, pressure: kPa}", 'give the "domain" from which on it holds',
    ),
    "a jump": (
        "B_r", "B_r: {pieces: [[0.55], [0.35, 0.0012]], breaks: [250 kPa], unit: N.s/mm, pressure: kPa}",
        "B_r jumps at 250 kPa from 0.55 N·s/mm to 0.65 N·s/mm",
    ),
    "a domain that ends too early": (
        "K", "K: {coefficients: [3.1], unit: N/mm, pressure: kPa, domain: [100 kPa, 400 kPa]}",
        "ends at 400 kPa, but highest_pressure is 500 kPa",
    ),
    "a table that ends too early": ("K", "K: {points: [[0 kPa, 3 N/mm], [4 bar, 4 N/mm]]}", "ends at 400 kPa"),
    "pressures that fall": (
        "K", "K: {points: [[0 kPa, 3 N/mm], [5 bar, 4 N/mm], [4 bar, 4 N/mm], [6 bar, 4 N/mm]]}",
        "the pressures must rise; 500 kPa is before it",
    ),
    "the unit of another": ("K", "K: 2.9 N.s/mm", '"N.s/mm" is no unit of stiffness'),
    "a polynomial without its unit": ("K", "K: {coefficients: [3.1], pressure: kPa}", '"unit" is missing'),
    "both forms": (
        "K", "K: {coefficients: [3], pieces: [[3], [3]], breaks: [1 bar], unit: N/mm, pressure: kPa}",
        'either "coefficients" or "pieces" with "breaks" is expected',
    ),
    "too few breaks": (
        "K", "K: {pieces: [[3], [3], [3]], breaks: [1 bar], unit: N/mm, pressure: kPa}", "3 pieces are joined at 2 breaks",
    ),
    "a number without unit": ("K", "K: 3", "no reading with a unit"),
    "numbers out of range": ("K", "K: {coefficients: [1.0e+300, 1.0e+300], unit: N/mm, pressure: kPa}", "more than any"),
    "kinetic friction above static": ("friction", "friction: {F_s: 3 N, F_c: 5 N}", '"F_c" (while it moves)'),
    "a misspelt key": ("friction", "friction: {F_s: 3 N, F_c: 1 N, spead: 1 mm/s}", 'unknown key "spead"; did you mean "speed"'),
    "a misspelt key at the top": ("noise", "niose: {}", 'unknown key "niose"; did you mean "noise"'),
    "a dead band without lag": ("regulator", "regulator: {dead_band: 1 kPa}", 'needs a "lag"'),
    "a lag of a day": ("regulator", "regulator: {lag: 1 day}", "outside 0 s to 60 s"),
    "another law": ("law", "law: hill", '"hill" is no law of a plant'),
    "too much pressure": ("highest_pressure", "highest_pressure: 60 bar", "6000 kPa is outside 1 kPa to 2000 kPa"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_no_muscle_is_has_a_sentence_at_its_place(tmp_path, case):
    key, line, sentence = REFUSED[case]
    found = refused(tmp_path, re.sub(rf"(?m)^{key}:.*\n(?:  .*\n)*", f"{line}\n", MUSCLE))
    number = line_of(MUSCLE, f"{key}:")
    assert any(sentence in problem and problem.startswith(f"{number}:") for problem in found), found


DAERDEN = (PLANTS / "daerden.yaml").read_text()


@pytest.mark.parametrize(
    ("key", "line", "sentence"),
    [
        ("reach", "reach: [-3.9 %, 20 %]", "-0.039 must stay above -0.036, short of the pole"),
        # S > 0 while (1 - eps)^alpha > 1 / (3 cos^2 theta0): up to 29.31 %, and 2 % of that are kept away
        ("reach", "reach: [-3 %, 29 %]", "29.0% is too far: from 28.7% on"),
        ("braid_angle", "braid_angle: 60 deg", "outside 0.572958 deg to 54.6783 deg"),
        ("flow", "flow: {fill: 0 g/s/bar, vent: 0 g/s/bar}", 'one of "fill" and "vent" must be above zero'),
        ("B1", "B3: 3 %", 'unknown key "B3"'),
        ("hysteresis", "hysteresis: {height: 30 N}", '"width" is missing'),
    ],
)
def test_what_no_daerden_muscle_is_has_a_sentence_at_its_place(tmp_path, key, line, sentence):
    found = refused(tmp_path, re.sub(rf"(?m)^{key}: .*$", line, DAERDEN))
    number = line_of(DAERDEN, f"{key}:")
    assert any(sentence in problem and problem.startswith(f"{number}:") for problem in found), found


CONTRACTOR = (PLANTS / "contractor-30.yaml").read_text()


@pytest.mark.parametrize(
    ("key", "line", "sentence"),
    [
        # (1 - 1 / (sqrt 3 cos theta)) / (1 + e^-5): 36.06 % at 25 deg and 5 bar
        ("reach", "reach: [0 %, 37 %]", "37.0% is too far: from 36.1% on it does not pull at 500 kPa either"),
        ("reach", "reach: [30 %, 20 %]", "the second must lie above the first"),
        (
            "highest_pressure",
            "highest_pressure: 6 bar",
            "paper 2's contractors are known up to 500 kPa, not to 600 kPa",
        ),
        ("braid_angle", "braid_angle: 60 deg", "outside 0.572958 deg to 54.6783 deg"),
        ("threshold", "threshold: 3 bar", "outside 0 kPa to 200 kPa"),
        ("radius", "diameter: 20 mm", 'unknown key "diameter"'),
    ],
)
def test_what_no_contractor_is_has_a_sentence_at_its_place(tmp_path, key, line, sentence):
    found = refused(tmp_path, re.sub(rf"(?m)^{key}: .*$", line, CONTRACTOR))
    number = line_of(CONTRACTOR, f"{key}:")
    assert any(sentence in problem and problem.startswith(f"{number}:") for problem in found), found


def test_a_contractor_of_ones_own_pulls_as_paper_2_has_it(tmp_path):
    """eqs. 8-9 by hand: 12 mm, 20 deg, 3 bar, 10 %: q = 1 + e^-3, a = 3 / tan^2, b = 1 / sin^2."""
    text = CONTRACTOR.replace("radius: 10 mm", "radius: 12 mm").replace("braid_angle: 25 deg", "braid_angle: 20 deg")
    muscle = setup(tmp_path, text).muscle
    angle, q = math.radians(20), 1 + math.exp(-3)
    force = (
        math.pi * 0.012**2 * (3e5 - 45e3) * (3 / math.tan(angle) ** 2 * (1 - 0.1 * q) ** 2 - 1 / math.sin(angle) ** 2)
    )
    assert muscle.pull(np.array([3e5]), np.array([0.03]))[0] == pytest.approx(force)
    assert muscle.pull(np.array([4e4]), np.array([0.03]))[0] == 0.0


REAL = (PLANTS / "real.yaml").read_text()


@pytest.mark.parametrize(
    ("key", "line", "sentence"),
    [
        ("hysteresis", "hysteresis: {height: 5 N, widths: [1 mm, 2 mm], weights: [1.0]}", 'each stop needs one of both'),
        ("hysteresis", "hysteresis: {height: 5 N, widths: [1 mm], weights: [0.9]}", "they must add up to 1"),
        ("hysteresis", "hysteresis: {height: 5 N, per_pressure: -1 N/kPa, widths: [1 mm], weights: [1]}", "below zero"),
        ("pressure_hysteresis", "pressure_hysteresis: {height: 5 N, widths: [1 mm], weights: [1]}", '"mm" is no unit of'),
        ("creep", "creep: {share: 10 %, times: [1 s, 2 s, 3 s, 4 s, 5 s, 6 s]}", "more than half in all"),
        # K at 600 kPa and 28 %: [33.4 (244.7 - 66.9) e^-9.35 + 600 C] / 250 mm, below 0 for C > 0
        ("surface", "surface: {A: 244.7 N, A_P: -0.1115 N/kPa, s: 33.4, C: 8.3 N/kPa, D: 2.65 N/kPa, E: -249.4 N}",
         "the stiffness is -19.92"),
        ("surface", "surface: {A: 244.7 N, A_P: -0.1115 N/kPa, s: 33.4, C: -8.3 N/kPa, D: 2.65 N/kPa, E: 0 N}",
         "pulls with 244.7 N without pressure"),
        ("reach", "reach: [1 %, 28 %]", "1 % is outside -10 % to 0 %"),
        ("B_c", "B_c: 0 N.s/mm", "at least 0.001"),
    ],
)  # fmt: skip
def test_what_no_muscle_with_hysteresis_and_creep_is_has_a_sentence_at_its_place(tmp_path, key, line, sentence):
    found = refused(tmp_path, re.sub(rf"(?m)^{key}: .*$", line, REAL))
    number = line_of(REAL, f"{key}:")
    assert any(sentence in problem and problem.startswith(f"{number}:") for problem in found), found


def test_what_a_file_leaves_out_is_not_there(tmp_path):
    """Held at 20 mm and 300 kPa it pulls with F_s, by hand 361.0 N, whichever way it came."""
    bare = re.sub(r"(?m)^(hysteresis|pressure_hysteresis|creep|noise): .*\n", "", REAL)
    plant = changed(setup(tmp_path, bare), "ideal").driven(Actuator())
    plant.command(constant(0.0, 3e5))
    plant.move((*constant(0.0, 30e-3), *constant(10.0, 20e-3)))
    assert plant.advance(60.0, np.array([60.0])).F[0] == pytest.approx(361.0, abs=0.1)


def test_all_problems_come_at_once(tmp_path):
    text = re.sub(r"(?m)^K: .*$", "K: -1 N/mm", MUSCLE)
    text = re.sub(r"(?m)^B_c: .*$", "B_c: 3 N", text)
    text = re.sub(r"(?m)^B_r: .*$", "B_r: {points: [[0 kPa, 1 N.s/mm], [9 bar, -1 N.s/mm]]}", text)
    assert [int(problem.split(":")[0]) for problem in refused(tmp_path, text)] == [
        line_of(text, "K:"), line_of(text, "B_c:"), line_of(text, "B_r:")
    ]  # fmt: skip


def bench(folder: Path, options: str, more: str = "") -> Path:
    text = (BENCHES / "mock-realtime.yaml").read_text().replace("include: mock.yaml", "include: base.yaml")
    base = (BENCHES / "mock.yaml").read_text().replace("{plant: paper0, preset: bench, seed: 1}", options)
    (folder / "base.yaml").write_text(base)
    if not (folder / "calibrations").exists():
        (folder / "calibrations").symlink_to(BENCHES / "calibrations")
    return written(folder, text + more, "bench.yaml")


def test_a_bench_takes_the_plant_of_a_file_and_keeps_it(tmp_path):
    written(tmp_path, MUSCLE.replace("500 kPa     #", "600 kPa     #").replace("[500 kPa, 295 N]", "[6 bar, 350 N]"))
    mounted = mount(bench(tmp_path, "{plant: muscle.yaml, preset: ideal}"), SPECIMEN)
    assert mounted.documents["muscle.yaml"] == (tmp_path / "muscle.yaml").read_text()
    (device,) = mounted.bench.devices
    assert device.options["plant"]["name"] == "silicone 12-200"
    assert device_from(json.loads(json.dumps(asdict(device)))) == device, "it goes to other processes"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ("{plant: muscle.yaml}", "muscle.yaml holds up to 500 kPa, and this bench may command 600 kPa"),
        ("{plant: absent.yaml}", "cannot be read"),
        ("{plant: ../muscle.yaml}", 'a .yaml file next to this one is expected, for instance "plants/my-muscle.yaml"'),
        ("{plant: {law: three-element}}", "the name of a plant, or a plant file next to this one, is expected"),
        ("{plant: paper1}", 'did you mean "paper0"'),
        ("{plant: broken.yaml}", '"source" is missing'),
        ("{plant: specimen.yaml}", 'in the record of a run another file is called "specimen.yaml"'),
        ("{plant: protocol.yaml}", 'in the record of a run another file is called "protocol.yaml"'),
        ("{plant: daerden.yaml}", "daerden.yaml is for a driven free end"),
        ("{plant: short.yaml}", "known for lengths of 150 to 400 mm, not for 120 mm"),
    ],
)
def test_a_plant_that_does_not_fit_the_bench_is_reported_where_it_is_named(tmp_path, options, sentence):
    written(tmp_path, MUSCLE)
    written(tmp_path, re.sub(r"(?m)^source: .*\n", "", MUSCLE), "broken.yaml")
    written(tmp_path, DAERDEN, "daerden.yaml")
    written(tmp_path, CONTRACTOR.replace("300 mm", "120 mm"), "short.yaml")
    for name in ("specimen.yaml", "protocol.yaml"):
        written(tmp_path, (PLANTS / "paper0.yaml").read_text(), name)
    with pytest.raises(InvalidFile) as caught:
        mount(bench(tmp_path, options), SPECIMEN)
    assert sentence in str(caught.value)
    assert all(problem.line > 0 or "absent" in problem.path for problem in caught.value.problems)


@settings(max_examples=40)
@given(
    st.lists(st.floats(-3, 3), min_size=1, max_size=7), st.sampled_from([0, 100, 250]), st.sampled_from([80, 125, 250])
)
def test_a_polynomial_is_refused_just_where_it_falls_too_low(tmp_path_factory, numbers, centre, scale):
    form = f"K: {{coefficients: {numbers}, unit: N/mm, pressure: kPa, centre: {centre} kPa, scale: {scale} kPa}}"
    path = written(tmp_path_factory.getbasetemp(), re.sub(r"(?m)^K: .*$", form, MUSCLE))
    values = np.polyval(numbers[::-1], (np.linspace(0, 500, 5001) - centre) / scale)
    lowest = values.min()
    try:
        read_plant(path)
    except InvalidFile as error:
        (problem,) = error.problems
        if "more than any muscle" in problem.message:
            assert values.max() > 1e3, error
            return
        assert lowest < 0.001 + 1e-9, error
        reported = float(re.search(r"K falls to (\S+) N/mm", problem.message)[1])
        assert reported == pytest.approx(lowest, rel=1e-3, abs=1e-6)
    else:
        assert lowest >= 0.001 - 1e-6


NASTY = st.one_of(
    st.sampled_from(
        [
            None, True, 0, -1, 1e308, "", "~", "0", "-5 kPa", "1e300 MPa", "0 kPa", "1 kPa", "300 kPa", "5 bar", "-1 N",
            "0 N", "1e300 N", "3 N/mm", "-3 N/mm", "1 N.s/mm", "0 N.s/mm", "1e-300 N.s/mm", "5 ms", "-5 ms", "1 h", "N/mm",
            "kPa", "degC", "nan kPa", "three-element", [], [[]], [[0]], {}, {"points": []}, {"points": [["0 kPa", "1 N"]]},
            ["0 kPa", "1 N"], ["100 kPa", "500 kPa"], [0, 1], [1e300, 1e300], [5, -1e-2, 1e-5], "x" * 500, "\u0000", "${HOME}",
        ]
    ),
    st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=8),
    st.floats(allow_nan=False, allow_infinity=False),
    st.fixed_dictionaries(
        {
            "coefficients": st.lists(st.floats(-5, 5), min_size=1, max_size=5),
            "unit": st.just("N/mm"),
            "pressure": st.just("bar"),
            "centre": st.sampled_from(["0 bar", "2.5 bar", "250 kPa", "-1 bar"]),
            "scale": st.sampled_from(["1 bar", "2 bar", "100 kPa", "0 bar", "-1 bar"]),
        }
    ),
)  # fmt: skip
DATA = YAML(typ="safe", pure=True).load(MUSCLE)


def places(data, at=()):
    """Every location in plain data."""
    if at:
        yield at
    for key, value in data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ():
        yield from places(value, (*at, key))


@settings(max_examples=200)
@given(st.data())
def test_a_hostile_file_is_a_muscle_or_has_sentences(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp() / "plants"
    folder.mkdir(exist_ok=True)
    made = copy.deepcopy(DATA)
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.sampled_from(list(places(made))))
        target = made
        for part in at[:-1]:
            target = target[part]
        if data.draw(st.booleans()) and data.draw(st.booleans()):
            del target[at[-1]]
        else:
            target[at[-1]] = copy.deepcopy(data.draw(NASTY))  # a later draw may change it
    path = written(folder, json.dumps(made))
    try:
        numbers = read_plant(path).numbers
    except InvalidFile as error:
        assert error.problems
        assert all(problem.line > 0 and problem.message for problem in error.problems), error
        return
    muscle = setup_of(numbers).muscle
    P = np.linspace(0, numbers["highest_pressure"], 4001)
    for curve, least in ((muscle.F_ce, 0.0), (muscle.K, 1.0), (muscle.B_c, 1.0), (muscle.B_r, 1.0)):
        values = curve.values(P)
        assert np.isfinite(values).all()
        assert values.min() >= least - 1e-6 * max(1.0, values.max())
    assert muscle.F_ce(0.0) <= 1.0
    assert math.isfinite(muscle.contraction(numbers["highest_pressure"]))


@pytest.mark.parametrize("K", ["1000 N/mm", "0.001 N/mm"])
@pytest.mark.parametrize("B", ["10000 N.s/mm", "0.001 N.s/mm"])
@pytest.mark.parametrize(("mass", "force"), [(0.01, 0.0), (50.0, 500.0)])
def test_the_ends_of_what_is_taken_are_simulated(tmp_path, K, B, mass, force):
    text = re.sub(r"(?m)^(K|B_c|B_r): .*$", lambda key: f"{key[1]}: {K if key[1] == 'K' else B}", MUSCLE)
    text = re.sub(r"(?m)^friction: .*$", "friction: {F_s: 100 N, F_c: 1 N, speed: 0.01 mm/s}", text)
    found = setup(tmp_path, text)
    plant = found.free(force=force, mass=mass)
    for second, P in enumerate((300e3, 500e3, 0.0)):
        plant.command(constant(float(second), P))
        motion = plant.advance(second + 1.0, np.arange(second * 100, (second + 1) * 100) / 100)
        assert np.isfinite(motion.x).all()
        assert np.isfinite(motion.F).all()
        assert motion.x.min() >= 0
        assert motion.x.max() <= found.muscle.stop + 1e-9


AIRY = (PLANTS / "paper0-air.yaml").read_text()


@pytest.mark.parametrize(
    ("was", "becomes", "message"),
    [
        ("diameter: 20 mm\n", "", '"flow" needs "diameter" and "braid_angle"'),
        ("lag: 0 s", "lag: 80 ms", '"lag" (first order) and "natural_frequency" (second order) exclude each other'),
        ("natural_frequency: 2.5 Hz, ", "", '"damping_ratio" needs a "natural_frequency" above zero'),
        ("ratio: 0.9", "ratio: 0", "greater than or equal to 0.05"),
        ("2.5 Hz", "2.5 bar", "bar"),
    ],
)
def test_what_a_regulator_that_moves_air_needs(tmp_path, was, becomes, message):
    (tmp_path / "paper0.yaml").write_text((PLANTS / "paper0.yaml").read_text())
    assert was in AIRY
    assert any(message in reported for reported in refused(tmp_path, AIRY.replace(was, becomes)))
