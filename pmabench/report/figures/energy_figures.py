"""Figure of work per loop: given while contracting, lost in the loop, and the share that comes back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pmabench.analysis.results import Analysis, Estimate
from pmabench.plotting.pictures import Picture, bound, picture
from pmabench.plotting.plots import FULL, MARKERS, PALETTE, Array, blank, few_ticks, grid
from pmabench.plotting.wording import in_order, point_shown, point_text, shown
from pmabench.report.document.tables import cell

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SYMBOLS = ("W_c", "W", "eta")
HEADS = {"W_c": "given W_c", "W": "loss W", "eta": "recovered eta"}
MOST = 6
"""Most operating points of the figure."""
Series = tuple[str, str, Array, Array, Array]
"""Operating point, symbol, rate, value and half width in display units."""


def energy(analysis: Analysis) -> list[Picture]:
    """One figure over speed or frequency, a series for each other operating point; none without W_c and W."""
    found: list[Picture] = []
    for rate in ("speed", "frequency"):
        mine = [e for e in analysis.estimates if e.symbol in SYMBOLS and rate in e.at and e.value is not None]
        if {"W_c", "W"} <= {e.symbol for e in mine}:
            found.append(_energy(mine, rate, analysis.simulated))
    return found


def _where(e: Estimate, rate: str, alike: Sequence[str]) -> str:
    return point_text({name: at for name, at in e.at.items() if name != rate and name not in alike})


def _energy(mine: Sequence[Estimate], rate: str, simulated: bool) -> Picture:
    alike = [name for name in mine[0].at if name != "pressure" and len({e.at.get(name) for e in mine}) == 1]
    places = list(dict.fromkeys(_where(e, rate, alike) for e in mine))
    kept = [places[i] for i in np.unique(np.linspace(0, len(places) - 1, min(MOST, len(places))).astype(int))]
    series: list[Series] = []
    for place in kept:
        for symbol in SYMBOLS:
            members = sorted((e for e in mine if e.symbol == symbol and _where(e, rate, alike) == place),
                          key=lambda e: e.at[rate])  # fmt: skip
            scales = [shown(e.quantity, e.unit).scale for e in members]
            values = np.array([(e.value or 0.0) / s for e, s in zip(members, scales, strict=True)])
            halves = np.array([(e.parts.combined or 0.0) / s for e, s in zip(members, scales, strict=True)])
            at = np.array([e.at[rate] / point_shown(rate)[1].scale for e in members])
            series.append((place, symbol, at, values, halves))
    label, unit = point_shown(rate)
    x_label = unit.label(label)
    here = point_text({name: mine[0].at[name] for name in alike if name in mine[0].at})
    per = "a cycle of the sine" if rate == "frequency" else "a cycle of the ramps"
    some = "" if len(kept) == len(places) else f" {len(kept)} of {len(places)} are shown."
    caption = (
        f"For {per}{f', at {here}' if here else ''}: work given while contracting, the loop's area (work lost), and "
        "what comes back of the work taken up while expanding, eta = W_c/(W_c + W), with 95 % intervals. What the air "
        f"carries in and out is not measured.{some}"
    )
    ends = {s: [float(v) for _, symbol, _, values, _ in series if symbol == s for v in values] for s in SYMBOLS}
    words = {"W_c": "work given", "W": "work lost", "eta": "share recovered"}
    reaches = ", ".join(
        f"{words[s]} {min(v):.3g} to {max(v):.3g} {'%' if s == 'eta' else 'J'}" for s, v in ends.items() if v
    )
    alt = f"Work per loop over {label} at {'; '.join(kept)}: {reaches}."
    draw = bound(drawing_of, series, x_label)
    return picture(draw, "Work per loop", caption, alt, _table(mine, rate), wide=True, simulated=simulated)


def _table(mine: Sequence[Estimate], rate: str) -> pd.DataFrame:
    """One row per operating point."""
    rows: dict[tuple[tuple[str, float], ...], dict[str, str]] = {}
    names = in_order((name for e in mine for name in e.at), ("pressure",))
    for e in mine:
        row = rows.setdefault(tuple((n, e.at[n]) for n in names if n in e.at), {"at": point_text(e.at)})
        row[shown(e.quantity, e.unit).label(e.symbol)] = cell(e)
    return pd.DataFrame([rows[key] for key in sorted(rows)]).fillna("")


def drawing_of(series: Sequence[Series], x_label: str) -> Figure:
    """A panel for each symbol."""
    figure = blank(FULL, 2.75)
    cells = grid(figure, 1, len(SYMBOLS), top=0.55, left=0.5, across=0.6)
    places = list(dict.fromkeys(place for place, *_ in series))
    for i, symbol in enumerate(SYMBOLS):
        axes = figure.add_subplot(cells[i])
        for place, name, x, y, half in series:
            if name == symbol and len(x):
                n = places.index(place)
                color = PALETTE[n % len(PALETTE)]
                axes.errorbar(x, y, yerr=half, fmt=MARKERS[n % len(MARKERS)], color=color, markersize=3.6,
                              elinewidth=0.9, linewidth=0.7, linestyle="-", label=place)  # fmt: skip
        axes.set_xlabel(x_label)
        axes.set_ylabel(f"{HEADS[symbol]} [{'%' if symbol == 'eta' else 'J'}]")
        axes.set_ylim(bottom=0.0, top=None if symbol != "eta" else 100.0)
        few_ticks(axes, x=5)
    width, height = figure.get_size_inches()
    handles = figure.axes[0].get_legend_handles_labels()
    figure.legend(*handles, loc="upper left", bbox_to_anchor=(0.4 / width, 1 - 0.06 / height), ncols=3)
    return figure
