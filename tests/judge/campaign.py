"""Campaigns of 24 trials by the simulated muscle, sound or with one fault of known size, as a bench would record them.

Weights of 6 to 41 kg hang; each is lifted at 200, 350 and 500 kPa in snake order, and lowered in steps of 100 kPa.
A cell between muscle and weight, a displacement and a pressure are sampled at 500 Hz. A trial begins and ends at rest:
no pressure, and the weight on its support, where the cell reads 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.signal import lfilter

from tests.judge.motion import GRAVITY, RATE, Motion, Steps, hang, pressure
from tests.judge.muscle import Array, Muscle, Range

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
}
"""Cause -> its full size: N over the campaign; m; m; share of a contraction; s; s; share of K."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")
SIZES = (1.0, 0.5, 0.25, 0.125)


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


def muscle_of(cause: str, size: float) -> Muscle:
    """The muscle of a campaign; only two of the causes are in it, the others are in the bench."""
    amount = size * FULL[cause]
    return Muscle(bend=amount if cause == "bend" else 0.0, creep=amount if cause == "creep" else 0.0)


def truth(cause: str, size: float) -> dict[str, Callable[[Array], Range]]:
    """Symbol -> function from pressures [Pa] to the least and the greatest value that is right; see `Muscle.truth`."""
    return muscle_of(cause, size).truth(MASSES[0] * GRAVITY, MASSES[-1] * GRAVITY, CONTRACT)


@lru_cache(maxsize=32)
def _motion(muscle: Muscle, slack: float) -> Motion:
    masses = np.array([mass for mass, _ in PLAN])
    return hang(muscle, masses, [commands(P) for _, P in PLAN], DURATION, PAUSES, slack=slack)


def campaign(cause: str, size: float, seed: int) -> list[Trial]:
    """The trials of a campaign with a cause at `size` times its full size (`FULL`); chance is drawn from the seed.

    cell-drift
        The zero of the cell goes evenly with time, up with even seeds and down with odd ones; at rest the cell reads
        what it drifted.
    slip-0.8, slip-3
        Before one trial, drawn from the 4th to the 22nd, a mount gives way. With even seeds that of the muscle: its
        fixed end is nearer to the load, which stays on its support. At rest the record shows nothing; from then on
        each contraction is shorter. With odd seeds that of the displacement sensor: it reads that much less, at rest
        too.
    creep
        The muscle yields under load by up to this share of its contraction, in 0.2 to 60 s, and recovers at rest.
    force-lag
        The cell has a filter of first order with this time constant.
    pressure-late
        The pressure is recorded that much later than the rest.
    bend
        The spring is no straight line: steeper by this share without contraction, flatter by it at 60 mm.
    """
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    muscle = muscle_of(cause, size)
    slips = int(chance.integers(3, 22)) if cause.startswith("slip") else len(PLAN)
    of_sensor = seed % 2 == 1
    sound = _motion(muscle, 0.0)
    slipped = _motion(muscle, amount) if slips < len(PLAN) and not of_sensor else sound
    late = amount if cause == "pressure-late" else 0.0
    t = np.arange(round(DURATION * RATE) + 1) / RATE
    trials = []
    for number, ((mass, target), start) in enumerate(zip(PLAN, STARTS.tolist(), strict=True)):
        done = slipped if number >= slips else sound
        x, force = done.x[number], done.force[number]
        if number >= slips and of_sensor:
            x = x - amount
        if cause == "cell-drift":
            force = force + (1 - 2 * (seed % 2)) * amount * (start + t) / (STARTS[-1] + DURATION)
        if cause == "force-lag":
            force = lagged(force, amount)
        steps = commands(target)
        clean = {"pressure": pressure(steps, t - late), "displacement": x, "force": force}
        read = {name: one + NOISE[name] * chance.standard_normal(len(t)) for name, one in clean.items()}
        asked = tuple((start + at, value) for at, value in steps)
        trials.append(Trial(mass, mass * GRAVITY, target, asked, start + t, **read))
    return trials


def lagged(values: Array, constant: float) -> Array:
    """Samples after a filter of first order with a time constant [s]; exact for straight lines between samples."""
    a = 1.0 / (RATE * constant)
    keep = float(np.exp(-a))
    b1 = 1.0 - (1.0 - keep) / a
    b0 = 1.0 - keep - b1
    return np.asarray(lfilter([b1, b0], [1.0, -keep], values - values[0]) + values[0])
