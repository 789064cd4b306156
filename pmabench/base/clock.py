"""Two clocks with the same methods: real time, and virtual time that jumps to what is waited for; a device's clock."""

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
        """Set bench time back to `moment` [s] where possible; returns whether it was."""

    def set_quiet_until(self, moment: float) -> None:
        """Announce that no command is expected before `moment` [s], so that a simulation may compute ahead."""


class RealClock:
    """The machine's monotonic clock; it cannot be set back.

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
        """False: real time cannot be set back."""
        return False

    def set_quiet_until(self, moment: float) -> None:
        """No effect: in real time nothing can be computed ahead."""


class VirtualClock:
    """A clock that jumps to whatever is waited for: the mock bench as fast as the machine computes."""

    def __init__(self) -> None:
        self._now = 0.0
        self.quiet_until = 0.0
        """Time until which no command is expected [s]."""

    def now(self) -> float:
        """The bench time reached so far."""
        return self._now

    def wait_until(self, deadline: float) -> None:
        """Jump to the deadline."""
        self._now = max(self._now, deadline)

    def back_to(self, moment: float) -> bool:
        """Go back to `moment` within the last jump, so that a block can end at the sample where a limit was crossed."""
        self._now = min(self._now, moment)
        return True

    def set_quiet_until(self, moment: float) -> None:
        """Keep it for the simulation."""
        self.quiet_until = moment


DRIFT = 1e-2
"""Largest drift of any device's clock against the computer's [1]: a ceramic resonator with temperature and age."""


class DeviceClock:
    """Converts device time to bench time, by the sample with the shortest delay so far."""

    def __init__(self, drift: float = DRIFT) -> None:
        self._drift, self._ahead = drift, inf
        self._last: int | None = None

    def ahead(self, newest: int, arrived: float) -> float:
        """Bench time minus device time [s], after a sample of device time `newest` [ns] has `arrived` [s]."""
        passed = newest - self._last if self._last is not None else 0
        self._last = newest
        if passed < 0:  # the device restarted
            self._ahead = inf
        self._ahead = min(self._ahead + self._drift * passed * 1e-9, arrived - newest * 1e-9)
        return self._ahead
