"""The line of progress of a run in virtual time, and of other work in this process."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pmabench.cli.common import Ui, rewrite

if TYPE_CHECKING:
    from pmabench.engine.executor import Progress


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
        rewrite(line[: shutil.get_terminal_size().columns - 1])

    yield show
    if live:
        rewrite()
