"""Whether samples with times of their own keep coming at the pace that was agreed. Standard library only."""

from __future__ import annotations

import math

DRIFT = 2e-4
"""How far the clocks of device and computer may run apart [1]."""
AHEAD = 0.3
"""More than this no sample may be here before its time [s]."""
WINDOW = 1.0
"""So long everything must be late, before it is believed [s]: a computer that is busy is late now and then."""
ENOUGH = 20
"""And so many pieces."""


class Pace:
    """Looks at how late pieces arrive; `slip` is how much later than at best they all may be for a while [s]."""

    def __init__(self, slip: float) -> None:
        self._slip = slip
        self._least, self._seen, self._begun = math.inf, -math.inf, -math.inf
        self._window: list[float] = []

    def behind(self, taken: float, now: float) -> float:
        """For a newest sample `taken` by its own clock that came `now` [s, bench time]: 0, or how much is wrong [s].

        Negative where samples come before their time.
        """
        late = now - taken
        self._least = min(self._least + DRIFT * max(0.0, min(now - self._seen, WINDOW)), late)
        self._seen = now
        if late < -AHEAD:
            return late
        if not self._window:
            self._begun = now
        self._window.append(late)
        if now - self._begun < WINDOW or len(self._window) < ENOUGH:
            return 0.0
        behind = min(self._window) - self._least
        self._window = []
        return behind if behind > self._slip else 0.0
