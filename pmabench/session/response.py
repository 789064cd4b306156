"""A step of the regulator in the words of ISO 10094, and the delay between two channels; pure functions of arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmabench.engine.acquire import Array
from pmabench.session.listening import Series

BAND = 0.05
"""Share of a step that counts as having begun, and inside which it counts as settled."""
MOST_DELAY = 0.2
"""Longest delay between two channels that is looked for [s]."""


@dataclass(frozen=True)
class StepResponse:
    """Times [s] from the command on; None where it never came so far. Overshoot in SI, not below 0."""

    dead_time: float | None
    """Until 5 % of the step."""
    rise: float | None
    """From 10 to 90 %."""
    settling: float | None
    """Until it stays within 5 % of the step about its end value."""
    overshoot: float
    final: float


def step_response(series: Series, commanded_at: float, before: float, noise: float) -> StepResponse:
    """The response to a command at `commanded_at` [s] from a rest at `before`; `noise` is the rms of one sample."""
    y = smoothed(series.y, 5)
    final = float(series.y[series.t > series.t[-1] - 0.2 * (series.t[-1] - commanded_at)].mean())
    size = final - before
    if abs(size) < 5 * noise or size == 0:
        return StepResponse(None, None, None, 0.0, final)
    part = (y - before) / size
    started, low, high = (first_crossing(series.t, part, level) for level in (BAND, 0.1, 0.9))
    outside = np.flatnonzero(np.abs(part - 1) > max(BAND, 4 * noise / abs(size)))
    last = int(outside[-1]) + 1 if len(outside) else 0
    settled = float(series.t[last]) - commanded_at if last < len(series.t) else None
    over = float((part.max() - 1) * abs(size))
    return StepResponse(
        None if started is None else started - commanded_at,
        None if low is None or high is None else high - low,
        settled,
        max(0.0, over - 3 * noise / np.sqrt(5)),
        final,
    )


def smoothed(y: Array, width: int) -> Array:
    """Running mean of an odd `width`, the ends repeated; shape as `y`."""
    if len(y) < width:
        return y
    padded = np.pad(y, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")


def first_crossing(t: Array, y: Array, level: float) -> float | None:
    """When y first passes `level` upwards for good over three samples, on a straight line between two samples."""
    above = y >= level
    held = above[:-2] & above[1:-1] & above[2:] if len(y) > 2 else above
    found = np.flatnonzero(held)
    if not len(found):
        return None
    i = int(found[0])
    if i == 0 or y[i] == y[i - 1]:
        return float(t[i])
    return float(t[i - 1] + (level - y[i - 1]) / (y[i] - y[i - 1]) * (t[i] - t[i - 1]))


def delay(pressure: tuple[Series, Series], other: tuple[Series, Series]) -> float | None:
    """By how much `other` comes later than the pressure [s]: both over one step up and one down.

    Where `other` follows the pressure by any rising curve, it passes half its way at the same pressure up and down.
    That holds for one delay, which is looked for within `MOST_DELAY`. None where there is none.
    """
    up, down = other
    low, high = up.y[: max(3, len(up.y) // 50)].mean(), up.mean(0.2 * (up.t[-1] - up.t[0]))
    if high == low:
        return None
    curves = []
    delays = np.arange(-MOST_DELAY, MOST_DELAY, 1e-3)
    for p, y, sign in ((pressure[0], up, 1.0), (pressure[1], down, -1.0)):
        at = first_crossing(y.t, sign * (smoothed((y.y - low) / (high - low), 5) - 0.5), 0.0)
        if at is None:
            return None
        curves.append(np.interp(at - delays, p.t, smoothed(p.y, 9)))
    apart = curves[0] - curves[1]
    passes = np.flatnonzero(np.diff(np.sign(apart)))
    if not len(passes):
        return None
    i = int(passes[np.abs(delays[passes]).argmin()])
    return float(delays[i] + 1e-3 * apart[i] / (apart[i] - apart[i + 1]))
