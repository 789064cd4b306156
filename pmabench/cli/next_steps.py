"""What a person types after a run that did not come to its end: the reset of a tripped bench, and going on."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from pmabench.cli.common import Ui, say

if TYPE_CHECKING:
    from pmabench.bench.interface import CompiledBench
    from pmabench.engine.run import Outcome

FINISHED = ("finished", "failed")


def show_next(ui: Ui, outcome: Outcome, bench: CompiledBench, *, trials: bool) -> None:
    """A line for each thing to do, each with its command; nothing where the run came to its end.

    `trials`: whether the run had any; a session has none, and is done anew. With --quiet only that a bench is tripped.
    """
    from pmabench.guard.station import Station

    if bench.realtime and Station(bench.name).latched():
        reset = f"pmabench vent {_named(bench)} --reset --operator NAME --because TEXT"
        say(f"the bench is now tripped, and nothing runs on it: look at it, then  {reset}")
    if trials and outcome.folder is not None and outcome.status not in FINISHED:
        ui.note(f"the trials that are left:  pmabench run --resume {shlex.quote(str(outcome.folder))}")


def _named(bench: CompiledBench) -> str:
    """The bench as it can be typed here: a shipped one by its name, another by its file."""
    from pmabench.files.shipped import shipped_folder

    path = Path(bench.path)
    if path == (shipped_folder("bench") / path.name).resolve():
        return path.stem
    return shlex.quote(str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path))
