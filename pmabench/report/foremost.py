"""The table that comes first, on the terminal and on the certificate: the test with most headline values.

Both take their rows from here, so that they cannot say different things. Computes no estimate.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from pmabench.base.quantities import show
from pmabench.plotting.wording import POINTS, clean, in_order, number, point_shown, printed, symbol_text
from pmabench.report.terminal_coefficients import for_terminal, reasons, without_comparison
from pmabench.report.words import declared
from pmabench.store.analyses.results import Analysis, Dropped, Estimate

NEAR_0 = 0.5
"""Half width as a share of its value above which a share says little."""
WIDTH = 80
"""Letters of a reason by which two are the same."""
_SIZE = re.compile(r"(,|=|<|>| of)? ?[-\u2212]?\d[\d.,]*( ?(N|mm|m|kPa|Pa|s|ms|Hz|%)(/\w+)?)?(?=\W|$),?")


def richest(tests: Sequence[Analysis]) -> tuple[list[Estimate], str]:
    """The headline values of one test at its operating points, and the name of what these differ in; the most."""
    best: tuple[list[Estimate], str] = ([], "")
    for analysis in tests:
        kept, _ = without_comparison(analysis)
        for names, (members, _) in for_terminal(kept, declared([analysis])).items():
            over = in_order(members[0].at, POINTS)[:1] if names else []
            if len(over) == 1 and len(members) > len(best[0]):
                best = members, over[0]
    return best


def how_well(members: Sequence[Estimate], over: str) -> str:
    """How well the values are known at most, and where: `F_ce within 1.7 %, K 0.31 % from 150 to 500 kPa`; or empty.

    Of values that come near 0 it is a half width in their unit.
    """
    by_symbol: dict[str, list[Estimate]] = {}
    for e in members:
        if e.value and e.parts.combined is not None:
            by_symbol.setdefault(symbol_text(e.symbol), []).append(e)
    widest = {name: _widest(same) for name, same in by_symbol.items()}
    if not widest:
        return ""
    unit = point_shown(over)[1]
    places = [e.at[over] / unit.scale for e in members]
    known = ", ".join(f"{name}{'' if n else ' within'} {half}" for n, (name, half) in enumerate(widest.items()))
    return f"{known} from {number(min(places))} to {number(max(places))} {unit.unit}".rstrip()


def _widest(same: Sequence[Estimate]) -> str:
    """The widest half width of estimates of one symbol: as a share of its value, or where that is near 0 as it is."""
    halves = [(e.parts.combined or 0.0, abs(e.value or 0.0)) for e in same]
    if all(half < NEAR_0 * value for half, value in halves):
        return f"{100 * max(half / value for half, value in halves):.2g} %"
    return show(max(half for half, _ in halves), same[0].quantity, 2)


def left_out(dropped: Sequence[Dropped]) -> str:
    """Why trials were left out, without the numbers of each: `the load is not below F_ce (32), too little motion (2)`.

    At most three reasons, the most frequent first.
    """
    counts = Counter(" ".join(_SIZE.sub("", one.reason.partition(":")[0]).split()) for one in dropped)
    return ", ".join(f"{clean(reason)} ({count})" for reason, count in counts.most_common(3))


def costliest(tests: Sequence[Analysis], failed: Sequence[str]) -> list[str]:
    """What costs most first: not accepted (`failed`: why), withheld, faults, doubts, trials that are missing.

    Findings that all is well are not among them.
    """
    found = [f"not accepted: {text}" for text in failed]
    held = [text for a in tests for text in reasons([e for e in a.estimates if e.withheld])]
    found += [text for text in held if not any(text.partition("withheld: ")[2][:WIDTH] in one for one in failed)]
    for level in ("fault", "doubt"):
        texts = (f.text for a in tests for f in a.findings if f.level == level)
        found += [printed(t) for t in texts if not any(t.removeprefix("form: ")[:WIDTH] in one for one in failed)]
    for analysis in tests:
        if analysis.dropped:
            found.append(f"{len(analysis.dropped)} trials not used: {left_out(analysis.dropped)}")
    return list(dict.fromkeys(clean(text) for text in found))
