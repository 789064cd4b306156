"""Laws that ramp and wait: `ramp-until` and `closed-strokes`; they know no devices and no files.

`ramp-until` ramps the output until a channel crosses a threshold: lift, set-down, return to zero, dead band. A fast
approach finds the neighbourhood, then the output goes back and a slow ramp finds the crossing again, so that lag of the
regulator and creep have little effect.

`closed-strokes`: a valve shuts the air in, the driven end moves to and fro, the valve opens again. Shut is the safe
state of this valve, so any end of the run leaves it shut.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pmabench.base.errors import LimitTripped
from pmabench.base.quantities import CHANNEL_QUANTITY, show, without_number
from pmabench.engine.acquire import Samples
from pmabench.engine.seek import Moves


def ramp_until(
    moves: Moves,
    *,
    channel: str,
    threshold: float,
    direction: str,
    rate: float,
    approach_rate: float,
    back_off: float,
    window: float,
    settle: float,
) -> dict[str, Any]:
    """Search for the crossing of `threshold` [SI of `channel`].

    `direction` "up": the output rises until the channel is above the threshold for `window` [s]; "down": it falls until
    the channel is below. `rate` [SI/s] is the slow one, `approach_rate` the fast one (0: none). After the approach the
    output goes back by `back_off` [SI] and rests for `settle` [s]. Result: measured pressure, time and channel value at
    the crossing (means over `window`), and the command's end value. Not found where the channel is above the threshold
    before the output has risen: then its zero is wrong.
    """
    up = direction == "up"
    far = moves.step.high if up else moves.step.low
    start = moves.commanded if moves.commanded is not None else _commanded_now(moves)
    began = moves.clock.now()
    if approach_rate > 0:
        crossing = _cross(moves, start, far, approach_rate, channel, threshold, window, above=up)
        if crossing is None:
            return {"found": False, "reason": f"{channel} did not cross before the end of the range"}
        if up and crossing["t"] < began + 2 * window:
            at = show(crossing[channel], CHANNEL_QUANTITY[without_number(channel)[0]])
            return {
                "found": False,
                "reason": f"{channel} is {at} before anything moves: set its zero, then search again",
            }
        here = _commanded_now(moves)
        start = moves.inside(here - back_off if up else here + back_off)
        moves.wait(moves.ramp(here, start, approach_rate))
        moves.wait(moves.clock.now() + settle)
    crossing = _cross(moves, start, far, rate, channel, threshold, window, above=up)
    if crossing is None:
        return {"found": False, "reason": f"{channel} did not cross before the end of the range"}
    here = _commanded_now(moves)
    moves.set(here)
    return {"found": True, "direction": direction, "command": here, **crossing}


def _commanded_now(moves: Moves) -> float:
    name = f"{moves.step.output}_command"
    return moves.inside(moves.acquisition.latest[name])


def _cross(
    moves: Moves,
    origin: float,
    target: float,
    rate: float,
    channel: str,
    threshold: float,
    window: float,
    *,
    above: bool,
) -> dict[str, float] | None:
    samples = max(1, round(window * moves.acquisition.rate))
    seen = _Crossing(channel, threshold, samples, above=above)
    end = min(moves.ramp(origin, target, rate) + 1.0, moves.deadline)
    stopped = moves.acquisition.until(end, seen)
    if stopped is None:
        return None
    return {"t": stopped, **seen.at}


class _Crossing:
    """Looks for a run of samples beyond the threshold, across blocks."""

    def __init__(self, channel: str, threshold: float, samples: int, *, above: bool) -> None:
        self.channel, self.threshold, self.samples, self.above = channel, threshold, samples, above
        self.run = 0
        self.at: dict[str, float] = {}

    def __call__(self, block: Samples) -> int | None:
        x = block.values.get(self.channel)
        if x is None:
            return None
        beyond = x > self.threshold if self.above else x < self.threshold
        index = np.arange(len(beyond))
        runs = index - np.maximum.accumulate(np.where(beyond, -1 - self.run, index))  # length of the run beyond
        hits = np.flatnonzero(beyond & (runs >= self.samples))
        if len(hits) == 0:
            self.run = int(runs[-1]) if beyond[-1] else 0
            return None
        hit = int(hits[0])
        first = max(0, hit - self.samples + 1)
        self.at = {name: float(np.mean(values[first : hit + 1])) for name, values in block.values.items()}
        return hit


def closed_strokes(
    moves: Moves, *, valve: str, start: float, to: float, rate: float, rest: float, cycles: int
) -> dict[str, Any]:
    """Shut `valve`, move the output `cycles` times from `start` to `to` [SI] and back at `rate` [SI/s], open it.

    It rests for `rest` [s] after the valve has shut, at both ends of each stroke, and before it opens again. Result:
    bench times [s] at which it was shut and opened.

    Raises
    ------
    LimitTripped
        Where it takes longer than the step's limit: the end is not where the plan expects it, and air is shut in.
    """
    shut = moves.valve(valve, safe=True)
    moves.wait(shut + rest)
    for _ in range(cycles):
        for origin, target in ((start, to), (to, start)):
            there = moves.ramp(origin, target, rate)
            moves.wait(there + rest)
            if moves.clock.now() < there + rest - 1e-6:
                raise LimitTripped(f"the strokes with {valve} shut took longer than {moves.step.limit:g} s")
    opened = moves.valve(valve, safe=False)
    return {"found": True, "command": start, "shut": shut, "opened": opened}
