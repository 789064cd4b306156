"""Isometric pressurisation as a plan: where the driven end goes, what the pressure does there, and what is refused."""

from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.engine.resume import remaining
from pmabench.kinds.compile import make_plan
from pmabench.protocol.plan import Ramp, Set

ROOT = Path(__file__).resolve().parents[2]
PLAIN = ROOT / "protocols" / "isometric-pressurisation.yaml"
SIDES = ROOT / "protocols" / "isometric-pressurisation-paper3.yaml"


def plan(*settings, path=PLAIN, bench="mock-actuator", specimen="mas-20-250-paper0"):
    places = (ROOT / "fixtures" / "benches" / f"{bench}.yaml", ROOT / "fixtures" / "specimens" / f"{specimen}.yaml")
    return make_plan(path, mount(*places), settings)[0]


def refused(*settings, **of):
    with pytest.raises(InvalidFile) as caught:
        plan(*settings, **of)
    return str(caught.value)


def test_shares_and_lengths_name_the_same_place():
    one = plan(("sweep.matrix.contraction", "[8 %, 20 mm]"), ("sweep.repeat.count", "1"))
    assert [trial.point for trial in one.trials] == [{"contraction": 0.02}] * 2


def moves_and_ramps(steps):
    """Motions, and ramps of pressure with the place at which they happen; each motion begins where the last ended."""
    moves, ramps, at = [], [], 0.0
    for step in steps:
        if isinstance(step, Ramp) and step.output == "displacement":
            assert step.origin == pytest.approx(at)
            at = step.to
            moves.append((step.phase, round(at, 6)))
        elif isinstance(step, Ramp) and step.phase in {"fill", "empty"}:
            ramps.append((step.phase, step.origin, step.to, step.rate, at))
    assert at == 0.0
    return moves, ramps


def test_the_driven_end_does_not_move_while_the_pressure_ramps():
    """Paper 3: fixed position, slow pressurisation."""
    found = plan(("sweep.matrix.contraction", "[0 %, 8 %]"), ("sweep.repeat.count", "1"))
    moves, ramps = moves_and_ramps(found.steps)
    up, down = ("fill", 0.0, 500e3, 20e3), ("empty", 500e3, 0.0, 20e3)
    assert ramps == [(*up, 0.0), (*down, 0.0), (*up, 0.02), (*down, 0.02)]
    assert moves == [("approach", 0.02), ("return", 0.0)]
    assert isinstance(found.steps[-2], Set)
    assert found.steps[-2].value == 0.0


def test_from_both_sides_it_goes_beyond_first():
    found = plan(("sweep.matrix.contraction", "[6 %]"), ("sweep.repeat.count", "1"), path=SIDES,
                 bench="mock-daerden-ideal", specimen="daerden-20-200")  # fmt: skip
    assert [trial.point["side"] for trial in found.trials] == [-1.0, 1.0]
    moves, _ = moves_and_ramps(found.steps)
    below, above = ("move", 0.008), ("move", 0.016)
    there, back = ("approach", 0.012), ("return", 0.0)
    assert moves == [below, there, back, above, there, back]


def test_a_run_that_goes_on_never_jumps():
    """Whichever trials are done, the driven end is where each motion begins."""
    found = plan(path=SIDES, bench="mock-daerden-ideal", specimen="daerden-20-200")
    for done in ({0}, {0, 1, 2}, {0, 3, 5}, set(range(31))):
        _, ramps = moves_and_ramps(remaining(found, done))
        assert len(ramps) == 2 * (32 - len(done))


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("sweep.matrix.contraction", "[30 %]", "75 mm is above the limit for commanded displacement"),
        ("sweep.matrix.contraction", "[-5 %]", "below the limit for commanded displacement"),
        ("sweep.matrix.contraction", "[3]", 'a share of the nominal length, for instance "5 %"'),
        ("sweep.matrix.contraction", "[20 kPa]", "no unit of length"),
        ("sweep.matrix.contraction", "[]", "contraction"),
        ("trial.pressurise.stop", "700 kPa", "above the limit for commanded pressure"),
        ("trial.pressurise.stop", "0 kPa", "must lie above the start"),
        ("trial.pressurise.start", "-20 kPa", "below the limit for commanded pressure"),
        ("trial.pressurise.rate", "0 kPa/s", "must be above zero"),
        ("trial.pressurise.rate", "400 kPa/s", "too fast: the ramp has fewer than 200 samples; at most 250 kPa/s"),
        ("trial.move.speed", "2 m/s", "the actuator at most at 500 mm/s"),
        ("trial.move.speed", "-1 mm/s", "must be above zero"),
        ("trial.move.beyond", "2 mm", 'is for "approach: from-both-sides" only'),
        ("trial.move.approach", "from-both-sides", "must be above zero"),
        ("trial.move.approach", "sideways", "from-both-sides"),
        ("trial.settle", "0 s", "must be above zero"),
        ("record", "[pressure, displacement]", 'lacks "force"'),
        ("accept", "{B_c: {relative_interval: 5 %}}", "it gives F_ce, K"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(name, value, says):
    text = refused((name, value))
    assert says in text
    assert name.split(".")[-1] in text or "isometric-pressurisation.yaml:" in text or "--set" in text


def test_a_force_beyond_actuator_or_trip_is_refused_before_anything_moves(tmp_path):
    specimen = (ROOT / "fixtures" / "specimens" / "mas-20-250-paper0.yaml").read_text()
    strong = tmp_path / "strong.yaml"
    strong.write_text(specimen.replace("F_ce: 491 N", "F_ce: 1600 N"))
    mounted = mount(ROOT / "fixtures" / "benches" / "mock-actuator.yaml", strong)
    with pytest.raises(InvalidFile) as caught:
        make_plan(PLAIN, mounted, ())
    text = str(caught.value)
    assert "at 500 kPa the force is predicted to reach 1606 N; the actuator bears 1500 N" in text
    assert "lower pressurise.stop" in text


def test_another_free_end_is_refused():
    assert 'whose free end is "actuator"' in refused(bench="mock")
