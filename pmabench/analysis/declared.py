"""Whether what an analysis holds is what its kind of test declares; knows no kind of test."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from pmabench.base.kind import Result
from pmabench.base.quantities import QUANTITIES

if TYPE_CHECKING:
    from pmabench.analysis.results import Curve, Estimate


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
            f"{kind}: not declared: {', '.join(missing)}; declared are {', '.join(known)}. Add the result to the "
            "record of this kind of test, with title, quantity and whether it is a headline"
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
