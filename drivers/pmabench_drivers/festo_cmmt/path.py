"""Where the drive is wanted at a time, and the next target and velocity of a sine; knows no drive.

In each cycle the drive gets the velocity that brings it to the sine's value at the end of the cycle, and a target
beyond that in the same direction: so it never brakes for a target on the way, and goes on smoothly where a cycle comes
late. The target is never outside the sine's own crests. What the drive loses by its acceleration is seen in where it
is, and made up slowly. Standard library only.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from pmabench.bench.interface import Segment
from pmabench_drivers.shared.segments import stepped

CATCH_UP = 0.02
"""Share of what the drive is off its profile by that is made up in one cycle: slow against delays of the link."""


class Path:
    """Positions in user units of the drive; `clock` tells bench time [s]."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._segment: Segment | None = None
        self._since, self._from, self._to, self._velocity = 0.0, 0.0, 0.0, 0.0
        self._off = 0.0

    def rest_at(self, position: float) -> None:
        """It is at rest there."""
        self.end()
        self._from = self._to = position

    def go(self, target: float, velocity: float) -> None:
        """It was sent to `target` at `velocity` [1/s] from where it was wanted."""
        self.end()
        self._leave(target, velocity)

    def follow(self, segment: Segment) -> None:
        """It is to follow the segment."""
        self._segment, self._off = segment, 0.0

    def end(self) -> None:
        """No more of a segment."""
        self._segment = None

    def now(self) -> float:
        """Where it is wanted at this moment."""
        now = self._clock()
        if self._segment is not None:
            value, _ = stepped(self._segment, now)
            if value is not None:
                return value
        return self._profile(now)

    def seen(self, position: float, at: float) -> None:
        """Where it was at a bench time `at` [s], since the last target was sent."""
        if self._segment is not None and at >= self._since:
            self._off += CATCH_UP * (position - self._profile(at) - self._off)

    def next(self, cycle: float) -> tuple[float, float] | None:
        """Target and velocity [1/s] for the next `cycle` [s]; None where nothing new is to be sent."""
        segment, now = self._segment, self._clock()
        if segment is None or now < segment.start:
            return None
        if segment.kind == "ramp":
            self.end()
            self._leave(segment.target, segment.rate)
            return segment.target, segment.rate
        value, over = stepped(segment, now + cycle)
        if value is None:
            return None
        reach = value - self._profile(now) - self._off
        velocity = abs(reach) / cycle
        target = value
        swing = abs(segment.amplitude)
        if over:
            self.end()
            velocity = max(velocity, 2 * math.pi * segment.frequency * swing)  # whatever it lags by, it arrives
        else:
            target = min(max(value + math.copysign(abs(reach), reach), segment.origin - swing), segment.origin + swing)
        self._leave(target, velocity)
        return target, velocity

    def _leave(self, target: float, velocity: float) -> None:
        now = self._clock()
        self._since, self._from, self._to, self._velocity = now, self._profile(now), target, velocity

    def _profile(self, now: float) -> float:
        """The drive's own way, without its acceleration."""
        way = self._velocity * max(now - self._since, 0.0)
        left = self._to - self._from
        return self._to if way >= abs(left) else self._from + math.copysign(way, left)
