"""The rests of an arm's staircase of pressure: one trial up and down under one load; grouped by load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pmabench.analysis.shared.samples import Held, Left, NotUsable, left, noise_of
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Dropped
from pmabench.store.records import Array, RunData, TrialData

LAST = 0.2
"""Share of each rest at its end whose mean counts."""
LATER = 0.6
"""Share of it that shows whether it is a rest."""
FEWEST = 5
"""Samples that it needs."""
UNUSABLE_SHARE = 0.5
FOLLOWS = 0.5
"""Share of the commanded change that the measured pressure must show between the rests [1]."""
MANY = 3
"""Trials of which one can be known from the others."""
SURE = 8.0
"""Standard deviations of the noise of a rest from which on a trial that does not come back is seen."""
PHASES = {"preload": -1, "up": -1, "down": 1}
"""Phase of a ramp -> the side from which its pressure is reached: -1 from below."""


@dataclass(frozen=True)
class Rest:
    """One pressure of one trial, at rest."""

    set: float
    """Commanded [Pa]."""
    side: int
    pressure: float
    """[Pa]."""
    angle: float
    """[rad]."""
    drift: float
    """What the angle still changes by over the last fifth of the hold [rad]."""
    noise: float
    """Of the mean [rad]."""
    held: Held
    """The angle over the later part of the hold."""
    arc: float
    """Contraction of the bending muscle by the radius [rad]; nan where one of them is not known."""


@dataclass(frozen=True, eq=False)
class Stair:
    """One trial."""

    run: RunData
    trial: TrialData
    rests: tuple[Rest, ...]

    def column(self, sets: Sequence[float], side: int, of: str = "angle") -> Array:
        """`of` the rests that were reached from one side, at the commanded pressures; nan where there is none."""
        values = {round(rest.set): float(getattr(rest, of)) for rest in self.rests if rest.side == side}
        return np.array([values.get(round(P), np.nan) for P in sets])


@dataclass(frozen=True, eq=False)
class Loaded:
    """One load and its trials."""

    mass: float
    """At the arm's end [kg]."""
    stairs: tuple[Stair, ...]
    sets: tuple[float, ...]
    """Commanded pressures that every trial has on its way up, rising [Pa]."""

    @cached_property
    def pressure(self) -> Array:
        """Measured, the mean of all rests at each [Pa]; shape (n,)."""
        each = [stair.column(self.sets, side, "pressure") for side in (-1, 1) for stair in self.stairs]
        return np.asarray(np.nanmean(each, axis=0))

    @cached_property
    def up(self) -> Array:
        """Angles reached from below [rad]; shape (trials, n)."""
        return np.array([stair.column(self.sets, -1) for stair in self.stairs])

    @cached_property
    def down(self) -> Array:
        """Angles reached from above [rad]; nan at the top, where it turns; shape (trials, n)."""
        return np.array([stair.column(self.sets, 1) for stair in self.stairs])

    @property
    def both(self) -> bool:
        """Whether every trial came down again."""
        return len(self.sets) > 1 and bool(np.isfinite(self.down[:, :-1]).all())

    @cached_property
    def mean(self) -> Array:
        """Mean of both ways and all trials [rad]; of the way up alone where there is no other; shape (n,)."""
        there = np.isfinite(self.down)
        return np.asarray(np.where(there, 0.5 * (self.up + np.where(there, self.down, 0.0)), self.up).mean(axis=0))

    @cached_property
    def gaps(self) -> Array:
        """From above less from below [rad]; shape (trials, n)."""
        return self.down - self.up

    @property
    def widest(self) -> int | None:
        """Where both ways are furthest apart; None where there is one way only."""
        if not self.both:
            return None
        return int(np.argmax(np.abs(self.gaps[:, :-1].mean(axis=0))))

    def motion(self, place: int, side: int) -> Left:
        """What the angle would still change by at one pressure, reached from one side [rad]."""
        wanted = round(self.sets[place]), side
        return left(
            [rest.held for stair in self.stairs for rest in stair.rests if (round(rest.set), rest.side) == wanted]
        )

    @cached_property
    def slip(self) -> tuple[float, bool]:
        """By how much more than the others a trial does not come back to the preload [rad], and whether it is seen."""
        if not self.both or len(self.stairs) < MANY:
            return 0.0, False
        off = np.abs(self.gaps[:, 0] - np.median(self.gaps[:, 0]))
        noise = max(rest.noise for stair in self.stairs for rest in stair.rests)
        return float(off.max()), float(off.max()) > SURE * noise


def loads_of(runs: Sequence[RunData], settings: Mapping[str, Any]) -> tuple[list[Loaded], list[Dropped]]:
    """The loads, rising, and the trials that cannot be used."""
    groups: dict[int, list[Stair]] = {}
    dropped = []
    for run in runs:
        for trial in run.trials:
            try:
                stair = measure(run, trial, settings)
            except NotUsable as reason:
                dropped.append(Dropped(trial.name, trial.point, str(reason)))
            else:
                groups.setdefault(round(trial.point["tip_mass"] * 1e6), []).append(stair)
    found = []
    for _, stairs in sorted(groups.items()):
        on_the_way = [{round(rest.set): rest.set for rest in stair.rests if rest.side < 0} for stair in stairs]
        common = sorted(set.intersection(*(set(one) for one in on_the_way)))
        mass = float(stairs[0].trial.point["tip_mass"])
        if common:
            found.append(Loaded(mass, tuple(stairs), tuple(on_the_way[0][key] for key in common)))
        else:
            why = "no pressure is common to all trials with its load"
            dropped += [Dropped(stair.trial.name, stair.trial.point, why) for stair in stairs]
    return found, dropped


def measure(run: RunData, trial: TrialData, settings: Mapping[str, Any]) -> Stair:
    """One trial: what it shows at each pressure; raises `NotUsable`."""
    if trial.status != "finished":
        raise NotUsable(f"the trial is {trial.status}")
    by_arc, radius = settings.get("angle") == "from-displacement", float(settings.get("radius") or np.nan)
    channel = "displacement" if by_arc else "angle"
    missing = [name for name in (channel, "pressure") if name not in trial.channels]
    if missing:
        raise NotUsable(f"{' and '.join(missing)} not recorded")
    if "tip_mass" not in trial.point:
        raise NotUsable("its point names no load at the arm's end")
    if by_arc and not radius > 0:
        raise NotUsable("the plan tells no radius for an angle from the displacement")
    P, arc = trial.channels["pressure"], trial.channels.get("displacement", np.full(trial.t.shape, np.nan)) / radius
    angle = arc if by_arc else trial.channels["angle"]
    good = trial.usable & np.isfinite(angle) & np.isfinite(P)
    if float(np.mean(~good)) > UNUSABLE_SHARE:
        raise NotUsable(f"{np.mean(~good):.0%} of the samples are flagged or missing")
    ramps = [c for c in trial.commands if c.output == "pressure" and c.kind == "ramp" and c.data.get("rate", 0.0) > 0]
    rests = []
    for n, ramp in enumerate(ramps):
        side = PHASES.get(ramp.phase)
        if side is None:
            continue
        end = ramps[n + 1].t if n + 1 < len(ramps) else float(trial.t[-1])
        begin = ramp.t + abs(ramp.value - ramp.before) / ramp.data["rate"]
        last = np.flatnonzero(good & (trial.t >= end - LAST * (end - begin)) & (trial.t < end - 1e-9))
        if len(last) < FEWEST:
            continue
        middle = len(last) // 2
        later = np.flatnonzero(good & (trial.t >= end - LATER * (end - begin)) & (trial.t < end - 1e-9))
        rests.append(
            Rest(
                set=float(ramp.value),
                side=side,
                pressure=float(P[last].mean()),
                angle=float(angle[last].mean()),
                drift=2 * float(angle[last[middle:]].mean() - angle[last[:middle]].mean()),
                noise=noise_of(angle[last]) / np.sqrt(max(1, middle)),
                held=Held.of(trial.t[later], angle[later], end - LAST * (end - begin) - float(trial.t[later[0]])),
                arc=float(arc[last].mean()),
            )
        )
    if sum(rest.side < 0 for rest in rests) < 2:
        raise NotUsable(f"fewer than two rests of {FEWEST} samples on its way up")
    wanted, found = (np.ptp([getattr(rest, name) for rest in rests if rest.side < 0]) for name in ("set", "pressure"))
    if found < FOLLOWS * wanted:
        moved = f"{show(float(found), 'pressure', 3)} of the {show(float(wanted), 'pressure', 3)} that were commanded"
        raise NotUsable(f"over the rests on its way up the measured pressure moves by {moved}: a dead or wrong channel")
    return Stair(run, trial, tuple(rests))
