"""`pmabench run --until` and `next`: trials chosen one by one, or proposed, until intervals are as narrow as is wanted.

What is chosen depends on the record alone, so that a run that goes on after another chooses the same. In real time a
separate process chooses.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import shlex
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten, wrap
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import PmaError, UsageError, did_you_mean
from pmabench.base.kind import Kind, load
from pmabench.base.quantities import in_words, show
from pmabench.cli.common import Ui, common, no_overwriting, read_quantity
from pmabench.cli.names import FILE, WIDTH, RunFolder
from pmabench.engine.resume import CHANGED, Chosen, NoMore
from pmabench.files.quantity import parse_quantity
from pmabench.protocol.plan import TrialRecord
from pmabench.store.folder import MANIFEST

if TYPE_CHECKING:
    from pmabench.analysis.next_trial import Goal
    from pmabench.kinds.compile import PlannedRun
    from pmabench.store.records import RunData


PART = "next trial"
"""Of `Kind.parts`: what chooses the trials of a kind of test."""
PATIENCE = 5.0
"""Longest time until the samples of a trial that ended are in the record [s]."""
NICE = 5
"""A process that chooses leaves the processor to the bench."""


@dataclass(frozen=True)
class Asked:
    """What a chooser is made of; plain data, for another process."""

    part: str
    plan: Mapping[str, Any]
    expected: Mapping[str, Any] | None
    goals: tuple[Any, ...]
    seconds: float | None


def asked_of(prepared: PlannedRun, goal: str, length: str) -> Asked:
    """The chooser of a prepared plan; UsageError where its kind of test has none, or a goal is none."""
    from pmabench.kinds import registry

    kind = registry.kind_of(prepared.plan.kind)
    if PART not in kind.parts:
        able = ", ".join(registry.with_part(PART))
        raise UsageError(f"--until chooses trials of kind {able}; this protocol is of kind {kind.name}")
    expected = prepared.mounted.specimen_file.expected
    if expected is None:
        raise UsageError(
            "--until needs to know what is expected of the specimen, to choose the first trials: write `expected` into"
            " its file, from an earlier analysis or the data sheet"
        )
    seconds = read_quantity("--time", length, "time") if length else None
    made = Asked(
        kind.parts[PART], prepared.plan.to_dict(), expected.model_dump(mode="json"), goals_of(goal, kind), seconds
    )
    if refusal := _chooser(made).refusal:
        raise UsageError(f"--until: {refusal}")
    return made


def _chooser(asked: Asked) -> Any:
    return load(asked.part)(asked.plan, asked.expected, asked.goals, asked.seconds)


class Until:
    """Chooses trials by what a run folder holds."""

    def __init__(self, ui: Ui, asked: Asked, pool: ProcessPoolExecutor | None) -> None:
        self.ui, self.asked, self.pool = ui, asked, pool
        self.shown = pool is not None and not ui.quiet and not ui.json
        """Whether a display shows each choice."""
        self.folder: Path | None = None
        """Of the run; known when it begins."""

    def choose(self, wait: Callable[[], None]) -> Chosen | NoMore:
        """See `pmabench.engine.resume.Choosing`."""
        if self.folder is None:
            raise UsageError("a run that is not recorded cannot choose its trials")
        answer = self._answer(self.folder, wait)
        if not self.shown:
            self.ui.note(f"{'no further trial' if isinstance(answer, NoMore) else 'next'}: {answer.why}")
        return answer

    def _answer(self, folder: Path, wait: Callable[[], None]) -> Chosen | NoMore:
        if self.pool is None:
            return decide(self.asked, folder)
        future = self.pool.submit(decide, self.asked, folder)
        while not future.done():
            wait()
        try:
            return future.result()
        except BrokenProcessPool as error:
            raise PmaError("the process that chooses the trials ended; pmabench continue goes on") from error


@contextmanager
def choosing(ui: Ui, asked: Asked, *, realtime: bool) -> Iterator[Until]:
    """A chooser for one run: in real time a process, which a busy moment of cannot stop the bench."""
    if not realtime:
        yield Until(ui, asked, None)
        return
    pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _begin)
    try:
        yield Until(ui, asked, pool)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _begin() -> None:
    """Of the process that chooses: Ctrl-C is for the run."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICE)


_choosers: dict[Path, Any] = {}
"""The chooser of this process, which keeps its fits."""


def decide(asked: Asked, folder: Path) -> Chosen | NoMore:
    """The decision after what the run in `folder`, and those that it continues, hold."""
    chooser = _choosers.get(folder)
    if chooser is None:
        _choosers.clear()
        chooser = _chooser(asked)
        _choosers[folder] = chooser
    answer = chooser.decide(_recorded(folder))
    if not hasattr(answer, "trial"):
        return NoMore(answer.reached, answer.why)
    trial = TrialRecord(answer.trial, answer.point, answer.repeat, answer.reference)
    return Chosen(trial, answer.like, answer.why, {"role": answer.role, "predicted": dict(answer.predicted)})


def _recorded(folder: Path) -> tuple[RunData, ...]:
    """The runs of the chain, once the samples of the last chosen trial are in it."""
    from pmabench.store.chain import open_chain

    until = time.monotonic() + PATIENCE
    while True:
        runs = open_chain(folder)
        chosen = [int(event.data["trial"]) for event in runs[-1].events if event.kind == CHANGED]
        whole = {trial.index for trial in runs[-1].trials if trial.status != "interrupted"}
        if not chosen or chosen[-1] in whole:
            return runs
        if time.monotonic() > until:
            raise PmaError(f"the samples of trial {chosen[-1] + 1} did not reach {folder}")
        time.sleep(0.05)


EXAMPLE = 'for instance --until "K 1 %, B_r 2 %"'
_SWEEP = re.compile(r"\s*(\d+(?:\.\d+)?)\s*x\s*sweep\s*")
_GOAL = re.compile(r"\s*([A-Za-z][A-Za-z_]*)\s*[= ]\s*(.+?)\s*")


def goals_of(text: str, kind: Kind) -> tuple[Goal, ...]:
    """The goals in `text`; UsageError where a coefficient is none of the kind's, or a size is none of its."""
    from pmabench.analysis.next_trial import SWEEP, Goal

    if match := _SWEEP.fullmatch(text):
        sweeps = float(match.group(1))
        if not sweeps >= 1:
            raise UsageError(f"--until: {text.strip()}: fewer trials give no narrower intervals; at least 1 x sweep")
        return (Goal(SWEEP, sweeps, True),)
    known = {result.symbol: result for result in kind.results if result.symbol in ("F_ce", "K", "B_c", "B_r", "F_c")}
    found = []
    for part in text.split(","):
        match = _GOAL.fullmatch(part)
        if match is None:
            raise UsageError(f'--until: "{part.strip()}" is no goal; {EXAMPLE}')
        symbol, size = match.groups()
        if symbol not in known:
            raise UsageError(f'--until: no coefficient "{symbol}" to wait for{did_you_mean(symbol, known)}; {EXAMPLE}')
        relative = size.endswith("%")
        quantity = "ratio" if relative else known[symbol].quantity
        try:
            value = parse_quantity(size, quantity)
        except ValueError as error:
            raise UsageError(f"--until: {symbol}: {error}") from error
        if not value > 0:
            raise UsageError(f"--until: {symbol}: {show(value, quantity)}: a goal is above 0; {EXAMPLE}")
        found.append(Goal(symbol, value, relative))
    return tuple(found)


MOST = 10
"""Trials that are proposed at once: after these more is known."""


@click.command(name="next")
@click.argument("sources", nargs=-1, required=True, type=RunFolder(), metavar="RUN-OR-ANALYSIS...")
@click.option("--until", "goal", required=True, metavar="GOAL", help="Half widths that are wanted: 'K 1 %, B_r 2 %'.")
@click.option("--time", "length", default="", metavar="TIME", help="Longest time of the trials, '40 min'.")
@click.option("-o", "--output", type=FILE, help="Write them as a protocol.")
@common
def command(ui: Ui, sources: tuple[Path, ...], goal: str, length: str, output: Path | None) -> None:
    """Propose at most 10 trials that narrow the 95 % intervals of a test most per minute.

    They are cells of the sweep that was run. With -o they become a protocol, which `check` and `run` take.
    """
    no_overwriting(output)
    runs, kind = _runs(ui, sources)
    seconds = read_quantity("--time", length, "time") if length else None
    chooser = load(kind.parts[PART])(_plan(runs), None, goals_of(goal, kind), seconds)
    if chooser.refusal:
        raise UsageError(f"next: {chooser.refusal}")
    found = chooser.propose(runs, MOST)
    if output is not None and found.steps:
        _write(runs[-1], found.trials(), output)
    written = str(output) if output is not None and found.steps else ""
    data: dict[str, Any] = {
        "schema": "pmabench.next/1",
        "goal": goal,
        "why": found.why,
        "out_of_reach": list(found.beyond),
        "trials": [
            {"role": step.choice.role, "why": why, "predicted": predicted, "seconds": step.seconds}
            for step, (why, predicted) in zip(found.steps, found.lines, strict=True)
        ],
        "written": written,
    }
    ui.result(data, lambda: click.echo("\n".join(_lines(runs, found, goal, written))))


def _runs(ui: Ui, sources: Sequence[Path]) -> tuple[list[RunData], Kind]:
    """The runs of a kind whose trials can be chosen."""
    from pmabench.cli.sources import load_runs
    from pmabench.kinds import registry
    from pmabench.store.analyses.folder import runs_of

    folders = [run for path in sources for run in ([path] if (path / MANIFEST).is_file() else runs_of(path))]
    if not folders:
        raise UsageError(f"{sources[0]} is no run, and no analysis whose runs are where they were")
    able = registry.with_part(PART)
    runs = load_runs(folders)
    mine = [run for run in runs if run.kind in able]
    if not mine or len({run.kind for run in mine}) > 1:
        raise UsageError(f"next is for runs of one kind, {' or '.join(able)}; none of these is one")
    for run in runs:
        if run not in mine:
            ui.note(f"{run.id} is of kind {run.kind}: not used")
    if not mine[-1].plan.get("trials"):
        raise UsageError(f"{mine[-1].id} has no plan, from which trials could be chosen: it was imported")
    return mine, able[mine[0].kind]


def _plan(runs: Sequence[RunData]) -> Any:
    """The plan with most trials: the sweep that the others were taken from."""
    return max((run.plan for run in runs if run.plan.get("trials")), key=lambda plan: len(plan["trials"]))


def _write(run: RunData, trials: Sequence[int], path: Path) -> None:
    """The protocol of a run with these trials of its plan in place of its sweep."""
    from pmabench.kinds.compile import read_protocol
    from pmabench.protocol.sweep import chosen
    from pmabench.report.writing import write_file

    document, model = read_protocol(Path(run.path) / "protocol.yaml", ())
    swept = [trial["index"] for trial in run.plan["trials"] if not trial["reference"]]
    text = (Path(run.path) / "protocol.yaml").read_text(encoding="utf-8")
    made = chosen(document, getattr(model, "sweep", None), text, [swept.index(index) for index in trials])
    write_file(path, made, "the protocol")


def _lines(runs: Sequence[RunData], found: Any, goal: str, written: str) -> list[str]:
    """At most 25 lines of 80 columns."""
    done = sum(t.status == "finished" for run in runs for t in run.trials)
    simulated = "SIMULATED  " if any(run.simulated for run in runs) else ""
    lines = [shorten(f"{simulated}{runs[-1].kind}, {done} trials done; wanted: {goal}", WIDTH, placeholder=" …")]
    for text in found.beyond[:3]:
        lines += wrap(f"!  out of reach: {text}", WIDTH, subsequent_indent="   ", max_lines=2, placeholder=" …")
    if len(found.beyond) > 3:
        lines.append(f"   and {len(found.beyond) - 3} more values")
    if found.why not in ("", "reached", "out of reach"):
        return [*lines, *wrap(found.why, WIDTH, max_lines=6, placeholder=" …")]
    if not found.steps:
        other = "other " if found.beyond else ""
        end = "no further trial is needed"
        if found.why != "reached":
            end = "but too few cells were repeated to tell scatter from a wrong form"
        return [*lines, *wrap(f"every {other}goal is reached, {end}", WIDTH)]
    for number, (step, (why, _)) in enumerate(zip(found.steps, found.lines, strict=True), 1):
        text = shorten(why, WIDTH - 17, placeholder=" …")
        lines.append(f"{number:3d}  {text:{WIDTH - 17}}{in_words(step.seconds):>12}")
    last = found.steps[-1]
    end = "all goals should be reached" if last.worst <= 1 else f"the farthest is at {last.worst:.2g} times its goal"
    lines.append(f"after them {end}")
    if written:
        sources = runs[-1].manifest.get("sources") or {}
        bench, specimen = (
            shlex.quote(Path(str(sources.get(name, name.upper()))).stem) for name in ("bench", "specimen")
        )
        lines.append(f"next    pmabench run {shlex.quote(written)} --bench {bench} --specimen {specimen}")
    else:
        lines.append("next    the same command with -o FILE.yaml writes them as a protocol")
    return lines
