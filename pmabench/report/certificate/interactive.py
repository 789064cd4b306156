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
from math import isfinite
from typing import Any

from pmabench.plotting.chart import MOST_POINTS, Array, Chart, limits
from pmabench.plotting.pictures import Picture

AS_THEY_ARE = ("label", "color", "mark", "hollow", "width", "dashed", "method", "hidden")
"""Fields of a series that the script takes as they are."""
DIGITS = 5
"""Significant digits of the numbers."""


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
    """The charts of each figure that has some, as plain data."""
    return [
        {"n": n, "charts": [_chart(chart) for chart in picture.charts]} for n, picture in numbered if picture.charts
    ]


def _chart(chart: Chart) -> dict[str, Any]:
    x0, x1, y0, y1 = (float(f"{end:.8g}") for end in limits(chart))
    return {
        "x": chart.x_label,
        "y": chart.y_label,
        "range": [x0, x1, y0, y1],
        "ratio": round(chart.height / chart.width, 4),
        "named": chart.x_named,
        "sides": chart.sides,
        "words": chart.words,
        "stamp": chart.stamp,
        "together": chart.together,
        "tested": None if chart.tested is None else [_numbers(column) for column in chart.tested.T],
        "series": [
            {
                **{name: getattr(s, name) for name in AS_THEY_ARE},
                "said": s.said or s.label,
                "x": _numbers(s.x),
                "y": _numbers(s.y),
                "half": None if s.half is None else _numbers(s.half),
                "name": s.name_color or s.color,
                "first": s.named_first,
            }
            for s in chart.series
        ],
    }


def _numbers(values: Array) -> list[float | None]:
    """Five significant digits; null for what is no number; evenly thinned."""
    stride = max(1, -(-len(values) // MOST_POINTS))
    return [float(f"{v:.{DIGITS}g}") if isfinite(v) else None for v in values[::stride].tolist()]
