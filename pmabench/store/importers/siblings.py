"""Files of one call against each other: what differs between files at the same point; judges no file alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.store.importers.found import Found


@dataclass(frozen=True)
class Summary:
    """What is compared between files at the same point: the peak of each channel [SI]."""

    point: tuple[tuple[str, float], ...]
    peaks: Mapping[str, float]
    numbers: Mapping[str, float]
    """The same peaks as the numbers in the file."""
    trusted: bool
    """False where the file was found wrong already."""
    slope: float | None = None
    """Force over pressure where there is force [N/Pa], of a muscle that is held."""


ALIKE = 1.3
"""Slopes of repeats differ by a factor below this."""
UNIT_FACTORS: Mapping[str, Mapping[str, float]] = {
    "force": {"kilograms for newtons": 9.80665, "pounds for newtons": 4.4482, "a factor of 1000": 1000.0},
    "pressure": {"psi for kPa": 6.8948, "bar for kPa": 100.0, "a factor of 10": 10.0, "a factor of 1000": 1000.0},
    "length": {"inches for mm": 25.4, "a factor of 10": 10.0, "a factor of 1000": 1000.0},
}


def compare(files: Sequence[Summary], allowed: Mapping[str, float]) -> list[list[Found]]:
    """Findings per file: peaks that lie further than `allowed` [1] from those of its siblings.

    With three or more the median shows which is wrong (`fault`); of two that nobody doubts either may be (`doubt`).
    """
    found: list[list[Found]] = [[] for _ in files]
    for index, file in enumerate(files):
        group = [other for other in files if other.point == file.point]
        for channel, share in allowed.items():
            peaks = [o.peaks[channel] for o in group if channel in o.peaks and o.trusted]
            others = [o.peaks[channel] for o in group if o is not file and channel in o.peaks and o.trusted]
            if channel not in file.peaks or not others:
                continue
            usual = float(np.median(peaks if len(peaks) > 2 else others))
            ratio = file.peaks[channel] / usual if usual else float("inf")
            if abs(ratio - 1.0) <= share:
                continue
            sure = len(peaks) > 2 or not file.trusted
            quantity = CHANNEL_QUANTITY[channel]
            text = (
                f"{channel}: peak {show(file.peaks[channel], quantity, 4)}, that of its siblings "
                f"{show(usual, quantity, 4)}: implausible{_hint(ratio, quantity)}"
            )
            if not sure:
                text += "; which of the two is wrong is not known"
            found[index].append(Found("fault" if sure else "doubt", "sibling", text, channel))
        found[index] += _steeper(file, [other for other in group if other is not file])
        found[index] += _swapped(file, [other for other in group if other is not file and other.trusted], allowed)
    return found


def _steeper(file: Summary, others: Sequence[Summary]) -> list[Found]:
    """A slope that is not that of the other files at the same point: they are no repeats of each other.

    Where two thirds of the files agree the others are wrong; else nobody knows which are, and all are withheld.
    """
    slopes = [other.slope for other in others if other.slope and other.trusted]
    if not file.slope or not file.trusted or not slopes:
        return []
    every = [file.slope, *slopes]
    usual = float(np.median(every))
    agree = sum(1.0 / ALIKE <= slope / usual <= ALIKE for slope in every)
    decided = len(every) > 2 and 3 * agree >= 2 * len(every)
    if agree == len(every) or (decided and 1.0 / ALIKE <= file.slope / usual <= ALIKE):
        return []
    shown = ", ".join(show(slope, "force per pressure", 4) for slope in sorted(slopes)[:4])
    ratio = file.slope / float(np.median(slopes))
    text = (
        f"force: slope over pressure {show(file.slope, 'force per pressure', 4)}, in other files at the same point "
        f"{shown}: these are no repeats of one test, for a unit or a scale differs, or the contraction"
        f"{_hint(ratio, 'force') or _hint(ratio, 'pressure')}"
    )
    return [Found("fault", "sibling", text, "force", withholds=not decided)]


def _swapped(file: Summary, others: Sequence[Summary], allowed: Mapping[str, float]) -> list[Found]:
    """Pairs of columns whose numbers look like each other's in the siblings, and not like their own."""
    if not others:
        return []
    usual = {
        channel: float(np.median([other.numbers[channel] for other in others]))
        for channel in file.numbers
        if all(other.numbers.get(channel) for other in others)
    }

    def like(channel: str, other: str) -> bool:
        share = max(allowed.get(channel, 0.3), allowed.get(other, 0.3))
        return abs(file.numbers[channel] / usual[other] - 1.0) <= share

    found = []
    for a, b in combinations(sorted(usual), 2):
        if like(a, b) and like(b, a) and not like(a, a) and not like(b, b):
            text = f"{a} and {b} look swapped: each reads what the other reads in the sibling files"
            found.append(Found("fault", "swap", text, a))
    return found


def _hint(ratio: float, quantity: str) -> str:
    if ratio <= 0:
        return ", the sign may be wrong"
    for text, factor in UNIT_FACTORS.get(quantity, {}).items():
        if min(abs(ratio / factor - 1.0), abs(ratio * factor - 1.0)) < 0.03:
            return f" (is it {text}?)"
    return ""
