"""Campaigns whose trials a chooser picks one by one, by the independent simulator `tests.judge`, with scatter and drift.

Weights of up to 160 kg on a muscle that pulls 1.5 kN at most: a third of the cells of the whole sweep cannot move. In each
trial the muscle pulls by some force more or less, which the cell does not see at rest: the weight that hangs in the
simulator is that much lighter. Drift makes contractions longer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from pmabench.analysis.next_trial import Goal
from pmabench.kinds.contraction_relaxation.known import Known, cells_of, known_after
from pmabench.kinds.contraction_relaxation.next_trial import Chooser, Stop
from pmabench.store.records import Event, RunData
from tests.analysis.judged import as_run
from tests.judge.campaign import BASELINE, CONTRACT, DURATION, NOISE, RELAX, Trial, commands
from tests.judge.motion import GRAVITY, RATE, Motion, hang, pressure
from tests.judge.muscle import Muscle, damping_down, damping_up, pull, stiffness

LINES = {"F_ce": pull, "K": stiffness, "B_c": damping_up, "B_r": damping_down}
NODES = (-60.0, -40.0, -20.0, 0.0, 20.0, 40.0, 60.0)
"""Forces [N] by which the muscle pulls more, that are simulated; between them on straight lines."""


@dataclass(frozen=True)
class Sweep:
    """Masses that hang [kg], and pressures [Pa]; cells are numbered pressure by pressure within masses."""

    masses: tuple[float, ...]
    pressures: tuple[float, ...]
    repeats: int = 2

    @property
    def cells(self) -> list[tuple[float, float]]:
        """Mass and pressure of each."""
        return [(mass, P) for mass in self.masses for P in self.pressures]

    def cell(self, point: Mapping[str, float]) -> int:
        """The number of a cell."""
        return self.masses.index(point["mass"]) * len(self.pressures) + self.pressures.index(point["pressure"])


WHOLE = Sweep(tuple(np.arange(10.0, 161.0, 15.0).tolist()), tuple(np.arange(150e3, 501e3, 50e3).tolist()))
SMALL = Sweep((15.0, 40.0, 65.0, 90.0), (200e3, 350e3, 500e3), repeats=4)


@dataclass(frozen=True)
class Scatter:
    """What differs from trial to trial, and over a campaign."""

    of_force: float
    """Standard deviation of the force by which the muscle pulls more in a trial [N]."""
    drift: float
    """Share by which the last trial of 100 contracts more than the first."""


def scatter(seed: int) -> Scatter:
    """That of a campaign: 0.3 to 2 % of the pull at 350 kPa, and a drift of up to 0.5 % either way."""
    chance = np.random.default_rng([seed, 6])
    share = 0.003 * (0.02 / 0.003) ** chance.random()
    return Scatter(share * float(pull(np.array([350e3]))[0]), 0.005 * (2 * chance.random() - 1))


@lru_cache(maxsize=4)
def motions(muscle: Muscle, sweep: Sweep) -> tuple[Motion, ...]:
    """Every cell for each of `NODES`."""
    cells = sweep.cells
    masses = np.array([mass for mass, _ in cells])
    asked = [commands(P) for _, P in cells]
    pauses = np.full(len(cells), 60.0)
    return tuple(hang(muscle, masses - more / GRAVITY, asked, DURATION, pauses) for more in NODES)


@lru_cache(maxsize=4)
def plan(sweep: Sweep) -> dict[str, Any]:
    """The sweep as a plan of plain data: the trials of `grid`, and then those that cannot move."""
    trials, steps = [], list[dict[str, Any]]()
    moving = grid(sweep)
    still = sorted(set(range(len(sweep.cells))) - {cell for cell, _, _ in moving})
    cells = [(cell, reference) for cell, _, reference in moving] + [(cell, False) for cell in still * sweep.repeats]
    for index, (cell, reference) in enumerate(cells):
        mass, P = sweep.cells[cell]
        point = {"load": mass * GRAVITY, "mass": mass, "pressure": P}
        trials.append({"index": index, "point": point, "repeat": 0, "reference": reference})
        steps += [{"step": "record", "on": True, "trial": index}, {"step": "hold", "duration": BASELINE}]
        for number, (_, value) in enumerate(commands(P)):
            steps += [
                {"step": "set", "output": "pressure", "value": value},
                {"step": "hold", "duration": RELAX if number else CONTRACT},
            ]
        steps.append({"step": "record", "on": False, "trial": index})
    return {"name": "chosen", "rate": RATE, "trials": trials, "steps": steps, "settings": {}}


def trial(cell: int, number: int, seed: int, by: Scatter, muscle: Muscle, sweep: Sweep) -> Trial:
    """The trial `number` of a campaign, in a cell of `motions`."""
    chance = np.random.default_rng([seed, number])
    mass, P = sweep.cells[cell]
    t = np.arange(round(DURATION * RATE) + 1) / RATE
    more = float(np.clip(by.of_force * chance.standard_normal(), NODES[0], NODES[-1]))
    left = min(int(np.searchsorted(NODES, more, side="right")) - 1, len(NODES) - 2)
    share = (more - NODES[left]) / (NODES[left + 1] - NODES[left])
    low, high = motions(muscle, sweep)[left : left + 2]
    x = (1 - share) * low.x[cell] + share * high.x[cell]
    force = (1 - share) * low.force[cell] + share * high.force[cell] + np.where(x > 0, more, 0.0)
    clean = {
        "pressure": pressure(commands(P), t),
        "displacement": (1.0 + by.drift * number / 100) * x,
        "force": force,
    }
    read = {name: one + NOISE[name] * chance.standard_normal(len(t)) for name, one in clean.items()}
    start = number * (DURATION + 60.0)
    asked = tuple((start + at, value) for at, value in commands(P))
    return Trial(mass, mass * GRAVITY, P, asked, start + t, **read)


def run_of(done: Sequence[tuple[int, int, bool]], seed: int, by: Scatter, muscle: Muscle, sweep: Sweep) -> RunData:
    """A run of trials (cell, index, whether a reference trial), in this order."""
    made = as_run([trial(cell, number, seed, by, muscle, sweep) for number, (cell, _, _) in enumerate(done)])
    trials = [
        replace(one, index=index, reference=reference)
        for one, (_, index, reference) in zip(made.trials, done, strict=True)
    ]
    return replace(made, trials=tuple(trials), plan=plan(sweep))


def grid(sweep: Sweep) -> list[tuple[int, int, bool]]:
    """Every cell that moves, load by load and back, with a reference trial every eighth."""
    moving = [n for n in range(len(sweep.cells)) if motions(Muscle(), sweep)[2].x[n].max() > 1e-3]
    reference = moving[len(moving) // 2]
    order: list[tuple[int, int, bool]] = []
    for cell in (*moving, *reversed(moving)) * (sweep.repeats // 2):
        if len(order) % 8 == 0:
            order.append((reference, 1000 + len(order), True))
        order.append((cell, len(order), False))
    return order


@dataclass(frozen=True)
class Campaign:
    """A campaign whose trials were chosen."""

    done: tuple[tuple[int, int, bool], ...]
    stop: Stop
    known: Known
    """By all its trials."""


def expected() -> Mapping[str, Any]:
    """What a lab expects of the muscle beforehand: off by some percent."""
    P = np.array([150e3, 325e3, 500e3])
    off = {"F_ce": 1.04, "K": 0.94, "B_c": 1.15, "B_r": 0.85}
    points = [
        {
            "pressure": float(at),
            **{symbol: off[symbol] * float(line(np.array([at]))[0]) for symbol, line in LINES.items()},
        }
        for at in P
    ]
    return {"F_c": 12.0, "points": points}


def chosen(goals: tuple[Goal, ...], seed: int, by: Scatter, sweep: Sweep, muscle: Muscle | None = None) -> Campaign:
    """The campaign, from nothing to the end that its chooser decides."""
    muscle = muscle or Muscle()
    chooser = Chooser(plan(sweep), expected(), goals)
    done: list[tuple[int, int, bool]] = []
    events: list[Event] = []
    while True:
        runs = [replace(run_of(done, seed, by, muscle, sweep), events=tuple(events))] if done else []
        answer = chooser.decide(runs)
        if isinstance(answer, Stop):
            known = known_after(cells_of(plan(sweep)), goals, runs, expected())
            assert known is not None
            return Campaign(tuple(done), answer, known)
        done.append((sweep.cell(answer.point), answer.trial, answer.role == "reference"))
        events.append(Event(len(events), 0.0, "plan-change", vars(answer)))
