"""What the results do not hold for: beyond the tested range, stroke and speed, and what no test here looked at.

Every line is made from what the runs and analyses hold; where these do not say it, the line says that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import pi

import numpy as np

from pmabench.plotting.pictures import column, has, unit_of, usable
from pmabench.plotting.wording import POINTS, in_order, number, point_shown, rounded
from pmabench.report.certificate.quality import FOLLOWING
from pmabench.report.document.provenance import get
from pmabench.report.document.tables import is_number, mappings
from pmabench.report.words import reverses
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import RunData

MOST_RANGES = 3
WINDOW = 0.02
"""Time over which a speed is taken from recorded motion [s]."""
Line = tuple[str, str]


def limits(analysis: Analysis | None, analyses: Sequence[Analysis], runs: Sequence[RunData]) -> list[Line]:
    """Up to six lines of a word and a sentence; `analysis`: the one whose values the first table has."""
    mine = [run for run in runs if analysis is not None and run.id in analysis.runs] or list(runs)
    found = [_range(analysis, mine), _stroke(analysis, mine), _speed(analysis, mine)]
    found.append(("Temperature", "the record holds none: values are those of the day of the test"))
    found.append(_wear(mine))
    stiffness = analysis is not None and any(e.symbol == "K" for e in analysis.estimates)
    if stiffness and not any(reverses(a.kind) for a in analyses):
        found.append(("Small reversals", "not tested: K is that of whole strokes, a small loop is stiffer"))
    return [line for line in found if line is not None]


def _points(analysis: Analysis | None, runs: Sequence[RunData]) -> list[dict[str, float]]:
    """Operating points of the trials that are used; those of the values where the runs are not at hand."""
    out = {one.trial for one in analysis.dropped} if analysis else set()
    points = [dict(t.point) for run in runs for t in run.trials if t.name not in out and t.status == "finished"]
    if not points and analysis is not None:
        points = [dict(row) for row in mappings(analysis.facts.get("free_run"))]
        points += [dict(e.at) for e in analysis.estimates if e.value is not None]
    return points


def _range(analysis: Analysis | None, runs: Sequence[RunData]) -> Line | None:
    points = _points(analysis, runs)
    parts = []
    for name in in_order((key for point in points for key in point if key in POINTS), POINTS):
        values = [point[name] for point in points if is_number(point.get(name))]
        if name in FOLLOWING or not values:
            continue
        label, unit = point_shown(name)
        low, high = (number(float(f"{v / unit.scale:.4g}")) for v in (min(values), max(values)))
        parts.append(f"{label} {low if low == high else f'{low} to {high}'} {unit.unit}".rstrip())
    return ("Range", f"outside {', '.join(parts[:MOST_RANGES])}") if parts else None


def _stroke(analysis: Analysis | None, runs: Sequence[RunData]) -> Line | None:
    far = [float(step["x_inf"]) for step in mappings(analysis.facts.get("steps") if analysis else None)
           if is_number(step.get("x_inf"))]  # fmt: skip
    for trace in analysis.traces if analysis else ():
        if has(trace, "displacement"):
            far.append(float(np.nanmax(column(trace, "displacement"))) * unit_of(trace, "displacement").scale)
    length = next((v for run in runs if is_number(v := get(run.manifest, "specimen", "nominal_length"))), None)
    if not far or max(far) <= 0:
        return None
    share = f", {rounded(100 * max(far) / length, None, 2)} % of the nominal length" if length else ""
    return "Stroke", f"contractions beyond {rounded(1e3 * max(far), None, 3)} mm{share}"


def _speed(analysis: Analysis | None, runs: Sequence[RunData]) -> Line | None:
    """The fastest motion: of sines and ramps as commanded, else as the recorded strokes show it."""
    points = _points(analysis, runs)
    fastest = [2 * pi * p["frequency"] * p["amplitude"] for p in points if {"frequency", "amplitude"} <= set(p)]
    fastest += [abs(p["speed"]) for p in points if is_number(p.get("speed"))]
    if not fastest and analysis is not None:
        fastest = list(_recorded(analysis))
    if not fastest or max(fastest) <= 0:
        return None
    return "Speed", f"motion faster than {rounded(1e3 * max(fastest), None, 2)} mm/s, the fastest here"


def _recorded(analysis: Analysis) -> Iterator[float]:
    for trace in filter(usable, analysis.traces):
        if not {"t", "displacement"} <= set(trace.columns):
            continue
        t, x = (column(trace, name) * unit_of(trace, name).scale for name in ("t", "displacement"))
        step = float(np.median(np.diff(t))) if len(t) > 2 else 0.0
        n = max(1, round(WINDOW / step)) if step > 0 else 0
        if n and len(t) > 2 * n:
            with np.errstate(all="ignore"):
                speed = np.abs(x[n:] - x[:-n]) / (t[n:] - t[:-n])
            if np.isfinite(speed).any():
                yield float(np.nanmax(np.where(np.isfinite(speed), speed, np.nan)))


def _wear(runs: Sequence[RunData]) -> Line:
    before = next((v for run in runs if is_number(v := get(run.manifest, "specimen", "cycles_before"))), None)
    done = f"this one had done {number(before)} cycles before" if before is not None else "its cycles are not recorded"
    return "Wear, others", f"other specimens, or this one after many more cycles: {done}"
