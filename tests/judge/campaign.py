"""Campaigns of 24 trials by the simulated muscle, sound or with one fault of known size, as a bench would record them.

Weights of 6 to 41 kg hang; each is lifted at 200, 350 and 500 kPa in snake order, and lowered in steps of 100 kPa.
A cell between muscle and weight, a displacement and a pressure are sampled at 500 Hz. A trial begins and ends at rest:
no pressure, and the weight on its support, where the cell reads 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tests.judge.motion import GRAVITY, RATE, Motion, Steps, hang, pressure
from tests.judge.muscle import CREEP_DECADES, Array, Muscle, Range
from tests.judge.record import lagged

MASSES = (6.0, 11.0, 16.0, 21.0, 26.0, 31.0, 36.0, 41.0)
"""[kg]"""
PRESSURES = (200e3, 350e3, 500e3)
DURATION = 14.0
"""Of a trial [s]."""
BASELINE, CONTRACT, RELAX = 0.2, 5.0, 1.6
"""At rest before the first command, held at the pressure, held after each step down [s]."""
PAUSE, CHANGE = 10.0, 60.0
"""Between two trials, and to change weights [s]."""
NOISE = {"pressure": 0.5e3, "displacement": 2e-6, "force": 0.3}
"""White, standard deviation [SI]."""
FULL = {
    "clean": 0.0,
    "cell-drift": 15.0,
    "slip-0.8": 0.8e-3,
    "slip-3": 3e-3,
    "creep": 0.10,
    "force-lag": 10e-3,
    "pressure-late": 10e-3,
    "bend": 0.20,
    "slip": 3e-3,
    "force-late": 12e-3,
    "pressure-lag": 12e-3,
    "position-lag": 8e-3,
    "tube": 20e-3,
    "hysteresis": 30.0,
    "several": 1.0,
    "gain": 0.03,
    "mass": 0.05,
    "guide": 8.0,
}
"""Cause -> its full size [SI], in the order of `campaign`; shares have no unit."""
CAUSES = ("cell-drift", "slip-0.8", "slip-3", "creep", "force-lag", "pressure-late", "bend")
SIZES = (1.0, 0.5, 0.25, 0.125)
"""Shares of the full sizes of `CAUSES`, from what any look at the record shows to what hides in the noise."""
SEVERAL = {"bend": 0.07, "hysteresis": 20.0, "creep": 0.04 * CREEP_DECADES}
"""What the cause `several` puts into the muscle at once."""
AMOUNTS = {
    "clean": (0.0,),
    "cell-drift": (5.0, 10.0, 20.0),
    "slip": (0.3e-3, 1e-3, 3e-3),
    "force-late": (4e-3, 8e-3, 12e-3),
    "force-lag": (4e-3, 8e-3, 12e-3),
    "pressure-late": (4e-3, 8e-3, 12e-3),
    "pressure-lag": (4e-3, 8e-3, 12e-3),
    "position-lag": (3e-3, 5e-3, 8e-3),
    "tube": (5e-3, 10e-3, 20e-3),
    "bend": (0.04, 0.07, 0.10),
    "hysteresis": (10.0, 20.0, 30.0),
    "creep": tuple(share * CREEP_DECADES for share in (0.02, 0.04, 0.06)),
    "several": (0.5, 0.75, 1.0),
    "gain": (0.01, 0.02, 0.03),
    "mass": (0.02, 0.035, 0.05),
}
"""Causes that a diagnosis has to tell apart, each at amounts [SI] that it must find."""
CASES = tuple((cause, amount / (FULL[cause] or 1.0)) for cause, amounts in AMOUNTS.items() for amount in amounts)
"""The same as arguments of `campaign`."""


LAGGED = {"force-lag": "force", "pressure-lag": "pressure", "position-lag": "displacement"}
"""Cause -> the channel whose sensor has a filter."""


@dataclass(frozen=True)
class Trial:
    """One trial: what was done and recorded, all SI; `t` counts from the start of the campaign."""

    mass: float
    """That hangs and moves [kg]."""
    load: float
    """Its weight [N]."""
    target: float
    """Pressure that is contracted to [Pa]."""
    commands: Steps
    """Time from the start of the campaign [s] and pressure [Pa]."""
    t: Array
    pressure: Array
    displacement: Array
    force: Array


def commands(target: float) -> Steps:
    """Commands of a trial: up in one step, down by 100 kPa each, and vented; time from its start."""
    down = np.arange(target - 100e3, 1.0, -100e3)
    times = BASELINE + CONTRACT + RELAX * np.arange(len(down) + 1)
    return ((BASELINE, target), *zip(times.tolist(), [*down.tolist(), 0.0], strict=True))


PLAN = tuple((mass, P) for row, mass in enumerate(MASSES) for P in (PRESSURES if row % 2 == 0 else reversed(PRESSURES)))
"""Mass and pressure of each trial, in the order that they are done."""
PAUSES = np.array([CHANGE if (number + 1) % len(PRESSURES) == 0 else PAUSE for number in range(len(PLAN))])
STARTS = np.concatenate(([0.0], np.cumsum(DURATION + PAUSES)[:-1]))


def muscle_of(cause: str, size: float, seed: int) -> Muscle:
    """The muscle of a campaign: bend, creep and hysteresis are in it, the other causes are in the bench."""
    amounts = SEVERAL if cause == "several" else {cause: FULL[cause]} if cause in SEVERAL else {}
    if not amounts:
        return Muscle()
    return Muscle.drawn(np.random.default_rng([seed, 77]), **{name: size * amounts.get(name, 0.0) for name in SEVERAL})


def truth(cause: str, size: float, seed: int) -> dict[str, Callable[[Array], Range]]:
    """Symbol -> function from pressures [Pa] to the least and the greatest value that is right; see `Muscle.truth`."""
    return muscle_of(cause, size, seed).truth(MASSES[0] * GRAVITY, MASSES[-1] * GRAVITY, CONTRACT)


def slope(cause: str, size: float, seed: int) -> Callable[[Array, Array | None, bool], Range]:
    """Least and greatest K [N/m] that is right, over pressures [Pa], contractions, creep taken off: `Muscle.slope`."""
    muscle, loads = muscle_of(cause, size, seed), (MASSES[0] * GRAVITY, MASSES[-1] * GRAVITY)
    return lambda P, x, crept: muscle.slope(P, *loads, CONTRACT, x, crept)


@lru_cache(maxsize=16)
def _motion(muscle: Muscle, slack: float, tube: float, guide: float) -> Motion:
    masses = np.array([mass for mass, _ in PLAN])
    return hang(muscle, masses, [commands(P) for _, P in PLAN], DURATION, PAUSES, slack=slack, tube=tube, guide=guide)


def campaign(cause: str, size: float, seed: int) -> list[Trial]:
    """The trials of a campaign with a cause at `size` times its full size (`FULL`); chance is drawn from the seed.

    cell-drift
        The zero of the cell goes evenly with time, up with even seeds and down with odd ones; at rest the cell reads
        what it drifted.
    slip-0.8, slip-3, slip
        Before one trial, drawn from the 4th to the 22nd, a mount gives way. With even seeds that of the muscle: its
        fixed end is nearer to the load, which stays on its support. At rest the record shows nothing; from then on
        each contraction is shorter. With odd seeds that of the displacement sensor: it reads that much less, at rest
        too. `slip` goes the other way with half of the seeds of each.
    creep
        The muscle yields under load by this share of its contraction in about 0.2 to 60 s, and recovers at rest. Its
        times are drawn, as the motions after which a braid slides (`Muscle.drawn`): each seed is another muscle.
    force-lag, pressure-lag, position-lag
        The sensor has a filter of first order with this time constant.
    force-late, pressure-late
        The stream is recorded that much later than the rest.
    tube
        The pressure in the muscle follows the one that is recorded, with this time constant.
    bend
        The spring is no straight line: steeper by this share without contraction, flatter by it at 60 mm.
    hysteresis
        The strands of the braid slide on each other after some motion: half of the gap between both ways at 500 kPa.
    several
        Bend, hysteresis and creep at once (`SEVERAL`).
    gain
        The cell reads too much or too little by this share, up with even seeds and down with odd ones.
    mass
        One weight, drawn, is heavier or lighter by this share than what is written on it and recorded.
    guide
        A linear guide rubs on the load, between cell and support (Coulomb).
    """
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    sign = 1 - 2 * (seed % 2)
    muscle, tube = muscle_of(cause, size, seed), amount if cause == "tube" else 0.0
    slips = int(chance.integers(3, 22)) if cause.startswith("slip") else len(PLAN)
    away = amount * (1 - 2 * (seed // 2 % 2)) if cause == "slip" else amount
    guide = amount if cause == "guide" else 0.0
    sound = _motion(muscle, 0.0, tube, guide)
    slipped = _motion(muscle, away, tube, guide) if slips < len(PLAN) and sign > 0 else sound
    mislabelled = chance.choice(MASSES) if cause == "mass" else None
    t = np.arange(round(DURATION * RATE) + 1) / RATE
    trials = []
    for number, ((mass, target), start) in enumerate(zip(PLAN, STARTS.tolist(), strict=True)):
        done = slipped if number >= slips else sound
        steps = commands(target)
        clean = {"pressure": pressure(steps, t), "displacement": done.x[number], "force": done.force[number]}
        if number >= slips and sign < 0:
            clean["displacement"] = clean["displacement"] - away
        clean = _in_the_bench(cause, amount, sign, clean, steps, t, (start + t) / (STARTS[-1] + DURATION))
        read = {name: one + NOISE[name] * chance.standard_normal(len(t)) for name, one in clean.items()}
        asked = tuple((start + at, value) for at, value in steps)
        named = mass / (1 + sign * amount) if mass == mislabelled else mass
        trials.append(Trial(named, named * GRAVITY, target, asked, start + t, **read))
    return trials


def _in_the_bench(
    cause: str, amount: float, sign: int, clean: dict[str, Array], steps: Steps, t: Array, done: Array
) -> dict[str, Array]:
    """What sensors make of the channels of a trial; `done` is the share of the campaign at times `t` [s]."""
    if cause == "cell-drift":
        return clean | {"force": clean["force"] + sign * amount * done}
    if cause == "gain":
        return clean | {"force": clean["force"] * (1 + sign * amount)}
    if cause == "pressure-late":
        return clean | {"pressure": pressure(steps, t - amount)}
    if cause == "force-late":
        return clean | {"force": np.interp(t - amount, t, clean["force"])}
    if cause in LAGGED:
        return clean | {LAGGED[cause]: lagged(clean[LAGGED[cause]], amount, RATE)}
    return clean


@dataclass(frozen=True)
class Weighed:
    """Readings of the cell against known weights: arrays, one value a reading."""

    t: Array
    """[s] from the start of the campaign."""
    weight: Array
    """What the cell should read, by what is written on the weights [N]; 0 where they lie on their support."""
    read: Array
    """[N]"""


def weighed(trials: Sequence[Trial], seed: int, held: float = 0.5, lying: float = 0.1) -> Weighed:
    """Readings at rest before each trial and at the end of each held pressure, with a scatter of both [N].

    A pulley's friction takes up some of a weight that hangs, and nothing of one that lies.
    """
    chance = np.random.default_rng(seed)
    rest, plateau = slice(0, 100), slice(round((BASELINE + CONTRACT - 1.0) * RATE), round((BASELINE + CONTRACT) * RATE))
    rows = [(trial.t[part].mean(), weight, trial.force[part].mean() + scatter * chance.standard_normal())
            for trial in trials
            for part, weight, scatter in ((rest, 0.0, lying), (plateau, trial.load, held))]  # fmt: skip
    return Weighed(*np.array(rows).T)
