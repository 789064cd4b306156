"""What symbols, kinds of test and methods are called, as the kinds declare it; one name for one thing in a report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter

from pmabench.base.kind import Result
from pmabench.base.text import clean
from pmabench.kinds import registry
from pmabench.store.analyses.results import AGREEMENT, Analysis, Curve, Estimate


def declared(analyses: Iterable[Analysis]) -> dict[str, Result]:
    """Every symbol of the analyses with its declaration, in the order of columns.

    A symbol that no analysis declares has no title and is shown as a headline: its kind of test is not known here.
    """
    known: dict[str, Result] = {}
    orders = []
    analyses = list(analyses)
    for result in (result for analysis in analyses for result in analysis.results):
        known.setdefault(result.symbol, result)
    for analysis in analyses:
        found = [result.symbol for result in analysis.results] or [e.symbol for e in analysis.estimates]
        orders.append(list(dict.fromkeys(found)))
        for e in analysis.estimates:
            known.setdefault(e.symbol, Result(e.symbol, "", e.quantity, headline=True))
    return {symbol: known[symbol] for symbol in in_common(orders)}


def is_headline(analysis: Analysis, symbol: str) -> bool:
    """Whether the symbol is a key number of this analysis."""
    found = declared([analysis]).get(symbol)
    return found is not None and found.headline


def distinct(analyses: Sequence[Analysis]) -> list[Analysis]:
    """The analyses, their symbols renamed where an earlier one calls another quantity so: `K (bulk modulus)`."""
    first: dict[str, Result] = {}
    renamed = []
    key = attrgetter("title", "quantity", "unit")
    for analysis in analyses:
        names = {
            result.symbol: f"{result.symbol} ({result.title})"
            for result in analysis.results
            if key(first.setdefault(result.symbol, result)) != key(result)
        }
        renamed.append(_renamed(analysis, names) if names else analysis)
    return renamed


def _renamed(analysis: Analysis, names: Mapping[str, str]) -> Analysis:
    def estimate(e: Estimate) -> Estimate:
        return replace(e, symbol=names.get(e.symbol, e.symbol))

    def curve(c: Curve) -> Curve:
        return replace(c, symbol=names.get(c.symbol, c.symbol), terms=tuple(estimate(term) for term in c.terms))

    return replace(
        analysis,
        estimates=tuple(estimate(e) for e in analysis.estimates),
        curves=tuple(curve(c) for c in analysis.curves),
        results=tuple(replace(r, symbol=names.get(r.symbol, r.symbol)) for r in analysis.results),
    )


def kind_title(kind: str) -> str:
    """The kind of test as a heading."""
    return "Agreement of the tests" if kind == AGREEMENT else registry.title_of(clean(kind))


def reverses(kind: str) -> bool:
    """Whether a kind of test looks at small reversals of the motion."""
    found = registry.all_kinds().get(kind)
    return found is not None and found.reverses


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


_DIFFERENCE = "Difference of two independent tests of the same specimen; their intervals are added as squares."


def described(method: str) -> str:
    """What a method does; empty for one that is not known.

    What follows ` above ` is a limit of it; after `, ` the way of one side of a comparison.
    """
    known = {name: words for kind in registry.all_kinds().values() for name, words in kind.methods.items()}
    names = (method, method.partition(" above ")[0], method.partition(", ")[0])
    words = next((known[name] for name in names if name in known), "")
    return words or (_DIFFERENCE if " against " in method else "")
