"""Recognises columns by their numbers alone: phases, commands, channels correlated with pressure, counts.

Pure functions of arrays.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pmabench.store.importers import motion
from pmabench.store.importers.found import correlation
from pmabench.store.importers.guess.proposal import METRES, STILL, Proposal
from pmabench.store.records import Array

HELD = 0.02
"""Largest range of a length that counts as held, as a share of the length."""


def by_shape(proposals: Sequence[Proposal]) -> list[Proposal]:
    """Assign roles to unnamed columns: ordered whole numbers are phases, a command rests, others follow the pressure.

    Returns the measured ones except lengths.
    """
    bare = [p for p in proposals if p.role == "ignore" and p.bare and not p.unit and len(p.good) and not _phases(p)]
    taken = {p.role for p in proposals}
    command = None if "pressure_command" in taken else _command(bare)
    order = sorted((p for p in bare if p is not command), key=lambda p: _like_pressure(p.good), reverse=True)
    scale = _pressure_unit(order[0].good) if order else None
    if "pressure" in taken or scale is None:
        return []
    pressure, others = order[0], order[1:]
    pressure.role, pressure.unit = "pressure", scale
    top = float(np.quantile(pressure.good, 0.99))
    pressure.reasons.append(f"never far below zero, {top:.4g} at most: like a pressure in {scale}")
    if command is not None:
        command.role, command.unit = "pressure_command", scale
        together = correlation(command.values, pressure.values)
        command.reasons.append(f"rests at levels, and the pressure goes with it (correlation {together:.2f})")
        command.doubts.append("that it is the command of the pressure is a guess: no name says it")
    follow = [p for p in others if abs(correlation(p.values, pressure.values)) > 0.5]
    if len(follow) > 1 and not taken & {"force", "displacement"}:
        _displacement(follow, pressure)
    if "force" not in taken:
        _force([p for p in others if p.role == "ignore"], pressure)
    return [pressure, *(p for p in others if p.role == "force")]


def _phases(proposal: Proposal) -> bool:
    """Whether an unnamed column has few whole numbers in ascending order; more than one of them mark phases."""
    marks = np.unique(proposal.good)
    if len(marks) > 6 or not np.array_equal(marks, np.round(marks)) or not bool(np.all(np.diff(proposal.good) >= 0)):
        return False
    if len(marks) > 1:
        proposal.role = "phase"
        proposal.reasons.append(f"few whole numbers in order, {', '.join(f'{m:g}' for m in marks)}: phases")
    return True


def _force(others: Sequence[Proposal], pressure: Proposal) -> None:
    """Assign the force to the unnamed column that correlates best with the pressure, if one does."""
    force = max(others, key=lambda p: abs(correlation(p.values, pressure.values)), default=None)
    together = 0.0 if force is None else correlation(force.values, pressure.values)
    if force is None or abs(together) <= 0.5:
        return
    force.role, force.unit = "force", "N"
    force.reasons.append(f"goes with the pressure (correlation {together:.2f}), flat where the pressure is low")
    force.doubts.append("that it is a force in N is a guess: no name says it")
    pressure.doubts.append("only its numbers distinguish it from the other column: is it the other way round?")


def _command(bare: Sequence[Proposal]) -> Proposal | None:
    """A column in the range of a pressure that rests at levels while another one follows it; None for none."""
    for proposal in bare:
        values = proposal.good
        if len(values) < 10 or np.ptp(values) == 0 or _pressure_unit(values) is None:
            continue
        rests = float(np.mean(np.diff(values) == 0)) > 0.9
        twin = any(
            correlation(proposal.values, p.values) > 0.8 and _pressure_unit(p.good) == _pressure_unit(values)
            for p in bare
            if p is not proposal and float(np.mean(np.diff(p.good) == 0)) <= 0.9
        )
        if rests and twin:
            return proposal
    return None


def _displacement(follow: Sequence[Proposal], pressure: Proposal) -> None:
    """Assign the displacement to the column with the smallest numbers, if they could be a length."""
    smallest = min(follow, key=lambda p: float(np.quantile(np.abs(p.good), 0.99)))
    top = float(np.quantile(np.abs(smallest.good), 0.99))
    unit = "m" if top < 0.5 else "mm" if top < 200.0 else ""
    if not unit:
        return
    smallest.role, smallest.unit = "displacement", unit
    together = correlation(smallest.values, pressure.values)
    smallest.reasons.append(
        f"goes with the pressure (correlation {together:.2f}), {top:.4g} at most: a length in {unit}?"
    )
    smallest.doubts.append(
        "that it is a displacement is a guess by its size: no name says it; look whether it is not the force"
    )


def held(column: Proposal, pressure: Proposal | None) -> bool:
    """Whether a length is held: small range, and not correlated with the pressure."""
    x = column.good
    if len(x) < 3:
        return False
    low, high = (float(value) for value in np.quantile(x, [0.01, 0.99]))
    if high - low == 0:
        return True
    together = 0.0 if pressure is None else correlation(column.values, pressure.values)
    still = STILL / METRES[column.unit] if column.unit in METRES else 0.0
    return high - low < max(still, HELD * max(abs(low), abs(high))) and abs(together) < 0.5


def _pressure_unit(values: Array) -> str | None:
    top = float(np.quantile(values, 0.99))
    usual = (("bar", 0.8, 12.0), ("kPa", 50.0, 1200.0), ("Pa", 5e4, 1.2e6), ("MPa", 0.05, 0.8))
    return next((unit for unit, low, high in usual if low <= top <= high), None)


def _like_pressure(values: Array) -> float:
    """Score for a gauge pressure: its range of values, never below zero, rarely at rest at its lower end."""
    low, top = (float(v) for v in np.quantile(values, [0.002, 0.998]))
    span = (top - low) or 1.0
    size = 1.0 if _pressure_unit(values) else 0.0
    below = min(1.0, max(0.0, -low / span) * 20)
    rest = float(np.mean(values < low + 0.1 * span))
    return size - below - rest


def lone(values: Array) -> NDArray[np.bool_]:
    """Mask of samples far from their neighbours, such as sentinels and spikes, shape (n,); for finite values."""
    if len(values) < 9:
        return np.zeros(len(values), dtype=bool)
    around = motion.medians(values, 9)
    return np.asarray(np.abs(values - around) > 0.25 * float(np.ptp(around)))


def lattice(values: Array) -> float:
    """Step between values that come from an A/D converter; 0 where they do not."""
    marks = np.unique(np.round(values, 9))
    if not 20 < len(marks) < len(values) / 4:
        return 0.0
    gaps = np.diff(marks)
    step = float(np.median(gaps))
    near = np.abs(gaps / step - np.round(gaps / step))
    return step if float(np.mean(near < 0.2)) > 0.95 and float(gaps.min()) > 1e-6 * step else 0.0


def is_whole(values: Array) -> bool:
    """Whether all values are whole numbers, and more than 12 different ones."""
    return len(values) > 0 and bool(np.all(values == np.round(values))) and len(np.unique(values)) > 12
