"""Static load: F_ce(P) between lift and set-down is that of plant 5.1, half their difference its friction."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pmabench.kinds.reduce import reduce_runs
from pmabench.kinds.static_load import line
from pmabench.kinds.static_load.reduction import reduce
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import RunData, TrialData
from tests.analysis.simulate import LOADS, contraction_run, rig, static_run


@cache
def study(kind: str) -> tuple[RunData, Analysis]:
    run = static_run(rig("paper0", kind, uncertainty=True))
    return run, reduce([run])


def F_ce(P: float) -> float:
    """The plant paper0."""
    return 1.08e-3 * P - 49.0


def at(analysis: Analysis, method: str) -> dict[float, float]:
    return {e.at["pressure"]: e.value for e in analysis.estimates if e.method == method and "pressure" in e.at}


def found_at(load: float, lift: float | None, set_down: float | None, index: int = 0, **point: float) -> TrialData:
    """A trial of which only the results are known."""
    found = {}
    for phase, P in (("lift", lift), ("set-down", set_down)):
        no = {"found": False, "reason": "displacement did not cross before the end of the range"}
        found[phase] = {"found": True, "pressure": P, "t": 1.0, "displacement": 2e-5} if P is not None else no
    return TrialData(
        "s", index, {"load": load, "mass": 5.0, **point}, 0, False, "finished", np.empty(0), {},
        np.empty(0, dtype=np.uint16), (), found,
    )  # fmt: skip


def of(trials: list[TrialData]) -> Analysis:
    return reduce([replace(study("ideal")[0], trials=tuple(trials))])


def test_ideal_gives_the_line_of_f_ce():
    _, analysis = study("ideal")
    line = next(c for c in analysis.curves if c.method == "static-mean")
    assert line.terms[0].value == pytest.approx(-49.0, abs=1.0)
    assert line.terms[1].value == pytest.approx(1.08e-3, rel=0.01)
    assert list(at(analysis, "static-mean")) == pytest.approx([1e3 * P for P in range(100, 551, 50)])


def test_bench_mean_of_both_directions_is_f_ce_and_one_side_is_not():
    _, analysis = study("bench")
    for P, value in at(analysis, "static-mean").items():
        assert abs(value - F_ce(P)) < 0.01 * F_ce(P) + 2.5
    for method, sign in (("static-lift", -1), ("static-set-down", 1)):
        off = [value - F_ce(P) for P, value in at(analysis, method).items()]
        assert all(6.0 < sign * value < 11.0 for value in off)
    assert all(e.bias is not None and not e.corrected for e in analysis.estimates if e.method == "static-lift")


@pytest.mark.parametrize(("gain", "more"), [(1.06, 0.0), (0.96, 0.0), (1.0, 10.8)])
def test_loads_that_are_not_what_is_marked_on_them_are_in_the_intervals(gain: float, more: float):
    """Marks in another unit, or a hanger that was forgotten: the cell knows, and F_ce was 4.5 half widths off."""
    run = study("bench")[0]
    marked = [replace(t, point={**t.point, "load": t.point["load"] / gain - more}) for t in run.trials]
    analysis = reduce([replace(run, trials=tuple(marked))])
    for e in (e for e in analysis.estimates if e.method == "static-mean" and e.at):
        assert e.ci95[0] <= F_ce(e.at["pressure"]) <= e.ci95[1]
    assert any("than the marks of the loads" in f.text and f.level == "doubt" for f in analysis.findings)
    assert not any("than the marks of the loads" in f.text for f in study("bench")[1].findings)


def test_a_cell_within_what_is_known_of_it_raises_no_doubt_and_lost_samples_hide_none():
    """A zero 0.7 N off where no offset is declared; one sample that is no number, not flagged."""
    run = study("bench")[0]
    forces = [t.channels["force"] + 0.7 for t in run.trials]
    near = [replace(t, channels={**t.channels, "force": F}) for t, F in zip(run.trials, forces, strict=True)]
    plain = {name: replace(info, offset_uncertainty=0.0) for name, info in run.channels.items()}
    assert not any("marks" in f.text for f in reduce([replace(run, trials=tuple(near), channels=plain)]).findings)
    lost = []
    for t in run.trials:
        F = 1.06 * t.channels["force"]
        F[len(F) // 2] = np.nan
        lost.append(replace(t, channels={**t.channels, "force": F}))
    assert any("6.0% more than the marks" in f.text for f in reduce([replace(run, trials=tuple(lost))]).findings)


def test_half_the_difference_lies_between_sliding_and_static_friction():
    _, analysis = study("bench")
    half = [e for e in analysis.estimates if e.symbol == "F_f"]
    assert len(half) == 1 + len(LOADS)
    assert all(6.0 < e.value < 10.6 for e in half)
    assert half[0].n == 5 * len(LOADS)


@pytest.mark.parametrize("seed", range(2))
def test_the_interval_covers_f_ce(seed: int):
    analysis = reduce([static_run(rig(), LOADS[::2], repeats=3, seed=seed)])
    for e in analysis.estimates:
        if e.method == "static-mean" and e.at:
            assert abs(e.value - F_ce(e.at["pressure"])) < e.parts.combined < 5.0


def test_calibration_is_the_offset_of_the_pressure():
    _, analysis = study("ideal")
    line = next(c for c in analysis.curves if c.method == "static-mean")
    assert line.terms[0].parts.calibration == pytest.approx(1.5e3 * 1.08e-3, rel=0.01)
    assert line.terms[1].parts.calibration is None
    assert any(
        "no calibration part: the record gives no gain uncertainty of pressure" in f.text for f in analysis.findings
    )


def test_a_line_from_results_alone():
    # F_ce = 1 N/kPa P, 10 N of friction
    trials = [found_at(F, 1e3 * (F + 10), 1e3 * (F - 10), i) for i, F in enumerate((100.0, 200.0, 300.0))]
    analysis = of(trials)
    assert at(analysis, "static-mean") == pytest.approx({P: 1e-3 * P for P in (1e5, 1.5e5, 2e5, 2.5e5, 3e5)})
    assert next(e for e in analysis.estimates if e.symbol == "F_f").value == pytest.approx(10.0)


def test_searches_that_found_nothing_are_listed():
    analysis = of([found_at(100.0, 1.1e5, 0.9e5), found_at(200.0, 2.1e5, 1.9e5, 1), found_at(900.0, None, None, 2)])
    assert [(d.trial, d.point["load"]) for d in analysis.dropped] == [("s/3", 900.0)]
    assert "did not cross" in analysis.dropped[0].reason
    assert analysis.facts["trials_used"] == 2


def test_one_direction_alone_is_doubted():
    trials = [found_at(F, None, 1e3 * (F - 10), i) for i, F in enumerate((100.0, 200.0, 300.0))]
    analysis = of(trials)
    assert {c.method for c in analysis.curves} == {"static-set-down"}
    assert any(f.level == "doubt" and "one direction only" in f.text for f in analysis.findings)


def test_one_load_makes_no_line():
    analysis = of([found_at(100.0, 1.1e5, 0.9e5)])
    assert not analysis.curves
    assert any(f.level == "fault" for f in analysis.findings)


def test_a_bent_f_ce_is_doubted():
    analysis = reduce([static_run(rig("serres2009"))])
    # serres2009: 3.207 P below 150 kPa, 2.91 P + 44.6 above; the loads reach 173 kPa
    assert any(f.level == "doubt" and "is no line" in f.text for f in analysis.findings)


def test_traces_show_points_and_lifts():
    _, analysis = study("bench")
    points, *lifts = analysis.traces
    assert points.figure == "static"
    assert len(points.columns["load"]) == 5 * len(LOADS)
    assert len(lifts) == 3
    for trace in lifts:
        assert len(trace.columns["t"]) <= 1500
        assert trace.marks["set-down"] < trace.marks["lift"]


def reported_stiffness(*points: tuple[float, float, float]) -> dict[str, object]:
    return {"stiffness": {"from": "contraction-relaxation", "points": [list(point) for point in points]}}


@pytest.mark.parametrize("seed", [1, 2])
def test_f_ce_is_that_at_x_0(seed: int):
    """Plant paper0: a lifted load hangs 0.3 to 0.5 mm above its support, K x is 3 N, and half of that would be missing."""
    analysis = reduce([static_run(rig("paper0", "bench"), LOADS[::2], repeats=3, seed=seed)])
    for P, value in at(analysis, "static-mean").items():
        assert abs(value - F_ce(P)) < 0.003 * F_ce(P) + 0.5
    mean = [e for e in analysis.estimates if e.method == "static-mean" and e.at]
    assert all(e.corrected and e.bias is not None and e.bias < 0 for e in mean)
    assert max(value - F_ce(P) for P, value in at(analysis, "static-lift").items()) < -6.0, "as found: low by friction"
    assert 6.0 < next(e for e in analysis.estimates if e.symbol == "F_f").value < 10.3, "F_c and F_s of the plant"
    assert any("are carried to x = 0" in f.text for f in analysis.findings)


def of_results(x: float) -> list[TrialData]:
    """F_ce = 1 N/kPa P, no friction, K = 20 N/mm: set-down is found at a contraction x [m], its way is not recorded."""
    trials = []
    for index, F in enumerate((100.0, 200.0, 300.0)):
        trial = found_at(F, 1e3 * F, 1e3 * (F + 20e3 * x), index)
        trial.found["set-down"]["displacement"] = x
        trial.found["lift"]["displacement"] = 0.0
        trials.append(trial)
    return trials


def test_where_the_way_down_is_not_recorded_k_of_another_test_carries_set_down_to_x_0():
    run = replace(study("ideal")[0], trials=tuple(of_results(0.5e-3)))
    alone, next_to = reduce([run]), reduce([run], reported_stiffness((2e5, 20e3, 400.0)))
    assert at(next_to, "static-mean") == pytest.approx({P: 1e-3 * P for P in (1e5, 1.5e5, 2e5, 2.5e5, 3e5)})
    assert at(alone, "static-mean")[2e5] == pytest.approx(195.0)
    assert any("process a test of K together" in f.text for f in alone.findings)
    assert at(next_to, "static-lift") == pytest.approx(at(alone, "static-lift")), "the paper's own sides stay as found"


def test_a_k_that_is_uncertain_widens_f_ce():
    run = replace(study("ideal")[0], trials=tuple(of_results(0.5e-3)))
    narrow, wide = (reduce([run], reported_stiffness((2e5, 20e3, half))) for half in (0.0, 8000.0))
    first, second = (next(e for e in a.estimates if e.method == "static-mean" and e.at) for a in (narrow, wide))
    assert second.value == pytest.approx(first.value)
    assert second.parts.method == pytest.approx(first.parts.method + 2.0, abs=0.05), "half of 8 N/mm times 0.5 mm"


def test_k_comes_from_the_contraction_test_that_is_processed_together():
    bench = rig("paper0", "bench")
    cells = [(load, P) for load in LOADS[1:6:2] for P in (3e5, 4e5, 5e5)]
    runs = [static_run(bench, LOADS[::4], repeats=2), contraction_run(bench, cells)]
    static, steps, _ = reduce_runs(runs)
    assert [static.kind, steps.kind] == ["static-load", "contraction-relaxation"]
    assert static.facts["options"]["stiffness"]["from"] == "contraction-relaxation"
    assert all(e.corrected for e in static.estimates if e.method == "static-mean" and e.at)


def turning(w):
    """A force that turns exponentially on a way w [m]: dz/dx = (1 - z)/w upward, (1 + z)/w downward."""
    return lambda z, change: z + (np.sign(change) - z) * -np.expm1(-abs(change) / w)


def stops(ways):
    """Springs with sliders (Maxwell slip), each yielding after a way [m]; their mean reaches 1."""
    ways = np.array(ways)
    return lambda z, change: np.clip(z + change / ways, -1.0, 1.0)


SLOW = stops([0.2e-3, 1e-3, 3e-3, 8e-3])


@pytest.mark.parametrize(("after", "stroke", "widest"), [
    (turning(0.5e-3), 12e-3, 4.1), (turning(1.5e-3), 12e-3, 4.1), (turning(3e-3), 12e-3, 4.5),
    (turning(6e-3), 12e-3, 7.0), (SLOW, 12e-3, 16.0), (turning(1.5e-3), 6e-3, 7.0), (turning(3e-3), 6e-3, 20.0),
    (SLOW, 6e-3, 30.0),
])  # fmt: skip
def test_what_the_ends_of_a_stroke_keep_of_hysteresis_is_reported_by_its_loop(after, stroke, widest):
    """10 N of it, dry friction of 2 N, noise of 0.2 N: the mean of lift and set-down is higher by what is at the ends."""
    rng, s = np.random.default_rng(3), 2.6e-3
    x = np.linspace(0.0, stroke, 2001)
    z, ways = np.array([0.0] * 4), []
    for way in (x, x[::-1], x, x[::-1]):
        forces = []
        for change in np.diff(way, prepend=way[0]):
            z = after(z, change)
            forces.append(10.0 * float(np.mean(z)))
        ways.append(np.array(forces))
    (up, down), kept_at_end = ways[2:], -ways[3][-1]
    loads = np.repeat([60.0, 120.0, 240.0, 400.0], 3)
    loops = []
    for load in loads:
        P = (load + 15e3 * x + up + 2.0) / s, (load + 15e3 * x + down[::-1] - 2.0) / s
        P = [way + rng.normal(0, 0.2 / s, len(x)) for way in P]
        gap = np.interp(line.ALONG * stroke, x, P[0] - P[1])
        middle = [float(np.mean(way[(x > 0.4 * stroke) & (x < 0.6 * stroke)])) for way in P]
        loops.append(line.Loop(*middle, 0.0, stroke, gap))
    found = line.kept(loops, loads, np.full(len(loads), 4.0 / s), s)
    assert found is not None
    assert np.all(np.abs(found.force - kept_at_end) < found.half)
    assert np.all(found.half < widest)
