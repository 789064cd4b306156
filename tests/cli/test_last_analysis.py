"""`check` repeats what the last diagnosis found: of the same bench its faults, of the same specimen what it is."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from pmabench_drivers.mock import sampled

from pmabench.cli.main import main
from pmabench.cli.prepare import prepare
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
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


def test_the_newest_diagnosis_counts_and_older_ones_are_passed_over(said):
    both = {"state": "corrected", "explanations": [LATE, LOOP]}
    (line,) = said({"state": "sound", "explanations": []}, both, bench="mock-real-ideal")
    assert "analyses/a1" in line
    assert said(both, {"state": "sound", "explanations": []}, bench="mock-real-ideal") == []


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


FEW = [
    ("sweep.matrix.load", "[6 kg, 11 kg, 21 kg, 26 kg, 31 kg, 41 kg]"), ("sweep.matrix.pressure", "[200 kPa, 350 kPa, 500 kPa]"),
    ("sweep.repeat.count", "1"), ("trial.contract.hold", "6 s"),
    ("trial.relax", "{by: 100 kPa, hold: 3 s, then: 0 kPa, hold_at_end: 3 s}"),
]  # fmt: skip


def delayed_by(samples):
    """The block of samples as it is kept where the force comes so many samples late."""
    keep, before = sampled.Sampled._keep, []

    def late(self, time_ns, columns):
        force = np.asarray(columns["force"])
        every = np.concatenate([*(before or [np.repeat(force[:1], samples)]), force])
        before[:] = [every[len(force) :]]
        keep(self, time_ns, {**columns, "force": every[: len(force)]})

    return late


@pytest.mark.slow
def test_a_late_cell_is_named_before_the_next_test_also_after_recalibrate_took_it_off(tmp_path, monkeypatch):
    """4 samples of 500 Hz; what `recalibrate` takes off the record is still at the bench."""
    monkeypatch.chdir(tmp_path)
    names = ("contraction-relaxation", "mock-serres2009", "mas-20-250-serres2009")
    with monkeypatch.context() as patch:
        patch.setattr(sampled.Sampled, "_keep", delayed_by(4))
        prepared = prepare(*names, FEW)
        run = str(run_plan(prepared.plan, prepared.mounted, ConfirmedBeforehand(), out=tmp_path / "runs").folder)
    taken = ["recalibrate", run, "--skew", "force=8 ms", "--because", "a filter", "--out", "analyses/taken"]
    for words in (["process", run, "-q"], [*taken, "-q"]):
        assert CliRunner().invoke(main, words).exit_code in (0, 6)
        said = CliRunner().invoke(main, ["check", names[0], "--bench", names[1], "--specimen", names[2], "--json"])
        (line,) = json.loads(said.stdout)["last_diagnosis"]
        assert "force is 8 ms" in line
        assert "the filter of the force cell's amplifier, and at the clock of its device" in line
        assert 'pmabench recalibrate RUN... --skew "force=' in line
    (after,) = Path("analyses/taken").glob("*/analysis.json")
    assert json.loads(after.read_text())["facts"]["form"]["explanations"] == []
