"""The rubber's force without pressure: F_e = A eps (eps - B1)/(eps + B2) through a mean curve at 0 kPa (paper 3 eq. 8).

A, B1 and B2 can be told apart only where data come close to the pole at -B2; the curve itself is known long before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

from pmabench.analysis.results import Estimate, Finding, Parts, Trace
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.lines import mean_half
from pmabench.base.quantities import show
from pmabench.kinds.isobaric_ramp.cell import Cell
from pmabench.store.records import Array

METHOD = "rubber term"
NAMES = ("A", "B1", "B2")
KINDS: Mapping[str, tuple[str, str]] = {"A": ("N", "force"), "B1": ("1", "ratio"), "B2": ("1", "ratio")}
NORMAL = 1.96
WIDE = 0.25
"""A coefficient is not told where its interval is wider than this share of it."""
PLACES = 4
STARTS = ((0.1, 0.01), (0.2, 0.02), (0.4, 0.1), (0.9, 0.5))
"""B1, and B2 beyond the lowest contraction, from which the fit starts."""
FEWEST = 10
"""Points of the mean curve."""
SHORT = "needs a stretch that comes close to the pole at -B2, and a longer range"


@dataclass(frozen=True)
class Rubber:
    """What came out."""

    estimates: list[Estimate] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    traces: list[Trace] = field(default_factory=list)


def rubber_force(eps: Array, A: float, B1: float, B2: float) -> Array:
    """F_e [N] at contractions eps [1] (paper 3 eq. 8)."""
    from pmabench.model.library.daerden import rubber_force as model

    return model(eps, np.float64(A), np.float64(B1), np.float64(B2))  # type: ignore[arg-type]


@dataclass(frozen=True)
class Fit:
    """What least squares say."""

    terms: Array
    """A [N], B1 and B2 [1], shape (3,)."""
    rms: float
    """Of what is left [N]."""
    misfit: Array
    """Half widths that a misfit of that size makes of the terms, shape (3,)."""


def fit(eps: Array, F: Array) -> Fit:
    """Least squares of F_e(eps) = A eps (eps - B1)/(eps + B2) through forces F [N] at eps [1], shapes (n,).

    A follows linearly for each B1 and B2, so that only these are searched, from several starts; B2 beyond the lowest
    contraction, where the pole would lie inside the data. What is left of a smooth curve does not average out: the
    half widths are those of one point alone.
    """
    lowest = max(0.0, -float(eps.min()))
    size = max(float(np.max(np.abs(F))), 1e-12)

    def left(p: Array) -> Array:
        one = rubber_force(eps, 1.0, float(p[0]), float(p[1]))
        return np.asarray(one * (one @ F) / max(float(one @ one), 1e-300) - F) / size

    bounds = ([1e-3, lowest + 1e-5], [1.0, 2.0])
    tries = [
        least_squares(left, (B1, lowest + more), bounds=bounds, x_scale=(0.1, 0.02), xtol=1e-12, ftol=1e-14, gtol=1e-14)
        for B1, more in STARTS
    ]
    B1, B2 = min(tries, key=lambda one: float(one.cost)).x
    one = rubber_force(eps, 1.0, B1, B2)
    A = float(one @ F) / max(float(one @ one), 1e-300)
    terms = np.array([A, B1, B2])
    off = rubber_force(eps, A, B1, B2) - F
    rms = float(np.sqrt(np.mean(off**2)))
    jacobian = np.column_stack(
        [one, -A * eps / (eps + B2), -A * eps * (eps - B1) / (eps + B2) ** 2]
    ) * np.abs(terms)  # fmt: skip
    _, values, directions = np.linalg.svd(jacobian, full_matrices=False)
    inverse = (directions.T / np.maximum(values, 1e-12 * values[0]) ** 2) @ directions
    return Fit(terms, rms, NORMAL * rms * np.sqrt(len(eps) * np.diag(inverse)) * np.abs(terms))


def rubber(cell: Cell, scales: Scales) -> Rubber:
    """A, B1, B2 and the force along the stretch from the loops without pressure."""
    length = _length(cell)
    if length is None:
        return Rubber(findings=[Finding("note", "no rubber term: the record tells no nominal length of the specimen")])
    eps = cell.x / length
    if len(eps) < FEWEST or float(np.ptp(cell.curve)) <= 6 * max(m.loop.noise for m in cell.members):
        return Rubber(findings=[Finding("doubt", "no rubber term: the force at 0 kPa does not rise above its noise")])
    whole = fit(eps, cell.curve)
    terms, rms = whole.terms, whole.rms
    each = [[fit(eps, curve).terms for curve in member.loop.mean] for member in cell.members]
    trials = tuple(member.trial.name for member in cell.members)
    found: list[Estimate] = []
    unknown = []
    for place, name in enumerate(NAMES):
        by_trial = [np.array([one[place] for one in cycles]) for cycles in each]
        half = mean_half(np.array([float(v.mean()) for v in by_trial]), by_trial)
        value, misfit = float(terms[place]), float(whole.misfit[place])
        part = scales.part({"force": value}) if name == "A" else scales.part({"displacement": value})
        parts = Parts(half, misfit, part)
        wide = parts.combined
        if wide is None or wide > WIDE * abs(value) or _at_bound(terms, eps):
            unknown.append(name)
            how = "one loop tells no scatter" if wide is None else f"{_text(name, value)} within {_text(name, wide)}"
            found.append(
                Estimate(name, None, *KINDS[name], METHOD, n=len(trials), trials=trials,
                         note=f"not identifiable ({how}): {SHORT}")
            )  # fmt: skip
            continue
        note = "eps as a fraction of the nominal length"
        found.append(Estimate(name, value, *KINDS[name], METHOD, {}, parts, len(trials), note=note, trials=trials))
    findings = []
    reach = f"{show(rms, 'force', 2)} rms, from {100 * eps[0]:.3g} to {100 * eps[-1]:.3g} %"
    if unknown:
        named = " and ".join(unknown)
        text = f"rubber term: {named} not identifiable, it {SHORT}; the curve itself fits to {reach}"
        findings.append(Finding("doubt", text))
    else:
        findings.append(Finding("note", f"the rubber term fits the mean curve at 0 kPa to {reach}"))
    for where in np.linspace(eps[0], eps[-1], PLACES):
        curves = [np.array([float(rubber_force(where, *one)) for one in cycles]) for cycles in each]
        half = mean_half(np.array([float(v.mean()) for v in curves]), curves)
        value = float(rubber_force(where, *terms))
        parts = Parts(half, rms, scales.part({"force": value}))
        at = {"contraction": round(float(where) * length, 7)}
        found.append(Estimate("F_e", value, "N", "force", METHOD, at, parts, len(trials), trials=trials))
    trace = Trace(
        "rubber",
        "rubber",
        "Force of the rubber at 0 kPa",
        {"displacement": cell.x, "force": cell.curve, "model": rubber_force(eps, *(float(v) for v in terms))},
        {"displacement": "length", "force": "force", "model": "force"},
        dict(zip(NAMES, (float(v) for v in terms), strict=True)),
    )
    return Rubber(found, findings, [trace])


def _text(name: str, value: float) -> str:
    return show(value, KINDS[name][1], 3)


def _at_bound(terms: Array, eps: Array) -> bool:
    """Whether the search ended at the end of what it may try."""
    return bool(terms[1] > 0.999 or terms[1] < 2e-3 or terms[2] > 1.99 or terms[2] < -float(eps.min()) + 2e-5)


def _length(cell: Cell) -> float | None:
    """Nominal length of the specimen [m], as the record tells it."""
    specimen = cell.members[0].run.manifest.get("specimen")
    length = specimen.get("nominal_length") if isinstance(specimen, Mapping) else None
    return float(length) if isinstance(length, int | float) and 0 < length < 100 else None
