"""A discrete PID controller, and a path for its set-point.

Standard library only, because both are called once per sample.

Ideal form C(s) = K_p (1 + 1/(T_i s) + T_d s / (1 + T_d s / N)), with the derivative of the measured value alone, so
that a step of the set-point r causes no spike. At sample k with error e = r - y, h seconds after the last one (Astrom
and
Murray, Feedback Systems, 2nd ed., section 11.5):

    P_k = K_p e_k
    D_k = T_d / (T_d + N h) D_(k-1) - K_p T_d N / (T_d + N h) (y_k - y_(k-1))      backward difference
    v_k = P_k + I_k + D_k,   u_k = v_k inside low..high
    I_(k+1) = I_k + K_p h / T_i e_k + anti-windup                                  forward difference

Anti-windup: `back-calculation` adds h / T_t (u_k - v_k) with the tracking time T_t; `clamping` does not integrate the
error while v_k is outside low..high and e_k drives it further out. I has units of the output and starts at the current
command, so that the transfer at r = y is bumpless.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from math import cos, inf, isfinite, pi, sin, sqrt

ANTI_WINDUP = ("back-calculation", "clamping")


class PID:
    """P, PI or PID controller, by its parameters: T_i infinite for no integral action, T_d 0 for no derivative.

    Parameters
    ----------
    K_p : gain [output per measured, Pa/m]
    T_i, T_d : integral and derivative time [s]
    N : ratio of T_d to the lag of the derivative's filter [1]
    low, high : range of the output
    anti_windup : one of `ANTI_WINDUP`
    tracking : T_t [s]; T_i for a PI, sqrt(T_i T_d) for a PID where not given (Astrom and Hagglund 1995, section 3.5)
    start : current output when the controller takes over

    Raises ValueError for invalid parameters.
    """

    def __init__(
        self,
        K_p: float,
        T_i: float = inf,
        T_d: float = 0.0,
        *,
        N: float = 10.0,
        low: float = -inf,
        high: float = inf,
        anti_windup: str = ANTI_WINDUP[0],
        tracking: float | None = None,
        start: float = 0.0,
    ) -> None:
        natural = sqrt(T_i * T_d) if T_d > 0 and 0 < T_i < inf else T_i
        T_t = natural if tracking is None else tracking
        wrong = [
            text
            for good, text in (
                (isfinite(K_p) and K_p > 0, f"K_p must be above 0, not {K_p:g}"),
                (T_i > 0, f"T_i must be above 0 s, not {T_i:g}"),
                (isfinite(T_d) and T_d >= 0, f"T_d must not be below 0 s: {T_d:g}"),
                (isfinite(N) and N > 0, f"N must be above 0, not {N:g}"),
                (low < high, f"the range of the output is empty: {low:g} to {high:g}"),
                (low <= start <= high, f"the output at the start, {start:g}, is outside {low:g} to {high:g}"),
                (anti_windup in ANTI_WINDUP, f'no anti-windup "{anti_windup}"; known: {", ".join(ANTI_WINDUP)}'),
                (T_t > 0, f"the tracking time must be above 0 s, not {T_t:g}"),
            )
            if not good
        ]
        if wrong:
            raise ValueError("; ".join(wrong))
        self.K_p, self.T_i, self.T_d, self.N = K_p, T_i, T_d, N
        self.low, self.high, self.anti_windup, self.tracking = low, high, anti_windup, T_t
        self.output = start
        """The last output."""
        self.saturated = False
        """Whether the last output was limited to its range."""
        self._integral = start
        self._derivative = 0.0
        self._before: float | None = None
        self._error = self._excess = 0.0

    def update(self, h: float, setpoint: float, measured: float, ahead: float = 0.0) -> float:
        """The output for `measured`, `h` [s, >= 0] after the last sample; `h` of the first sample is ignored.

        `ahead`: feed-forward that is added [output]. If an input is not finite nothing changes, and the last output is
        held.
        """
        error = setpoint - measured
        if not isfinite(error + ahead) or not isfinite(h):
            return self.output
        derivative, integral = self._derivative, self._integral
        if self._before is not None and h > 0:
            integral += self._gained(h)
            if self.T_d > 0:
                share = 1.0 / (self.T_d + self.N * h)
                derivative = self.T_d * share * (derivative - self.K_p * self.N * (measured - self._before))
        wanted = self.K_p * error + integral + derivative + ahead
        if not isfinite(wanted):
            return self.output
        self._integral, self._derivative, self._before, self._error = integral, derivative, measured, error
        output = self.low if wanted < self.low else self.high if wanted > self.high else wanted
        self._excess = output - wanted
        self.saturated, self.output = output != wanted, output
        return output

    def _gained(self, h: float) -> float:
        """Change of the integral from the last sample to this one."""
        if self.T_i == inf:
            return 0.0
        step = self.K_p * h / self.T_i * self._error
        if self._excess == 0.0:
            return step
        if self.anti_windup == "clamping":
            return 0.0 if self._excess * self._error < 0 else step
        return step + min(1.0, h / self.tracking) * self._excess


class ReferencePath:
    """Path through all `places` [m] with at most `speed` [m/s], and a rest of `rest` [s] at each.

    A cosine move over d takes T = pi d / (2 speed), x = from + d (1 - cos(pi t / T)) / 2, with zero speed at both ends.

    Examples
    --------
    >>> path = ReferencePath([0.0, 0.02], speed=0.01, rest=1.0)
    >>> round(path.duration, 4), round(path.place(1.0 + 3.1416 / 2), 6), round(path.speed(1.0 + 3.1416 / 2), 6)
    (5.1416, 0.01, 0.01)
    """

    def __init__(self, places: Sequence[float], speed: float, rest: float) -> None:
        if len(places) < 2 or not all(map(isfinite, places)) or not speed > 0 or not rest >= 0:
            raise ValueError(f"a path needs two places, a speed above 0 and a rest, not {places}, {speed:g}, {rest:g}")
        self.places, self.rest = tuple(places), rest
        self.starts, now = [], rest
        """Begin of each move [s]."""
        self.times = [0.5 * pi * abs(b - a) / speed for a, b in pairwise(self.places)]
        """Duration of each move [s]."""
        for time in self.times:
            self.starts.append(now)
            now += time + rest
        self.duration = now

    def _move(self, t: float) -> tuple[int, float]:
        """Number of the current or last move at a time [s], -1 before the first, and its completed share [1]."""
        number = bisect_right(self.starts, t) - 1
        if number < 0:
            return -1, 0.0
        time = self.times[number]
        return number, min((t - self.starts[number]) / time, 1.0) if time > 0 else 1.0

    def place(self, t: float) -> float:
        """Position [m] at a time [s]; the last one after the end."""
        number, share = self._move(t)
        if number < 0:
            return self.places[0]
        way = self.places[number + 1] - self.places[number]
        return self.places[number] + way * 0.5 * (1.0 - cos(pi * share))

    def speed(self, t: float) -> float:
        """Speed [m/s] at a time [s]."""
        number, share = self._move(t)
        if number < 0 or share >= 1.0:
            return 0.0
        way = self.places[number + 1] - self.places[number]
        return way * 0.5 * pi / self.times[number] * sin(pi * share)
