"""Closed loops in theory: ultimate gain and margins of a gain with dead time and lags.

The plant is G(s) = k_g exp(-L s) / prod(1 + T_i s), command [Pa] to displacement [m].
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from pmabench.model.muscle import Muscle
from pmabench.model.regulator import Regulator

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Loop:
    """A stable linear plant from command to displacement, as seen by a controller."""

    gain: float
    """k_g [m/Pa]."""
    dead_time: float
    """L [s], including half a sample period for the hold."""
    lags: tuple[complex, ...]
    """Time constants T_i [s]; a complex one comes with its conjugate."""

    def __post_init__(self) -> None:
        if self.gain <= 0 or self.dead_time < 0 or any(complex(lag).real < 0 for lag in self.lags):
            raise ValueError("a loop needs a gain above 0, and dead time and lags that are not negative")

    def response(self, s: ComplexArray | complex) -> ComplexArray:
        """G(s) [m/Pa] at complex frequencies `s` [1/s]; same shape."""
        s = np.asarray(s, dtype=np.complex128)
        value = np.asarray(self.gain * np.exp(-self.dead_time * s), dtype=np.complex128)
        for lag in self.lags:
            value = value / (1 + complex(lag) * s)
        return value

    def phase_lag(self, omega: float) -> float:
        """Phase lag omega L + sum of arg(1 + j omega T_i) [rad], continuous from 0 at omega = 0 [rad/s]."""
        return omega * self.dead_time + sum(float(np.angle(1 + 1j * omega * lag)) for lag in self.lags)


@dataclass(frozen=True)
class Ultimate:
    """Gain K_u [Pa/m] of sustained oscillation of a proportional loop, and its period T_u [s]."""

    gain: float
    period: float


def ultimate(loop: Loop) -> Ultimate:
    """Ultimate gain and period of a proportional loop.

    omega_u solves omega L + sum atan(omega T_i) = pi; K_u = prod sqrt(1 + (omega_u T_i)^2) / k_g; T_u = 2 pi / omega_u
    (Ziegler and Nichols, Trans. ASME 64, 1942, 759; no Pade form of the dead time: that gives K_u up to 71 % too high).

    Raises ValueError where the phase never reaches pi: no dead time and fewer than three lags.

    >>> found = ultimate(Loop(1.0, 0.04, (0.22, 0.25)))
    >>> round(found.gain, 3), round(found.period, 4)
    (12.427, 0.4361)
    """
    high = 1.0
    while loop.phase_lag(high) <= pi:
        high *= 2.0
        if high > 1e9:
            raise ValueError("no ultimate gain: without dead time, fewer than three lags never oscillate")
    omega = brentq(lambda w: loop.phase_lag(w) - pi, 0.0, high, xtol=1e-12)
    return Ultimate(gain=1.0 / abs(complex(loop.response(1j * omega))), period=2 * pi / omega)


def sensitivity(F_slope: float, K: float, K_slope: float, x: float) -> float:
    """k_g = dx/dP [m/Pa] of a muscle under constant load: (F_ce' - K' x) / K.

    `F_slope` = dF_ce/dP [N/Pa], `K` [N/m], `K_slope` = dK/dP [N/m/Pa],
    contraction `x` [m]: the derivative of x = (F_ce(P) - F_L) / K(P).
    """
    return (F_slope - K_slope * x) / K


def muscle_loop(
    *,
    gain: float,
    K: float,
    B: float,
    regulator_lag: float,
    dead_time: float,
    sample_period: float = 0.0,
    mass: float = 0.0,
) -> Loop:
    """The loop that a controller sees at one operating point of a muscle behind a regulator.

    `gain` k_g [m/Pa] (see `sensitivity`), `K` [N/m], `B` [N.s/m], `regulator_lag` T_r [s], transport `dead_time` [s],
    `sample_period` T_s [s] (the hold adds T_s/2), moving `mass` M [kg]: M x'' + B x' + K x
    has the lags (B +- sqrt(B^2 - 4 M K)) / (2 K), tau = B/K without mass.
    """
    root = complex(B * B - 4.0 * mass * K) ** 0.5
    pair = ((B + root) / (2 * K), (B - root) / (2 * K))
    lags: list[complex] = [regulator_lag, *(lag.real if lag.imag == 0 else lag for lag in pair)]
    return Loop(gain, dead_time + sample_period / 2, tuple(lag for lag in lags if lag != 0))


SPAN = 25e3
"""Half width of the central differences over pressure [Pa]."""


def loop_at(
    muscle: Muscle,
    regulator: Regulator,
    contraction: float,
    load: float,
    domain: tuple[float, float],
    *,
    mass: float = 0.0,
    sample_period: float = 0.0,
) -> tuple[float, Loop]:
    """Pressure [Pa] at which `muscle` rests at `contraction` [m] under `load` F_L [N], and the loop there.

    The pressure is searched in `domain` [Pa]; slopes over pressure are central differences over +- `SPAN`, which are
    exact for parabolas, even if tabulated every 2 SPAN. Damping and the regulator's lag are means of both directions;
    friction and hysteresis are not part of a linear loop. `mass` [kg] and `sample_period` [s] as in `muscle_loop`.

    Raises ValueError where no pressure in `domain` holds the contraction, or where contraction does not rise there.
    """  # fmt: skip
    low, high = domain

    def left(P: float) -> float:
        return muscle.F_ce(P) - load - muscle.K(P) * contraction

    if not left(low) <= 0 <= left(high):
        raise ValueError(
            f"no pressure from {low / 1e3:.4g} to {high / 1e3:.4g} kPa holds {contraction * 1e3:.4g} mm under "
            f"{load:.4g} N"
        )
    P = float(brentq(left, low, high, xtol=1e-3))
    below, above = max(low, P - SPAN), min(high, P + SPAN)
    F_slope, K_slope = ((curve(above) - curve(below)) / (above - below) for curve in (muscle.F_ce, muscle.K))
    K, gain = muscle.K(P), sensitivity(F_slope, muscle.K(P), K_slope, contraction)
    if gain <= 0:
        raise ValueError(f"at {P / 1e3:.4g} kPa more pressure does not contract the muscle any more")
    B = 0.5 * (muscle.B_c(P) + muscle.B_r(P))
    pair = muscle_loop(
        gain=gain, K=K, B=B, regulator_lag=0.0, dead_time=regulator.dead_time, sample_period=sample_period, mass=mass
    )
    return P, Loop(pair.gain, pair.dead_time, (*_lags(regulator), *pair.lags))


def _lags(regulator: Regulator) -> tuple[complex, ...]:
    """Time constants of a regulator [s], the mean of filling and venting."""
    both = 0.5 * (1 + regulator.vent_ratio)
    if not regulator.natural_frequency:
        return (regulator.lag * both,) if regulator.lag else ()
    damping, root = regulator.damping_ratio, complex(regulator.damping_ratio**2 - 1) ** 0.5
    pair = [(damping + way * root) * both / (2 * pi * regulator.natural_frequency) for way in (1, -1)]
    return tuple(lag.real if lag.imag == 0 else lag for lag in pair)


@dataclass(frozen=True)
class Controller:
    """A PID controller in ideal form: C(s) = K_p (1 + 1/(T_i s) + T_d s / (1 + T_d s / filter))."""

    K_p: float
    """[Pa/m]."""
    T_i: float = inf
    """[s]; infinite: no integral action."""
    T_d: float = 0.0
    """[s]."""
    filter: float = 10.0
    """Ratio of T_d to the lag of the derivative's filter."""

    def response(self, s: ComplexArray | complex) -> ComplexArray:
        """C(s) [Pa/m] at complex frequencies `s` [1/s]; same shape."""
        s = np.asarray(s, dtype=np.complex128)
        integral = 0.0 if self.T_i == inf else 1.0 / (self.T_i * s)
        return np.asarray(self.K_p * (1 + integral + self.T_d * s / (1 + self.T_d / self.filter * s)))


@dataclass(frozen=True)
class Margins:
    """Stability margins of a loop."""

    gain_margin: float
    """Factor on K_p [1] at which a stable loop becomes unstable; below 1 for an unstable loop."""
    phase_margin: float
    """Phase margin [rad] at gain crossover; infinite where the loop gain stays below 1."""
    M_s: float
    """Largest magnitude of the sensitivity 1/(1 + C G) [1]; infinite for an unstable loop."""
    stable: bool


def margins(loop: Loop, controller: Controller) -> Margins:
    """Gain margin, phase margin and M_s of `controller` with the plant `loop`.

    Read from C(j omega) G(j omega) on a grid of 4000 frequencies over five decades around omega_u, crossings
    interpolated linearly in log magnitude and phase (Astrom and Murray, Feedback Systems, section 9.3).
    """
    centre = 2 * pi / ultimate(loop).period
    omega = np.geomspace(centre * 1e-3, centre * 1e2, 4000)
    s = (1j * omega).astype(np.complex128)
    # The dead time is added separately: at the upper end its phase changes too fast for np.unwrap.
    lagged: ComplexArray = Loop(loop.gain, 0.0, loop.lags).response(s) * controller.response(s)
    phase = np.unwrap(np.angle(lagged)) - loop.dead_time * omega
    level = np.log(np.abs(lagged))
    at_pi = np.flatnonzero((phase[:-1] > -pi) & (phase[1:] <= -pi))
    share = (phase[at_pi] + pi) / (phase[at_pi] - phase[at_pi + 1])
    crossing = level[at_pi] + share * (level[at_pi + 1] - level[at_pi])
    returned = 1 + np.exp(level + 1j * phase)
    # Nyquist: no encirclement if the angle of 1 + C G ends near 0
    stable = bool(abs(np.unwrap(np.angle(returned))[-1]) < pi)
    # conditionally stable loops also have crossings above 1
    limits = crossing[crossing < 0] if stable else crossing
    gain_margin = float(np.exp(-limits.max())) if limits.size else inf
    at_one = np.flatnonzero((level[:-1] > 0) != (level[1:] > 0))
    share = level[at_one] / (level[at_one] - level[at_one + 1])
    left = pi + phase[at_one] + share * (phase[at_one + 1] - phase[at_one])
    phase_margin = float(left.min()) if left.size else inf
    peak = float((1 / np.abs(returned)).max()) if stable else inf
    return Margins(gain_margin, phase_margin, peak, stable)
