"""Driven sines, or each cycle of them, as points, and the straight lines through them; no interval, no estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmabench.analysis.shared.lines import Line, weighted_line
from pmabench.analysis.shared.sine_loop import Sine


@dataclass(frozen=True)
class Point:
    """One trial, or one cycle of it, as the lines want it."""

    frequency: float
    speed: float
    stiffness: float
    ratio: complex
    loss: float
    width: float


def turned(sine: Sine, by: float) -> Point:
    """The trial had the force come `by` [s] earlier; the width at mid stroke grows by twice what the loss does."""
    ratio = sine.ratio * complex(np.exp(1j * sine.omega * by))
    loss = -ratio.imag * sine.amplitude
    width = sine.width + 2 * (loss - sine.loss)
    return Point(sine.frequency, sine.speed, -ratio.real, ratio, loss, width)


def each_cycle(sine: Sine) -> list[Point]:
    """Each cycle of a trial as a point of the lines."""
    rows = zip(sine.cycles.ratio, sine.cycles.size, sine.cycles.width, strict=True)
    return [
        Point(
            sine.frequency,
            sine.omega * float(size),
            -float(ratio.real),
            complex(ratio),
            -float(ratio.imag) * float(size),
            float(width),
        )
        for ratio, size, width in rows
    ]


def lines(points: Sequence[Sine] | Sequence[Point]) -> tuple[Line, Line, Line]:
    """K over all trials, and the lines of loss and width over speed."""
    frequency = np.array([point.frequency for point in points])
    speed = np.array([point.speed for point in points])
    K = np.array([point.stiffness for point in points])
    size = np.array([abs(point.ratio) for point in points])
    # Phase errors turn loss into stiffness: a K counts by the whole force beside it.
    pooled = weighted_line(frequency, None, K, size)
    loss = weighted_line(frequency, speed, np.array([point.loss for point in points]))
    width = weighted_line(frequency, speed, np.array([point.width for point in points]))
    return pooled, loss, width
