"""What creeps after a path, in closed form: a length after a contraction, a pressure after a pressure."""

from __future__ import annotations

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.real.muscle import Creep
from pmabench.model.regulator import Regulated, Trace, answer


def rubber(per_decade: float) -> Creep:
    """The pressure that rubber no longer passes on as force: `per_decade` of it [1] in each decade, 0.1 s to 1e5 s.

    Two exponentials a decade: their sum is straight over the logarithm of time within 1 % of a decade.
    """
    return Creep(per_decade / 2, tuple(10.0 ** (0.5 * k) for k in range(-2, 11)))


class CreepAlong:
    """What creeps after a path x, the sum of x_j with T_j x_j' = share x - x_j, all 0 at `start` [s].

    Time only goes forward. A copy made with `copy.copy` is independent.
    """

    def __init__(self, creep: Creep, start: float) -> None:
        self._creep, self._time = creep, start
        self._path: Trace | None = None
        self._lengths = tuple(Trace(start, 0.0) for _ in creep.times)

    def along(self, path: Regulated, t: Array) -> Array:
        """The sum [as the path] at rising times t [s]; every piece of `path` since the last call counts."""
        result = np.empty(t.shape)
        last, done = float(t[-1]), 0
        while True:
            trace, end = path.piece(self._time)
            if trace != self._path:
                self._path = trace
                self._lengths = tuple(
                    answer(trace, self._time, length.value(self._time), lag, self._creep.share)
                    for length, lag in zip(self._lengths, self._creep.times, strict=True)
                )
            count = len(t) if end > last else int(np.searchsorted(t, end))
            part = t[done:count]
            result[done:count] = sum((length.values(part) for length in self._lengths), np.zeros(part.shape))
            done, self._time = max(done, count), min(end, last)
            if end > last:
                return result
