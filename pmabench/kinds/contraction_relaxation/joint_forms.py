"""Contraction runs with chosen forms over pressure, beside straight lines between pressures; where options ask."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from pmabench.analysis.results import Curve, Estimate, Finding
from pmabench.analysis.shared.calibration import sentences
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.forms import Form, asked, forms_of, order_of
from pmabench.kinds.contraction_relaxation.intervals import Pooled, Trust
from pmabench.kinds.contraction_relaxation.joint_fit import Joint, above, choose, solve
from pmabench.kinds.contraction_relaxation.pooled import SYMBOLS, rms_of
from pmabench.kinds.contraction_relaxation.trials import Campaign
from pmabench.kinds.contraction_relaxation.values import QUANTITY, Told, values
from pmabench.store.records import Array

METHOD = "joint"
BELOW = 0.05
"""So far below the lowest tested pressure the forms reach, as a share of it."""
ADEQUATE = 1.1
"""A residual this many times that of straight lines between pressures says that a form is too simple."""
SIMPLE = "a form is too simple: its interval does not hold that"
TOGETHER = 0.95
"""Correlation from which on it is said that two coefficients hang together."""


@dataclass(frozen=True)
class Beside:
    """What stands beside the primary method."""

    estimates: tuple[Estimate, ...] = ()
    curves: tuple[Curve, ...] = ()
    findings: tuple[Finding, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)


def compare(campaign: Campaign, pooled: Pooled, options: Mapping[str, Any]) -> Beside:
    """The joint fit where `options` ask for forms, {"forms": ["K=line", ...]}; else nothing.

    Raises UsageError for a form that is none.
    """
    wanted = {symbol: order_of(form) for symbol, form in asked(options.get("forms") or ()).items()}
    if not wanted:
        return Beside()
    least = (1 - BELOW) * campaign.tested[0]
    rows = above(pooled.segments, least)
    segments, noise = pooled.segments.where(rows), rms_of(pooled.noise[rows])
    knots = pooled.fit.knots[pooled.fit.knots >= least]
    orders, scores = choose(segments, {s: wanted.get(s) for s in SYMBOLS}, knots, noise)
    solved = solve(segments, forms_of(orders, knots), noise, least, pooled.fit.added)
    trust = pooled.trust_of(solved, rows, pooled.noise[rows])
    note = sentences(_forms(solved.forms), "" if _enough(solved, pooled) else SIMPLE)
    estimates = values(Told(campaign, segments, solved, pooled.fit.knots, trust, METHOD, note))
    known = [e for e in estimates if e.value is not None]
    return Beside(
        tuple(estimates),
        tuple(_curve(solved, trust, symbol, known) for symbol in SYMBOLS if _has_curve(solved, symbol, known)),
        (_adequacy(solved, pooled), *_together(solved, trust, known)),
        {
            "forms": {symbol: form.name for symbol, form in solved.forms.items()},
            "orders": {
                symbol: {str(order): asdict(score) for order, score in found.items()}
                for symbol, found in scores.items()
            },
            "residual_rms": solved.rms,
            "correlation": _correlation(solved, trust, known),
        },
    )


def _forms(forms: Mapping[str, Form]) -> str:
    """The forms in words."""
    chosen = [f"{symbol} {form.name}" for symbol, form in forms.items() if form.knots is None]
    return ", ".join(chosen) or f"every coefficient in {next(iter(forms.values())).name}"


def _has_curve(solved: Joint, symbol: str, known: Sequence[Estimate]) -> bool:
    return solved.forms[symbol].knots is None and sum(e.symbol == symbol for e in known) > 1


def _curve(solved: Joint, trust: Trust, symbol: str, known: Sequence[Estimate]) -> Curve:
    """The form of one symbol with its terms; it is the fit itself, and nothing scatters about it: r2 1, residual 0."""
    form, (unit, quantity) = solved.forms[symbol], QUANTITY[symbol]
    mine = [e for e in known if e.symbol == symbol]
    trials = tuple(dict.fromkeys(trial for e in mine for trial in e.trials))
    first = solved.columns(symbol).start
    terms = []
    for power in range(form.size):
        combination = np.zeros(len(solved.theta))
        combination[first + power] = 1.0
        parts, bias, budget = trust.budget(combination)
        terms.append(
            Estimate(
                symbol, float(solved.theta[first + power]) - bias, unit, quantity, METHOD, {}, parts, len(trials), bias,
                True, "", trials, f"z^{power}", budget,
            )
        )  # fmt: skip
    ends = [e.at["pressure"] for e in mine]
    return Curve(
        symbol, f"order {form.size - 1} in z", tuple(terms), "pressure", (min(ends), max(ends)), 1.0, 0.0, METHOD,
        form.centre, form.scale,
    )  # fmt: skip


def _enough(solved: Joint, pooled: Pooled) -> bool:
    return solved.rms <= ADEQUATE * pooled.fit.rms


def _adequacy(solved: Joint, pooled: Pooled) -> Finding:
    """Whether the forms leave more than straight lines between pressures do: the residual is the test of a form."""
    size = f"joint fit, {_forms(solved.forms)}: residual {show(solved.rms, 'force', 2)} rms"
    comparison = f"straight lines between pressures leave {show(pooled.fit.rms, 'force', 2)}"
    noise = f"noise explains {show(pooled.expected, 'force', 2)}"
    if not _enough(solved, pooled):
        return Finding("doubt", f"{size}, {comparison}, {noise}: a form is too simple for this muscle")
    return Finding("note", f"{size}, {comparison}, {noise}: the forms are enough")


def _correlation(solved: Joint, trust: Trust, known: Sequence[Estimate]) -> dict[str, Any]:
    """Names of the coefficients and the correlation of their scatter, shape (m, m)."""
    rows = np.array([solved.row(e.symbol, e.at.get("pressure", 0.0)) for e in known])
    covariance = rows @ trust.covariance @ rows.T
    width = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    matrix: Array = covariance / np.outer(width, width)
    return {"of": [_name(e) for e in known], "matrix": [[round(float(v), 4) for v in row] for row in matrix]}


def _name(estimate: Estimate) -> str:
    at = estimate.at.get("pressure")
    return estimate.symbol if at is None else f"{estimate.symbol} at {show(at, 'pressure', 4)}"


def _together(solved: Joint, trust: Trust, known: Sequence[Estimate]) -> list[Finding]:
    """Different coefficients at one pressure that cannot be told apart well, the worst pair of each kind."""
    correlation = _correlation(solved, trust, known)
    worst: dict[tuple[str, str], tuple[float, str, str]] = {}
    for i, one in enumerate(known):
        for j in range(i):
            other, r = known[j], float(correlation["matrix"][i][j])
            if one.symbol == other.symbol or (one.at and other.at and one.at != other.at):
                continue
            pair = (other.symbol, one.symbol)
            if abs(r) > max(TOGETHER, abs(worst.get(pair, (0.0, "", ""))[0])):
                worst[pair] = (r, correlation["of"][j], correlation["of"][i])
    return [
        Finding(
            "note",
            f"{first} and {second} hang together (correlation {r:+.3f}): their sum is known better than each;"
            " loads or speeds that differ more part them",
        )
        for r, first, second in worst.values()
    ]
