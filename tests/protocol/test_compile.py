"""Protocols compile to plans of plain data, inside the limits of bench and specimen, or say what is wrong where."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.kinds.compile import make_plan, plan_campaign
from pmabench.protocol.driven import predicted_force
from pmabench.protocol.plan import Ask, Follow, Hold, Ramp, Record, Seek, Set

ROOT = Path(__file__).resolve().parents[2]
SPECIMEN = ROOT / "fixtures" / "specimens" / "mas-20-250-paper0.yaml"
BENCH_OF = {
    "static-load": "mock",
    "static-load-hands-at-pressure": "mock-hands-at-pressure",
    "contraction-relaxation": "mock",
    "contraction-relaxation-paper1": "mock-dmsp",
    "sinusoidal-displacement": "mock-actuator",
    "ultimate-gain": "mock",
    "ultimate-gain-relay": "mock",
    "ultimate-gain-open-loop": "mock",
    "positioning-pi": "mock",
    "positioning-path": "mock",
    "validation": "mock",
    "isometric-pressurisation": "mock-actuator",
    "isometric-pressurisation-paper3": "mock-daerden-ideal",
    "sinusoidal-displacement-paper3": "mock-daerden",
    "isobaric-ramp": "mock-actuator",
    "free-contraction": "mock-contractor-free",
    "arm-angle": "mock-arm",
    "step-displacement": "mock-daerden",
    "closed-volume": "mock-daerden-closed",
    "isobaric-ramp-paper3": "mock-daerden-ideal",
    "joint-sweep": "mock-joint",
    "joint-torque": "mock-joint",
    "platform": "mock-platform",
    "platform-paper3": "mock-platform",
    "joint-step": "mock-joint-free",
    "relaxation": "mock-daerden-relaxing",
    "isometric-pressurisation-flow": "mock-daerden-flow",
    "real-muscle-ramps": "mock-actuator",
    "real-muscle-pressurisation": "mock-actuator",
    "real-muscle-sines": "mock-actuator",
    "real-muscle-holds": "mock-actuator",
}


def mounted(name="mock"):
    stems = {
        "daerden": "daerden-20-200",
        "dmsp": "dmsp-40-305",
        "contractor": "contractor-30",
        "arm": "arm-30",
        "joint": "joint-daerden",
        "platform": "platform-daerden",
    }
    stem = next((stem for part, stem in stems.items() if part in name), SPECIMEN.stem)
    return mount(ROOT / "fixtures" / "benches" / f"{name}.yaml", SPECIMEN.with_stem(stem))


def plan(name, *settings, bench=None):
    return make_plan(ROOT / "protocols" / f"{name}.yaml", mounted(bench or BENCH_OF[name]), settings)[0]


@pytest.mark.parametrize("name", sorted(BENCH_OF))
def test_every_shipped_protocol_names_its_paper_and_compiles(name):
    assert {path.stem for path in (ROOT / "protocols").glob("*.yaml")} == set(BENCH_OF)
    compiled = plan(name)
    assert "paper" in compiled.source
    assert compiled.trials
    shortest, longest = compiled.duration()
    assert 0 < shortest <= longest
    assert json.loads(compiled.to_json())["kind"] == compiled.kind
    assert compiled.sha256 == plan(name).sha256


def test_contraction_uses_the_loads_and_pressures_of_paper_0():
    compiled = plan("contraction-relaxation", ("sweep.repeat.count", "1"))
    assert len(compiled.trials) == 88
    loads = sorted({trial.point["load"] for trial in compiled.trials})
    assert loads == pytest.approx([58.86 + 49.05 * i for i in range(11)])
    assert compiled.trials[0].point["mass"] == pytest.approx(8.0)
    asks = [step for step in compiled.steps if isinstance(step, Ask)]
    assert len(asks) == 11
    assert all(step.demands == "vented" for step in asks)


def test_relaxation_goes_down_in_steps_and_is_tagged():
    compiled = plan("contraction-relaxation", ("sweep.matrix.load", "[6 kg]"), ("sweep.matrix.pressure", "[450 kPa]"))
    one = [step for step in compiled.steps if isinstance(step, Set) and step.phase != "precondition"]
    assert [(step.phase, step.value / 1e3) for step in one[:6]] == [
        ("contract", 450.0), ("relax", 350.0), ("relax", 250.0), ("relax", 150.0), ("relax", 50.0), ("vent", 0.0),
    ]  # fmt: skip


def test_a_relaxation_does_not_go_up():
    relaxed = ("sweep.matrix.load", "[6 kg]"), ("sweep.matrix.pressure", "[300 kPa, 450 kPa]")
    with pytest.raises(InvalidFile, match="400 kPa is above the pressure of a trial, 300 kPa") as refused:
        plan("contraction-relaxation", *relaxed, ("trial.relax.then", "400 kPa"))
    assert len(refused.value.problems) == 1
    assert plan("contraction-relaxation", *relaxed, ("trial.relax.then", "300 kPa")).trials


def test_the_reference_trial_comes_first_last_and_between():
    extra = ("reference_trial", "{load: 6 kg, pressure: 300 kPa, every: 3}")
    compiled = plan("contraction-relaxation", extra, ("sweep.matrix.load", "[6 kg]"), ("sweep.repeat.count", "1"))
    assert [trial.reference for trial in compiled.trials] == [
        True, False, False, False, True, False, False, False, True, False, False, True,
    ]  # fmt: skip


def test_a_load_in_newtons_is_a_pure_force():
    compiled = plan("contraction-relaxation", ("sweep.matrix.load", "[58.86 N]"))
    assert compiled.trials[0].point["mass"] == 0.5
    ideal = plan("contraction-relaxation", bench="mock-ideal")
    assert ideal.trials[0].point["load"] == pytest.approx(58.86)
    assert ideal.trials[0].point["mass"] == 0.5


def test_static_load_searches_both_directions_with_the_load_on_at_zero():
    compiled = plan("static-load")
    seeks = [step for step in compiled.steps if isinstance(step, Seek)]
    assert [step.phase for step in seeks[:4]] == ["lift", "raise", "lower", "set-down"]
    assert all(step.parameters["rate"] <= 2000.0 for step in seeks if step.phase in ("lift", "set-down"))
    assert not compiled.hazards


def test_hands_at_pressure_is_a_variant_that_says_so_and_is_capped():
    compiled = plan("static-load-hands-at-pressure")
    assert "under pressure" in compiled.hazards[0]
    with pytest.raises(InvalidFile, match="this bench allows them up to 0 kPa"):
        plan("static-load-hands-at-pressure", bench="mock")


def test_a_sine_that_goes_slack_is_refused():
    steps = [step for step in plan("sinusoidal-displacement").steps if isinstance(step, Follow)]
    assert {step.frequency for step in steps} == {0.1, 0.5, 1.0, 3.0}
    with pytest.raises(InvalidFile, match="predicted to fall to .* goes slack"):
        plan("sinusoidal-displacement", ("trial.mean", "25 mm"))
    with pytest.raises(InvalidFile, match="at most at 500 mm/s"):
        plan("sinusoidal-displacement", ("sweep.matrix.frequency", "[20 Hz]"))


def test_predicted_force_is_the_equation_of_motion():
    expected = mounted().specimen_file.expected
    low, high = predicted_force(expected, 300e3, 0.010, 0.005, 1e-6)
    assert low == pytest.approx(275 - 6.77 * 15 - 6, abs=1e-3)
    assert high == pytest.approx(275 - 6.77 * 5 + 6, abs=1e-3)
    fast, _ = predicted_force(expected, 300e3, 0.010, 0.005, 3.0)
    speed = 2 * 3.141592653589793 * 3.0 * 5.0
    closed = 275 - 6.77 * 10 - ((6.77 * 5) ** 2 + (1.68 * speed) ** 2) ** 0.5 - 6
    assert fast == pytest.approx(closed, abs=0.05)


def test_a_protocol_gets_the_free_end_that_it_needs():
    with pytest.raises(InvalidFile, match='needs a bench whose free end is "actuator"'):
        plan("sinusoidal-displacement", bench="mock")


def test_a_point_above_the_active_limit_names_both_places():
    with pytest.raises(InvalidFile) as caught:
        plan("contraction-relaxation", ("sweep.matrix.pressure", "[300 kPa, 700 kPa]"))
    (problem,) = caught.value.problems
    assert (problem.path, problem.column) == ("--set sweep.matrix.pressure", 18)
    assert "above the limit for commanded pressure, 600 kPa" in problem.message
    assert "mock.yaml:" in problem.message


TEN_MISTAKES = """schema: pmabench.protocol/1
kind: contraction-relaxation
name: wrong
sorce: nobody
needs: {free_end: wieghts}
sample_rate: 500
record: [presure, displacement]
sweep:
  matrix:
    load: [6 kg, 7 mm]
    pressure: [1,5 bar, nan]
  order: snail
trial:
  contract: {hold: 10}
  relax: {by: 100 kPa, hold: 4 s, hold_at_end: 6 kPa}
"""


def test_ten_mistakes_give_ten_located_messages(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(TEN_MISTAKES)
    with pytest.raises(InvalidFile) as caught:
        make_plan(path, mounted())
    places = [(p.line, p.column) for p in caught.value.problems]
    assert len(places) >= 10
    assert len(set(places)) >= 10
    text = str(caught.value)
    for expected in ("mine.yaml:4:1", 'did you mean "source"', 'did you mean "weights"', 'did you mean "pressure"',
                     'for instance "500 Hz"', "neither a mass nor a force", 'did you mean "snake"', "10 needs a unit"):  # fmt: skip
        assert expected in text


def test_an_unknown_kind_gets_the_nearest(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text("kind: static-lod\n")
    with pytest.raises(InvalidFile, match='did you mean "static-load"'):
        make_plan(path, mounted())


def test_plan_counts_rows_of_the_recorded_time():
    compiled = plan("contraction-relaxation", ("sweep.matrix.load", "[6 kg]"), ("sweep.matrix.pressure", "[150 kPa]"),
                    ("sweep.repeat.count", "1"))  # fmt: skip
    assert compiled.rows() == round((0.2 + 10 + 4 + 6) * 500)
    assert sum(isinstance(step, Record) for step in compiled.steps) == 2


def test_the_demo_campaign_uses_two_benches():
    _, planned = plan_campaign(ROOT / "fixtures" / "campaigns" / "demo.yaml")
    assert {run.mounted.bench.free_end for run in planned} == {"weights", "actuator"}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("trial.relax.hold_at_end", "-100 s"), "not below zero"),
        (("sweep.repeat.count", "200"), "more than 200000 steps"),
        (("sample_rate", "0.01 Hz"), "greater than or equal to 10"),
        (("kind", "[a]"), "unknown kind of protocol"),
    ],
)
def test_what_a_plan_cannot_be(change, says):
    with pytest.raises(InvalidFile, match=says):
        plan("contraction-relaxation", change, ("trial.relax.by", "2.5 kPa"))


def test_the_driven_end_never_starts_with_a_jump():
    steps = [step for step in plan("sinusoidal-displacement").steps if isinstance(step, Ramp)]
    assert (steps[0].origin, steps[0].to) == (0.0, 0.01)
    with pytest.raises(InvalidFile, match="approaches at 600 mm/s; the actuator at most at 500 mm/s"):
        plan("sinusoidal-displacement", ("trial.approach", "600 mm/s"))


@pytest.mark.parametrize(
    ("load", "says"),
    [
        ("6.37 kg", r"6.37 kg cannot be made .* nearest: 6.1 kg or 10.6 kg"),
        ("0.5 kg", "nearest: 0 kg or 1.1 kg"),
        ("61 kg", "nearest: 60.6 kg$"),
        ("58.9 N", r"nearest: 58.86 N \(6 kg\)"),
        ("200 kg", r"weighs 1962 N, not below the trip limit for measured force, 1900 N \(.*mock.yaml:\d+:\d+\)"),
        ("-1 kg", "not below zero"),
    ],
)
def test_loads_that_the_bench_cannot_make_or_bear(load, says):
    with pytest.raises(InvalidFile, match=says) as caught:
        plan("contraction-relaxation", ("sweep.matrix.load", f"[6 kg, {load}]"))
    (problem,) = caught.value.problems
    assert (problem.path, problem.column) == ("--set sweep.matrix.load", 15)


@pytest.mark.parametrize("name", sorted(BENCH_OF))
def test_a_record_without_what_the_fit_needs_is_refused(name):
    several = ("joint-sweep", "joint-torque", "joint-step", "platform", "platform-paper3")
    lacking = {"arm-angle": "angle", "relaxation": "force"} | dict.fromkeys(several, "pressure_1")
    channel = lacking.get(name, "displacement")
    record = "[pressure, displacement]" if name == "relaxation" else "[pressure, force]"
    with pytest.raises(InvalidFile, match=f'record:1:8  lacks "{channel}"'):
        plan(name, ("record", record))


@pytest.mark.parametrize("interval", ["-2 %", "0"])
def test_an_accepted_interval_is_wider_than_nothing(interval):
    with pytest.raises(InvalidFile, match="an interval must be > 0 %"):
        plan("contraction-relaxation", ("accept.K.relative_interval", interval))


def test_a_plan_without_end_is_refused():
    with pytest.raises(InvalidFile, match=r"the whole plan can take \d+ years .* at most 30 days"):
        plan("contraction-relaxation", ("trial.contract.hold", "1e9 s"))
    with pytest.raises(InvalidFile, match="more than a million years"):
        plan("sinusoidal-displacement", ("trial.at_least", "1e308 s"), ("trial.settle", "1e308 s"))


def test_a_bench_without_the_commanded_pressure_is_refused_where_the_search_reads_it():
    bench = mounted()
    bench = replace(bench, bench=without(bench.bench, "pressure_command"))
    with pytest.raises(InvalidFile, match='needs the channel "pressure_command", which the bench does not have'):
        make_plan(ROOT / "protocols" / "static-load.yaml", bench, [("record", "[pressure, displacement]")])
    record = ("record", "[pressure, displacement]")
    assert make_plan(ROOT / "protocols" / "contraction-relaxation.yaml", bench, [record])


def without(bench, channel):
    devices = tuple(replace(d, channels=tuple(c for c in d.channels if c.name != channel)) for d in bench.devices)
    return replace(bench, devices=devices)


def test_the_longest_time_of_hands_counts_the_vent_before_them_and_the_wait_after():
    vented, pressed = Ask("load", "x"), Ask("load", "x", demands="at-pressure")
    assert vented.longest() == 33.0
    assert pressed.longest() == 3.0
    assert vented.shortest() == 3.0
    compiled = plan("contraction-relaxation", ("sweep.repeat.count", "1"), ("prepare.precondition.cycles", "0"))
    shortest, longest = compiled.duration()
    assert longest - shortest == pytest.approx(11 * 30.0)


def test_the_rest_comes_before_the_first_trial_and_after_preconditioning():
    both = "{precondition: {cycles: 1, pressure: 300 kPa, hold: 1 s}, rest: 20 min}"
    compiled = plan("isobaric-ramp", ("prepare", both))
    holds = [(n, s.duration) for n, s in enumerate(compiled.steps) if isinstance(s, Hold) and s.phase == "precondition"]
    first = next(n for n, s in enumerate(compiled.steps) if isinstance(s, Record))
    assert [seconds for _, seconds in holds] == [1.0, 1.0, 1200.0]
    assert holds[-1][0] < first


def test_the_rest_before_the_first_trial_is_not_that_of_the_strokes():
    """It stood in the settings in its place, and windows before a ramp were 10 min long."""
    assert plan("closed-volume", ("prepare", "{rest: 20 min}")).settings["rest"] == 2.0


@pytest.mark.parametrize(
    ("name", "symbol", "gives"),
    [
        ("static-load", "K_u", "F_ce"),
        ("contraction-relaxation", "B", "F_ce, K, B_c, B_r, F_c"),
        ("sinusoidal-displacement", "B_c", "K, B, F_c"),
        ("ultimate-gain", "K", "K_u, T_u"),
    ],
)
def test_what_a_kind_cannot_give_cannot_be_accepted(tmp_path, name, symbol, gives):
    text = (ROOT / "protocols" / f"{name}.yaml").read_text().split("\naccept:")[0]
    path = tmp_path / "protocol.yaml"
    path.write_text(f"{text}\naccept:\n  {gives.split(', ')[0]}: {{relative_interval: 5 %}}\n")
    make_plan(path, mounted(BENCH_OF[name]))
    path.write_text(f"{text}\naccept:\n  {symbol}: {{relative_interval: 5 %}}\n")
    with pytest.raises(InvalidFile) as caught:
        make_plan(path, mounted(BENCH_OF[name]))
    (problem,) = caught.value.problems
    line = path.read_text().splitlines().index(f"  {symbol}: {{relative_interval: 5 %}}") + 1
    assert (problem.line, problem.column) == (line, 3)
    assert problem.message == f'"{name}" does not give {symbol}; it gives {gives}'
