"""What a person sees of a run from the command line, and answers: progress, prompts, how it ended, what next."""

from __future__ import annotations

import os
import select
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from textwrap import shorten, wrap
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import Interrupted
from pmabench.base.quantities import highest_pressure
from pmabench.cli.common import Ui, fields, read_or_not, rewrite, say
from pmabench.cli.names import WIDTH, short, typed
from pmabench.engine.operator import ConfirmedBeforehand, Nobody, Operator
from pmabench.guard.safe import UNANSWERED
from pmabench.guard.station import Station
from pmabench.report.terminal import print_texts

if TYPE_CHECKING:
    from pmabench.bench.interface import CompiledBench
    from pmabench.display.child import Display
    from pmabench.engine.executor import Progress
    from pmabench.engine.run import Outcome
    from pmabench.session.checks import Check

FINISHED = ("finished", "failed")
MAY_COME = "; a command may still come: shut the supply"


def cut(text: str) -> str:
    """One line of at most 80 columns."""
    return text if len(text) <= WIDTH else f"{text[: WIDTH - 1]}…"


def show_next(ui: Ui, outcome: Outcome, bench: CompiledBench, *, trials: bool) -> None:
    """A line for each thing to do, each with its command; nothing where the run came to its end.

    `trials`: whether a single run ended, whose rest is named; `continue` leads on from a session or a campaign.
    With --quiet only that a bench is tripped.
    """
    if bench.realtime and Station(bench.name).latched():
        reset = f"pmabench vent {typed(Path(bench.path), 'bench')} --reset --operator NAME --because TEXT"
        if not trials and outcome.folder is not None:
            reset = f"pmabench continue {short(outcome.folder)}"
        with read_or_not(outcome.exit_code):
            say(f"the bench is now tripped, and nothing runs on it: look at it, then  {reset}")
    if trials and outcome.folder is not None and outcome.status not in FINISHED:
        with read_or_not(outcome.exit_code):
            ui.note(f"the trials that are left:  pmabench run --resume {shlex.quote(str(outcome.folder))}")


def outcome_json(outcome: Outcome) -> dict[str, Any]:
    """The documented object of a run's end."""
    return {
        "schema": "pmabench.outcome/1",
        "run": str(outcome.folder),
        **fields(outcome, "status", "why", "exit_code", "bench_seconds", "rows"),
        "vent": None if outcome.vent is None else fields(outcome.vent, "result", "actions"),
        "trials_failed": [index + 1 for index in outcome.trials_failed],
    }


def show_outcome(ui: Ui, outcome: Outcome) -> None:
    """The result of a command that was one run; with --quiet its folder, why it did not finish, how it vented."""
    folder = () if outcome.folder is None else (str(outcome.folder),)
    with read_or_not(outcome.exit_code):
        if ui.quiet and not ui.json and outcome.status != "finished":
            say(f"{outcome.status}: {outcome.why}{_vent_words(outcome)}")
        ui.result(outcome_json(outcome), lambda: print_outcome(outcome), folder)


def show_end(ui: Ui, outcome: Outcome, bench: CompiledBench, kind: str, trials: int) -> None:
    """The result of a run of `trials` trials: how it ended and what to type next; the same as JSON, or its folder.

    With --json and --quiet what comes next is on stderr.
    """
    if ui.json or ui.quiet:
        show_outcome(ui, outcome)
        show_next(ui, outcome, bench, trials=True)
        return
    with read_or_not(outcome.exit_code):
        ui.result(outcome_json(outcome), lambda: click.echo("\n".join(_end(outcome, bench, kind, trials))))


def _end(outcome: Outcome, bench: CompiledBench, kind: str, trials: int) -> list[str]:
    """At most 25 lines of 80 columns: status, trials, vent, cause, record, next."""
    mark = "SIMULATED  " if outcome.folder is not None and "_SIMULATED_" in outcome.folder.name else ""
    seconds = outcome.bench_seconds
    length = f"{seconds / 60:.0f} min" if seconds >= 120 else f"{seconds:.0f} s"
    done = f"{outcome.trials_done} of {trials} {'trial' if trials == 1 else 'trials'}"
    head = f"{mark}{outcome.status.upper()}  {kind}: {done}, {length}{_vent_words(outcome, 'vented')}"
    lines = wrap(head, WIDTH, subsequent_indent="   ")
    if outcome.why:
        lines += wrap(outcome.why, 80, initial_indent="   ", subsequent_indent="   ", max_lines=4, placeholder=" …")
    if outcome.trials_failed:
        numbers = ", ".join(str(index + 1) for index in outcome.trials_failed)
        lines.append(shorten(f"   trials that failed: {numbers}", 80, placeholder=" …"))
    lines += _unconfirmed(outcome, 8)
    if bench.realtime and (latched := Station(bench.name).latched()):
        lines.append("   the bench is now tripped, and nothing runs on it: look at it first")
        if outcome.vent is not None and outcome.vent.confirmed and not latched.startswith(f"{outcome.why},"):
            lines += wrap(latched, 80, initial_indent="   ", subsequent_indent="   ", max_lines=4, placeholder=" …")
    if outcome.folder is not None:
        place = short(outcome.folder)
        if not outcome.folder.is_dir():
            lines.append(f"record  {place}")
            return [*lines, "   is not there: it was moved or deleted during the run; bring it back"]
        lines.append(f"record  {place}   {outcome.rows:,} rows")
        again = "pmabench continue" if outcome.folder.parent.name == "runs" else f"pmabench continue {place}"
        lines.append(f"next    pmabench process {place}" if outcome.status in FINISHED else f"next    {again}")
    return lines


def print_outcome(outcome: Outcome) -> None:
    """How it ended, in two lines; where no vent was confirmed, what came of each action and what to do."""
    why = f": {outcome.why}" if outcome.why else ""
    click.echo(f"{outcome.status}{why}; {outcome.rows:,} rows{_vent_words(outcome)}")
    click.echo("\n".join([*_unconfirmed(outcome), str(outcome.folder)]))


def _unconfirmed(outcome: Outcome, most: int | None = None) -> list[str]:
    """What came of (the first `most`) actions of a vent that was not confirmed, and what to do; empty where it was."""
    if outcome.vent is None or outcome.vent.confirmed:
        return []
    return [
        *(f"   {action}" for action in outcome.vent.actions[:most]),
        "   nobody knows that the pressure is gone and nothing moves: stay away, shut",
        "   supply and power by hand, then  pmabench vent",
    ]


def _vent_words(outcome: Outcome, confirmed: str = "vent confirmed") -> str:
    if outcome.vent is None:
        return ""
    words = confirmed if outcome.vent.confirmed else f"vent {outcome.vent.result}"
    late = UNANSWERED in outcome.vent.actions and outcome.status not in FINISHED  # a lost step of a ramp is made up
    return f"; {words}{MAY_COME if late else ''}"


@contextmanager
def progress_line(ui: Ui, title: str) -> Iterator[Callable[[Progress], None]]:
    """The line of `bar_line` for a run."""
    with bar_line(ui, title) as show_bar:

        def show(progress: Progress) -> None:
            done = progress.t / (progress.t + progress.longest) if progress.t + progress.longest > 0 else 0.0
            trial = f"trial {progress.trial + 1} of {progress.trials}" if progress.trial is not None else progress.phase
            show_bar(done, trial)

        yield show


@contextmanager
def bar_line(ui: Ui, title: str) -> Iterator[Callable[[float, str], None]]:
    """A line with the share that is done, words, and the time left, at most four times a second on a terminal."""
    live = sys.stderr.isatty() and not ui.quiet and not ui.json
    started = last = time.monotonic()

    def show(done: float, words: str) -> None:
        nonlocal last
        now = time.monotonic()
        if not live or now - last < 0.25:
            return
        last = now
        left = f", {(now - started) * (1 - done) / done:.0f} s left" if done > 0.02 else ""
        line = f"{title}  [{'#' * round(24 * done):<24}] {100 * done:3.0f} %  {words}{left}"
        rewrite(line[: shutil.get_terminal_size().columns - 1])

    yield show
    if live:
        rewrite()


def print_checks(ui: Ui, checks: Sequence[Check], *, err: bool = False) -> None:
    """The table of a self-test; below it what to look at."""
    if not checks:
        return
    console = ui.console(err=err)
    rows = [[c.name, c.value or (c.hint if c.verdict.startswith("not ") else ""), c.limit, c.verdict] for c in checks]
    print_texts(console, ["check", "value", "limit", "verdict"], rows)
    for check in checks:
        if check.verdict == "failed":
            console.print(f"{check.name}: {check.hint}")


class _Keys:
    """What comes from the display."""

    def __init__(self, display: Display) -> None:
        self._display = display
        self._answer: tuple[int, str] | None = None
        self._keys: list[tuple[str, str]] = []

    def poll(self, measured: Mapping[str, float]) -> Sequence[tuple[str, str]]:
        """Keys and notes since the last call."""
        self._display.live(measured)
        self._take()
        keys, self._keys = self._keys, []
        return keys

    def _take(self) -> None:
        for message in self._display.poll():
            if "answer" in message:
                self._answer = (message["answer"]["id"], message["answer"]["text"])
            self._keys += [(what, message[what]) for what in ("key", "note") if what in message]


class Confirmed(_Keys):
    """`--yes`: every prompt counts as answered, and the record says so; keys and notes still count."""

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Answered without a person."""
        return ConfirmedBeforehand().ask(text, measured, wait)


class AtDisplay(_Keys):
    """A person in front of the display, or of what is left of it."""

    def __init__(self, display: Display, *, answers: bool) -> None:
        super().__init__(display)
        self._answers = answers
        """Whether there is a terminal to type at."""

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Show the prompt until it is answered; the bench is watched meanwhile. A lost terminal ends the run."""
        if not self._answers:
            return Nobody().ask(text, measured, wait)
        number = self._display.ask(text)
        try:
            while self._answer is None or self._answer[0] != number:
                if not self._display.alive:
                    raise Interrupted("loss of the display while a prompt was open", 129)
                wait()
                self._display.live(measured)
                self._take()
        finally:
            self._display.withdraw()
        return self._answer[1]


class AtLines:
    """A person who answers line by line. `realtime`: bench time passes while they think; else it waits."""

    def __init__(self, *, realtime: bool) -> None:
        self._realtime = realtime
        self._typed = b""

    def poll(self, measured: Mapping[str, float]) -> Sequence[tuple[str, str]]:
        """No keys; lines are answers."""
        return ()

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Ask until a line is the word `clear`; nothing else counts, nor what was typed before the question."""
        if sys.stderr.isatty():
            rewrite()
        self._typed = b""
        descriptor = _descriptor()
        while select.select([descriptor], [], [], 0.0)[0]:
            _typed_at(descriptor)
        say(text)
        typed = before = ""
        while typed.lower() != "clear":
            pressure = highest_pressure(measured)
            shown = (
                "The pressure is not measured." if pressure is None else f"Measured pressure: {pressure / 1e3:.1f} kPa."
            )
            typed = self.line(f'{before}{shown} Type "clear" when it is done and hands are out: ', wait)
            before = f'"{typed}" does not count. '
        return "clear"

    def line(self, prompt: str, wait: Callable[[], None]) -> str:
        """The next line that is typed; raises Interrupted at the end of the input."""
        if sys.stderr.isatty():
            rewrite()
        sys.stderr.write(prompt)
        sys.stderr.flush()
        descriptor = _descriptor()
        while b"\n" not in self._typed:
            if select.select([descriptor], [], [], 0.0 if self._realtime else None)[0]:
                self._typed += _typed_at(descriptor)
            elif self._realtime:
                wait()
        line, _, self._typed = self._typed.partition(b"\n")
        return line.decode("utf-8", "replace").strip()


def at_terminal(bench: CompiledBench, *, yes: bool, there: bool) -> Operator:
    """Who answers without a display, where somebody is `there`."""
    if yes or not there:
        return ConfirmedBeforehand() if yes else Nobody()
    return AtLines(realtime=bench.realtime)


def _descriptor() -> int:
    """Where a person types; Interrupted where the input is closed, or none that can be waited for."""
    try:
        return sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        raise Interrupted("end of input at the prompt", 130) from None


def _typed_at(descriptor: int) -> bytes:
    """What was typed; Interrupted at the end of the input."""
    read = b""
    with suppress(OSError):
        read = os.read(descriptor, 4096)
    if not read:
        raise Interrupted("end of input at the prompt", 130)
    return read
