"""Contraction and relaxation of weights by the second muscle, sound or with a known cause, as a bench records them.

24 trials: eight weights from 6 to 41 kg, each at 200, 350 and 500 kPa in snake order, lowered in steps of 100 kPa. A
trial begins and ends without pressure and with the weight on its support, where a sound cell reads 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq

from tests.judge.second.bench import GRAVITY, behind, noise, stepped
from tests.judge.second.hanging import hang
from tests.judge.second.muscle import DAMPING, FRICTION, Array, Muscle, ends

RATE, FINE = 500.0, 2
"""Samples a second, and steps of the motion for each."""
MASSES = (6.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.5, 41.0)
TARGETS = (200e3, 350e3, 500e3)
LASTS, REST, HOLD, STAIR = 14.4, 0.3, 4.8, 1.7
"""A trial, at rest before its first command, at its pressure, and at each stair down [s]."""
BETWEEN, CHANGED = 11.0, 55.0
"""Between two trials, and where the weight is changed [s]."""
REAL = Muscle(bend=1.0, hysteresis=22.0, creep=0.005)
"""All departures at about the size that muscles have: a gap of 4 % of the force at 500 kPa, creep of 1 % in a decade
at loads of some hundred newtons."""
SEVERAL = Muscle(bend=0.15, hysteresis=20.0, creep=0.03)
OF_MUSCLE = ("bend", "hysteresis", "creep")
LAGGED = {"force-lag": "force", "pressure-lag": "pressure", "position-lag": "displacement"}
LATE = {"force-late": "force", "pressure-late": "pressure"}
AMOUNTS = {
    "clean": (0.0,),
    "drift": (5.0, 10.0, 20.0),
    "slip": (0.3e-3, 1e-3, 3e-3),
    "force-late": (4e-3, 8e-3, 12e-3),
    "force-lag": (4e-3, 8e-3, 12e-3),
    "pressure-late": (4e-3, 8e-3, 12e-3),
    "pressure-lag": (4e-3, 8e-3, 12e-3),
    "position-lag": (3e-3, 5e-3, 8e-3),
    "tube": (5e-3, 10e-3, 20e-3),
    "bend": (0.05, 0.1, 0.2),
    "hysteresis": (10.0, 20.0, 30.0),
    "creep": (0.02, 0.04, 0.06),
    "gain": (0.01, 0.02, 0.03),
    "mass": (0.02, 0.035, 0.05),
    "several": (1.0,),
    "real": (1.0,),
}
"""Cause -> amounts [SI; shares as in `Muscle`]: what a diagnosis has to name, several at once, and the whole muscle."""
CASES = tuple((cause, amount) for cause, amounts in AMOUNTS.items() for amount in amounts)
PLAN = tuple((mass, P) for row, mass in enumerate(MASSES) for P in (TARGETS if row % 2 == 0 else TARGETS[::-1]))
PAUSES = np.array([CHANGED if number % len(TARGETS) == len(TARGETS) - 1 else BETWEEN for number in range(len(PLAN))])
BEGINS = np.concatenate([[0.0], np.cumsum(LASTS + PAUSES)[:-1]])


@dataclass(frozen=True)
class Trial:
    """One trial [SI]; `t` and the times of the commands count from the start of the campaign."""

    mass: float
    """By what is written on the weights."""
    load: float
    target: float
    commands: tuple[tuple[float, float], ...]
    """Time and pressure."""
    t: Array
    pressure: Array
    displacement: Array
    force: Array


def steps(target: float) -> tuple[tuple[float, float], ...]:
    """Commands of a trial: time from its start [s] and pressure [Pa]."""
    down = [*np.arange(target - 100e3, 1.0, -100e3).tolist(), 0.0]
    return ((REST, target), *((REST + HOLD + STAIR * n, value) for n, value in enumerate(down)))


def muscle_of(cause: str, amount: float) -> Muscle:
    """The muscle of a campaign; other causes than its own leave it straight."""
    if cause in OF_MUSCLE:
        return Muscle(**{cause: amount})
    return {"several": SEVERAL, "real": REAL}.get(cause, Muscle())


@lru_cache(maxsize=4)
def _moved(muscle: Muscle, slack: float, tube: float) -> tuple[Array, Array]:
    t = np.arange(round(LASTS * RATE) * FINE + 1) / (RATE * FINE)
    P = np.array([behind(stepped(steps(target), t), tube, RATE * FINE) for _, target in PLAN])
    return hang(muscle, np.array([mass for mass, _ in PLAN]), P, RATE * FINE, PAUSES, slack=slack, fine=FINE)


def campaign(cause: str, amount: float, seed: int, colour: float = 1.0) -> list[Trial]:
    """The trials of a campaign; chance is drawn from the seed, noise is white with `colour` 0.

    drift: the cell's zero goes evenly over the campaign. slip: before a trial the fixed end of the muscle or the
    displacement sensor moves. -late, -lag: a stream is late, or its sensor has a filter. tube: the muscle's pressure
    lags behind the one that is recorded. gain: of the cell. mass: of one weight, against what is written on it. Drift,
    slip, gain and mass are up or down by the seed.
    """
    chance = np.random.default_rng([seed, *f"second {cause} {amount:g}".encode()])
    sign = float(chance.choice((-1.0, 1.0)))
    muscle, tube = muscle_of(cause, amount), amount if cause == "tube" else 0.0
    slips = int(chance.integers(3, 22)) if cause == "slip" else len(PLAN)
    of_sensor, wrong = bool(chance.integers(2)), float(chance.choice(MASSES)) if cause == "mass" else 0.0
    sound = _moved(muscle, 0.0, tube)
    slipped = _moved(muscle, sign * amount, tube) if cause == "slip" and not of_sensor else sound
    t = np.arange(round(LASTS * RATE) + 1) / RATE
    trials = []
    for number, ((mass, target), begin) in enumerate(zip(PLAN, BEGINS.tolist(), strict=True)):
        x, force = (of[number] for of in (slipped if number >= slips else sound))
        true = {"pressure": stepped(steps(target), t), "displacement": x, "force": force}
        if number >= slips and of_sensor:
            true["displacement"] = x - sign * amount
        if cause == "drift":
            true["force"] = force + sign * amount * (begin + t) / (BEGINS[-1] + LASTS)
        if cause == "gain":
            true["force"] = force * (1 + sign * amount)
        if cause in LATE:
            true[LATE[cause]] = np.interp(t - amount, t, true[LATE[cause]])
        if cause in LAGGED:
            true[LAGGED[cause]] = behind(true[LAGGED[cause]], amount, RATE)
        read = {name: value + noise(name, len(t), RATE, chance, colour) for name, value in true.items()}
        written = mass * (1 - sign * amount) if mass == wrong else mass
        asked = tuple((begin + at, value) for at, value in steps(target))
        trials.append(Trial(written, written * GRAVITY, target, asked, begin + t, **read))
    return trials


def undisturbed(cause: str, amount: float) -> tuple[Array, Array, Array]:
    """Pressure of the regulator [Pa], contraction [m] and force [N] without noise and faults, arrays (trials, samples).

    Without a slip, which comes with chance.
    """
    t = np.arange(round(LASTS * RATE) + 1) / RATE
    x, force = _moved(muscle_of(cause, amount), 0.0, amount if cause == "tube" else 0.0)
    return np.array([stepped(steps(target), t) for _, target in PLAN]), x, force


def truth(cause: str, amount: float) -> dict[str, Callable[[Array], tuple[Array, Array]]]:
    """Symbol -> function from pressures [Pa] to the least and the greatest value that is right [SI].

    K of a bent muscle: from the tangent where the lightest weight rests to the secant to where the heaviest rests; of
    one that creeps: from the longest hold to none. F_ce is the force without contraction, between no hysteresis and the
    middle of its branches, F_c between what slides at once and half of the whole gap. `K_0` is the tangent without
    contraction, before any creep.
    """
    muscle = muscle_of(cause, amount)

    def pull(P: Array) -> tuple[Array, Array]:
        both = muscle.static(0 * P, P), muscle.mean(0 * P, P)
        return np.minimum(*both), np.maximum(*both)

    def friction(P: Array) -> tuple[Array, Array]:
        sliding = 0.5 * (ends()[0] - ends()[1]) * float(muscle.rubbed(np.array(TARGETS[-1])))
        return np.full_like(P, FRICTION), np.full_like(P, FRICTION + sliding)

    def damping(way: int) -> Callable[[Array], tuple[Array, Array]]:
        return lambda P: (DAMPING[way][0] + DAMPING[way][1] * P,) * 2

    def steepest(P: Array) -> tuple[Array, Array]:
        return (muscle.tangent(0 * P, P),) * 2

    return {
        "K": lambda P: slope(cause, amount)(P, None, False), "F_ce": pull, "F_c": friction, "B_c": damping(1), "B_r": damping(-1), "K_0": steepest,
    }  # fmt: skip


def slope(cause: str, amount: float) -> Callable[[Array, Array | None, bool], tuple[Array, Array]]:
    """Least and greatest K [N/m] that is right, as `truth` has it, over pressures [Pa]; where it is said to be the slope
    at contractions [m] the tangent there, and where creep is said to be taken off that before any.
    """
    muscle = muscle_of(cause, amount)
    slow = 1 + float(muscle.crept(np.array(HOLD), MASSES[-1] * GRAVITY))

    def right(P: Array, x: Array | None, crept: bool) -> tuple[Array, Array]:
        if x is not None:
            low, high = (of(muscle.tangent(x, P), muscle.tangent(x / slow, P)) for of in (np.minimum, np.maximum))
        else:
            light, heavy = (np.array([rest(muscle, float(one), mass * GRAVITY) for one in P]) for mass in (6.0, 41.0))
            low, high = muscle.tangent(light, P), muscle.tangent(heavy, P)
            out = heavy > 1e-6
            high[out] = ((muscle.static(0 * P, P) - muscle.static(heavy, P))[out]) / heavy[out]
        return low / (1.0 if crept else slow), high

    return right


def rest(muscle: Muscle, P: float, load: float) -> float:
    """Contraction at which it carries a load [N] without friction, hysteresis and creep [m]."""

    def left(x: float) -> float:
        return float(muscle.static(np.array(x), np.array(P))) - load

    return 0.0 if left(0.0) <= 0 else float(brentq(left, 0.0, 0.1))
