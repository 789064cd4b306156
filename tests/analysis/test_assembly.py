"""Like muscles side by side and end to end, against one muscle: the arm of paper 2 and the trap of the connector.

Corrected force of paper 2, r 10 mm, 25 deg: 141.7, 656.7, 1171.8 N at 1, 3, 5 bar and no contraction, 80.9, 436.9, 794.7 N
at 10 %; the arm of four pulls 566.6 N at 1 bar and 2626.9 N at 3 bar.
"""

import shutil
from dataclasses import replace
from math import exp, pi, radians, sin, tan

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from pmabench_drivers.mock import MockBench

from pmabench.analysis.verdict.agreement import adds_up, of_one, without_diameter
from pmabench.analysis.verdict.comparison import Side, compare
from pmabench.base.clock import VirtualClock
from pmabench.base.errors import DeviceError
from pmabench.bench.compile import mount
from pmabench.bench.files.specimen import SpecimenFile
from pmabench.bench.interface import DeviceRecord
from pmabench.cli.main import main
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.compile import make_plan
from pmabench.kinds.reduce import reduce_runs
from pmabench.model.overrides import Overrides
from pmabench.model.presets import preset
from pmabench.store.reader import open_run
from tests.analysis.driven_runs import ROOT, recorded

SHORT = (
    ("prepare.precondition.cycles", "0"), ("sweep.repeat.count", "2"), ("sweep.matrix.contraction", "[0 %, 10 %]"),
)  # fmt: skip
TABLE = {
    (1e5, 0.0): 141.7,
    (3e5, 0.0): 656.7,
    (1e5, 0.1): 80.9,
    (3e5, 0.1): 436.9,
    (5e5, 0.0): 1171.8,
    (5e5, 0.1): 794.7,
}
"""Gauge pressure [Pa], contraction ratio -> force of one muscle [N]."""
ARM = {1e5: 566.6, 3e5: 2626.9}


def force(P, eps):
    """Eqs. 8 and 9 of paper 2 [N]."""
    theta, q = radians(25), 1 + exp(-P / 1e5)
    return pi * 0.01**2 * (P - 45e3) * (3 / tan(theta) ** 2 * (1 - q * eps) ** 2 - 1 / sin(theta) ** 2)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    out = tmp_path_factory.mktemp("arm")
    return recorded(out, "isometric-pressurisation", "mock-contractor-arm", "contractor-30-arm", *SHORT)


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    out = tmp_path_factory.mktemp("single")
    return recorded(out, "isometric-pressurisation", "mock-contractor", "contractor-30", *SHORT)


def at_pressure(run, contraction, P):
    """Mean force of the samples within 1 kPa of a pressure [N], filling and emptying, with the slope taken out."""
    trial = next(t for t in run.trials if t.point["contraction"] == pytest.approx(contraction))
    begin, end = (next(c.t for c in trial.commands if c.phase == name) for name in ("fill", "return"))
    t, p, F = trial.t, trial.channels["pressure"], trial.channels["force"]
    rows = (t > begin) & (t < end) & (np.abs(p - P) < 5e3)
    _, level = np.polyfit(p[rows] - P, F[rows], 1)
    return level


@pytest.mark.parametrize(("place", "expected"), TABLE.items())
def test_forces_are_those_of_the_table_and_four_times_them(arm, single, place, expected):
    P, eps = place
    assert force(P, eps) == pytest.approx(expected, abs=0.06)
    P = min(P, 499e3)  # the ramp turns at 5 bar
    assert at_pressure(single, eps * 0.3, P) == pytest.approx(force(P, eps), abs=1.0)
    assert at_pressure(arm, eps * 0.3, P) == pytest.approx(4 * force(P, eps), abs=4.0)


def test_the_arm_is_four_muscles_and_a_weak_one_is_seen(arm, single):
    """Per muscle both agree; where each muscle of the arm pulls 5 % less, F_b and the slopes are beyond E_n = 1."""
    (of_arm,), (of_single,) = ([a for a in reduce_runs([run]) if a.kind == arm.kind] for run in (arm, single))
    blocked = {e.at["pressure"]: e for e in of_arm.estimates if e.symbol == "F_b"}
    for P, pull in ARM.items():
        assert blocked[P].value == pytest.approx(pull, rel=2e-3)
    assert all(e.value is None for e in of_arm.estimates if e.symbol == "D_0"), "no diameter of one muscle"
    one = of_one(of_arm, 4)
    found = compare(Side("A", (one,)), Side("B", (of_single,)))
    judged = [d for d in found.differences if d.score is not None]
    assert {"F_b", "m"} <= {d.a.symbol for d in judged}
    assert all(d.agrees for d in judged)
    ratios = [4 + 4 * d.relative for d in judged if d.a.symbol in ("F_b", "m") and d.a.at.get("pressure", 1e5) > 9e4]
    assert ratios == pytest.approx([4.0] * len(ratios), rel=5e-3)
    weaker = [replace(t, channels={**t.channels, "force": 0.95 * t.channels["force"]}) for t in arm.trials]
    (weak,) = (a for a in reduce_runs([replace(arm, trials=tuple(weaker))]) if a.kind == arm.kind)
    seen = compare(Side("A", (of_one(weak, 4),)), Side("B", (of_single,))).differences
    slopes = [d for d in seen if d.a.symbol == "m" and d.a.at["contraction"] == 0]
    assert slopes
    assert all(d.score < -1 and d.relative == pytest.approx(-0.05, abs=2e-3) for d in slopes)


def test_compare_divides_what_adds_up(arm, single):
    done = CliRunner().invoke(main, ["compare", arm.path, single.path, "--accept", "E_n<=1"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert "4 muscles side by side: forces and volumes are divided by 4" in done.output
    assert "F_b: agree at all" in done.output


def test_what_adds_up_side_by_side():
    adding = ("force", "stiffness", "damping", "volume", "force per pressure", "work", "mass flow")
    assert all(adds_up(name) for name in adding)
    assert not any(adds_up(name) for name in ("pressure", "length", "ratio", "time", "angle", "gain", ""))


def test_one_muscle_keeps_its_diameter(single):
    (found,) = (a for a in reduce_runs([single]) if a.kind == single.kind)
    assert without_diameter(found, 1) is found


def specimen(nominal, assembly):
    """The specimen file of one contractor, of another length and made of several."""
    given = yaml.safe_load((ROOT / "fixtures/specimens/contractor-30.yaml").read_text())
    return SpecimenFile.model_validate(
        {**given, "nominal_length": nominal, "mounted": {"length": nominal}, "assembly": assembly}
    )


def test_a_connector_that_is_counted_in_is_refused():
    """Two muscles of 30 cm and 20 mm between them: of 620 mm a contraction comes out 20 / 620 = 3.2 % too small."""
    two = {"series": 2, "section": "300 mm", "connector": "20 mm"}
    assert specimen("600 mm", two).assembly.series == 2
    with pytest.raises(ValueError, match=r"do not contract; every contraction would come out 3\.2% too small"):
        specimen("620 mm", two)
    with pytest.raises(ValueError, match="too large"):
        specimen("300 mm", two)


LONG = """
include: mock-contractor.yaml
name: {name}
actuator: {{stroke: [0 mm, 180 mm], speed: 500 mm/s, force: 2700 N}}
devices:
  plant: {{options: {{plant: long-plant.yaml, actuator_high: 0.2, seed: {seed}}}}}
channels:
  displacement: {{device: plant, input: displacement, range: [-5 mm, 200 mm], unit: m, calibration: null}}
  displacement_command: {{device: plant, input: displacement_set, range: [-10 mm, 200 mm], unit: m}}
outputs:
  displacement: {{device: plant, output: displacement, scale: [[0 mm, 0 mm], [180 mm, 180 mm]]}}
limits:
  displacement: {{command: 160 mm}}
"""
"""A bench of one's own with 60 cm of contractor, behind the shipped files that it includes."""


def end_to_end(lab, name, seed, serial, length, assembly=None):
    """A run on that bench of a specimen that is said to be so long [mm]; its folder."""
    given = yaml.safe_load((ROOT / "fixtures/specimens/contractor-30.yaml").read_text())
    place = given["mounted"] | {"length": f"{length} mm"}
    made = given | {"nominal_length": f"{length} mm", "serial": serial, "mounted": place}
    (lab / f"{name}.yaml").write_text(LONG.format(name=name, seed=seed))
    (lab / f"{name}-muscle.yaml").write_text(yaml.safe_dump(made | ({"assembly": assembly} if assembly else {})))
    mounted_here = mount(lab / f"{name}.yaml", lab / f"{name}-muscle.yaml")
    plan = make_plan(ROOT / "protocols/isometric-pressurisation.yaml", mounted_here, SHORT)[0]
    outcome = run_plan(plan, mounted_here, ConfirmedBeforehand(), out=lab / name)
    assert outcome.exit_code == 0, outcome.why
    return str(outcome.folder)


def test_two_of_30_cm_end_to_end_are_one_of_60_cm_where_the_connector_is_left_out(tmp_path):
    benches = ROOT / "fixtures/benches"
    for name in ("mock.yaml", "mock-actuator.yaml", "mock-contractor.yaml"):
        shutil.copy(benches / name, tmp_path)
    shutil.copytree(benches / "calibrations", tmp_path / "calibrations")
    plant = (ROOT / "fixtures/plants/contractor-30.yaml").read_text()
    (tmp_path / "long-plant.yaml").write_text(plant.replace("length: 300 mm", "length: 600 mm"))
    two = {"series": 2, "section": "300 mm", "connector": "20 mm"}
    one = end_to_end(tmp_path, "one", 1, "LONG", 600)
    pair = end_to_end(tmp_path, "pair", 2, "PAIR", 600, two)
    counted_in = end_to_end(tmp_path, "counted", 3, "COUNTED-IN", 620)

    done = CliRunner().invoke(main, ["compare", pair, one, "--accept", "E_n<=1"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    (found,) = (a for a in reduce_runs([open_run(pair)]) if a.kind == "isometric-pressurisation")
    slopes = {e.at["contraction"]: e for e in found.estimates if e.symbol == "m" and not e.withheld and e.value}
    for x, e in slopes.items():
        assert e.value == pytest.approx(force(4.5e5, x / 0.6) / (4.5e5 - 45e3), rel=0.06)
    # 20 mm that do not contract, counted in: 10 % are 62 mm, and the force there is that of 10.3 %
    far = at_pressure(open_run(counted_in), 0.062, 4e5)
    assert far == pytest.approx(force(4e5, 0.062 / 0.6), abs=2.0)
    assert at_pressure(open_run(one), 0.06, 4e5) - far > 5.0


def test_the_mock_takes_whole_muscles_at_a_driven_end_only():
    with pytest.raises(DeviceError, match="driven free end"):
        MockBench(DeviceRecord("plant", "", "", {"parallel": 4}), VirtualClock())
    with pytest.raises(ValueError, match="it is one muscle without air"):
        preset("real", "bench", Overrides(parallel=4.0))
