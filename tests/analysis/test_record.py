"""What the record of a run has against its results is repeated by every analysis of it."""

from pmabench.analysis.verdict.checks import with_record
from pmabench.store.analyses.results import Analysis
from pmabench.store.reader import open_run
from tests.store.runs import closed

EMPTY = Analysis("isometric", (), simulated=False)


def test_a_kept_file_that_was_changed_or_lost_refuses_acceptance(tmp_path):
    folder = closed(tmp_path, rows=200)
    assert with_record(EMPTY, [open_run(folder)]).refusals == ()
    path = folder / "calibrations" / "P-0231.yaml"
    path.chmod(0o644)
    path.write_bytes(path.read_bytes() + b"# better\n")
    (refusal,) = with_record(EMPTY, [open_run(folder)]).refusals
    assert refusal.startswith("run: calibrations/P-0231.yaml was changed: its sha256 does not fit")
    path.unlink()
    assert "P-0231.yaml is missing" in with_record(EMPTY, [open_run(folder)]).refusals[0]


def test_a_question_that_was_open_at_the_import_refuses_acceptance_once_for_all_runs(tmp_path):
    asked = {"what": "columns.F.unit", "where": "map.yaml:9:11", "question": "which unit?", "used": "N"}
    runs = [open_run(closed(tmp_path, name, rows=200, imported={"unresolved": [asked]})) for name in ("a", "b")]
    (refusal,) = with_record(EMPTY, runs).refusals
    assert refusal.startswith(
        "isometric: not answered: 2 runs: columns.F.unit: which unit?; taken here: N (map.yaml:9:11); write the answer"
    )


def test_what_a_record_of_another_says_is_harmless_on_a_terminal(tmp_path):
    asked = {"what": "unit", "question": "which\x1b[31m?"}
    run = open_run(closed(tmp_path, rows=200, imported={"unresolved": [asked, "no question", {"what": 1}]}))
    (refusal,) = with_record(EMPTY, [run]).refusals
    assert "\x1b" not in refusal


def test_doubts_of_the_record_become_findings(tmp_path):
    run = open_run(closed(tmp_path, rows=200, doubts=["bench.yaml:3:1  the simulated muscle is another one"]))
    (finding,) = with_record(EMPTY, [run]).findings
    assert (finding.level, finding.text) == ("doubt", "run: bench.yaml:3:1  the simulated muscle is another one")
