"""The card of a bench as one self-contained HTML file that prints on one A4 page; knows its texts, not the bench."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pmabench import __version__
from pmabench.report.writing import render, write_file

LETTERS = {24: 7.4, 31: 6.6}
SMALLEST = 5.0
"""Rows up to which letters are so large [pt], and their size on a card with more."""


def write_card(card: Mapping[str, Any], path: Path) -> Path:
    """Write the card (the fields of `pmabench.bench.card.Card`) to `path`; raises RecordError where it cannot be."""
    return write_file(path, render_card(card), "the card")


def render_card(card: Mapping[str, Any]) -> str:
    """The card as text; every value is escaped."""
    context = {**card, "version": __version__, "size": letter_size(card)}
    return render("bench_card.html.j2", context, nb=unbroken)


def letter_size(card: Mapping[str, Any]) -> float:
    """Size of the letters [pt] by the number of rows; a card with very many may take a second page."""
    rows = sum(len(card[part]) for part in ("limits", "channels", "outputs", "watch", "vent", "failures", "lacks"))
    return next((size for most, size in LETTERS.items() if rows <= most), SMALLEST)


def unbroken(text: object) -> str:
    """The text with its numbers kept next to their units."""
    return re.sub(r"(?<=\d) (?=\S)", "\u00a0", str(text))
