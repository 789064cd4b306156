"""`pmabench next`: which trials bring the intervals of a test to their goals soonest; as a protocol file."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from textwrap import shorten, wrap
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import RecordError, UsageError
from pmabench.base.kind import Kind, load
from pmabench.base.quantities import in_words
from pmabench.cli.common import Ui, common, read_quantity
from pmabench.cli.names import FILE, RunFolder
from pmabench.cli.until import PART, goals_of

if TYPE_CHECKING:
    from pmabench.store.records import RunData

MOST = 10
"""Trials that are proposed at once: after these more is known."""
WIDTH = 80


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
    if output is not None and output.exists():
        raise UsageError(f"{output} is there already; give the name of a new file")
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
    from pmabench.cli.process import load_runs
    from pmabench.kinds import registry
    from pmabench.store.analyses.folder import runs_of
    from pmabench.store.folder import MANIFEST

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
    from pmabench.protocol.idle import chosen

    document, model = read_protocol(Path(run.path) / "protocol.yaml", ())
    swept = [trial["index"] for trial in run.plan["trials"] if not trial["reference"]]
    text = (Path(run.path) / "protocol.yaml").read_text(encoding="utf-8")
    made = chosen(document, getattr(model, "sweep", None), text, [swept.index(index) for index in trials])
    try:
        path.write_text(made, encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{path} cannot be written: {error.strerror}") from error


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
