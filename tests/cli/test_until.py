"""`run --until` and `next`: trials are chosen from the sweep, resumed runs choose the same, the protocol is valid."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from pmabench.base.errors import Interrupted, UsageError
from pmabench.cli.main import main
from pmabench.cli.prepare import prepare
from pmabench.cli.until import asked_of, goals_of
from pmabench.engine.executor import Executor
from pmabench.kinds import registry
from pmabench.kinds.contraction_relaxation import KIND
from pmabench.kinds.contraction_relaxation.next_trial import FIELDS, Chooser
from pmabench.store.chain import open_chain
from pmabench.store.records import RunData

SMALL = {
    "prepare.precondition.cycles": "1",
    "prepare.precondition.hold": "0.5 s",
    "sweep.matrix.load": "[6 kg, 16 kg, 26 kg]",
    "sweep.matrix.pressure": "[300 kPa, 400 kPa, 500 kPa]",
    "sweep.repeat.count": "3",
    "trial.contract.hold": "2 s",
    "trial.relax.hold": "1 s",
    "trial.relax.hold_at_end": "1.5 s",
}
SETTINGS = [word for name, value in SMALL.items() for word in ("--set", f"{name}={value}")]
FILES = ["contraction-relaxation", "--bench", "mock-ideal", "--specimen", "mas-20-250-paper0"]
GOAL = "K 3 %, F_ce 3 %"


def pmabench(*words: str) -> Result:
    return CliRunner().invoke(main, list(words))


def until(*words: str) -> Result:
    return pmabench("run", *FILES, *SETTINGS, "--until", GOAL, "--yes", *words)


def newest() -> Path:
    return max(Path("runs").iterdir(), key=lambda folder: (folder / "manifest.json").stat().st_mtime_ns)


def changes(runs: tuple[RunData, ...]) -> list[dict[str, object]]:
    """The decisions of a chain, each once."""
    found: dict[object, dict[str, object]] = {}
    for event in (event for run in runs for event in run.events if event.kind == "plan-change"):
        found.setdefault(event.data["trial"], {name: event.data[name] for name in FIELDS})
    return list(found.values())


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that came to its goal; the folder that it was done in."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("until"))
        done = until()
        assert done.exit_code == 0, done.output
        return newest().resolve()


def test_a_run_ends_when_its_goal_is_reached_and_its_record_says_each_choice(whole: Path) -> None:
    runs = open_chain(whole)
    made = changes(runs)
    end = next(event for event in runs[-1].events if event.kind == "choice-end")
    assert end.data["reached"], end.data["why"]
    assert [t.index for t in runs[-1].trials] == [change["trial"] for change in made]
    assert len(made) < 27
    assert [change["role"] for change in made].count("confirm") == 3
    assert made[0]["role"] == made[8]["role"] == "reference"
    assert runs[-1].trials[8].reference
    assert runs[-1].manifest["until"] == {"goal": GOAL, "time": ""}


def follow_from_the_record(runs: tuple[RunData, ...], numbers: list[int]) -> None:
    """Asked again at some of its trials, with nothing remembered but the record before, the decision is the same."""
    prepared = prepare(FILES[0], "mock-ideal", "mas-20-250-paper0", list(SMALL.items()))
    asked = asked_of(prepared, GOAL, "")
    made = changes(runs)
    for number in numbers:
        before = {change["trial"] for change in made[:number]}
        part = [
            replace(
                run,
                trials=tuple(trial for trial in run.trials if trial.index in before),
                events=tuple(e for e in run.events if e.kind != "plan-change" or e.data["trial"] in before),
            )
            for run in runs
        ]
        answer = Chooser(asked.plan, asked.expected, asked.goals).decide(part)
        assert {name: getattr(answer, name) for name in FIELDS} == made[number]


def test_each_choice_follows_from_the_record_before_it(whole: Path) -> None:
    runs = open_chain(whole)
    follow_from_the_record(runs, [0, 5, 9, 13, len(changes(runs)) - 1])


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.study)])
def test_a_run_that_was_ended_anywhere_goes_on_as_its_record_says(
    seed: int, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was chosen before is done first; what is chosen after follows from the record of both runs."""
    monkeypatch.chdir(tmp_path)
    left = random.Random(seed).randint(10, 90)
    hold = Executor._hold

    def ended(self: Executor, step: object) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            raise Interrupted("the test", 130)
        hold(self, step)  # type: ignore[arg-type]

    monkeypatch.setattr(Executor, "_hold", ended)
    assert until().exit_code == 130
    left = -1
    first = changes(open_chain(newest()))
    assert first == changes(open_chain(whole))[: len(first)]
    done = pmabench("run", "--resume", str(newest()), "--yes")
    assert done.exit_code == 0, done.output
    runs = open_chain(newest())
    assert len(runs) == 2
    made = changes(runs)
    assert made[: len(first)] == first
    follow_from_the_record(runs, [len(first), len(made) - 2])
    finished = [t.index for run in runs for t in run.trials if t.status == "finished" and not t.again]
    assert sorted(finished) == sorted(int(str(c["trial"])) for c in changes(runs))
    refused = pmabench("run", "--resume", str(newest()), "--until", "K 1 %", "--yes")
    assert refused.exit_code == 2
    assert "keeps the goal of its run" in refused.output


def test_next_writes_a_protocol_that_check_takes(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    files = ("--bench", "mock", "--specimen", "mas-20-250-paper0")
    few = ("--set", "sweep.repeat.count=1", "--yes")
    assert pmabench("run", FILES[0], *files, *SETTINGS, *few).exit_code == 0
    words = ("next", str(newest()), "--until", "B_c 0.3 %, B_r 0.3 %", "--time", "10 min", "-o", "next.yaml")
    done = pmabench(*words)
    assert done.exit_code == 0, done.output
    lines = done.output.splitlines()
    assert len(lines) <= 25
    assert max(map(len, lines)) <= 80
    assert lines[0] == "SIMULATED contraction-relaxation, 9 trials done; wanted: B_c 0.3 %, B_r 0.3 %"
    assert lines[-1] == "next    pmabench run next.yaml --bench mock --specimen mas-20-250-paper0"
    checked = pmabench("check", "next.yaml", *files, "--json")
    assert checked.exit_code == 0, checked.output
    proposed = json.loads(checked.stdout)["trials"]
    assert 1 <= proposed <= 10
    assert sum(line[:3].strip().isdigit() for line in lines) == proposed
    again = pmabench(*words)
    assert again.exit_code == 2
    assert "next.yaml is there already" in again.output
    easy = pmabench("next", words[1], "--until", "K 9 %")
    assert "too few cells were repeated" in easy.output
    assert "every goal is reached, no further trial" in pmabench("next", str(whole), "--until", GOAL).output


def test_a_wanted_value_that_no_trial_tells_is_named(whole: Path) -> None:
    """B_r at the highest pressure: nothing relaxes from above it."""
    said = " ".join(pmabench("next", str(whole), "--until", "B_r 50 %").output.split())
    assert "out of reach: B_r at 500 kPa: not identifiable" in said
    assert "every goal is reached" not in said


def test_the_time_ends_a_run_and_the_rest_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = until("--time", "5 min")
    assert done.exit_code == 0, done.output
    (run,) = open_chain(newest())
    end = next(event for event in run.events if event.kind == "choice-end")
    assert not end.data["reached"]
    assert end.data["why"].startswith("the time is over; ")
    assert len(run.trials) < 10


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("K", "is no goal"),
        ("k 1 %", 'no coefficient "k"'),
        ("K 0 %", "a goal is above 0"),
        ("K 1 kg", "stiffness"),
        ("tau_c 1 %", "to wait for"),
        ("", "is no goal"),
        ("0.8 x sweep", "at least 1 x sweep"),
        ("K 1 %, 1.25 x sweep", "is no goal"),
    ],
)
def test_goals_that_are_none_are_refused_with_an_example(text: str, said: str) -> None:
    with pytest.raises(UsageError) as error:
        goals_of(text, KIND)
    assert said in str(error.value)


def test_goals_are_shares_or_have_the_unit_of_their_coefficient() -> None:
    K, F_c = goals_of("K=1.5 %, F_c 2 N", KIND)
    assert K.of(("K", 300e3), -6000.0, 50.0) == pytest.approx(90.0)
    assert K.of(("B_c", 300e3), 6000.0, 50.0) is None
    assert F_c.of(("F_c", 0.0), 6.0, 1.0) == 2.0
    (sweep,) = goals_of("1.25 x sweep", KIND)
    assert sweep.of(("B_c", 300e3), 6000.0, 50.0) == 62.5


def test_other_kinds_of_test_and_unknown_muscles_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("--bench", "mock", "--specimen", "mas-20-250-paper0", "--yes", "--until", "K 1 %")
    refused = pmabench("run", "static-load", *words)
    assert refused.exit_code == 2
    assert "--until chooses trials of kind contraction-relaxation" in refused.output
    assert pmabench("run", *FILES, "--yes", "--time", "5 min").exit_code == 2
    paper_1 = ("--bench", "mock-dmsp", "--specimen", "dmsp-40-305", "--until", "K 1 %", "--yes")
    refused = pmabench("run", "contraction-relaxation-paper1", *paper_1)
    assert refused.exit_code == 2
    assert "paper 1 cannot be chosen" in refused.output or "`expected`" in refused.output
    assert list(registry.with_part("next trial")) == ["contraction-relaxation"]


def test_a_choice_needs_what_is_expected() -> None:
    prepared = prepare(FILES[0], "mock-ideal", "mas-20-250-paper0", list(SMALL.items()))
    file = prepared.mounted.specimen_file.model_copy(update={"expected": None})
    with pytest.raises(UsageError, match="write `expected` into its file"):
        asked_of(replace(prepared, mounted=replace(prepared.mounted, specimen_file=file)), GOAL, "")


@pytest.mark.study
@pytest.mark.realtime
def test_in_real_time_another_process_chooses_while_the_bench_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    files = (FILES[0], "--bench", "mock-realtime", *FILES[3:], *SETTINGS)
    words = ("--until", GOAL, "--time", "75 s", "--yes", "--skip-warm-up", "--because", "a test")
    done = subprocess.run(
        [sys.executable, "-m", "pmabench", "run", *files, *words],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (run,) = open_chain(max(Path("runs").glob("*contraction-relaxation*")))
    assert [t.index for t in run.trials] == [change["trial"] for change in changes((run,))]
    assert 2 <= len(run.trials) <= 4
    assert "next: 255 N" in done.stderr
    assert "no further trial: the time is over" in done.stderr
    assert {t.status for t in run.trials} == {"finished"}
