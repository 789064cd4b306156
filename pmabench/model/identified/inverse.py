"""The pressure with which an identified muscle follows a wanted contraction under a load, for a feed-forward.

The muscle's memory goes along with the wanted contraction, so that each small loop has its own pressure. At each moment
one equation is left for one pressure, F(P, x, past) - B(P) x' = F_L, whose left side rises with P: it is solved inside
the range of the command by false position (Illinois).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.identified.muscle import IdentifiedMuscle
from pmabench.model.identified.plant import Path
from pmabench.model.regulator import Regulator

NEAR = 1.0
"""Pressure that is near enough [Pa]."""
MOST = 40


def pressures(muscle: IdentifiedMuscle, t: Array, x: Array, v: Array, load: float, ends: tuple[float, float]) -> Array:
    """Pressure [Pa], shape (n,), between `ends` [Pa], for contractions x [m] at rates v [m/s] and rising times t [s].

    Under a load F_L [N], from a muscle that was rested and vented. Where no pressure of the range does it, the nearest.
    """
    path = Path(muscle, 0.0, float(x[0]))
    found = np.empty(len(t))
    before = float(t[0]) - 1.0
    for row, (now, place, speed) in enumerate(zip(t.tolist(), x.tolist(), v.tolist(), strict=True)):
        span = now - before

        def left(P: float, span: float = span, place: float = place, speed: float = speed) -> float:
            return path.step(span, P).pull(place)[0] - muscle.damping(P, speed > 0) * speed - load

        P = found[row] = rising_root(left, *ends, first=found[row - 1] if row else ends[0])
        path.arrive(path.step(span, P), place)
        before = now
    return found


def rising_root(of: Callable[[float], float], low: float, high: float, first: float) -> float:
    """Where a rising function is 0 between two ends, or the end that is nearest; looked for around `first` first."""
    width = 1e-3 * (high - low)
    a, b = max(low, first - width), min(high, first + width)
    at_a, at_b = of(a), of(b)
    while at_a > 0 and a > low:
        b, at_b, width = a, at_a, 4 * width
        a = max(low, a - width)
        at_a = of(a)
    while at_b < 0 and b < high:
        a, at_a, width = b, at_b, 4 * width
        b = min(high, b + width)
        at_b = of(b)
    if at_a >= 0:
        return a
    if at_b <= 0:
        return b
    side = 0
    for _ in range(MOST):
        middle = b - at_b * (b - a) / (at_b - at_a)
        at = of(middle)
        if abs(b - a) < NEAR or at == 0:
            return middle
        if at > 0:
            b, at_b = middle, at
            at_a, side = (0.5 * at_a if side > 0 else at_a), 1
        else:
            a, at_a = middle, at
            at_b, side = (0.5 * at_b if side < 0 else at_b), -1
        if abs(at) < 1e-3:
            return middle
    return middle


def led(t: Array, P: Array, regulator: Regulator, ends: tuple[float, float]) -> Array:
    """What to command for P(t) [Pa] behind a regulator with dead time and lag: P + lag P', earlier; inside `ends`."""
    early = t + regulator.dead_time
    wanted = np.interp(early, t, P) + regulator.lag * np.interp(early, t, np.gradient(P, t))
    return np.clip(wanted, *ends)
