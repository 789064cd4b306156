"""The card of a bench as one self-contained HTML file that prints on one A4 page; knows its texts, not the bench."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import ceil
from pathlib import Path
from typing import Any

from pmabench import __version__
from pmabench.report.writing import render, write_file

SIZES = tuple(size / 10 for size in range(92, 46, -2))
"""Sizes of letters [pt] that are tried."""
PAGE = (538.0, 774.0)
"""Width and height of the text of one A4 page [pt]; a little less high than it is."""
LETTER = 0.59
"""Width of a letter over its size, in a wide fount."""


def write_card(card: Mapping[str, Any], path: Path) -> Path:
    """Write the card (the fields of `pmabench.bench.card.Card`) to `path`; raises RecordError where it cannot be."""
    return write_file(path, render_card(card), "the card")


def render_card(card: Mapping[str, Any]) -> str:
    """The card as text; every value is escaped."""
    context = {**card, "version": __version__, "size": letter_size(card)}
    return render("bench_card.html.j2", context, nb=unbroken)


def letter_size(card: Mapping[str, Any]) -> float:
    """Largest size of the letters [pt] at which the card fits one A4 page, by a rough setting of its lines."""
    return next((size for size in SIZES if _height(card, PAGE[0] / size) * size <= PAGE[1]), SIZES[-1])


def _height(card: Mapping[str, Any], width: float) -> float:
    """Height of the card in sizes of its letters, where the page is so wide in sizes of letters."""

    def lines(text: str, share: float, size: float = 1.0) -> int:
        return max(1, ceil(len(text) * LETTER * size / (share * width)))

    def table(rows: Any, share: float = 1.0) -> float:
        return 1.7 + sum(0.5 + 1.25 * lines("  ".join(row), share) for row in rows)

    head = 3.3
    facts = sum(1.44 * lines(value, 0.42) for _, value in card["facts"])
    top = max(facts, 1.2 + 2.7 * lines(card["name"], 0.38, 2.35))
    emergency = 6.2 + 1.4 * lines(f"pmabench is not a safety function. {card['protection']}", 0.72)
    emergency += 3.2 * bool(card["unconfirmed"]) + 1.6 * lines(f"From any terminal: {card['emergency']}", 0.72, 1.25)
    vent = sum(0.7 + 1.34 * lines(text, 0.36) for text, _ in card["vent"])
    vent += 0.8 + 1.34 * (lines("an action that fails stops none of the others. " + card["stop"], 0.46))
    vent += 1.34 * lines(card["proof"], 0.46) + head + table(card["interlocks"] or [["none"]], 0.46)
    fails = sum(0.6 + 1.34 * lines(text, 0.31) for _, text in card["failures"])
    watched = sum(0.5 + 1.25 * lines("   ".join(row), 0.44) for row in card["watch"] or [["none"]]) / 2 + 1.8
    parts = [table(card["limits"]), max(vent, fails), watched, table(card["channels"]) + table(card["outputs"])]
    if card["lacks"]:
        parts.append(0.8 + sum(0.2 + 1.34 * lines(text, 0.95) for text in card["lacks"]))
    foot = 1.5 + 1.2 * lines(" " * (130 + 40 * len(card["hashes"])), 1.0, 0.86)
    return top + emergency + sum(head + part for part in parts) + foot


def unbroken(text: object) -> str:
    """The text with its numbers kept next to their units."""
    return re.sub(r"(?<=\d) (?=\S)", "\u00a0", str(text))
