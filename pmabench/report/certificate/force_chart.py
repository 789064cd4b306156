"""The second and the third figure of the certificate: force over contraction at each pressure, and one stroke.

What no trial reached is grey. The lines are F = F_ce(P) − K(P) x of the first method that gives both, bent where the
fit found them so; dots are where strokes ended under a load, or forces at held contractions, as the analyses hold them.

The stroke is measured, and run freely by the fitted muscle, with the residual below. The bend of a muscle is as its
analysis wrote it down: where K is the slope, and what it pulls more there.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from pmabench.plotting.chart import BLUE, BROWN, FAINT, PAGE, QUIET, Array, Chart, Series, small_multiples
from pmabench.plotting.pictures import Picture, column, has, head, label, of_charts, of_traces, spread, unit_of
from pmabench.plotting.wording import Frame, half_width, rounded
from pmabench.report.document.tables import mappings
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import is_number

FIGURE = "characteristic"
"""Kind of the trace of forces at set pressures and contractions."""
MODELS = ("measured-pressure", "isometric-sections")
"""Methods whose F_ce and K the lines may have; the first that is there."""
HEIGHT = 158.0
FEWEST = 2
"""Pressures that the figure needs."""
MOST = 8
"""Pressures that are drawn, evenly chosen."""
PALE, DEEP = (0x9D, 0xB7, 0xD5), (0x06, 0x2C, 0x52)
"""Ends of the sequence of blues, from the least to the largest pressure."""
READABLE = 0.45
"""Share of the way to `DEEP` from which on a blue is dark enough for text."""
ZERO = np.zeros(())
SAME = 500.0
"""Pressures that differ by less are one [Pa]."""


@dataclass(frozen=True)
class Level:
    """What is known at one pressure [Pa], SI."""

    P: float
    F_ce: float
    K: float
    rest: Array
    """Ends of contracting strokes and held forces: contraction and force, shape (n, 2)."""
    back: Array
    """Ends of relaxing strokes, as `rest`."""
    bend: tuple[Array, Array] | None = None
    """Of a bent line: contractions [m], and the force [N] that it has more there."""

    def force(self, x: Array) -> Array:
        """Force [N] at contractions [m]."""
        more = 0.0 if self.bend is None else np.interp(x, *self.bend)
        return np.asarray(self.F_ce - self.K * x + more)

    def contraction(self, force: Array) -> Array:
        """The inverse, negative above F_ce; where the line does not come down to a force, where it is lowest."""
        if self.bend is None:
            return np.asarray((self.F_ce - force) / self.K)
        x, y = self.bend[0], self.force(self.bend[0])
        lowest = int(np.argmin(y))
        falls = lowest == len(x) - 1
        x, y = x[: lowest + 1], np.minimum.accumulate(y[: lowest + 1])
        above, below = np.maximum(force - y[0], 0.0), np.maximum(y[-1] - force, 0.0) * falls
        return np.asarray(np.interp(-force, -y, x) + (below - above) / self.K)


def blue(share: float) -> str:
    """A colour between the palest (0) and the deepest blue (1)."""
    parts = (round(a + (b - a) * min(1.0, max(0.0, share))) for a, b in zip(PALE, DEEP, strict=True))
    return "#" + "".join(f"{part:02x}" for part in parts)


def force_picture(analyses: Sequence[Analysis], less: float = 0.0) -> Picture | None:
    """The figure, lower by `less` [pt].

    None where F_ce and K are not known at two pressures, or nothing was measured on their lines.
    """
    levels = _levels(analyses)
    if len(levels) < FEWEST or not any(len(level.rest) for level in levels):
        return None
    levels = spread(levels, MOST)
    dots = np.concatenate([np.concatenate([level.rest, level.back]) for level in levels])
    low, high, far = float(dots[:, 1].min()), float(dots[:, 1].max()), float(dots[:, 0].max())
    reach = max(far * 1.12, min(max(float(level.contraction(ZERO)) for level in levels), 1.6 * far))
    series = [one for n, level in enumerate(levels) for one in _series(level, n / (len(levels) - 1), reach)]
    ends = f"{_shown(levels[0].P)} to {_shown(levels[-1].P)} kPa"
    bent = any(level.bend is not None for level in levels)
    tested = _tested(levels, low, high)
    chart = Chart("contraction x [mm]", "F [N]", tuple(series), PAGE, HEIGHT - less, tested=tested, zero=True)
    friction = next((e.value or 0.0 for a in analyses for e in a.estimates if e.symbol == "F_c" and not e.at), 0.0)
    size = rounded(friction, None, 3) if friction > 0 else ""
    off = f" Friction lets a muscle rest up to F_c = {size} N off its line." if size else ""
    hollow = " Hollow: where relaxing strokes ended." if any(len(level.back) for level in levels) else ""
    lines = "the fitted force; K is its slope at one contraction" if bent else "F = F_ce − K x of the fit"
    held = any(t.figure == FIGURE for a in analyses for t in a.traces)
    strokes = any(step.get("x_inf") is not None for a in analyses for step in mappings(a.facts.get("steps")))
    dots_are = ["where strokes ended under each load"] * strokes + ["forces at held contractions"] * held
    caption = f"Lines: {lines}. Dots: {' and '.join(dots_are)}.{hollow}{off}"
    simulated = any(a.simulated for a in analyses)
    return of_charts([[chart]], f"Force over contraction, {ends}", caption, _table(levels), simulated=simulated)


def _levels(analyses: Sequence[Analysis]) -> list[Level]:
    """Pressures at which F_ce and K of one method are known, rising."""
    for method in MODELS:
        F_ce, K = (_by_pressure(analyses, symbol, method) for symbol in ("F_ce", "K"))
        both = sorted(P for P in set(F_ce) & set(K) if K[P] > 0)
        bend = bend_of(analyses, (method,))
        unknown = bend is None and slopes_of(analyses, (method,))  # K is a slope somewhere on a line that is not known
        if len(both) >= FEWEST and not unknown:
            bends = {} if bend is None else {P: (bend.x, bend.at(P)) for P in both}
            return [Level(P, F_ce[P], K[P], *_measured(analyses, P), bends.get(P)) for P in both]
    return []


def _by_pressure(analyses: Sequence[Analysis], symbol: str, method: str) -> dict[float, float]:
    """Values of a symbol by one method [SI] over the pressure alone [Pa]."""
    found = [e for a in analyses for e in a.estimates if (e.symbol, e.method, e.coordinate) == (symbol, method, "")]
    return {e.at["pressure"]: e.value for e in found if set(e.at) == {"pressure"} and e.value is not None}


def _measured(analyses: Sequence[Analysis], P: float) -> tuple[Array, Array]:
    """Contraction [m] and force [N] at rest near a pressure, after contracting (or held), and after relaxing."""
    rest: list[tuple[float, float]] = []
    back: list[tuple[float, float]] = []
    for a in analyses:
        for step in mappings(a.facts.get("steps")):
            known = all(is_number(step.get(name)) for name in ("pressure", "load", "x_inf"))
            if known and abs(step["pressure"] - P) < SAME:
                (rest if step.get("phase") == "contract" else back).append((step["x_inf"], step["load"]))
        for t in a.traces:
            if t.figure == FIGURE and has(t, "pressure", "displacement", "force"):
                near = np.abs(t.columns["pressure"] - P) < SAME
                rest += list(zip(t.columns["displacement"][near], t.columns["force"][near], strict=True))
    return np.array(rest, dtype=np.float64).reshape(-1, 2), np.array(back, dtype=np.float64).reshape(-1, 2)


def _series(level: Level, share: float, reach: float) -> list[Series]:
    """The line with its name at its end, and the dots."""
    color, text = blue(share), blue(max(share, READABLE))
    x = np.linspace(0.0, min(reach, float(level.contraction(ZERO))), 25)
    name = f"{_shown(level.P)} kPa"
    found = [Series(name, 1e3 * x, level.force(x), color, width=1.6, name_color=text, named_first=True)]
    for marks, hollow in ((level.rest, False), (level.back, True)):
        if len(marks):
            x, force = marks[np.argsort(marks[:, 0], kind="stable")].T
            said = f"{name}, {'relaxed' if hollow else 'measured'}"
            found.append(Series("", 1e3 * x, force, color, "o", hollow=hollow, said=said))
    return found


def _tested(levels: Sequence[Level], low: float, high: float) -> Array:
    """Corners of the zone between the least and the largest pressure and load [mm, N]."""
    force = np.linspace(low, high, 40)
    near, far = (level.contraction(force) for level in (levels[0], levels[-1]))
    inside = far >= 0
    left, right = np.maximum(near, 0.0)[inside], far[inside]
    return 1e3 * np.array([[*left, *right[::-1]], [*(1e-3 * force[inside]), *(1e-3 * force[inside])[::-1]]]).T


def _table(levels: Sequence[Level]) -> Frame:
    rows = [
        {
            "P [kPa]": _shown(level.P),
            "x [mm]": rounded(1e3 * x, None, 4),
            "F [N]": rounded(F, None, 4),
            "line [N]": rounded(float(level.force(x)), None, 4),
            "after": word,
        }
        for level in levels
        for marks, word in ((level.rest, "contracting, or held"), (level.back, "relaxing"))
        for x, F in marks
    ]
    return Frame(rows)


def _shown(P: float) -> str:
    return f"{P / 1e3:.4g}"


HIGH, LOW = 142.0, 82.0
"""Heights of the two charts of a stroke [pt]."""


def stroke_picture(analyses: Sequence[Analysis]) -> tuple[Picture, Trace] | None:
    """The figure and the trace that it shows, the one with the largest stroke; None where no test has a free run."""
    every = [(trace, analysis) for analysis in analyses for trace in analysis.traces if trace.figure == "overlay"]
    able = [(trace, analysis) for trace, analysis in every if has(trace, "t", "displacement", "model")]
    if not able:
        return None
    trace, analysis = max(able, key=lambda pair: float(np.nanmax(np.abs(pair[0].columns["displacement"]))))
    t, x, model = (column(trace, name) for name in ("t", "displacement", "model"))
    apart = model - x
    rms = float(np.sqrt(np.mean(apart[np.isfinite(apart)] ** 2)))
    unit, where = unit_of(trace, "displacement").unit, head(trace)
    misfit = f"{half_width(rms)} {unit} rms"
    share = 100 * rms / float(np.ptp(x[np.isfinite(x)]) or 1.0)
    t_label, residual = label(trace, "t"), (Series("residual", t, apart, BROWN, width=1.0),)
    lines = Series("measured", t, x, FAINT, width=4.0, name_color=QUIET), Series("free run", t, model, BLUE, width=1.4)
    charts = (
        Chart(t_label, f"contraction x [{unit}]", lines, height=HIGH),
        Chart(t_label, f"free run − measured [{unit}]", residual, height=LOW, y_ticks=3),
    )
    caption = (
        f"The fitted muscle with the measured pressure as its only input, from the first sample on. It "
        f"misses this trial by {misfit}, {share:.2g} % of the stroke."
    )
    title = f"One stroke, {where}: measured and free run"
    rows = small_multiples([charts], 1, width=PAGE)
    return of_traces(rows, title, caption, analysis, [trace], columns=("t", "displacement", "model")), trace


def slopes_of(analyses: Sequence[Analysis], methods: Iterable[str]) -> dict[float, tuple[float, float]]:
    """Of a muscle that is bent, where K of one of the methods is the slope: contraction [m] and the force there [N], by
    pressure [Pa]; empty of a straight one.
    """
    found = {}
    for form in _forms(analyses, methods):
        for one in mappings(form.get("K_at")):
            P, x, F = (one.get(name) for name in ("pressure", "contraction", "force"))
            if is_number(P) and is_number(x) and is_number(F) and isfinite(P * x * F) and x > 0:
                found[float(P)] = float(x), float(F)
    return found


def _forms(analyses: Sequence[Analysis], methods: Iterable[str]) -> Iterable[Mapping[str, object]]:
    known = {*methods}
    for analysis in analyses:
        form = analysis.facts.get("form")
        if isinstance(form, Mapping) and any(e.symbol == "K" and e.method in known for e in analysis.estimates):
            yield form


@dataclass(frozen=True, eq=False)
class Bend:
    """What a fitted muscle pulls more than F_ce - K x [N], shape (pressures, contractions)."""

    P: Array
    """Pressures [Pa], rising."""
    x: Array
    """Contractions [m], rising."""
    force: Array

    def at(self, P: float) -> Array:
        """Its force [N] over `x` at a pressure [Pa]: on straight lines between those tested, and held beyond."""
        return np.array([np.interp(P, self.P, column) for column in self.force.T])


def bend_of(analyses: Sequence[Analysis], methods: Iterable[str]) -> Bend | None:
    """The bend that belongs to K of one of the methods; None of a straight muscle, or where its record is damaged."""
    for form in _forms(analyses, methods):
        known = form.get("bend")
        try:
            P, x, force = (np.asarray(known[name], dtype=np.float64) for name in ("pressure", "contraction", "force"))  # type: ignore[index]
        except (KeyError, TypeError, ValueError):
            continue
        sound = force.ndim == 2 and force.shape == (P.size, x.size) and min(force.shape) > 0
        if sound and np.isfinite(force).all() and np.all(np.diff(P) > 0) and np.all(np.diff(x) > 0):
            return Bend(P, x, force)
    return None
