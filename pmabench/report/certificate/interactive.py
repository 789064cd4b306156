"""Charts for a browser: their numbers as JSON, the scripts that draw them, and the page's content security policy.

The page works without any of it: every chart is there as static SVG, too. Nothing is fetched.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from math import floor, isfinite, log10
from typing import Any

import numpy as np

from pmabench.plotting.chart import DIGITS, SHAPES, Array, Chart, Series, in_words, limits
from pmabench.plotting.drawing import level_names, rows_needed
from pmabench.plotting.pictures import Picture
from pmabench.plotting.svg import symbol_parts

AS_THEY_ARE = ("color", "mark", "hollow", "width", "dashed", "method", "positive")
"""Fields of a series that the script takes as they are."""
FINE = 2e-4
"""Resolution of lines as a share of the range of their axis."""


@dataclass(frozen=True)
class Assets:
    """What the page embeds: the style of uPlot, two weights of Inter as base64, scripts, and the policy for them."""

    style: str
    regular: str
    semibold: str
    scripts: tuple[str, ...]
    policy: str


@cache
def assets() -> Assets:
    """The files that the page embeds; a script runs only by its hash."""
    web, own = files("pmabench.plotting") / "web", files("pmabench.report") / "templates"
    style, *scripts = (
        path.read_text(encoding="utf-8")
        for path in (web / "uplot.min.css", web / "uplot.iife.min.js", own / "report.js")
    )
    digests = (hashlib.sha256(text.encode()).digest() for text in scripts)
    hashes = " ".join(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests)
    names = ("inter-regular.woff2", "inter-semibold.woff2")
    regular, semibold = (base64.b64encode((web / name).read_bytes()).decode() for name in names)
    policy = (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data:; font-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    return Assets(style, regular, semibold, tuple(scripts), policy)


def chart_data(numbered: Sequence[tuple[int, Picture]]) -> list[dict[str, Any]]:
    """The charts of each figure, as plain data."""
    return [
        {
            "n": n,
            "widths": [round(chart.width, 1) for chart in picture.longest],
            "layout": picture.layout,
            "charts": [
                _chart(chart) | {"column": column} for row in picture.rows for column, chart in enumerate(row, start=1)
            ],
        }
        for n, picture in numbered
    ]


def _chart(chart: Chart) -> dict[str, Any]:
    x0, x1, y0, y1 = (float(f"{end:.8g}") for end in limits(chart))
    places = {level: {"right": right, "first": first} for level, _, _, right, first in level_names(chart)}
    return {
        "x": _greek(chart.x_label),
        "y": _greek(chart.y_label),
        "title": _greek(chart.title),
        "alt": in_words([chart]),
        "range": [x0, x1, y0, y1],
        "ratio": round(chart.height / chart.width, 4),
        "named": chart.x_named,
        "yNamed": chart.y_named,
        "legend": chart.legend,
        "log": chart.log,
        "ticks": chart.x_ticks,
        "sides": chart.sides,
        "stamp": chart.stamp,
        "together": chart.together,
        "tested": None if chart.tested is None else [_numbers(column) for column in chart.tested.T],
        "levels": [{**vars(level), "name": _greek(level.name), **places.get(level, {})} for level in chart.levels],
        "series": [_series(chart, s) for s in chart.series],
    }


def _series(chart: Chart, s: Series) -> dict[str, Any]:
    """What the script needs of a series; what is empty is left out."""
    rows = rows_needed(chart, s)
    x0, x1, y0, y1 = limits(chart)
    fine = (0.0, 0.0) if s.mark else (FINE * (x1 - x0) * (not chart.log), FINE * (y1 - y0))
    loop = not s.mark and bool(np.any(np.diff(s.x[np.isfinite(s.x)]) < 0))
    found = {
        **{name: getattr(s, name) for name in AS_THEY_ARE},
        "hidden": s.hidden or loop,
        "shape": SHAPES.get(s.mark),
        "label": _greek(s.label),
        "said": _greek(s.said or s.label),
        "half": None if s.half is None else _numbers(s.half[rows]),
        "name": s.name_color or s.color,
        "first": s.named_first,
    }
    places = {"x": _numbers(s.x[rows], fine[0]), "y": _numbers(s.y[rows], fine[1])}
    return {name: value for name, value in found.items() if value} | places


def _greek(text: str) -> str:
    """The text with names of Greek letters as letters; subscripts stay behind their `_`."""
    return "".join(f"_{part}" if kind == "sub" else part for kind, part in symbol_parts(text))


def _numbers(values: Array, fine: float = 0.0) -> list[float | None]:
    """Five significant digits, and none finer than `fine`; null for what is no number."""
    decimals = max(0, -floor(log10(fine))) if fine > 0 else 30
    return [round(float(f"{v:.{DIGITS}g}"), decimals) if isfinite(v) else None for v in values.tolist()]
