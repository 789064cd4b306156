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

from pmabench.plotting.chart import MOST_POINTS, Chart, limits
from pmabench.plotting.pictures import Picture
from pmabench.plotting.plots import Array

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
    scripts = (
        (web / "uplot.iife.min.js").read_text(encoding="utf-8"),
        (own / "report.js").read_text(encoding="utf-8"),
    )
    hashes = " ".join(
        f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts
    )
    fonts = [
        base64.b64encode((web / f"inter-{weight}.woff2").read_bytes()).decode() for weight in ("regular", "semibold")
    ]
    return Assets(
        style=(web / "uplot.min.css").read_text(encoding="utf-8"),
        regular=fonts[0],
        semibold=fonts[1],
        scripts=scripts,
        policy=(
            f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data:; font-src data:; "
            "base-uri 'none'; form-action 'none'"
        ),
    )


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
                "label": s.label,
                "said": s.said or s.label,
                "x": _numbers(s.x),
                "y": _numbers(s.y),
                "half": None if s.half is None else _numbers(s.half),
                "color": s.color,
                "name": s.name_color or s.color,
                "dots": s.dots,
                "hollow": s.hollow,
                "cross": s.cross,
                "width": s.width,
                "dashed": s.dashed,
                "method": s.method,
                "first": s.named_first,
                "hidden": s.hidden,
            }
            for s in chart.series
        ],
    }


def _numbers(values: Array) -> list[float | None]:
    """Five significant digits; null for what is no number; evenly thinned."""
    stride = max(1, -(-len(values) // MOST_POINTS))
    return [float(f"{v:.{DIGITS}g}") if isfinite(v) else None for v in values[::stride].tolist()]
