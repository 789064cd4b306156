"""What the vented cell reads before and after a hold: its zero, and the muscle's own recovery.

A muscle that can push, as at no contraction in a stiff frame, shows the step back, whose course by superposition is
that of its own relaxation; a slack one shows nothing. What the record shows of that course is no drift of the cell.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pmabench.store.records import Array

CALM = 2.0
"""Time before the step and at the end of the trial whose mean is the zero of the force [s]."""
UNLIKE = 1.5
"""Factor by which an earlier hold may have relaxed more than this one, and a recovery from what superposition says."""
ZERO_SEEN = 6.0
"""Change of the force without pressure, in its noise, from which on it is attributed to the cell."""
PUSHES = 0.2
"""Share of the recovery from which on the vented muscle counts as pushing [1]."""
GONE = 0.05
"""Share of the pressure below which the muscle is vented [1]."""
FADES = (10.0, 30.0, 100.0)
"""Time constants with which a drift may fade, each where the record after the vent is twice as long [s]."""
SURE = 3.0
"""Standard errors of the recovery's share that its uncertainty counts for: the noise may be correlated."""


def left_by(holds: Sequence[tuple[float, float, float]], t: Array, relaxed: Callable[[Array], Array]) -> Array:
    """Force that holds (as `Course.before`) leave by superposition, at times t [s] after this step [N].

    `relaxed` is the part of the force that changes after a step.
    """
    return np.asarray(sum((P * (relaxed(t + a) - relaxed(t + b)) for P, a, b in holds), np.zeros_like(t)))


@dataclass(frozen=True, eq=False)
class Vented:
    """Samples of a trial, shape (n,)."""

    t: Array
    """Time after the step [s]."""
    F: Array
    """Force [N]."""
    risen: Array
    """Share of the pressure [1]."""
    holds: tuple[tuple[float, float, float], ...]
    """Holds as `Course.before`, this one as the last."""
    relaxed: Callable[[Array], Array]
    """The part of the force that changes after this step [N]."""
    straight: bool
    """Whether that is straight over log t; exponentials could also be a drift that fades."""

    @cached_property
    def _before(self) -> float:
        """What earlier holds leave before the step, by superposition [N]."""
        return float(left_by(self.holds[:-1], np.full(1, -CALM / 2), self.relaxed)[0])

    @cached_property
    def _first(self) -> float:
        """The force before the step [N]."""
        return float(self.F[(self.t >= -CALM) & (self.t < 0)].mean())

    @property
    def offset(self) -> float:
        """The force before the step, beyond what earlier holds may have left [N]."""
        most = UNLIKE * self._before
        return self._first - float(np.clip(self._first, min(most, 0.0), max(most, 0.0)))

    @cached_property
    def _after(self) -> tuple[float, float, float]:
        """Share of the recovery that the record shows after the vent [1], the uncertainty of that share [1], and a
        drift of the cell that fades [N].

        As soon as the pressure is gone a muscle that can push pushes most: one that does not is slack.
        """
        rows = (self.t > -self.holds[-1][2]) & (self.risen < GONE)
        t, F = self.t[rows], self.F[rows] - self._first
        since = t - np.min(t, initial=np.inf)
        early, rest = since < CALM, since >= CALM
        if min(np.count_nonzero(early), np.count_nonzero(rest)) < 8:
            return 0.0, 0.0, 0.0
        recovery = left_by(self.holds, t, self.relaxed) - self._before
        most = float(recovery[early].mean())
        pushes = bool(F[early].mean() * most > PUSHES * most**2)
        terms = [np.ones_like(t), self.risen[rows], *([recovery] if pushes else [])]
        share, error = _least(terms, F, rest) if pushes else (0.0, 0.0)
        known = [T for T in FADES if 2 * T <= since[-1]] if self.straight or not pushes else []
        fading = (_least([*terms, np.exp(-since / T)], F, rest)[0] for T in known)
        return share, SURE * error, max(fading, key=abs, default=0.0)

    @property
    def recovered(self) -> float:
        """What the muscle's own recovery adds to the force from before the step to the end of the trial [N]."""
        return self._after[0] * self._whole

    @property
    def unsure(self) -> float:
        """Uncertainty of `recovered` from the noise [N]."""
        return abs(self._after[1] * self._whole)

    @cached_property
    def _whole(self) -> float:
        """The same by superposition, of a muscle that can push [N]."""
        last = self.t[self.t > self.t[-1] - CALM]
        return float(left_by(self.holds, last, self.relaxed).mean()) - self._before

    @cached_property
    def end(self) -> float:
        """Change of the cell from before the step to the end of the trial [N]."""
        last, level = self.t > self.t[-1] - CALM, float(np.mean(self.F[self.risen > 1 - GONE]))
        change = float(self.F[last].mean()) - self._first - self.recovered
        # pressure remaining after the vent makes force: that part is no change of the cell
        pulls = float(self.risen[last].mean()) * level
        return change - float(np.clip(pulls, min(change, 0.0), max(change, 0.0)))

    @property
    def zero(self) -> float:
        """Change of the cell to the end or to the vent, whichever is larger [N]."""
        return max(self.end, self.end + self._after[2], key=abs)


def _least(terms: Sequence[Array], y: Array, rows: NDArray[np.bool_]) -> tuple[float, float]:
    """Size of the last of `terms` by least squares to y, both shape (n,), in `rows`, and its standard error."""
    design = np.column_stack(terms)[rows]
    inverse = np.linalg.pinv(design)
    sizes = inverse @ y[rows]
    return float(sizes[-1]), float(np.std(y[rows] - design @ sizes) * np.linalg.norm(inverse[-1]))
