"""Where the uncertainty comes from: one bar for each coefficient, shares of the variance by cause, at the middle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pmabench.plotting.plots import BLUE, BROWN, DARK, GREEN, QUIET
from pmabench.plotting.wording import clean, half_width, point_text, symbol_text
from pmabench.store.analyses.results import Estimate

COLORS = {"repeats": BLUE, "calibration": BROWN, "method": GREEN, "drift": QUIET, "skew": DARK}
"""Cause -> its colour; the same words are in the appendix."""
MOST = 5
SMALL = 0.005
"""Share of the variance below which a piece is not drawn."""


@dataclass(frozen=True)
class Bar:
    """One coefficient: half width in per cent, pieces (cause, colour, share from 0 to 1), its largest single source."""

    symbol: str
    percent: str
    pieces: list[tuple[str, str, float]]
    largest: str


@dataclass(frozen=True)
class Sources:
    """Bars at one operating point, and the causes that are in them."""

    where: str
    bars: list[Bar]
    causes: list[tuple[str, str]]


def sources(members: Sequence[Estimate], over: str) -> Sources | None:
    """The bars for the values of the first table, each symbol at the middle of `over`; None without any interval."""
    known = [e for e in members if e.value and e.parts.combined]
    places = sorted({e.at.get(over, 0.0) for e in known})
    if not places:
        return None
    middle = places[len(places) // 2]
    here = {e.symbol: e for e in known if e.at.get(over, 0.0) == middle}
    bars = [_bar(e) for e in list(here.values())[:MOST]]
    if not bars:
        return None
    used = {cause for bar in bars for cause, _, _ in bar.pieces}
    at = next(iter(here.values())).at
    where = point_text({over: at[over]} if over in at else at)
    return Sources(where, bars, [(cause, color) for cause, color in COLORS.items() if cause in used])


def _bar(e: Estimate) -> Bar:
    combined = e.parts.combined or 1.0
    shares = {cause: ((part or 0.0) / combined) ** 2 for cause, part in vars(e.parts).items()}
    pieces = [(cause, COLORS[cause], shares[cause]) for cause in COLORS if shares.get(cause, 0.0) >= SMALL]
    largest = max(e.budget, key=lambda s: s.half or 0.0, default=None)
    words = ""
    if largest is not None and largest.half:
        words = f"{clean(largest.name, 60)}, {100 * min(1.0, largest.half / combined) ** 2:.0f} %"
    elif pieces:
        cause, _, share = max(pieces, key=lambda piece: piece[2])
        words = f"{cause}, {100 * share:.0f} %"
    return Bar(symbol_text(e.symbol), half_width(100 * combined / abs(e.value or 1.0)), pieces, words)
