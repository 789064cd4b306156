"""Forms that a coefficient can take over pressure, as linear combinations of known functions; knows no fit.

As they are asked for: `constant`, `line`, `polynomial N`, `polynomial` (its order is chosen), `polygon`, straight lines
between pressures.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.kinds.contraction_relaxation.pooled import SYMBOLS, place
from pmabench.store.records import Array

POLYGON = "polygon"
MOST_ORDER = 6
"""Highest order of a polynomial."""
WORDS = {"constant": 0, "line": 1, "polynomial": -1}
"""Form -> order; -1 where the order is chosen."""
_FORM = re.compile(r"(constant|line|polygon|polynomial)(?:[ :-]([0-9]+))?")


@dataclass(frozen=True, eq=False)
class Form:
    """y(P) = sum c_j f_j(P): powers of z = (P - centre) / scale from the constant up, or hat functions at `knots`."""

    size: int
    centre: float = 0.0
    scale: float = 1.0
    knots: Array | None = None
    """[Pa]; None for powers."""

    @property
    def name(self) -> str:
        """The form in words."""
        if self.knots is not None:
            return "straight lines between pressures"
        order = self.size - 1
        return ("constant", "a line")[order] if order < 2 else f"a polynomial of order {order}"

    def basis(self, P: Array) -> Array:
        """f_j at pressures P [Pa] of any shape; shape (*P.shape, size)."""
        if self.knots is None:
            return ((P[..., None] - self.centre) / self.scale) ** np.arange(self.size)
        left, share = place(P, self.knots)
        found = np.zeros((*P.shape, self.size))
        np.put_along_axis(found, left[..., None], (1 - share)[..., None], axis=-1)
        np.put_along_axis(found, left[..., None] + 1, share[..., None], axis=-1)
        return found


def check(options: Mapping[str, Any]) -> None:
    """Raise UsageError for a form that is none among the options of the reduction."""
    asked(options.get("forms", ()))


def asked(texts: Sequence[str]) -> dict[str, str]:
    """Symbol -> form of `SYMBOL=FORM` texts; UsageError says what is wrong with one."""
    found: dict[str, str] = {}
    for text in texts:
        symbol, _, form = (part.strip() for part in text.partition("="))
        if symbol not in SYMBOLS:
            raise UsageError(f"{symbol[:40]!r} has no form over pressure{did_you_mean(symbol, SYMBOLS)}")
        match = _FORM.fullmatch(form)
        if match is None or (match[2] and match[1] != "polynomial") or int(match[2] or 0) > MOST_ORDER:
            forms = f"constant, line, polygon, polynomial, or polynomial N with N up to {MOST_ORDER}"
            raise UsageError(f"{symbol} = {form[:40]!r} is no form over pressure: {forms}")
        if symbol in found:
            raise UsageError(f"{symbol} has two forms: give one")
        found[symbol] = form
    return found


def order_of(form: str) -> int | None:
    """Order of a form that was asked for, -1 where it is to be chosen; None for a polygon."""
    word, _, order = form.replace("-", " ").replace(":", " ").partition(" ")
    if word == POLYGON:
        return None
    return int(order) if order else WORDS[word]


def forms_of(orders: Mapping[str, int | None], knots: Array) -> dict[str, Form]:
    """A form for each of `SYMBOLS`; those without an order are polygons on `knots` [Pa]."""
    centre, scale = float(np.mean(knots)), float(np.ptp(knots)) / 2 or 1.0
    return {
        symbol: Form(len(knots), knots=knots)
        if orders.get(symbol) is None
        else Form((orders[symbol] or 0) + 1, centre, scale)
        for symbol in SYMBOLS
    }
