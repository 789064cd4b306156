"""Campaigns of slow ramps both ways, of a joint's angle or a muscle's contraction, sound or with a known fault.

A turn fades as a hyperbolic tangent of the way, not as an exponential.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.judge.record import Array, Ramp, Trial, Truth, lagged

REPEATS, CYCLES, DISCARD, PAUSE = 2, 4, 1, 20.0


@dataclass(frozen=True)
class Swept:
    """What is moved and how, and what resists [units of the channels; a rad or m, b N m or N]."""

    moved: str
    pulls: str
    pressures: tuple[str, ...]
    phases: tuple[str, str]
    lower: float
    upper: float
    speeds: tuple[float, ...]
    stiff: float
    """Slope [b/a] in the middle."""
    harder: float
    """Its growth [b/a3]."""
    at_middle: float
    half_gap: float
    fades: float
    """Way on which a turn fades [a]."""
    damps: float
    """[b s/a]"""
    pressure: float
    noise: tuple[float, float, float]
    """Of what is moved, what pulls and each pressure."""
    rate: float
    full: dict[str, float]
    """Cause -> its full size: share by which the sweep is smaller; [b] over a trial; [a] in the middle of a trial; s;
    share of the gap in a decade of time; [a]; 1."""

    @property
    def middle(self) -> float:
        return 0.5 * (self.lower + self.upper)

    def ends(self, cause: str, amount: float) -> tuple[float, float]:
        half = 0.5 * (self.upper - self.lower) * (1 - amount if cause == "small-sweep" else 1.0)
        return self.middle - half, self.middle + half

    def without(self, x: Array) -> Array:
        """What pulls without hysteresis and damping."""
        off = x - self.middle
        return np.asarray(self.at_middle - self.stiff * off - self.harder * off**3)

    def turned(self, gone: Array) -> Array:
        """What hysteresis adds after a turn, against the way [b]."""
        return np.asarray(self.half_gap * (2 * np.tanh(gone / self.fades) - 1))


JOINT = Swept(
    "angle", "torque", ("pressure_1", "pressure_2"), ("rise", "fall"), -np.pi / 6, np.pi / 6, (3 * np.pi / 180,), 12.5,
    2.4, 0.35, 1.1, 0.045, 0.12, 3.2e5, (2e-4, 0.02, 300.0), 100.0,
    {"clean": 0.0, "small-sweep": 28 / 30, "cell-drift": 0.8, "slip": 0.03, "lag": 0.4, "creep": 0.15, "backlash": 0.02,
     "wrong-sign": 1.0},
)  # fmt: skip
MUSCLE = Swept(
    "displacement", "force", ("pressure",), ("contract", "expand"), 0.0, 30e-3, (2e-3, 6e-3), 14e3, 0.0, 380.0, 16.0,
    1.1e-3, 900.0, 3.5e5, (5e-6, 0.3, 300.0), 200.0,
    {"clean": 0.0, "cell-drift": 12.0, "slip": 0.4e-3, "lag": 60e-3, "creep": 0.2, "backlash": 0.2e-3, "wrong-sign": 1.0},
)  # fmt: skip


def truth(one: Swept, cause: str, size: float) -> dict[str, Truth]:
    """By the name of the coordinate: the slope in the middle, gaps there, areas of loops, damping."""
    lower, upper = one.ends(cause, size * one.full[cause])
    x = np.linspace(lower, upper, 20_001)
    gap = one.turned(x - lower) + one.turned(upper - x)
    still, area, stroke = float(gap[10_000]), float(np.trapezoid(gap, x)), upper - lower
    if one is JOINT:
        (v,) = one.speeds
        loose = 2 * one.damps * v
        return {"pressure_1": {
            ("K_th", "", one.pressure): (one.stiff,) * 2, ("H_tau", "", one.pressure): (still + loose,) * 2,
            ("W", "", one.pressure): (area + loose * stroke,) * 2,
        }}  # fmt: skip
    by_speed: Truth = {("H", "", 0.0): (still,) * 2}
    for v in one.speeds:
        by_speed["H", "", v] = (still + 2 * one.damps * v,) * 2
        by_speed["W", "", v] = (area + 2 * one.damps * v * stroke,) * 2
    P, at_0 = one.pressure, float(one.without(np.zeros(1))[0])
    return {
        "speed": by_speed,
        "pressure": {
            ("B", "", P): (one.damps,) * 2, ("F_c", "", P): (still / 2,) * 2, ("K", "", P): (one.stiff,) * 2,
            ("F_ce", "", P): (at_0, at_0 + (size * one.full[cause] * one.half_gap * 2.4 if cause == "creep" else 0.0)),
        },
    }  # fmt: skip


def campaign(one: Swept, cause: str, size: float, seed: int) -> list[Trial]:
    """The trials with a cause at `size` times its full size; chance by the seed.

    small-sweep
        The sweep is too small for the hysteresis.
    cell-drift, slip
        The zero of what pulls goes away over a trial; what is moved slips once in the middle of it.
    lag
        What pulls has a filter of first order.
    creep
        What pulls grows with the logarithm of time.
    backlash
        What reads the motion stands still for so long after each turn.
    wrong-sign
        What pulls is recorded with the other sign of its change.
    """
    amount = size * one.full[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    lower, upper = one.ends(cause, amount)
    trials, since = [], 0.0
    for speed in one.speeds:
        for repeat in range(REPEATS):
            v = speed * chance.uniform(0.999, 1.001)  # so that turns lie anywhere between samples
            way = (upper - lower) / v
            t = np.arange(round(2 * CYCLES * way * one.rate)) / one.rate
            half, gone = np.divmod(t * v, upper - lower)
            back = half.astype(int) % 2 == 1
            x = np.where(back, upper - gone, lower + gone)
            against = one.turned(gone) + one.damps * v
            pulls = one.without(x) + np.where(back, against, -against)
            seen = x
            if cause == "cell-drift":
                pulls = pulls + amount * t / t[-1]
            elif cause == "creep":
                pulls = pulls + amount * one.half_gap * np.log10(1 + t)
            elif cause == "slip":
                seen = x + amount * (t > 0.5 * t[-1])
            elif cause == "lag":
                pulls = lagged(pulls, amount, one.rate)
            elif cause == "backlash":
                held = np.where(back, np.maximum(x, lower), np.minimum(x, upper))
                seen = np.where(back, np.minimum(held, upper - amount) + amount, np.maximum(held, lower + amount))
            elif cause == "wrong-sign":
                pulls = 2 * one.at_middle - pulls
            values = {one.moved: seen, one.pulls: pulls} | dict.fromkeys(one.pressures, np.full(len(t), one.pressure))
            noise = dict(zip((one.moved, one.pulls, *one.pressures), (*one.noise, one.noise[-1]), strict=False))
            read = {name: v + noise[name] * chance.standard_normal(len(t)) for name, v in values.items()}
            commands = tuple(
                Ramp(since + k * way, one.moved, ends[1], ends[0], one.phases[k % 2], speed)
                for k in range(2 * CYCLES)
                for ends in [(lower, upper) if k % 2 == 0 else (upper, lower)]
            )
            point = dict.fromkeys(one.pressures, one.pressure)
            if one is JOINT:
                point |= {"angular_speed": speed, "lowest_angle": lower, "highest_angle": upper}
            else:
                point |= {"speed": speed, "lower": lower, "upper": upper}
            trials.append(Trial(point, repeat, since + t, read, commands))
            since += float(t[-1]) + PAUSE
    return trials
