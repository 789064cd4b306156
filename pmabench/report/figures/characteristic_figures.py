"""Figures that bring tests together: blocked force next to free contraction, force over contraction at set pressures.

The second is the surface of force, pressure and contraction as a family of curves: what was measured, and what the
three-element model F = F_ce(P) - K(P) x makes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pmabench.plotting.pictures import Picture, bound, drawable, has, picture, spread
from pmabench.plotting.plots import FAINT, FULL, INK, PALETTE, Array, blank, few_ticks, grid, one_axes
from pmabench.plotting.wording import Frame, rounded, shown
from pmabench.report.bends import bend_of
from pmabench.report.document.tables import is_number
from pmabench.store.analyses.results import Analysis, Estimate, Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURE = "characteristic"
"""Kind of the trace of forces at set pressures and contractions."""
PRESSURES, POINTS = 6, 60
"""Most pressures of the family; points of a drawn curve."""
SAME = 1e3
"""Pressures that differ by less are one [Pa]."""
PULLS = 0.02
"""A force below this share of the largest is that of a slack muscle, and no model is drawn or compared there."""
MODELS = (
    ("measured-pressure", "steps at constant load"),
    ("isometric-sections", "a line through the same forces at each pressure"),
)
"""Where F_ce and K of the drawn model come from: method, words; the first that is there."""


def characteristic(analyses: Sequence[Analysis]) -> list[Picture]:
    """Both figures, as far as the tests give them."""
    analyses = [drawable(a) for a in analyses]
    return [*_ends(analyses), *_family(analyses)]


class _Model:
    """F_ce [N] and K [N/m] over pressure [Pa], with straight lines between tested pressures; NaN beyond them."""

    def __init__(self, analyses: Sequence[Analysis]) -> None:
        self.words, self.bend = "", None
        self.P, self.F_ce, self.K = np.empty(0), np.empty(0), np.empty(0)
        for method, words in MODELS:
            known = [by_pressure(analyses, symbol, method) for symbol in ("F_ce", "K")]
            both = sorted(set(known[0]) & set(known[1]))
            if len(both) > 1:
                self.words, self.bend = words, bend_of(analyses, (method,))
                self.P = np.array(both)
                self.F_ce, self.K = (np.array([values[P] for P in both]) for values in known)
                return

    def force(self, P: float, x: Array) -> Array:
        """Force [N] over contraction x [m], shape (n,)."""
        F_ce, K = self.at(P)
        more = np.zeros_like(x) if self.bend is None else np.interp(x, self.bend.x, self.bend.at(P))
        return np.asarray(F_ce - K * x + more)

    def at(self, P: float) -> tuple[float, float]:
        """F_ce and K at a pressure."""
        if not len(self.P):
            return float("nan"), float("nan")
        F_ce, K = (float(np.interp(P, self.P, y, left=np.nan, right=np.nan)) for y in (self.F_ce, self.K))
        return F_ce, K


def _over_pressure(analyses: Sequence[Analysis], symbol: str, method: str) -> list[Estimate]:
    found = [e for a in analyses for e in a.estimates if (e.symbol, e.method, e.coordinate) == (symbol, method, "")]
    found = [e for e in found if set(e.at) == {"pressure"} and e.value is not None]
    return sorted(found, key=lambda e: e.at["pressure"])


def by_pressure(analyses: Sequence[Analysis], symbol: str, method: str) -> dict[float, float]:
    """Values of a symbol by one method [SI] over the pressure alone [Pa]."""
    return {e.at["pressure"]: e.value or 0.0 for e in _over_pressure(analyses, symbol, method)}


def _points(estimates: Sequence[Estimate]) -> tuple[Array, Array, Array]:
    P = np.array([e.at["pressure"] for e in estimates])
    return P, np.array([e.value or 0.0 for e in estimates]), np.array([e.parts.combined or 0.0 for e in estimates])


def _nominal(analyses: Sequence[Analysis]) -> float:
    """Nominal length [m] as free contraction has it, else as isometric tests do; NaN where neither has it."""
    for a in analyses:
        own, specimen = a.facts.get("nominal_length"), a.facts.get("specimen")
        value = specimen.get("nominal_length") if own is None and isinstance(specimen, dict) else own
        if is_number(value) and value > 0:
            return float(value)
    return float("nan")


def _ends(analyses: Sequence[Analysis]) -> list[Picture]:
    """Both ends of what a muscle can do: force without contraction, contraction without force; over pressure."""
    F_b = _over_pressure(analyses, "F_b", "blocked")
    L = _over_pressure(analyses, "L", "free-length")
    nominal = _nominal(analyses)
    if not F_b or not L or not np.isfinite(nominal):
        return []
    model = _Model(analyses)
    P_F, F, half_F = _points(F_b)
    P_x, length, half_x = _points(L)
    x = nominal - length
    through = np.linspace(model.P[0], model.P[-1], POINTS) if len(model.P) else np.empty(0)
    both = np.array([model.at(float(P)) for P in through]).reshape(-1, 2)
    free = np.where(both[:, 1] > 0, np.maximum(both[:, 0], 0.0) / np.where(both[:, 1] > 0, both[:, 1], 1.0), np.nan)
    kPa, mm = shown("pressure"), shown("length")
    line_words = f" Lines: F_ce and F_ce/K of {model.words}." if model.words else ""
    caption = (
        "Left: force at the nominal length, no contraction allowed. Right: contraction without load, in mm and as a "
        f"share of the nominal length of {nominal / mm.scale:.4g} mm. Marks with 95 % intervals.{line_words}"
    )
    alt = (
        f"Blocked force over pressure, up to {F.max():.4g} N at {P_F[int(np.argmax(F))] / kPa.scale:.4g} kPa, next to "
        f"free contraction over pressure, up to {x.max() / mm.scale:.4g} mm ({100 * x.max() / nominal:.3g} % of the "
        f"nominal length) at {P_x[int(np.argmax(x))] / kPa.scale:.4g} kPa."
    )
    rows = []
    for P in sorted({*P_F, *P_x}):
        i, j = np.flatnonzero(P_F == P), np.flatnonzero(P_x == P)
        rows.append(
            {
                "P [kPa]": f"{P / kPa.scale:g}",
                "blocked force F_b [N]": rounded(F[i[0]], half_F[i[0]] or None) if len(i) else "",
                "free contraction [mm]": rounded(x[j[0]] / mm.scale, half_x[j[0]] / mm.scale or None) if len(j) else "",
                "free contraction [%]": _number(100 * x[j[0]] / nominal, ".2f") if len(j) else "",
            }
        )
    left = (P_F / kPa.scale, F, half_F, through / kPa.scale, both[:, 0])
    right = (P_x / kPa.scale, x / mm.scale, half_x / mm.scale, through / kPa.scale, free / mm.scale)
    draw = bound(_draw_ends, left, right, nominal / mm.scale)
    simulated = any(a.simulated for a in analyses)
    title = "Blocked force and free contraction"
    return [picture(draw, title, caption, alt, Frame(rows), wide=True, simulated=simulated)]


Side = tuple[Array, Array, Array, Array, Array]


def _draw_ends(left: Side, right: Side, nominal: float) -> Figure:
    figure = blank(FULL, 2.6)
    cells = grid(figure, 1, 2, left=0.6, right=0.62, across=0.85)
    heads = ("blocked force F_b [N]", "free contraction x [mm]")
    for i, (P, y, half, through, model) in enumerate((left, right)):
        axes = figure.add_subplot(cells[i])
        axes.plot(through, model, color=FAINT, linewidth=1.6, zorder=1)
        axes.errorbar(P, y, yerr=half, fmt="o", color=PALETTE[i], markersize=3.8, elinewidth=0.9, linewidth=0)
        axes.set(xlabel="P [kPa]", ylabel=heads[i])
        few_ticks(axes)
        if i:
            axes.secondary_yaxis("right", functions=_scaled(100 / nominal)).set_ylabel("[%] of the nominal length")
    return figure


def _scaled(factor: float) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """To a second axis and back."""
    return lambda value: factor * value, lambda value: value / factor


def _family(analyses: Sequence[Analysis]) -> list[Picture]:
    """Force over contraction at set pressures: what was measured at rest and along slow ramps, and the model."""
    held = [t for a in analyses for t in a.traces if t.figure == FIGURE and has(t, "pressure", "displacement", "force")]
    slow = [t for a in analyses for t in a.traces if t.figure == "mean-curve" and has(t, "displacement", "force")]
    slow = [t for t in slow if t.marks.get("pressure", 0.0) > SAME]
    most = max((float(np.nanmax(t.columns["force"])) for t in [*held, *slow]), default=0.0)
    measured = {
        P: np.array([row for t in held for row in _rows(t, P) if row[1] > PULLS * most]).reshape(-1, 2)
        for P in sorted({round(float(P), -1) for t in held for P in t.columns["pressure"]})
    }
    every = [P for P, marks in measured.items() if len(marks) > 1]
    if len(every) < 2:
        return []
    chosen = _chosen(every, [t.marks["pressure"] for t in slow])
    model, nominal = _Model(analyses), _nominal(analyses)
    free = [(e.at["pressure"], nominal - (e.value or 0.0)) for e in _over_pressure(analyses, "L", "free-length")]
    levels, rows, off = list[Level](), list[dict[str, str]](), list[float]()
    for P in chosen:
        marks = measured[P][np.argsort(measured[P][:, 0], kind="stable")]
        mine = [t for t in slow if abs(t.marks["pressure"] - P) < SAME]
        ramps = [np.column_stack([t.columns["displacement"], t.columns["force"]]) for t in mine]
        zero = np.array([x for at, x in free if abs(at - P) < SAME and x > 0])
        ends = [float(v) for v in (*marks[:, 0], *zero, *(ramp[-1, 0] for ramp in ramps))]
        F_ce, K = model.at(P)
        line = np.empty((0, 2))
        if np.isfinite(F_ce) and K > 0 and F_ce > 0:
            x = np.linspace(min(0.0, *ends), min(F_ce / K, max(ends)), POINTS)
            line = np.column_stack([x, model.force(P, x)])
        levels.append((P, marks, ramps, zero, line))
        for x_one, F_one in marks:
            F_model = float(model.force(P, np.array([x_one]))[0])
            known = np.isfinite(F_model) and F_model > 0
            off += [F_one - F_model] if known else []
            numbers = {"P [kPa]": (P / 1e3, "g"), "x [mm]": (x_one * 1e3, ".2f")}
            numbers |= {"eps [%]": (100 * x_one / nominal, ".2f"), "F measured [N]": (F_one, ".1f")}
            numbers["F model [N]"] = (F_model if known else np.nan, ".1f")
            numbers["difference [N]"] = (F_one - F_model if known else np.nan, ".2f")
            rows.append({head: _number(value, form) for head, (value, form) in numbers.items()})
    caption = "Circles: isometric tests, held at one length (mean of filling and emptying), where the muscle pulls."
    caption += " Dashed: mean curves of slow isobaric ramps." if slow else ""
    caption += " Diamonds: free contraction, no load." if any(len(level[3]) for level in levels) else ""
    rms = float(np.sqrt(np.mean(np.square(off)))) if off else 0.0
    if off:
        form = "F_ce(P) − K(P) x" if model.bend is None else "F_ce(P) − K(P) x + F_bend(P, x)"
        caption += f" Lines: F = {form} of {model.words}; the circles lie {rms:.2g} N rms off them."
    some = f" {len(chosen)} of {len(every)} pressures are shown." if len(chosen) < len(every) else ""
    alt = (
        f"Force over contraction at {', '.join(f'{P / 1e3:g}' for P in chosen)} kPa: forces fall from "
        f"{most:.4g} N with rising contraction" + (f"; the model is off by {rms:.2g} N rms." if off else ".")
    )
    table = Frame(rows).filled()
    draw = bound(_draw_family, levels, nominal)
    simulated = any(a.simulated for a in analyses)
    title = "Force, pressure and contraction"
    return [picture(draw, title, caption + some, alt, table, wide=True, simulated=simulated)]


def _number(value: float, form: str) -> str:
    """A number with a real minus sign, and none before 0; empty where there is none."""
    if not np.isfinite(value):
        return ""
    text = f"{value:{form}}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−")


def _chosen(every: Sequence[float], wanted: Sequence[float]) -> list[float]:
    """At most `PRESSURES` of them, the highest among them, those of the ramps first, the rest evenly spread."""
    kept = sorted({P for P in every if any(abs(P - other) < SAME for other in wanted)} | {every[-1]})
    kept = spread(kept, PRESSURES)
    while len(kept) < min(PRESSURES, len(every)):
        kept.append(max([P for P in every if P not in kept], key=lambda P: min(abs(P - other) for other in kept)))
    return sorted(kept)


def _rows(trace: Trace, P: float) -> list[tuple[float, float]]:
    near = np.abs(trace.columns["pressure"] - P) < SAME
    return list(zip(trace.columns["displacement"][near], trace.columns["force"][near], strict=True))


Level = tuple[float, Array, list[Array], Array, Array]


def _draw_family(levels: Sequence[Level], nominal: float) -> Figure:
    """A colour for each pressure, named at the right end."""
    figure, axes = one_axes(FULL, 3.6, left=0.6, right=0.75, top=0.5)
    for i, (P, marks, ramps, zero, line) in enumerate(levels):
        color = PALETTE[i % len(PALETTE)]
        axes.plot(1e3 * line[:, 0], line[:, 1], color=color, linewidth=1.0, zorder=1)
        for ramp in ramps:
            axes.plot(1e3 * ramp[:, 0], ramp[:, 1], color=INK, linewidth=1.0, linestyle=(0, (3, 2)), zorder=2)
        x, F = 1e3 * marks[:, 0], marks[:, 1]
        axes.plot(x, F, "o", color=color, markersize=4, zorder=3, label=f"P = {P / 1e3:g} kPa")
        axes.plot(1e3 * zero, np.zeros(len(zero)), "D", color=color, markerfacecolor="white", markersize=4.2,
                  markeredgewidth=1.0, zorder=4, clip_on=False)  # fmt: skip
    axes.axhline(0, color=FAINT, linewidth=0.8, zorder=0)
    axes.set(xlabel="contraction x [mm]", ylabel="force F [N]")
    few_ticks(axes, x=8)
    if np.isfinite(nominal):
        axes.secondary_xaxis("top", functions=_scaled(0.1 / nominal)).set_xlabel("ε [%]", labelpad=2)
    axes.legend(loc="upper right", handletextpad=0.3)
    return figure
