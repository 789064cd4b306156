"""Fast strokes push air together: predicted, capped before anything moves, and stopped by the watch where forced."""

import shutil
from math import cos, inf, pi, radians

import numpy as np
import pytest

from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.compile import make_plan
from pmabench.kinds.sinusoidal_displacement import protocol as sinusoidal_displacement
from pmabench.model.library import MODELS
from pmabench.model.library.chamber import driven_chamber
from pmabench.protocol.driven import Supply, Tube, peak
from pmabench.store.reader import open_run
from tests.analysis.driven_runs import ROOT, planned

FORCED = (("sweep.concat.0.zip.frequency", "[3 Hz]"), ("sweep.concat.0.zip.pressure", "[5 bar]"),
          ("sweep.concat.0.zip.amplitude", "[23 mm]"))  # fmt: skip
TUBE = Tube(0.02, 0.2, radians(25.0))


def path(low=-6e-3, high=40e-3, n=360):
    return [(low + high) / 2 - (high - low) / 2 * cos(2 * pi * i / n) for i in range(n)]


def test_the_volume_is_that_of_the_library():
    """Papers digest 5.5: 40.9 cm3 at -3 %, 152.0 cm3 at 20 %; the free cylinder at 0."""
    volumes = [1e6 * TUBE.volume(x) for x in (-6e-3, 0.0, 40e-3)]
    assert volumes == pytest.approx([40.9, 62.832, 152.0], abs=0.06)


def test_a_motion_longer_than_the_muscle_leaves_no_volume():
    """It was the power 2.6 of a negative number: `check` ended in a TypeError."""
    assert TUBE.volume(23.0) == 0.0
    assert peak(3e5, [0.0, 23.0], 1.0, TUBE, None, 101325.0) == inf


@pytest.mark.parametrize("frequency", [0.1, 1.0, 3.0])
def test_the_peak_is_that_of_the_driven_chamber(frequency):
    """The library integrates with LSODA; the exponent is its own here, 1.4."""
    given = {p.name: np.float64(p.value) for p in MODELS["driven-chamber"].parameters if p.name != "time"}
    given |= {"frequency": np.float64(frequency), "polytropic": np.float64(1.4)}
    times = np.linspace(0.0, 4 / frequency, 2000)
    expected = float(driven_chamber(time=times, **given)["pressure"].max())
    reported = peak(5e5, path(), 1 / frequency, TUBE, Supply(1e-7, 0.5e-7, 101325.0), 101325.0)
    assert reported - 5e5 == pytest.approx(expected - 5e5, rel=0.02)


def test_a_closed_volume_is_the_polytropic_law():
    closed = peak(1e5, path(), 1.0, TUBE, None, 101325.0)
    assert closed == pytest.approx(201325.0 * (152.0 / 40.9) ** 1.4 - 101325.0, rel=2e-3)


def test_3_hz_over_the_full_stroke_at_5_bar_is_refused_and_what_would_go_is_reported():
    with pytest.raises(InvalidFile) as caught:
        planned("sinusoidal-displacement-paper3", "mock-daerden", "daerden-20-200", *FORCED)
    (problem,) = caught.value.problems
    assert "pushes the air together to 705 kPa" in problem.message
    assert "the cap is 650 kPa (trip of measured pressure, " in problem.message
    assert "mock-daerden.yaml:" in problem.message
    assert "allowed are amplitude up to 18 mm or frequency up to 2.2 Hz or pressure up to 450 kPa" in problem.message


@pytest.mark.parametrize("change", [("sweep.concat.0.zip.amplitude", "[18 mm]"), ("sweep.concat.0.zip.frequency", "[2.2 Hz]"),
                                    ("sweep.concat.0.zip.pressure", "[450 kPa]")])  # fmt: skip
def test_what_is_said_to_be_allowed_is(change):
    assert planned("sinusoidal-displacement-paper3", "mock-daerden", "daerden-20-200", *FORCED, change).trials


def test_a_bench_that_does_not_show_its_regulator_counts_as_closed_unless_it_is_slow(tmp_path):
    shutil.copytree(ROOT / "fixtures" / "benches", tmp_path / "benches")
    bench = tmp_path / "benches" / "mock-daerden.yaml"
    kept = [line for line in bench.read_text().splitlines() if not line.startswith("air: {conductance")]
    bench.write_text("\n".join(kept))
    mounted = mount(bench, ROOT / "fixtures" / "specimens" / "daerden-20-200.yaml")
    protocol = ROOT / "protocols" / "sinusoidal-displacement-paper3.yaml"
    with pytest.raises(InvalidFile, match="as a closed volume, for the bench file has no air: {conductance"):
        make_plan(protocol, mounted, [])
    only_slow = [(f"sweep.concat.{i}.zip.{name}", f"[{value}]") for i in (0, 1)
                 for name, value in (("frequency", "0.05 Hz"), ("pressure", "3 bar"), ("amplitude", "23 mm"))]  # fmt: skip
    assert make_plan(protocol, mounted, only_slow)[0].trials


def test_where_it_is_forced_the_watch_vents_before_the_muscles_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(sinusoidal_displacement, "not_pushed_together", lambda *_: None)
    mounted = mount(
        ROOT / "fixtures" / "benches" / "mock-daerden.yaml", ROOT / "fixtures" / "specimens" / "daerden-20-200.yaml"
    )
    changes = [*FORCED, *((f"sweep.concat.1.zip.{name}", f"[{v}]") for name, v in
                          (("frequency", "1 Hz"), ("pressure", "3 bar"), ("amplitude", "10 mm")))]  # fmt: skip
    plan = make_plan(ROOT / "protocols" / "sinusoidal-displacement-paper3.yaml", mounted, changes)[0]
    outcome = run_plan(plan, mounted, ConfirmedBeforehand(), out=tmp_path)
    assert outcome.exit_code != 0
    assert "pressure" in outcome.why
    run = open_run(outcome.folder)
    trips = [event for event in run.events if event.kind == "trip"]
    assert trips, [event.kind for event in run.events][-12:]
    highest = max(float(t.channels["pressure"].max()) for t in run.trials)
    assert 650e3 < highest < 700e3
