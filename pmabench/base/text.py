"""Texts of others made plain: nothing in them is obeyed by a terminal, a page or a spreadsheet's reader."""

from __future__ import annotations

import re

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ufffe\uffff]")


def printable(text: object, longest: int | None = None) -> str:
    """One line for a terminal or a comment: signs that it would obey, or does not show, are blanks."""
    return _cut("".join(sign if sign.isprintable() else " " for sign in str(text)), longest)


def clean(text: object, longest: int = 2000) -> str:
    """Text for a page, lines kept: without control and direction characters, cut where it is too long."""
    told = str(text).replace("\r", "").encode("utf-8", "replace").decode("utf-8")
    return _cut(_CONTROL.sub("", told), longest)


def _cut(text: str, longest: int | None) -> str:
    return text if longest is None or len(text) <= longest else text[: longest - 1] + "…"
