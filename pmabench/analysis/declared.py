"""What the results of a kind of test are called: each reduction declares symbol, title, unit and headline.

A reduction has them in a table `RESULTS` next to its `reduce`; an analysis carries them, and a result that is not
declared is an error there. Knows no kind of test.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pmabench.base.quantities import QUANTITIES

if TYPE_CHECKING:
    from pmabench.analysis.results import Curve, Estimate


@dataclass(frozen=True)
class Result:
    """A coefficient that a kind of test gives, as it is declared: symbol, title, unit, whether it is a headline."""

    symbol: str
    """As in the field: F_ce, K, B_c."""
    title: str
    """In words, as they follow `the`: `stiffness`. The same title in two kinds of test means the same coefficient."""
    quantity: str
    """Key of `QUANTITIES`, which has the unit; empty where none is the right one, and `unit` says it."""
    headline: bool = False
    """Whether it is a key number: on the terminal, and on the first page of a report."""
    plot: str = ""
    """Title of the plot that it shares with others of the same; where empty, it has a plot for itself."""
    unit: str = ""
    """SI unit where no quantity is declared."""
    positive: bool = False
    """Whether it cannot be below 0, so that its interval ends there; terms of its curves can be below."""


def check_declared(
    kind: str, declared: Sequence[Result], estimates: Iterable[Estimate], curves: Iterable[Curve]
) -> None:
    """Raise ValueError where a result of an analysis of `kind` is not declared, or is in another quantity or unit.

    An estimate with a coordinate (a slope, a term) may have another quantity, in the unit of that.
    """
    known = {result.symbol: result for result in declared}
    if len(known) < len(declared):
        raise ValueError(f"{kind}: a symbol is declared twice in {', '.join(r.symbol for r in declared)}")
    estimates = list(estimates)
    symbols = [e.symbol for e in estimates]
    symbols += [symbol for c in curves for symbol in (c.symbol, *(term.symbol for term in c.terms))]
    missing = [symbol for symbol in dict.fromkeys(symbols) if symbol not in known]
    if missing:
        raise ValueError(
            f"{kind}: not declared: {', '.join(missing)}; declared are {', '.join(known)}. Add the result to the table "
            "RESULTS of its reduction, with title, quantity and whether it is a headline"
        )
    for e in estimates:
        if e.quantity in QUANTITIES and e.unit != QUANTITIES[e.quantity].unit:
            right = QUANTITIES[e.quantity].unit
            raise ValueError(f"{kind}: {e.symbol} is given in {e.unit}; a {e.quantity} is in {right}")
        wanted = known[e.symbol]
        if not e.coordinate and (e.quantity, e.unit if wanted.unit else "") != (wanted.quantity, wanted.unit):
            declaration = wanted.quantity or wanted.unit
            raise ValueError(
                f"{kind}: {e.symbol} is declared as {declaration}, and was given as {e.quantity or e.unit}"
            )


def in_common(orders: Iterable[Iterable[str]]) -> list[str]:
    """The symbols of several orders in one: a new symbol follows the one before it in its own order.

    One that is first there precedes the next that is known, and comes last where none is.
    """
    whole: list[str] = []
    for symbols in map(list, orders):
        for place, symbol in enumerate(symbols):
            if symbol in whole:
                continue
            after = next((whole.index(s) for s in symbols[place + 1 :] if s in whole), len(whole))
            whole.insert(whole.index(symbols[place - 1]) + 1 if place else after, symbol)
    return whole
