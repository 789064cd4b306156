"""What departures from P V = const of the air shut in do to its volumes; knows strokes, no campaign.

What lags (heat, a slow sensor) makes the volume on the way there another one than on the way back; a leak that is not
proportional to the pressure makes it another one at the start between two cycles; a wrong pressure of the room makes
it another one from another start pressure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, sqrt

import numpy as np

from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.samples import left
from pmabench.kinds.closed_volume.fit import fit_volume
from pmabench.kinds.closed_volume.stroke import Gas, Stroke
from pmabench.store.analyses.results import Estimate
from pmabench.store.records import Array

SURE = 5.0
"""Standard deviations from which on a difference is seen."""
BOTH_WAYS, BETWEEN, STILL, ROOM = "both ways", "returns to the start", "motion in the rest", "pressure of the room"
PARTS = {BOTH_WAYS: "method", BETWEEN: "drift", STILL: "method", ROOM: "method"}
ADVICE = {
    BOTH_WAYS: "on the way there the volume is up to {} of it different from that on the way back: the air has no time "
    "to take the temperature of the wall, or the pressure comes late. Move more slowly",
    BETWEEN: "back at the start between the cycles the volume comes out up to {} off: the leak changes, or the air is "
    "not at the temperature of the room. Wait longer after filling, and look for the leak",
    STILL: "in the rest at the far end the pressure may still change by {} of it: the air is not at the temperature of "
    "the wall. Rest longer",
    ROOM: "start pressures give volumes that would be the same if they were up to {} other: the pressure of the room, "
    "or the zero of the pressure, is wrong. Read a barometer, and check the zero",
}


@dataclass(frozen=True, eq=False)
class Form:
    """What each departure may change the volumes by."""

    x: Array
    volumes: Array
    """Of all start pressures [m3]; shape (n,)."""
    shares: Mapping[float, Mapping[str, Array]]
    """Start pressure -> departure -> its effect as a share of the volume at `x`."""
    seen: Mapping[float, frozenset[str]]
    """Start pressure -> departures that are significant."""
    leaked: Mapping[float, Array]
    """Share that the volume is larger by where no leak is taken out, at `x`."""

    def of_volume(self, e: Estimate, *, leak: bool) -> list[Doubt]:
        """Of the volume at one start pressure and contraction."""
        P, place = round(e.at["pressure"], 6), int(np.argmin(np.abs(self.x - e.at["contraction"])))
        size = abs(e.value or 0.0)
        found = [
            Doubt(name, PARTS[name], size * abs(float(share[place])), name in self.seen[P],
                  ADVICE[name].format(f"{float(np.abs(share).max()):.2%}"))
            for name, share in self.shares[P].items()
        ]  # fmt: skip
        if not leak:
            lost = abs(float(self.leaked[P][place]))
            reason = f"no leak is taken out, and what leaked makes the volume {lost:.2%} larger. Look for the leak"
            found.append(Doubt("leak", "method", size * lost, seen=True, reason=reason))
        return found

    def of_curve(self, index: int, length: float) -> list[Doubt]:
        """Of a coefficient of V(eps), the `index`-th: it only widens, for each volume has its own limit."""
        base = fit_volume(self.x / length, self.volumes, length)
        found = []
        for name in ADVICE:
            share = np.mean([shares[name] for shares in self.shares.values()], axis=0)
            shapes = [np.ones(len(share))] if name == ROOM else _shapes(len(share))
            moved = [fit_volume(self.x / length, self.volumes * (1 + shape * share), length) for shape in shapes]
            if base is None or None in moved:
                continue
            half = hypot(*(one[index] - base[index] for one in moved if one is not None))
            found.append(Doubt(name, PARTS[name], half, any(name in names for names in self.seen.values())))
        return found


def _shapes(n: int) -> list[Array]:
    """Ways in which an effect of known size may go over `n` contractions: with one sign, with two, and so on."""
    along = np.pi * np.linspace(0.0, 1.0, n)
    return [np.cos(order * along) for order in range(5)]


def form_of(cells: Mapping[float, Sequence[Stroke]], gas: Gas) -> Form:
    """Of the strokes by start pressure [Pa]."""
    shares: dict[float, dict[str, Array]] = {}
    seen: dict[float, set[str]] = {}
    leaked, means = {}, {}
    for P, strokes in cells.items():
        shares[P], seen[P] = _of_one(strokes, gas)
        means[P] = np.mean([one.volumes(gas, leak=True).mean(axis=0) for one in strokes], axis=0)
        leaked[P] = np.mean([one.volumes(gas, leak=False).mean(axis=0) for one in strokes], axis=0) / means[P] - 1
    room, beyond = _room(cells, gas)
    for P in cells:
        shares[P][ROOM] = room[P] / means[P]
        if beyond:
            seen[P].add(ROOM)
    x = next(iter(cells.values()))[0].x
    found = {P: frozenset(names) for P, names in seen.items()}
    return Form(x, np.mean(list(means.values()), axis=0), shares, found, leaked)


def _of_one(strokes: Sequence[Stroke], gas: Gas) -> tuple[dict[str, Array], set[str]]:
    """Shares of the volume at one start pressure, and what is seen."""
    seen = set()
    by_way = np.array([one.by(one.P, one.paid, gas) for one in strokes])
    V = by_way.mean(axis=(0, 1))
    gaps = (by_way[:, 0::2] - by_way[:, 1::2]).reshape(-1, len(V)) / V
    gap = gaps.mean(axis=0)
    error = _noise(strokes, gas) * sqrt(2 / len(gaps))
    if float(np.abs(gap).max()) > SURE * error:
        seen.add(BOTH_WAYS)
    shares = {BOTH_WAYS: 0.5 * np.abs(gap)}
    returns = np.array([one.by(one.returns[:, 0], one.returns[:, 1], gas) for one in strokes]) / gas.reference - 1
    most = float(np.abs(returns.mean(axis=0)).max(initial=0.0))
    if most > SURE * _noise(strokes, gas) * sqrt(1.5 / len(strokes)):
        seen.add(BETWEEN)
    shares[BETWEEN] = np.full(len(V), most)
    further = left([held for one in strokes for held in one.far])
    lowest = float(np.mean([one.P[:, -1].mean() for one in strokes])) + gas.atmosphere
    if further.seen:
        seen.add(STILL)
    shares[STILL] = np.full(len(V), further.most / lowest)
    return shares, seen


def _noise(strokes: Sequence[Stroke], gas: Gas) -> float:
    """Of a volume from the mean of a rest, as a share of it."""
    return max(one.noise / (one.before + gas.atmosphere) / sqrt(one.resting) for one in strokes)


def _room(cells: Mapping[float, Sequence[Stroke]], gas: Gas) -> tuple[dict[float, Array], bool]:
    """What another pressure of the room, for which the start pressures agree best, makes of the volumes [m3]."""
    n = len(next(iter(cells.values()))[0].x)
    if len(cells) < 2:
        return {P: np.zeros(n) for P in cells}, False

    def mean_of(other: Gas) -> Array:
        each = [[one.volumes(other, leak=True).mean(axis=0) for one in strokes] for strokes in cells.values()]
        return np.array([np.mean(one, axis=0) for one in each])

    step = 100.0
    V = mean_of(gas)
    slope = (mean_of(replace(gas, atmosphere=gas.atmosphere + step)) - V) / step
    off, apart = slope - slope.mean(axis=0), V - V.mean(axis=0)
    power = float(np.sum(off**2))
    shift = -float(np.sum(off * apart)) / power if power else 0.0
    noise = max(_noise(strokes, gas) / sqrt(len(strokes)) for strokes in cells.values())
    error = noise * float(V.mean()) * sqrt(n) / sqrt(power) if power else 0.0
    size = abs(shift) + 2 * error
    return {P: one * size for P, one in zip(cells, slope, strict=True)}, abs(shift) > SURE * error
