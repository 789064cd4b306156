"""`pmabench run`: execute a protocol on a bench into a run folder; the exit code says how it ended."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.cli.common import Ui, common, plan_options

if TYPE_CHECKING:
    from pmabench.cli.prepare import Prepared
    from pmabench.engine.executor import Progress
    from pmabench.engine.operator import Operator
    from pmabench.engine.run import Outcome

CLEAR = "\r\x1b[2K"
"""Takes the line of progress away."""


@click.command(name="run")
@plan_options
@click.option("--out", default="runs", show_default=True, type=click.Path(path_type=Path), help="Where run folders go.")
@click.option("--operator", default="", help="Who is at the bench; the login name if not given.")
@click.option("--yes", is_flag=True, help="Every prompt counts as answered; the record says so.")
@common
def command(
    ui: Ui,
    protocol: str,
    bench: str,
    specimen: str,
    out: Path,
    settings: list[tuple[str, str]],
    operator: str,
    *,
    yes: bool,
) -> int | None:
    """Execute PROTOCOL on a bench with a specimen and record it."""
    from pmabench.cli.prepare import prepare

    prepared = prepare(protocol, bench, specimen, settings)
    outcome = execute(ui, prepared, out, operator_name=operator, yes=yes)
    ui.result(outcome_json(outcome), lambda: print_outcome(outcome))
    return outcome.exit_code


def execute(ui: Ui, prepared: Prepared, out: Path, *, operator_name: str = "", yes: bool = False) -> Outcome:
    """Run a prepared plan with progress on the terminal."""
    from pmabench.engine.run import run_plan

    for warning in prepared.warnings():
        ui.note(warning)
    with progress_line(ui, f"{prepared.plan.kind}") as progress:
        return run_plan(
            prepared.plan,
            prepared.mounted,
            _operator(yes=yes),
            out=out,
            protocol_text=prepared.protocol_text,
            deviations=prepared.deviations,
            operator_name=operator_name,
            progress=progress,
        )


def _operator(*, yes: bool) -> Operator:
    from pmabench.engine.operator import AtTerminal, ConfirmedBeforehand, Nobody

    if yes:
        return ConfirmedBeforehand()
    if sys.stdin.isatty():
        return AtTerminal(input, lambda text: click.echo(f"{CLEAR if sys.stderr.isatty() else ''}{text}", err=True))
    return Nobody()


@contextmanager
def progress_line(ui: Ui, title: str) -> Iterator[Callable[[Progress], None]]:
    """A line that is rewritten at most four times a second on a terminal; nothing elsewhere."""
    live = sys.stderr.isatty() and not ui.quiet and not ui.json
    started = last = time.monotonic()

    def show(progress: Progress) -> None:
        nonlocal last
        now = time.monotonic()
        if not live or now - last < 0.25:
            return
        last = now
        done = progress.t / (progress.t + progress.longest) if progress.t + progress.longest > 0 else 0.0
        left = (now - started) * (1 - done) / done if done > 0.02 else None
        trial = f"trial {progress.trial + 1} of {progress.trials}" if progress.trial is not None else progress.phase
        bar = "#" * round(24 * done)
        rest = f", {left:.0f} s left" if left is not None else ""
        line = f"{title}  [{bar:<24}] {100 * done:3.0f} %  {trial}{rest}"
        click.echo(CLEAR + line[: shutil.get_terminal_size().columns - 1], err=True, nl=False)

    yield show
    if live:
        click.echo(CLEAR, err=True, nl=False)


def outcome_json(outcome: Outcome) -> dict[str, Any]:
    """The documented object of a run's end."""
    return {
        "schema": "pmabench.outcome/1",
        "run": str(outcome.folder),
        "status": outcome.status,
        "why": outcome.why,
        "exit_code": outcome.exit_code,
        "vent": None
        if outcome.vent is None
        else {"result": outcome.vent.result, "actions": list(outcome.vent.actions)},
        "bench_seconds": outcome.bench_seconds,
        "rows": outcome.rows,
        "trials_failed": list(outcome.trials_failed),
    }


def print_outcome(outcome: Outcome) -> None:
    """How it ended, in two lines."""
    why = f": {outcome.why}" if outcome.why else ""
    vent = f"; vent {outcome.vent.result}" if outcome.vent is not None else ""
    click.echo(f"{outcome.status}{why}; {outcome.rows:,} rows{vent}")
    click.echo(str(outcome.folder))
