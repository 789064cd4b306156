"""One field of a text file as a number: decimal signs, groups of three digits, texts for no value, times in words."""

from __future__ import annotations

import re

import numpy as np

from pmabench.store.formats.shared.times import seconds_of
from pmabench.store.formats.text import TextLayout

THOUSANDS = {"comma": ",", "point": ".", "blank": " \u00a0\u2009\u202f", "apostrophe": "'\u2019"}
"""Signs between groups of three digits."""
NUMBER = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d{1,3})?\s*")
MINUS = "\u2212"
"""The minus sign of typesetting, which some programs write."""


class Fields:
    """Reads fields by a layout; `order` is that of day and month in dates."""

    def __init__(self, layout: TextLayout, order: str) -> None:
        """Compile what the layout says of numbers."""
        self._layout, self._order = layout, order
        self._signs = "" if layout.thousands is None else THOUSANDS[layout.thousands]
        point = "," if layout.decimal == "comma" else "."
        self._grouped = re.compile(rf"\s*[+-]?\d{{1,3}}(?:[{self._signs or '_'}]\d{{3}})+(?:[{point}]\d*)?\s*")

    def value(self, text: str, kind: str) -> float:
        """A field as a number, or as seconds where it is a time of a `kind`; raises ValueError with the reason."""
        if text.strip() in self._layout.missing:
            return np.nan
        if kind:
            try:
                return float(seconds_of([text], kind, self._order)[0])
            except ValueError as error:
                raise ValueError(error.args[1]) from error
        plain = text
        if self._signs and self._grouped.fullmatch(plain):
            plain = re.sub(f"[{self._signs}]", "", plain.strip())
        if self._layout.decimal == "comma":
            plain = "?" if "." in plain else plain.replace(",", ".")
        if NUMBER.fullmatch(plain) is None:
            raise ValueError("is no number")
        value = float(plain.replace("d", "e").replace("D", "e"))
        if not np.isfinite(value):
            raise ValueError("is no finite number")
        return value
