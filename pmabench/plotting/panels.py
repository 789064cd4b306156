"""Rows of charts that several kinds of test share, from panels of named columns in display units; no wording."""

from __future__ import annotations

from collections.abc import Sequence

from pmabench.plotting.chart import Chart, Level, Series, small_multiples
from pmabench.plotting.looks import BLUE, BROWN, FAINT, INK, PALETTE, QUIET
from pmabench.plotting.pictures import Panel, published

Rows = list[list[Chart]]


def loops(panels: Sequence[tuple[str, Sequence[tuple[str, Panel]], Panel | None]], labels: dict[str, str]) -> Rows:
    """One chart for each (title, loops with their names, mean curve); columns x, y."""
    names = list(dict.fromkeys(name for _, lines, _ in panels for name, _ in lines))
    crosses = published([mean or lines[0][1] for _, lines, mean in panels])
    charts = []
    for (title, lines, mean), theirs in zip(panels, crosses, strict=True):
        series = [
            Series(name, one.columns["x"], one.columns["y"], PALETTE[names.index(name) % len(PALETTE)], width=1.0)
            for name, one in lines
        ]
        if mean is not None:
            series.append(Series("mean", mean.columns["x"], mean.columns["y"], INK, width=1.0, dashed=True))
        charts.append(Chart(labels["x"], labels["y"], (*series, *theirs), height=170.0, title=title, legend=True))
    return small_multiples(charts, 3)


def curves(panels: Sequence[Panel], labels: dict[str, str]) -> Rows:
    """Curves y over x above, gap over x below, one of each panel, named at its end; columns x, y, gap."""
    upper, lower = (
        tuple(
            Series(one.title if name == "y" else "", one.columns["x"], one.columns[name], PALETTE[n % len(PALETTE)])
            for n, one in enumerate(panels)
        )
        for name in ("y", "gap")
    )
    zero = (Level(0.0, color=FAINT, dashed=False),)
    charts = (
        Chart(labels["x"], labels["y"], upper, height=150.0),
        Chart(labels["x"], labels["gap"], lower, height=96.0, y_ticks=3, levels=zero),
    )
    return small_multiples([charts], 1)


def courses(panels: Sequence[Panel], labels: dict[str, str]) -> Rows:
    """Columns x, y and P over t below each other, for each panel; its marks as levels of y."""
    looks = (("x", QUIET, 64.0), ("y", BLUE, 104.0), ("P", BROWN, 84.0))
    known = [look for look in looks if any(look[0] in one.columns for one in panels)]
    stacks = []
    for one in panels:
        levels = tuple(Level(value, color=INK) for value in one.marks.values())
        stacks.append(
            [
                Chart(
                    labels["t"],
                    labels[name],
                    (Series("", one.columns["t"], one.columns[name], color, width=1.0),) if name in one.columns else (),
                    height=height,
                    title=one.title if name == "x" else "",
                    levels=levels if name == "y" else (),
                    y_ticks=4 if name == "y" else 3,
                )
                for name, color, height in known
            ]
        )
    return small_multiples(stacks, 4, common="y")
