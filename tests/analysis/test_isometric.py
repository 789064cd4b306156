"""Isometric lines by a rule written beforehand: on our own old files, and on those of a lab where they are at hand."""

from pathlib import Path

import numpy as np
import pytest

from pmabench.analysis.shared.trials import mean_over_sessions
from pmabench.kinds.isometric import reduction as isometric
from pmabench.store.reader import open_run
from tests import fixtures_old_runs as made
from tests.analysis.judged_forms import as_run, as_trials
from tests.analysis.labs import SLOPE, lab
from tests.importing import import_files
from tests.judge import held
from tests.recorded import recorded_data

FIXTURES = Path(__file__).resolve().parents[2] / "fixtures"
OLD = FIXTURES / "old-runs"
LAB = {0.0: (0.647e-3, 0.05), 0.004: (0.641e-3, 0.05), 0.008: (0.587e-3, 0.05), 0.012: (0.545e-3, 0.10)}
"""Contraction [m] -> slope [N/Pa] that the lab fitted itself, and how near we have to come."""


def runs_of(files, map_path, out):
    return [open_run(run.path) for run in import_files(sorted(files), map_path, out)]


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    return runs_of(OLD.glob("isometric/*.csv"), OLD / "isometric.yaml", tmp_path_factory.mktemp("own"))


@pytest.fixture(scope="module")
def of_the_lab(tmp_path_factory):
    """The lab's own files; skipped where they are not at hand."""
    files = recorded_data().glob("aarl_10mm/*.csv")
    return runs_of(files, FIXTURES / "maps" / "aarl-10mm.yaml", tmp_path_factory.mktemp("lab"))


def slopes(analysis, method=isometric.METHOD):
    return {e.at["contraction"]: e for e in analysis.estimates if e.symbol == "m" and e.method == method}


def test_the_line_is_that_of_an_independent_fit_of_the_same_samples(own):
    found = slopes(isometric.reduce(own))
    rng = np.random.default_rng(20261121)
    samples = {c: [made.isometric(c, test, rng) for test in (1, 2, 10)] for c in (0.0, 0.004)}
    for contraction, tests in samples.items():
        each = []
        pressures, forces = [], []
        for test in tests:
            F = test[:, 0] * made.RIGHT[0] + made.RIGHT[1]
            P = 1e3 * (test[:, 1] * made.PRESSURE[0] + made.PRESSURE[1])
            each.append(np.polyfit(P[F > 20], F[F > 20], 1)[0])
            pressures.append(P[F > 20])
            forces.append(F[F > 20])
        slope = np.polyfit(np.concatenate(pressures), np.concatenate(forces), 1)[0]
        estimate = found[contraction]
        assert estimate.value == pytest.approx(slope, rel=1e-3)
        assert estimate.n == 3
        assert estimate.parts.repeats == pytest.approx(4.3027 * np.std(each, ddof=1) / np.sqrt(3), rel=0.05)


def test_each_branch_alone_has_the_slope_that_was_put_in(own):
    """The branches lie apart and are parallel above 100 kPa; the line through both need not have their slope."""
    analysis = isometric.reduce(own)
    for cell in analysis.facts["cells"]:
        slope, _ = made.TRUTH["isometric"][cell["contraction"]]
        for phase in ("fill", "exhaust"):
            assert cell["slopes_of_phases"][phase] == pytest.approx(slope, rel=0.01)


def test_other_thresholds_are_methods_of_their_own(own):
    analysis = isometric.reduce(own)
    methods = {estimate.method for estimate in analysis.estimates}
    assert methods == {isometric.METHOD, *(f"{isometric.METHOD} above {f} N" for f in (10, 15, 30))}
    assert analysis.estimates[0].method == isometric.METHOD
    assert analysis.facts["rule"]["force_above"] == 20.0


def test_options_are_reported_where_they_replace_the_rule(own):
    analysis = isometric.reduce(own, {"phases": ["fill"]})
    assert slopes(analysis)[0.0].value == pytest.approx(0.70e-3, rel=0.01)
    assert any("not the rule that the map gives" in finding.text for finding in analysis.findings)


def test_flagged_files_are_dropped_with_their_reason(tmp_path):
    files = [*OLD.glob("isometric/*Kinked4mm*.csv"), OLD / "isometric" / "rewritten" / "10mm_13cm_Kinked4mm_Test10.csv"]
    analysis = isometric.reduce(runs_of(files, OLD / "isometric.yaml", tmp_path))
    (dropped,) = analysis.dropped
    assert "600 suspect" in dropped.reason
    assert slopes(analysis)[0.004].n == 3
    assert any(f.level == "fault" and "no whole counts" in f.text for f in analysis.findings)


def test_figures_and_facts(own):
    analysis = isometric.reduce(own)
    assert [trace.figure for trace in analysis.traces] == ["isometric", "isometric"]
    for trace in analysis.traces:
        assert 0 < len(trace.columns["pressure"]) <= 1500
        assert {len(column) for column in trace.columns.values()} == {len(trace.columns["pressure"])}
        assert set(trace.quantities) == set(trace.columns)
    assert analysis.facts["flagged"] == {"overrange": 1, "suspect": 1}
    assert len(analysis.curves) == 2
    assert analysis.to_dict()["kind"] == "isometric"


def test_a_single_test_has_no_interval(own):
    (run,) = [run for run in own if run.trials[0].repeat == 1 and run.trials[0].point["contraction"] == 0]
    estimate = slopes(isometric.reduce([run]))[0.0]
    assert estimate.ci95 is None
    assert "one test only" in estimate.note


def test_a_pull_test_gives_a_line_at_each_contraction(tmp_path):
    runs = runs_of(OLD.glob("polled/*characterization*/*_data.dat"), OLD / "pull.yaml", tmp_path)
    analysis = isometric.reduce(runs)
    assert analysis.kind == "recorded-pull"
    found = [estimate.value for _, estimate in sorted(slopes(analysis).items())]
    assert found == pytest.approx(list(made.TRUTH["pull"].values()), rel=0.03)


def test_the_slopes_of_the_lab_are_recovered(of_the_lab):
    assert len(of_the_lab) == 12
    found = slopes(isometric.reduce(of_the_lab))
    for contraction, (slope, share) in LAB.items():
        estimate = found[contraction]
        assert estimate.n == 3
        assert estimate.value == pytest.approx(slope, rel=share)
        low, high = estimate.ci95
        assert low <= slope <= high


def test_the_file_that_the_lab_rewrote_twice_is_implausible(tmp_path):
    folder = recorded_data() / "aarl_10mm" / "rewritten"
    once, twice = import_files(sorted(folder.glob("*.csv")), FIXTURES / "maps" / "aarl-10mm-rewritten.yaml", tmp_path)
    assert once.source.name.endswith("Test1.csv")
    assert not any(found.level == "fault" for found in once.findings)
    (sibling,) = [found for found in twice.findings if found.kind == "sibling"]
    assert "peak 14.71 N" in sibling.text
    assert "implausible" in sibling.text
    assert twice.flagged["suspect"] == twice.rows


def test_other_choices_are_in_the_interval(own):
    """The largest change over the thresholds of the map and the upper half of the force, as a rectangle."""
    analysis = isometric.reduce(own)
    for contraction, estimate in slopes(analysis).items():
        (cell,) = (one for one in analysis.facts["cells"] if one["contraction"] == contraction)
        change = max(abs(m - estimate.value) for m in cell["slopes_above"].values())
        assert estimate.parts.method >= change > 0
        assert len(cell["slopes_above"]) == 5


def test_tests_of_one_session_are_no_independent_repeats():
    """Means 1 and 3 of two sessions: 2 +- 12.706 x 1; all six alone would give 2 +- 1.15."""
    mean, half = mean_over_sessions([0.9, 1.0, 1.1, 2.9, 3.0, 3.1], ["a"] * 3 + ["b"] * 3)
    assert mean == pytest.approx(2.0)
    assert half == pytest.approx(12.706, rel=1e-4)
    assert mean_over_sessions([0.9, 1.1], ["a", "a"]) == (pytest.approx(1.0), pytest.approx(1.2706, rel=1e-4))


def test_one_session_is_said_to_be_one():
    (together,) = [f for f in isometric.reduce(lab(1, sessions=1)).findings if "scatter between sessions" in f.text]
    assert together.level == "note"
    assert not any("scatter between sessions" in f.text for f in isometric.reduce(lab(1)).findings)


def covered(labs: range) -> float:
    """Share of labs whose interval of the slope holds the truth."""
    rule = {"force_above": 20.0, "also_at": [10.0, 15.0, 30.0]}
    found = [slopes(isometric.reduce(lab(seed), rule))[0.0] for seed in labs]
    return float(np.mean([abs(e.value - SLOPE) <= e.parts.combined for e in found]))


def test_intervals_of_labs_with_several_sessions_hold_the_truth():
    """95 % of 20 labs, five sessions of three tests each, 0.5 % between sessions; by tests alone it is 72 %."""
    assert 0.90 <= covered(range(20)) <= 0.99


@pytest.mark.parametrize("reads", [22.0, 500.0])
def test_a_single_sample_of_a_slack_muscle_above_the_threshold_is_no_part_of_the_line(reads):
    """At 3 kPa it made the line begin there, and changed the slope."""
    rule, runs = {"force_above": 20.0, "also_at": [10.0, 30.0]}, lab(2)
    plain = isometric.reduce(runs, rule)
    noisy = lab(2)
    for run in noisy:
        run.trials[0].channels["force"][1] = reads
    found = isometric.reduce(noisy, rule)
    assert [(e.symbol, e.method, e.value, e.ci95) for e in found.estimates] == [
        (e.symbol, e.method, e.value, e.ci95) for e in plain.estimates
    ]
    ((first, *_), *_) = found.facts["cells"][0]["forces"]
    assert first > 80e3 + 20.0 / 0.62e-3
    assert found.curves[0].r2 == plain.curves[0].r2


@pytest.mark.study
def test_intervals_of_a_thousand_labs_hold_the_truth():
    share = covered(range(1000, 2000))
    print(
        f"isometric slopes of 1,000 labs, five sessions of three tests each: {share:.1%} of the intervals hold the truth"
    )
    assert 0.93 <= share <= 0.97


def test_the_slopes_of_the_lab_are_held_by_two_tests_of_three_too(of_the_lab):
    for left_out in (1, 2, 10):
        for contraction, estimate in slopes(
            isometric.reduce([r for r in of_the_lab if r.trials[0].repeat != left_out])
        ).items():
            low, high = estimate.ci95
            assert low <= LAB[contraction][0] <= high, (left_out, contraction)


@pytest.mark.parametrize("seed", range(3))
def test_what_a_slack_muscle_reads_is_no_part_of_the_line(seed):
    """Up to 140 kPa the independent muscle is slack at its shortest length, and the map names no `force_above`."""
    runs = [as_run("isometric", as_trials(held.campaign("clean", 0.0, seed)), held.RATE, {})]
    found = slopes(isometric.reduce(runs))
    assert sorted(found) == pytest.approx(held.CONTRACTIONS)
    for contraction, estimate in found.items():
        assert estimate.value == pytest.approx(float(held.slope(np.array(contraction))), abs=estimate.parts.combined)
        assert estimate.parts.combined <= 0.01 * estimate.value
