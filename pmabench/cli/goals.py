"""How well coefficients are wanted, as people type it: `K 1 %, B_r 2 %`, `F_c 0.5 N` or `1.25 x sweep`."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.base.quantities import show

if TYPE_CHECKING:
    from pmabench.analysis.next_trial import Goal
    from pmabench.base.kind import Kind

EXAMPLE = 'for instance --until "K 1 %, B_r 2 %"'
_SWEEP = re.compile(r"\s*(\d+(?:\.\d+)?)\s*x\s*sweep\s*")
_GOAL = re.compile(r"\s*([A-Za-z][A-Za-z_]*)\s*[= ]\s*(.+?)\s*")


def goals_of(text: str, kind: Kind) -> tuple[Goal, ...]:
    """The goals in `text`; UsageError where a coefficient is none of the kind's, or a size is none of its."""
    from pmabench.analysis.next_trial import SWEEP, Goal
    from pmabench.files.quantity import parse_quantity

    if match := _SWEEP.fullmatch(text):
        sweeps = float(match.group(1))
        if not sweeps >= 1:
            raise UsageError(f"--until: {text.strip()}: fewer trials give no narrower intervals; at least 1 x sweep")
        return (Goal(SWEEP, sweeps, True),)
    known = {result.symbol: result for result in kind.results if result.symbol in ("F_ce", "K", "B_c", "B_r", "F_c")}
    found = []
    for part in text.split(","):
        match = _GOAL.fullmatch(part)
        if match is None:
            raise UsageError(f'--until: "{part.strip()}" is no goal; {EXAMPLE}')
        symbol, size = match.groups()
        if symbol not in known:
            raise UsageError(f'--until: no coefficient "{symbol}" to wait for{did_you_mean(symbol, known)}; {EXAMPLE}')
        relative = size.endswith("%")
        quantity = "ratio" if relative else known[symbol].quantity
        try:
            value = parse_quantity(size, quantity)
        except ValueError as error:
            raise UsageError(f"--until: {symbol}: {error}") from error
        if not value > 0:
            raise UsageError(f"--until: {symbol}: {show(value, quantity)}: a goal is above 0; {EXAMPLE}")
        found.append(Goal(symbol, value, relative))
    return tuple(found)
