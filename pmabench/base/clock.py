"""Two clocks with the same methods, real time and virtual time that jumps to what is waited for; a device's clock."""

from __future__ import annotations

import time
from math import inf
from typing import Protocol


class Clock(Protocol):
    """Bench time in seconds, monotonic, 0 at the start of the run."""

    def now(self) -> float:
        """Bench time [s]."""

    def wait_until(self, deadline: float) -> None:
        """Return when bench time has reached `deadline` [s]; at once if it has passed."""

    def back_to(self, moment: float) -> bool:
        """Take bench time back to `moment` [s] where that can be done; returns whether it was."""

    def set_quiet_until(self, moment: float) -> None:
        """Nothing is going to be commanded before `moment` [s], as far as is known now: a simulation may compute it."""


class RealClock:
    """The machine's monotonic clock; time that has passed stays passed.

    `start` is the moment of bench time 0 on that clock [s]: processes that share it share bench time.
    """

    def __init__(self, start: float | None = None) -> None:
        self.start = time.monotonic() if start is None else start

    def now(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self.start

    def wait_until(self, deadline: float) -> None:
        """Sleep to the absolute deadline, so that errors never add up."""
        left = deadline - self.now()
        if left > 0:
            time.sleep(left)

    def back_to(self, moment: float) -> bool:
        """Real time cannot be taken back."""
        return False

    def set_quiet_until(self, moment: float) -> None:
        """Nothing can be computed before it happens."""


class VirtualClock:
    """A clock that jumps to whatever is waited for: the mock bench as fast as the machine computes."""

    def __init__(self) -> None:
        self._now = 0.0
        self.quiet_until = 0.0
        """Up to when nothing is going to be commanded, as far as is known [s]."""

    def now(self) -> float:
        """The bench time reached so far."""
        return self._now

    def wait_until(self, deadline: float) -> None:
        """Jump to the deadline."""
        self._now = max(self._now, deadline)

    def back_to(self, moment: float) -> bool:
        """Undo the last jump as far as `moment`: a crossing ends a block at the sample where it happened."""
        self._now = min(self._now, moment)
        return True

    def set_quiet_until(self, moment: float) -> None:
        """Keep it for the simulation."""
        self.quiet_until = moment


DRIFT = 1e-2
"""How far any device's clock may drift against the computer's [1]: a ceramic resonator with temperature and age."""


class DeviceClock:
    """Bench time of a device's samples, by the one that came with the shortest delay so far."""

    def __init__(self, drift: float = DRIFT) -> None:
        self._drift, self._ahead = drift, inf
        self._last: int | None = None

    def ahead(self, newest: int, arrived: float) -> float:
        """Bench time minus device time [s], after a sample of `newest` [ns] has `arrived` [s]."""
        passed = newest - self._last if self._last is not None else 0
        self._last = newest
        if passed < 0:  # the device began anew
            self._ahead = inf
        self._ahead = min(self._ahead + self._drift * passed * 1e-9, arrived - newest * 1e-9)
        return self._ahead
