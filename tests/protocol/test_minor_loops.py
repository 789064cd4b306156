"""Minor loops: where they go, what is refused, and that the reduction of the wide loop does not see them."""

from itertools import pairwise
from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.compile import make_plan, plan_campaign
from pmabench.kinds.reduce import reduce_runs
from pmabench.protocol.plan import Ramp
from pmabench.store.reader import open_run

ROOT = Path(__file__).resolve().parents[2]
RAMP = ROOT / "protocols" / "isobaric-ramp.yaml"
FILL = ROOT / "protocols" / "isometric-pressurisation.yaml"
IN_STROKE = ("trial.minor", "{lower: 8 mm, upper: 12 mm, cycles: 2}")
IN_PRESSURE = ("trial.pressurise.minor", "{lower: 200 kPa, upper: 300 kPa}")


def bench():
    fixtures = ROOT / "fixtures"
    return mount(fixtures / "benches" / "mock-actuator.yaml", fixtures / "specimens" / "mas-20-250-paper0.yaml")


def minor_ramps(path, *settings):
    plan = make_plan(path, bench(), settings)[0]
    return [(s.output, s.origin, s.to) for s in plan.steps if isinstance(s, Ramp) and s.phase == "minor"]


def test_a_minor_loop_of_contraction_goes_to_its_upper_end_and_turns_there():
    one = [("sweep.matrix.pressure", "[300 kPa]"), ("sweep.matrix.speed", "[5 mm/s]")]
    places = [0.0, 0.012, 0.008, 0.012, 0.008, 0.012, 0.0]
    expected = [("displacement", a, b) for a, b in pairwise(places)]
    assert minor_ramps(RAMP, *one, IN_STROKE) == expected
    assert minor_ramps(RAMP, *one) == []


def test_a_minor_loop_of_pressure_likewise():
    one = [("sweep.matrix.contraction", "[8 %]"), ("sweep.repeat.count", "1")]
    levels = [0.0, 300e3, 200e3, 300e3, 0.0]
    expected = [("pressure", a, b) for a, b in pairwise(levels)]
    assert minor_ramps(FILL, *one, IN_PRESSURE) == expected


@pytest.mark.parametrize(
    ("path", "name", "value"),
    [
        (RAMP, "trial.minor", "{lower: 12 mm, upper: 8 mm}"),
        (RAMP, "trial.minor", "{lower: 8 mm, upper: 20 mm}"),
        (FILL, "trial.pressurise.minor", "{lower: 0 kPa, upper: 300 kPa}"),
        (FILL, "trial.pressurise.minor", "{lower: 300 kPa, upper: 300 kPa}"),
    ],
)
def test_a_minor_loop_lies_within_the_wide_one(path, name, value):
    with pytest.raises(InvalidFile, match="its lower and upper end must rise, and lie between"):
        make_plan(path, bench(), [(name, value)])


@pytest.mark.parametrize(
    ("path", "settings", "minor"),
    [
        (RAMP, [("sweep.matrix.pressure", "[300 kPa]"), ("sweep.matrix.speed", "[10 mm/s]")], IN_STROKE),
        (FILL, [("sweep.matrix.contraction", "[8 %]"), ("sweep.repeat.count", "1")], IN_PRESSURE),
    ],
)
def test_the_wide_loop_alone_is_reduced(tmp_path, path, settings, minor):
    """The mock is the same up to the minor loop, sample by sample, so all values of the last trial are."""
    found = []
    for name, more in (("without", []), ("with", [minor])):
        plan = make_plan(path, bench(), [*settings, *more])[0]
        outcome = run_plan(plan, bench(), ConfirmedBeforehand(), out=tmp_path / name)
        (analysis,) = reduce_runs([open_run(outcome.folder)])
        found.append([(e.symbol, e.at, e.value) for e in analysis.estimates])
    assert found[0] == found[1]
    assert any(value is not None for _, _, value in found[0])


def test_the_campaign_for_a_surface_takes_at_most_45_minutes():
    _, planned = plan_campaign(ROOT / "fixtures" / "campaigns" / "real-muscle.yaml")
    assert sum(run.plan.duration()[1] for run in planned) <= 45 * 60
