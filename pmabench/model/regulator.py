"""Commands over time, and the response of a regulator: dead time and a lag of first or second order.

Everything is piecewise in closed form: constants, ramps, sines. Used for the pressure of a regulator, which a dump
valve or a fault may override, and for the position of an actuator with a follow error.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from pmabench.model.curve import Array


def to_nanosecond(t: float) -> float:
    """A time [s] rounded to whole nanoseconds, so that equal times compare equal however they were summed."""
    return round(t * 1e9) / 1e9


class Wave(NamedTuple):
    """u(t) = level + slope s + amplitude sin(omega s + phase), s = t - start [s], until the next wave starts."""

    start: float
    level: float
    slope: float = 0.0
    amplitude: float = 0.0
    omega: float = 0.0
    phase: float = 0.0

    def value(self, t: float) -> float:
        """The commanded value at time t [s]."""
        since = t - self.start
        wave = self.amplitude * math.sin(self.omega * since + self.phase) if self.amplitude else 0.0
        return self.level + self.slope * since + wave

    def values(self, t: Array) -> Array:
        """The commanded values at times t [s]."""
        since = t - self.start
        return np.asarray(self.level + self.slope * since + self.amplitude * np.sin(self.omega * since + self.phase))

    def rate(self, t: float) -> float:
        """Rate of the commanded value at time t [s]."""
        return self.slope + self.amplitude * self.omega * math.cos(self.omega * (t - self.start) + self.phase)

    def later(self, t: float) -> Wave:
        """The same wave with its start moved to t [s]."""
        since = t - self.start
        return self._replace(start=t, level=self.level + self.slope * since, phase=self.phase + self.omega * since)

    @property
    def steady(self) -> bool:
        """Whether it is a constant."""
        return self.slope == 0 and self.amplitude == 0

    @property
    def steepest(self) -> float:
        """Highest rate of change [units/s]."""
        return abs(self.slope) + abs(self.amplitude * self.omega)


def constant(start: float, level: float) -> tuple[Wave, ...]:
    """A constant from `start` [s] on."""
    return (Wave(to_nanosecond(start), level),)


def ramp(start: float, origin: float, target: float, rate: float) -> tuple[Wave, ...]:
    """A ramp from `origin` at `start` [s] to `target` with `rate` [units/s, > 0], then constant."""
    duration = abs(target - origin) / rate
    if to_nanosecond(duration) == 0:
        return constant(start, target)
    return (
        Wave(to_nanosecond(start), origin, slope=math.copysign(rate, target - origin)),
        Wave(to_nanosecond(start + duration), target),
    )


def sine(start: float, origin: float, amplitude: float, frequency: float, cycles: float) -> tuple[Wave, ...]:
    """`origin + amplitude sin(2 pi frequency (t - start))` for `cycles`, then constant at `origin`; [s, units, Hz]."""
    return (
        Wave(to_nanosecond(start), origin, amplitude=amplitude, omega=2 * math.pi * frequency),
        Wave(to_nanosecond(start + cycles / frequency), origin),
    )


def commanded(waves: Sequence[Wave], t: float) -> float:
    """Value at time t [s] of the wave that started last; before the first one its level."""
    for wave in reversed(waves):
        if wave.start <= t:
            return wave.level if wave.steady else wave.value(t)
    return waves[0].level


FADED = 40.0
"""Number of lags after which the initial value has faded completely [1]."""
APART = 1e-5
"""Poles closer to each other are separated by this relative distance [1]; the result changes by less than 1e-9."""
NO_MORE = 1e-9
"""Smaller parts are left out of a closed form [units]."""

Mode = tuple[float, float, float, float]
"""r [1/s] (negative, or 0 for no fading), w [rad/s], a and b of exp(r s) (a cos(w s) + b sin(w s))."""


@dataclass(frozen=True)
class Regulator:
    """Dynamics of the output y for the command u: T y' = u(t - dead_time) - y - T leak y.

    `lag` T [s] while filling (y rising), `lag * vent_ratio` while venting; a lag of 0 is exact. Within `dead_band`
    [units] of the command the regulator rests, outside it approaches the edge of the band. `leak` is the relative loss
    of output [1/s]; a regulator without lag compensates it.

    With a `natural_frequency` f_n [Hz] above 0 it is of second order instead, with `damping_ratio` zeta:
    y'' + 2 zeta w y' + w^2 y = w^2 u(t - dead_time), w = 2 pi f_n, and w / `vent_ratio` for a
    command below y. It compensates a leak.
    """

    dead_time: float = 0.04
    lag: float = 0.0
    vent_ratio: float = 1.0
    dead_band: float = 0.0
    leak: float = 0.0
    natural_frequency: float = 0.0
    damping_ratio: float = 1.0

    def __post_init__(self) -> None:
        if min(self.dead_time, self.lag, self.dead_band, self.leak, self.natural_frequency) < 0 or self.vent_ratio <= 0:
            raise ValueError(f"times, bands and frequencies cannot be negative: {self}")
        if not self.damping_ratio > 0:
            raise ValueError(f"a damping ratio above 0 is expected, not {self.damping_ratio:g}")
        if self.natural_frequency > 0 and self.lag > 0:
            raise ValueError("a regulator has a lag (first order) or a natural frequency (second order), not both")
        if self.dead_band > 0 and self.lag == 0:
            raise ValueError("a dead band needs a lag above 0")


class Trace(NamedTuple):
    """A closed form: level + slope s + sum of `modes` (`Mode`), s = t - start [s]; at most one mode does not fade."""

    start: float
    level: float
    slope: float = 0.0
    modes: tuple[Mode, ...] = ()

    def value(self, t: float) -> float:
        """Value at time t [s]."""
        since = t - self.start
        value = self.level + self.slope * since
        for rate, omega, a, b in self.modes:
            wave = a * math.cos(omega * since) + b * math.sin(omega * since) if omega else a
            value += math.exp(rate * since) * wave if rate else wave
        return value

    def values(self, t: Array) -> Array:
        """Values at times t [s], the first of which is the earliest."""
        since = t - self.start
        value = self.level + self.slope * since if self.slope else np.full(since.shape, self.level, np.float64)
        for rate, omega, a, b in self._left(float(since[0])) if len(since) else ():
            wave = a * np.cos(omega * since) + b * np.sin(omega * since) if omega else a
            value += np.exp(rate * since) * wave if rate else wave
        return value

    def rates(self, t: Array) -> Array:
        """Rates of change at times t [s], the first of which is the earliest."""
        since = t - self.start
        value = np.full(since.shape, self.slope, np.float64)
        for rate, omega, a, b in self._left(float(since[0])) if len(since) else ():
            wave: Array | float = rate * a
            if omega:
                wave = (rate * a + omega * b) * np.cos(omega * since) + (rate * b - omega * a) * np.sin(omega * since)
            value += np.exp(rate * since) * wave if rate else wave
        return value

    def rate(self, t: float) -> float:
        """Rate of change at time t [s]."""
        return float(self.rates(np.array([t]))[0])

    def _left(self, since: float) -> list[Mode]:
        """The modes that have not faded `since` [s] after the start."""
        return [mode for mode in self.modes if -mode[0] * since < FADED]

    @property
    def omega(self) -> float:
        """Angular frequency of the sine that does not fade [rad/s]; 0 for none."""
        return next((omega for rate, omega, _, _ in self.modes if not rate), 0.0)

    @property
    def lag(self) -> float:
        """Time constant [s] if it is a level and one exponential; else 0."""
        return -1 / self.modes[0][0] if not self.slope and len(self.modes) == 1 and not self.modes[0][1] else 0.0

    def settled(self, t: float, within: float) -> bool:
        """Whether from `t` [s] on it stays `within` this distance of its final value."""
        since, left = t - self.start, 0.0
        for rate, omega, a, b in self.modes:
            if omega and -rate * since < 1:  # it does not fade, or s exp(r s) does not fall yet
                return False
            left += math.exp(rate * since) * (abs(a) + abs(b) * min(1.0, omega * since))
        return not self.slope and left < within

    def function(self, since: float = 0.0) -> Callable[[float], float]:
        """A fast function of s = t - start [s], for s >= `since`, to be called thousands of times."""
        level, slope, modes, exp, cos, sin = self.level, self.slope, self._left(since), math.exp, math.cos, math.sin
        if len(modes) == 1 and not slope:
            ((rate, omega, a, b),) = modes
            if not omega:
                return lambda s: level + a * exp(rate * s)
            if not rate:
                return lambda s: level + (a * cos(omega * s) + b * sin(omega * s))
            return lambda s: level + exp(rate * s) * (a * cos(omega * s) + b * sin(omega * s))

        def many(s: float) -> float:
            value = level + slope * s
            for rate, omega, a, b in modes:
                wave = a * cos(omega * s) + b * sin(omega * s) if omega else a
                value += exp(rate * s) * wave if rate else wave
            return value

        return many if modes or slope else lambda s: level


def _fading(size: float, lag: float) -> tuple[Mode, ...]:
    """One exponential with the initial value `size`; none without a lag [s]."""
    return ((-1 / lag, 0.0, size, 0.0),) if size and lag > 0 else ()


def answer(trace: Trace, t: float, value: float, lag: float, share: float = 1.0) -> Trace:
    """The exact response of `lag` y' = `share` u - y to a closed form u, from y(t) = `value`; `lag` > 0 [s].

    Each part c exp(p s) of u becomes c / (1 + p lag) exp(p s); a p of -1 / lag is shifted slightly.
    """
    since = t - trace.start
    slope = share * trace.slope
    level = share * (trace.level + trace.slope * since) - slope * lag
    while any(abs(1 + complex(rate, omega) * lag) < APART for rate, omega, _, _ in trace.modes):
        lag *= 1 + 2 * APART
    modes = []
    for rate, omega, a, b in trace.modes:
        p = complex(rate, omega)
        part = share * complex(a, -b) * cmath.exp(p * since) / (1 + p * lag)
        if not rate or abs(part) > NO_MORE:
            modes.append((rate, omega, part.real, -part.imag))
    return Trace(t, level, slope, (*_fading(value - level - sum(mode[2] for mode in modes), lag), *modes))


def lagged(wave: Wave, t: float, value: float, lag: float, share: float = 1.0) -> Trace:
    """The exact response of `lag` y' = `share` wave - y, from y(t) = `value`; with `lag` 0 the wave itself.

    `t` is on the wave's time axis [s].
    """
    if wave.steady:
        level = share * wave.level
        return Trace(t, level, modes=_fading(value - level, lag))
    since = t - wave.start
    phase = wave.omega * since + wave.phase
    sine: Mode = (0.0, wave.omega, wave.amplitude * math.sin(phase), wave.amplitude * math.cos(phase))
    exact = Trace(t, wave.level + wave.slope * since, wave.slope, (sine,) if wave.amplitude else ())
    return answer(exact, t, value, lag, share) if lag > 0 else exact


def swung(wave: Wave, t: float, value: float, rate: float, pace: float, damping: float) -> Trace:
    """The exact response of y'' + 2 zeta w y' + w^2 (y - wave) = 0, from y(t) = `value` and y'(t) = `rate`.

    `t` is on the wave's time axis [s], `pace` w > 0 [rad/s], `damping` zeta > 0. A ramp is delayed by 2 zeta / w, a
    sine of angular frequency W multiplied by 1 / (1 - (W/w)^2 + 2i zeta W/w); the rest fades with the poles -w (zeta +-
    sqrt(zeta^2 - 1)).
    """
    since = t - wave.start
    late = 2 * damping / pace
    level, slope, sine = wave.level + wave.slope * (since - late), wave.slope, 0j
    modes: tuple[Mode, ...] = ()
    if wave.amplitude:
        share = wave.omega / pace
        sine = -1j * wave.amplitude * cmath.exp(1j * (wave.omega * since + wave.phase))
        sine /= complex(1 - share * share, 2 * damping * share)
        modes = ((0.0, wave.omega, sine.real, -sine.imag),)
    off = value - level - sine.real
    moving = rate - slope + wave.omega * sine.imag
    if abs(off) < NO_MORE and abs(moving) < NO_MORE * pace:
        return Trace(t, level, slope, modes)
    root = pace * math.sqrt(abs(1 - damping * damping))
    if damping <= 1 or root < APART * pace:
        root = max(root, APART * pace)
        modes += ((-damping * pace, root, off, (moving + damping * pace * off) / root),)
    else:
        near = -pace / (damping + root / pace)
        far = -damping * pace - root
        other = (moving - near * off) / (far - near)
        modes += ((near, 0.0, off - other, 0.0), (far, 0.0, other, 0.0))
    return Trace(t, level, slope, modes)


class Regulated:
    """Output of a `Regulator` with its commands; at `start` [s] it rests at `value` [units].

    Time can only advance: each call of `piece`, `value` and `values` must be at or after the last one. A copy by
    `copy.copy` is independent.
    """

    def __init__(self, regulator: Regulator, value: float = 0.0, start: float = 0.0) -> None:
        self.regulator = regulator
        self._waves: tuple[Wave, ...] = (Wave(start, value),)
        self._trace = Trace(start, value)
        self._end = math.inf
        self._forced = False

    def __copy__(self) -> Regulated:
        made = object.__new__(Regulated)
        made.__dict__.update(self.__dict__)
        return made

    def command(self, waves: tuple[Wave, ...]) -> None:
        """Follow `waves`, with increasing starts; they replace all commands from the first start on."""
        first = waves[0].start
        kept = len(self._waves)
        while kept and self._waves[kept - 1].start >= first:
            kept -= 1
        self._waves = self._waves[:kept] + waves
        if not self._forced:
            self._end = min(self._end, self._arrival(waves[0]))

    def force(self, t: float, level: float, lag: float) -> None:
        """From `t` [s] on the output goes to `level` with `lag` [s] regardless of commands: a dump valve, a burst."""
        self._trace = lagged(Wave(t, level), t, self.value(t), lag)
        self._end, self._forced = math.inf, True

    def release(self, t: float) -> None:
        """From `t` [s] on the output follows the commands again, from its present value."""
        if self._forced:
            self._forced = False
            self._begin(t)

    def setpoint(self, t: float) -> float:
        """The commanded value at time t [s], before the dead time."""
        return commanded(self._waves, t)

    def setpoints(self, t: Array) -> Array:
        """The commanded values at increasing times t [s], before the dead time."""
        result = np.empty(t.shape)
        edges = [0, *np.searchsorted(t, [wave.start for wave in self._waves[1:]]).tolist()]
        for wave, first, last in zip(self._waves, edges, [*edges[1:], len(t)], strict=True):
            if first < last:
                result[first:last] = wave.level if wave.steady else wave.values(t[first:last])
        return result

    def piece(self, t: float) -> tuple[Trace, float]:
        """The closed form valid at time t [s], and its end [s]."""
        while t >= self._end:
            self._begin(self._end)
        return self._trace, self._end

    def value(self, t: float) -> float:
        """The output at time t [s]."""
        return self.piece(t)[0].value(t)

    def values(self, t: Array) -> tuple[Array, Array]:
        """The output and its rate at increasing times t [s]."""
        value, rate = np.empty(t.shape), np.empty(t.shape)
        for trace, _, rows in self.pieces(float(t[0]), t) if len(t) else ():
            value[rows], rate[rows] = trace.values(t[rows]), trace.rates(t[rows])
        return value, rate

    def pieces(self, begin: float, t: Array) -> Iterator[tuple[Trace, float, slice]]:
        """Each closed form from `begin` [s] to the last of increasing times t [s], its end, and the rows of t in it."""
        last, done, end = float(t[-1]), 0, begin
        while end <= last:
            trace, end = self.piece(end)
            count = len(t) if end > last else int(np.searchsorted(t, end))
            yield trace, min(end, last), slice(done, count)
            done = count

    def _arrival(self, wave: Wave) -> float:
        return to_nanosecond(wave.start + self.regulator.dead_time)

    def _begin(self, t: float) -> None:
        """Start a new piece at time t [s]: a wave arrives, or the regulator changes between filling and venting."""
        r = self.regulator
        active = 0
        while active + 1 < len(self._waves) and self._arrival(self._waves[active + 1]) <= t:
            active += 1
        self._waves = self._waves[active:]
        wave = self._waves[0]
        if not wave.steady:
            wave = wave._replace(start=self._arrival(wave))
        end = self._arrival(self._waves[1]) if len(self._waves) > 1 else math.inf
        value = self._trace.value(t)
        if r.natural_frequency:
            rate = self._trace.rate(t)
            falls = (wave.value(t) - value or wave.rate(t)) < 0
            pace = 2 * math.pi * r.natural_frequency / (r.vent_ratio if falls else 1.0)
            self._trace, self._end = swung(wave, t, value, rate, pace, r.damping_ratio), end
            return
        if r.lag == 0 or (r.vent_ratio == 1 and r.dead_band == 0):
            self._trace, self._end = self._answer(wave, t, value, r.lag), end
            return
        way = self._way(wave, t, value)
        if way == 0:
            self._trace = Trace(t, 0.0, modes=_fading(value, 1 / r.leak)) if r.leak else Trace(t, value)
        else:
            edge = wave._replace(level=wave.level - way * r.dead_band)
            self._trace = self._answer(edge, t, value, r.lag * (1 if way > 0 else r.vent_ratio))
        self._end = self._change(wave, way, t, end)

    def _answer(self, wave: Wave, t: float, value: float, lag: float) -> Trace:
        """The response of a lag to a wave; a leak makes it faster and leaves a steady-state error."""
        share = 1 / (1 + lag * self.regulator.leak)
        return lagged(wave, t, value, share * lag, share)

    def _way(self, wave: Wave, t: float, value: float) -> int:
        """1 filling, -1 venting, 0 resting in the dead band; on an edge, the direction of the command."""
        band, error = self.regulator.dead_band, wave.value(t) - value
        rate = wave.rate(t) + self.regulator.leak * value
        near = 1e-9 * (1 + abs(value))
        if error > band + near or (error >= band - near and rate > 0):
            return 1
        return -1 if error < -band - near or (error <= near - band and rate < 0) else 0

    def _change(self, wave: Wave, way: int, t: float, end: float) -> float:
        """Time before `end` [s] at which the regulator changes between filling, venting and rest; else `end`.

        With a constant command only a leak can cause this, from above.
        """
        band = self.regulator.dead_band
        if wave.steady:
            edge, trace = wave.level - (way or 1) * band, self._trace
            if way > 0 or not self.regulator.leak or not trace.level < edge < trace.value(t):
                return end
            after = trace.lag * math.log(trace.modes[0][2] / (edge - trace.level))
            return min(end, max(to_nanosecond(t + after), to_nanosecond(t + 1e-9)))

        def beyond(at: Array) -> Array:
            error = wave.values(at) - self._trace.values(at)
            return band - way * error if way else np.abs(error) - band

        count = 200 if wave.amplitude == 0 else max(200, int(64 * (end - t) * wave.omega / (2 * math.pi)))
        grid = np.linspace(t, end, count + 1)
        left = np.flatnonzero(beyond(grid[1:]) > 1e-9 * (1 + abs(self._trace.level)))
        if left.size == 0:
            return end
        low, high = float(grid[left[0]]), float(grid[left[0] + 1])

        def beyond_at(at: float) -> float:
            return float(beyond(np.array([at]))[0])

        if beyond_at(low) >= 0:
            return to_nanosecond(low if low > t else high)
        return max(to_nanosecond(float(brentq(beyond_at, low, high, xtol=1e-10))), to_nanosecond(t + 1e-9))
