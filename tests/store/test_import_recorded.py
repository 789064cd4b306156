"""Every fault that the recorded sets are known to hold is found, with its row and time."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from pmabench.store.reader import open_run
from tests.importing import import_files
from tests.recorded import recorded_data

MAPS = Path(__file__).resolve().parents[2] / "fixtures" / "maps"


def found(pattern, map_name, out):
    files = sorted(recorded_data().glob(pattern))
    assert files
    runs = import_files(files, MAPS / f"{map_name}.yaml", out)
    reported = [finding for run in runs for finding in run.findings]
    assert all(finding.index is not None and finding.t is not None for finding in reported)
    return runs, reported


def test_dropouts_and_gaps_of_the_pull_test(tmp_path):
    (run,), reported = found("mit_2-151/*characterization*/*_data.dat", "mit-2-151-pull", tmp_path)
    kinds = {(finding.kind, finding.channel): finding for finding in reported}
    assert (kinds["dropout", "pressure"].index, kinds["dropout", "pressure"].count) == (0, 65)
    assert kinds["dropout", "supply"].count == 127
    assert "8.03 s" in kinds["gap", ""].text
    assert len(open_run(run.path).trials) == 11
    assert not np.isnan(open_run(run.path).trials[0].point["contraction"])


def test_zeros_in_the_command_and_a_late_pressure_of_the_steps(tmp_path):
    runs, reported = found("mit_2-151/*step_exp/*_data.dat", "mit-2-151-step", tmp_path)
    kinds = Counter(finding.kind for finding in reported)
    zeros = [finding.count for finding in reported if (finding.kind, finding.channel) == ("spike", "pressure_command")]
    assert len(zeros) == len(runs) == 5
    assert all(count >= 2 for count in zeros), "a sample of zero at each step"
    (late,) = [finding for finding in reported if finding.kind == "late"]
    assert late.t == pytest.approx(10.06, abs=0.01)
    assert kinds["cut-end"] == 1


def test_sines_have_no_step_whose_pressure_is_late(tmp_path):
    _, reported = found("mit_2-151/*frq*/*_data.dat", "mit-2-151-sine", tmp_path)
    assert not [finding for finding in reported if finding.kind in {"late", "rate", "sign"}]


def test_rewritten_newtons_among_their_siblings(tmp_path):
    runs, _ = found("aarl_10mm/**/*.csv", "aarl-10mm", tmp_path)
    wrong = {run.source.name for run in runs if any(finding.kind == "not-whole" for finding in run.findings)}
    assert wrong == {"10mm_13cm_Kinked12mm_Test1.csv", "10mm_13cm_Kinked12mm_Test10.csv"}
    for run in runs:
        faults = {finding.kind for finding in run.findings if finding.level == "fault"}
        assert faults == ({"not-whole", "sibling"} if run.source.parent.name == "rewritten" else set())
        assert ("suspect" in run.flagged and run.flagged["suspect"] == run.rows) == bool(faults)
