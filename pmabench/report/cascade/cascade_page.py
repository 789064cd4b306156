"""The page of a simulated chain: it moves, with a slider; one HTML file that needs nothing else. And the drawings."""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np

from pmabench import __version__
from pmabench.base.errors import RecordError
from pmabench.base.quantities import show
from pmabench.report.cascade.cascade_drawing import (
    FITTING,
    LEFT,
    WIDTH,
    Scene,
    chain,
    definitions,
    moments_of,
    opacity,
    pressure_key,
    ruler,
    snapshots,
    standalone,
)
from pmabench.report.cascade.cascade_figures import Drawn, cursor_track, figures
from pmabench.report.cascade.cascade_record import Result

FRAME = 1 / 30
"""Time between frames [s], longer where there would be too many."""
MOST_FRAMES, MOST_SHAPES = 1800, 30_000


def write_drawings(result: Result, folder: Path, moments: Sequence[float] = ()) -> list[Path]:
    """The page `cascade.html`, the still `snapshots.svg` and each figure as SVG; RecordError where they cannot be."""
    drawn = figures(result)
    chosen = moments or moments_of(result)
    files = {"cascade.html": page(result, drawn, chosen), "snapshots.svg": snapshots(result, chosen)}
    for figure in drawn:
        files[f"{figure.name}.svg"] = _file(figure)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        raise RecordError(f"{folder}: the drawings cannot be written: {error.strerror or error}") from error
    return [folder / name for name in files]


def _file(figure: Drawn) -> str:
    """The figure's element as a separate file, twice the size."""
    left, top, width, height = (float(part) for part in figure.svg.split('viewBox="')[1].split('"')[0].split())
    inner = figure.svg.replace("<svg ", f'<svg x="{left}" y="{top}" width="{width}" height="{height}" ', 1)
    return standalone(inner, width, height, figure.title).replace(
        f'width="{width:g}" height="{height:g}" role', f'width="{2 * width:g}" height="{2 * height:g}" role', 1
    )


def page(result: Result, drawn: Sequence[Drawn], moments: Sequence[float]) -> str:
    """The page as text; every name is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from pmabench.report.document.html import symbols_marked

    environment = Environment(
        loader=PackageLoader("pmabench.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["sym"] = symbols_marked
    scene = Scene(result)
    rows = frame_rows(result)
    height = 2 * scene.low + 108
    first, *others = drawn
    context = {
        "version": __version__,
        "name": result.name,
        "source": result.source,
        "width": WIDTH,
        "height": round(height, 1),
        "axis": round(scene.low + 57, 1),
        "definitions": definitions(scene),
        "key": pressure_key(scene),
        "chain": chain(scene, 0, names=True),
        "ruler": ruler(scene),
        "frames": len(rows) - 1,
        "first": {
            "t": f"{result.time[0]:.2f} s",
            "x": f"{1e3 * result.displacement[0]:.1f} mm",
            "f": f"{result.force[0]:.0f} N",
            "s": f"{result.force_ce_sum[0]:.0f} N",
        },
        "over_time": first.svg,
        "still": _own_names(snapshots(result, moments, head=False)),
        "figures": others,
        "muscles": [
            {
                "name": link.name,
                "law": link.law,
                "length": show(link.length, "length"),
                "pressure": show(max(link.pressure), "pressure", 4),
                "most": f"{show(max(link.displacement), 'length', 4)}, "
                f"{100 * max(link.displacement) / link.length:.1f} %",
                "shape": f"radius {show(link.radius, 'length')}, braid {degrees(link.braid_angle):.1f} deg"
                + (f" ({' and '.join(link.assumed).replace('_', ' ')} assumed)" if link.assumed else ""),
            }
            for link in result.muscles
        ],
        "load": show(result.load, "force"),
        "fce_eval": result.fce_eval,
        "data": json.dumps(frames(result, scene, rows), allow_nan=False, separators=(",", ":")),
    }
    return environment.get_template("cascade.html.j2").render(context) + "\n"


def _own_names(still: str) -> str:
    """The still with names of its parts that no other drawing on the page has."""
    for mark in ('id="', "url(#", 'href="#', 'labelledby="'):
        still = still.replace(mark, f"{mark}still-")
    return still.strip()


def frame_rows(result: Result) -> list[int]:
    """Samples that are frames, evenly spaced in time, first and last among them."""
    t = np.array(result.time)
    most = max(2, min(MOST_FRAMES, MOST_SHAPES // len(result.muscles)))
    count = int(min(max((t[-1] - t[0]) / FRAME + 1, 2), most))
    rows = np.searchsorted(t, np.linspace(t[0], t[-1], count) - 0.5 * float(np.median(np.diff(t))))
    return [int(row) for row in np.unique(np.clip(rows, 0, len(t) - 1))]


def frames(result: Result, scene: Scene, rows: Sequence[int]) -> dict[str, Any]:
    """All numbers of the animation, in pixels of its drawing, and in s, mm and N; numbers only, no texts."""
    shapes = [scene.shapes(row) for row in rows]
    muscles = []
    for i, link in enumerate(result.muscles):
        mine = [shape[i] for shape in shapes]
        numbers: dict[str, Any] = {
            name: [round(getattr(shape, name), 2) for shape in mine]
            for name in ("begin", "length", "radius", "meet", "body")
        }
        numbers["tint"] = [round(opacity(shape.tint), 3) for shape in mine]
        numbers |= {
            "fitting": round(mine[0].fitting, 3),
            "rest": round(link.length * scene.scale, 3),
            "gap": round(FITTING * link.length * scene.scale, 3),
        }
        muscles.append(numbers)
    return {
        "muscles": muscles,
        "t": [round(result.time[row], 6) for row in rows],
        "x": [round(1e3 * result.displacement[row], 3) for row in rows],
        "f": [round(result.force[row], 2) for row in rows],
        "s": [round(result.force_ce_sum[row], 2) for row in rows],
        "end": round(scene.end, 2),
        "low": round(scene.low, 2),
        "left": LEFT,
        "track": [round(value, 2) for value in cursor_track()],
    }
