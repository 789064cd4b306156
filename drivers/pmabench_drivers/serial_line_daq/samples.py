"""From numbered samples to times on one clock that never wraps, and to what was lost; knows no port."""

from __future__ import annotations

from pmabench_drivers.serial_line_daq.wire import Sample

WRAP = 1 << 32
LONGEST = 10_000_000
"""A jump over more than this is no loss but nonsense [us]."""
DRIFT = 2e-3
"""How far number and clock may drift apart over a gap [1]."""


class Timeline:
    """Tells of each sample when it was taken; counts what was lost by the numbers.

    Number and clock say the same twice: a sample whose two do not fit is not believed.
    """

    def __init__(self, period: int, before: Timeline | None = None) -> None:
        self._period = period
        self._last: Sample | None = None
        self._time = 0
        self.ahead: float | None = before.ahead if before is not None else None
        """What the board's clock is ahead of bench time by, wraps counted [us]; times go on where `before` ended."""
        self.lost = 0
        """Samples whose numbers never came."""
        self.misfits = 0
        """Samples in a row that were not believed."""

    def place(self, sample: Sample, host: float) -> int | None:
        """Time of a sample that came at `host` [s, bench time] by the board's clock [us]; None: it is not believed."""
        last = self._last
        if last is None:
            if self.ahead is None:
                self.ahead = sample.micros - host * 1e6
            self._time = sample.micros + WRAP * round((host * 1e6 + self.ahead - sample.micros) / WRAP)
        else:
            ahead, passed = (sample.number - last.number) % WRAP, (sample.micros - last.micros) % WRAP
            expected = ahead * self._period
            if not 0 < expected <= LONGEST or abs(passed - expected) >= self._period + DRIFT * expected:
                self.misfits += 1
                return None
            self.lost += ahead - 1
            self._time += passed
        self._last, self.misfits = sample, 0
        return self._time
