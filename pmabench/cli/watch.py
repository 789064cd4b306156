"""`pmabench watch`: what a run is doing now, from its folder alone; nothing of the bench is touched."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError, invalid
from pmabench.cli.common import Ui, common, fields
from pmabench.cli.names import RunFolder

if TYPE_CHECKING:
    from pmabench.display.state import RunState


@click.command(name="watch")
@click.argument("run", default="runs", type=RunFolder())
@click.option("--plain", is_flag=True, help="One line per event and trial; so it is where the output is no terminal.")
@click.option("--wait", is_flag=True, help="Wait for a run that is not there yet.")
@click.option("--web", is_flag=True, help="In a browser, until Ctrl-C: prints the address to open.")
@click.option("--listen", metavar="ADDRESS", help="With --web: also for others, at this address of this computer.")
@click.option("--vent", is_flag=True, help="With --web: a vent button, where the bench file has `web_vent: true`.")
@common
def command(ui: Ui, run: Path, listen: str | None, *, plain: bool, wait: bool, web: bool, vent: bool) -> int | None:
    """Watch RUN, or the newest run of a folder of runs, until it ends; q leaves the run alone.

    Of a folder, what follows is watched too: the run after a session, the next run of a campaign.

    For instance: pmabench watch --web
    """
    if web:
        from pmabench.cli.web import serve

        return serve(ui, run, listen, vent=vent)
    if listen or vent:
        raise UsageError("--listen and --vent belong to --web")
    folder = _find(ui, run, wait=wait)
    several = folder != run
    from pmabench.display.console import watch
    from pmabench.display.lines import last_line

    try:
        state = watch(folder, plain=plain, color=ui.color, quiet=ui.json or ui.quiet, on=several)
        if ui.json or ui.quiet:
            ui.result(_json(state.files.folder, state), lambda: click.echo(last_line(state)))
    except BrokenPipeError:
        return 0
    return None


def _find(ui: Ui, place: Path, *, wait: bool) -> Path:
    """The run folder that is meant; raises InvalidFile where there is none."""
    noted = False
    while True:
        if (place / "manifest.json").exists():
            return place
        runs = [(path.stat().st_mtime, path.parent) for path in place.glob("*/manifest.json")]
        if runs:
            return max(runs)[1]
        if not wait:
            why = "holds no run" if place.is_dir() else "there is no such run"
            raise invalid(place, f"{why}; `pmabench runs list` shows those that are there, --wait waits for one")
        if not noted:
            ui.note(f"no run in {place} yet; waiting for it, Ctrl-C ends")
            noted = True
        time.sleep(0.25)


def _json(folder: Path, state: RunState) -> dict[str, Any]:
    """The documented object: the state of the run or how it ended, and each trial's line."""
    return {
        "schema": "pmabench.watch/1",
        "run": str(folder),
        **fields(state, "status", "why", "vent", "simulated", "rows"),
        "flagged": dict(state.counts),
        "trials_planned": state.trials,
        "trials": [
            fields(line, "point", "repeat", "status", "doubts")
            | {"trial": line.number, "numbers": [vars(number) for number in line.numbers]}
            for line in state.lines
        ],
    }
