"""`check` repeats what the last diagnosis found: of the same bench its faults, of the same specimen what it is."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from pmabench.store.analyses.folder import write_analysis
from pmabench.store.analyses.results import Analysis
from tests.cli.conftest import ran

LATE = {
    "of": "bench",
    "text": "force is 8 ms behind the other channels",
    "advice": "look at the filter of the amplifier",
}
LOOP = {"of": "muscle", "text": "the muscle has hysteresis of 30 N", "advice": "it belongs to the muscle"}
SHORT = [
    ("model.coefficients", "paper0 bench"),
    ("sweep.matrix.load", "[20.6 kg]"),
    ("sweep.matrix.pressure", "[300 kPa]"),
    ("sample_rate", "50 Hz"),
    ("trial.hold", "2 s"),
    ("trial.window", "[1 s, 2 s]"),
]


@pytest.fixture
def said(tmp_path, monkeypatch):
    """What `check` says on a bench after analyses with these diagnoses, the newest last."""
    monkeypatch.chdir(tmp_path)
    run = Path(ran(tmp_path / "runs", "validation", "mock-real", SHORT))

    def after(*forms, bench="mock-real", specimen="dmsp-20-250-real"):
        for number, form in enumerate(forms):
            facts = {"form": form}
            write_analysis(
                Analysis("contraction-relaxation", (run.name,), True, (), facts=facts),
                tmp_path / f"analyses/a{number}/cr",
            )
        words = [
            "check",
            "validation",
            "--bench",
            bench,
            "--specimen",
            specimen,
            "--set",
            "model.coefficients=paper0 bench",
        ]
        if specimen != "dmsp-20-250-real":
            words += ["--set", "sweep.matrix.load=[20.6 kg]"]
        result = CliRunner().invoke(main, [*words, "--json"])
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)["last_diagnosis"]

    return after


def test_faults_of_the_bench_and_the_muscle_itself(said):
    bench, muscle = said({"state": "corrected", "explanations": [LATE, LOOP]})
    assert "force is 8 ms behind" in bench
    assert "Look at the filter of the amplifier" in bench
    assert "analyses/a0" in bench
    assert "hysteresis of 30 N" in muscle
    assert "pmabench campaign real-muscle" in muscle


def test_another_muscle_on_the_same_bench_hears_of_the_bench_alone(said):
    (line,) = said({"state": "corrected", "explanations": [LATE, LOOP]}, specimen="mas-20-250-paper0")
    assert "last diagnosis of this bench" in line


def test_another_bench_hears_of_the_muscle_alone(said):
    (line,) = said({"state": "corrected", "explanations": [LATE, LOOP]}, bench="mock-real-ideal")
    assert "last diagnosis of this specimen" in line


def test_what_was_mended_since_is_not_said_again(said):
    assert said({"state": "corrected", "explanations": [LATE]}, {"state": "sound", "explanations": []}) == []


def test_a_name_that_may_be_wrong_is_not_given(said):
    """A diagnosis that was not decided names a wire here; nobody is sent to look for it."""
    (line,) = said({"state": "withheld", "explanations": [LATE, LOOP]})
    assert "8 ms" not in line
    assert "why is undecided" in line
    assert "process --form surface" in line


def test_at_most_three_lines_and_nothing_without_an_analysis(said):
    assert said() == []
    assert len(said({"state": "corrected", "explanations": [LATE] * 5})) == 3
