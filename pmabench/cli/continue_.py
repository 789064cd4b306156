"""`pmabench continue`: how the last run ended, and the way on: look at the rig, reset the bench, do what is left."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError, invalid
from pmabench.cli.common import Ui, common, login_name, say
from pmabench.cli.names import PATH, RunFolder, short, typed
from pmabench.cli.outcome import WIDTH

if TYPE_CHECKING:
    from pmabench.store.records import RunData

LOOKED = "Have you looked at the rig, and may pressure be put on it again?"


@click.command(name="continue")
@click.argument("run", required=False, type=RunFolder())
@click.option("--out", default="runs", show_default=True, type=PATH, help="Where run folders are.")
@click.option("--operator", default="", help="Who is at the bench; asked for if not given.")
@click.option("--because", default="", help="Why the bench may be used again; asked for where it is tripped.")
@click.option("--yes", is_flag=True, help="Ask nothing: every question counts as answered, and the record says so.")
@common
def command(ui: Ui, run: Path | None, out: Path, operator: str, because: str, *, yes: bool) -> int:
    """Say how RUN (or the newest in --out) ended, and lead on: reset its bench, do the trials that are left.

    Nothing is done before you have agreed to it.
    """
    from pmabench.store.reader import open_run

    folder = run if run is not None else _newest(out)
    data = open_run(folder)
    left, what_next = _left(folder, data)
    tripped = _tripped(data)
    ui.note(_happened(data, left, tripped))
    if tripped is not None:
        code = _reset(tripped, operator, because, yes=yes)
        if code:
            return code
    if not left:
        ui.result({"schema": "pmabench.continue/1", "run": str(folder), "next": what_next}, lambda: say_next(what_next))
        return 0
    until = (data.manifest.get("until") or {}).get("goal")
    question = f"Go on choosing trials until {until}?" if until else f"Do the {left} trials that are left now?"
    if not yes and not _agreed(question, f"pmabench run --resume {typed(folder.resolve())}"):
        return 0
    from pmabench.cli.run import run_or_resume

    return run_or_resume(ui, (None, None, None), resume=folder, operator=operator, yes=yes)


def say_next(line: str) -> None:
    """The command that comes next, or why there is none."""
    click.echo(f"next    {line}")


def _newest(out: Path) -> Path:
    from pmabench.store.catalogue import catalogue

    rows = [row for row in catalogue(out) if row.kind != "session" or row.status != "finished"] if out.is_dir() else []
    if not rows:
        raise invalid(out, "there is no run in this folder; name a run, or the folder with --out")
    newest = max(rows, key=lambda row: (row.date, row.folder))
    if newest.status == "running":
        raise UsageError(f"{newest.id} is going on; pmabench watch shows it")
    return out / newest.folder


def _left(folder: Path, data: RunData) -> tuple[int, str]:
    """How many trials are left, and the command to type where none can be done by going on."""
    from pmabench.cli.runs import ENDED_EARLY, going_on, trials_left

    after = going_on(folder, data)
    if after["continued_by"]:
        later = folder.resolve().parent / after["continued_by"]
        return 0, f"pmabench continue {typed(later)}    goes on after the run that continued this one"
    if after["resume"]:
        return trials_left(data), ""
    if data.status in ENDED_EARLY and not any(trial.status == "finished" for trial in data.trials):
        return 0, "nothing of this run can be processed or continued; run the protocol again"
    return 0, f"pmabench process {typed(folder.resolve())}"


def _happened(data: RunData, left: int, tripped: Any) -> str:
    from pmabench.cli.runs import vented

    planned = int(data.manifest.get("trials_planned") or 0)
    why = str(data.manifest.get("why") or "")
    mark = "SIMULATED  " if data.simulated else ""
    head = f"{mark}{data.status.upper()}  {data.kind}, {short(Path(data.path))}" + (f": {why}" if why else "")
    lines = wrap(head, WIDTH, subsequent_indent="   ")
    trials = f"{planned - left} of {planned} trials are done" if planned else "a run without trials"
    guard = data.manifest.get("guard") or {}
    result = vented(data) or str((guard.get("vent") or {}).get("result") or "")
    lines.append(f"   {trials}; vent {result or 'not recorded'}")
    if tripped is not None:
        lines.append("   its bench is tripped: nothing runs on it until it is reset")
    return "\n".join(lines)


def _tripped(data: RunData) -> str | None:
    """The bench as `vent` takes it, where it is tripped."""
    from pmabench.guard.station import stations

    name = data.manifest.get("bench")
    for station in stations():
        saved = station.read("bench")
        if saved.get("name") == name and saved.get("realtime") and station.latched():
            return str(name)
    return None


def _reset(bench: str, operator: str, because: str, *, yes: bool) -> int:
    """Vent and reset the bench where a person says that it may be used again; another exit code than 0 where not."""
    by_hand = f"pmabench vent {shlex.quote(bench)} --reset --operator NAME --because TEXT"
    if not (yes or (operator and because)) and not _agreed(LOOKED, by_hand):
        return 5
    if not (operator and because) and not sys.stdin.isatty():
        raise UsageError(f"a reset is recorded: say who and why, with --operator NAME --because TEXT, or {by_hand}")
    operator = operator or click.prompt("Who resets it", default=login_name(), err=True)
    because = because or click.prompt("Why may it be used again", err=True)
    asked = ["vent", bench, "--reset", "--operator", operator, "--because", because]
    done = subprocess.run([sys.executable, "-m", "pmabench", *asked], stdout=sys.stderr.fileno(), check=False)
    return done.returncode  # a process for itself: it holds the lock of the bench until it ends


def _agreed(question: str, command: str) -> bool:
    """Whether a person says yes; without a terminal nobody can, and the command for it is named."""
    if sys.stdin.isatty() and click.confirm(question, err=True):
        return True
    say(f"not done; later:  {command}")
    return False
