"""A chain in real time: blocks of the simulation, or of a result, each shown when its moment has come."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from shutil import get_terminal_size
from typing import TYPE_CHECKING

from pmabench.cli.common import Ui, rewrite, say

if TYPE_CHECKING:
    from pmabench.base.clock import Clock
    from pmabench.model.cascade import Course
    from pmabench.model.curve import Array

BLOCK = 0.05
"""Time of one block [s]."""
CLOSE = 0.02
"""How far elapsed and simulated time may lie apart."""
WIDTH, MARGIN = 60, 30
"""Letters of the whole chain where there is room, and of what is next to it."""
Show = Callable[[float, Sequence[float], Sequence[bool]], None]
"""Takes the time [s], the contraction of each muscle [m], and which of them are under pressure."""


def paced(times: Array, step: Callable[[Array], Course], clock: Clock, show: Show) -> tuple[list[Course], float]:
    """Take `times` [s] block by block, each ending no earlier than its moment; the blocks and the seconds elapsed."""
    import numpy as np

    begin = clock.now()
    blocks: list[Course] = []
    edges = np.arange(1, int(times[-1] / BLOCK) + 2) * BLOCK + 1e-9
    for part in np.split(times, np.searchsorted(times, edges, side="right")):
        if len(part) == 0:
            continue
        course = step(part)
        blocks.append(course)
        clock.wait_until(begin + float(part[-1]))
        show(float(part[-1]), course.x[:, -1].tolist(), (course.P[:, -1] > 0).tolist())
    return blocks, clock.now() - begin


def show_pace(ui: Ui, simulated: float, elapsed: float) -> None:
    """Say how well the pace was kept."""
    apart = elapsed / simulated - 1
    if abs(apart) <= CLOSE:
        ui.note(f"{simulated:.3f} s in {elapsed:.3f} s ({100 * apart:+.2f} %)")
    else:
        ui.note(
            f"{simulated:.3f} s took {elapsed:.3f} s ({100 * apart:+.1f} %): this computer does not keep up; take a "
            "lower sample_rate, or leave --pace"
        )


def shower(ui: Ui, lengths: Sequence[float]) -> Show:
    """Draws the chain as a line of text on stderr: in place on a terminal, else once a second; quiet: nothing."""
    live = sys.stderr.isatty()
    last = [-1.0]

    def show(t: float, x: Sequence[float], on: Sequence[bool]) -> None:
        if ui.quiet or (not live and t - last[0] < 1 - 1e-9):
            return
        last[0] = t
        width = min(max(get_terminal_size().columns - MARGIN, 10), WIDTH) if live else WIDTH
        text = f"{t:8.2f} s {drawn(lengths, x, on, width)} x {1e3 * sum(x):7.2f} mm"
        if live:
            rewrite(text)
        else:
            say(text)

    return show


def show_ended(ui: Ui) -> None:
    """Leave the line that was drawn in place."""
    if sys.stderr.isatty() and not ui.quiet:
        say("")


def drawn(lengths: Sequence[float], x: Sequence[float], on: Sequence[bool], width: int = WIDTH) -> str:
    """The chain between its fixed end and where its free end rests: muscles as long as they are, `=` under pressure.

    >>> drawn([0.3, 0.3], [0.1, 0.0], [True, False])
    '|[==================][----------------------------]o          .'
    """
    whole, place, text = sum(lengths), 0.0, ""
    for length, contraction, pressed in zip(lengths, x, on, strict=True):
        place += length - contraction
        wide = round(width * place / whole) - len(text)
        sign = "=" if pressed else "-"
        text += f"[{sign * (wide - 2)}]" if wide > 2 else sign * wide
    return f"|{text}o".ljust(width + 2) + "."
