"""One fit over all trials with chosen forms of the coefficients over pressure (option `forms`).

Forms: `constant`, `line`, `polynomial N`, `polynomial` (order chosen from the data), `polygon` (straight lines between
pressures).

    F_L = F_ce(P) - K(P) x - B(P) x' - F_c sign(x'),   B = B_c contracting, B_r relaxing

as in `pooled`, each coefficient in its form.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import sqrt
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import sentences
from pmabench.base.errors import UsageError, did_you_mean
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.intervals import Pooled, Trust
from pmabench.kinds.contraction_relaxation.pooled import (
    SYMBOLS,
    Fit,
    Powers,
    above,
    rms_of,
    solve,
    without_each,
)
from pmabench.kinds.contraction_relaxation.segments import Campaign, Segments
from pmabench.kinds.contraction_relaxation.values import QUANTITY, Further, Solution, aicc, name_of, values
from pmabench.store.analyses.results import Curve, Estimate, Finding
from pmabench.store.records import Array

MOST_ORDER = 6
"""Highest order of a polynomial."""
WORDS = {"polygon": None, "constant": 0, "line": 1, "polynomial": -1}
"""Form -> order; -1 where the order is chosen, None for straight lines between pressures."""
_FORM = re.compile(r"(constant|line|polygon|polynomial)(?:[ :-]([0-9]+))?")


def check(options: Mapping[str, Any]) -> None:
    """Raise UsageError for an unknown form in the options of the reduction."""
    asked(options.get("forms", ()))


def asked(texts: Sequence[str]) -> dict[str, str]:
    """Symbol -> form of `SYMBOL=FORM` texts; raises UsageError for an invalid one."""
    found: dict[str, str] = {}
    for text in texts:
        symbol, _, form = (part.strip() for part in text.partition("="))
        if symbol not in SYMBOLS:
            raise UsageError(f"{symbol[:40]!r} has no form over pressure{did_you_mean(symbol, SYMBOLS)}")
        match = _FORM.fullmatch(form)
        if match is None or (match[2] and match[1] != "polynomial") or int(match[2] or 0) > MOST_ORDER:
            forms = f"constant, line, polygon, polynomial, or polynomial N with N up to {MOST_ORDER}"
            raise UsageError(f"{symbol} = {form[:40]!r} is no form over pressure: {forms}")
        if symbol in found:
            raise UsageError(f"{symbol} has two forms: give one")
        found[symbol] = form
    return found


def order_of(form: str) -> int | None:
    """Order of a requested form; see `WORDS`."""
    word, _, order = form.replace("-", " ").replace(":", " ").partition(" ")
    return int(order) if order else WORDS[word]


def forms_of(orders: Mapping[str, int | None], knots: Array) -> dict[str, Powers]:
    """The forms of those of `SYMBOLS` that have an order; z is 0 in the middle of the knots [Pa]."""
    centre, scale = float(np.mean(knots)), float(np.ptp(knots)) / 2 or 1.0
    return {s: Powers(order, centre, scale) for s in SYMBOLS if (order := orders.get(s)) is not None}


FALL = 6.0
"""Fall of the corrected Akaike criterion from which on a higher order is taken, if the held-out error falls, too; lower
orders then have considerably less support (Burnham and Anderson, Model Selection, 2.6).
"""
Score = dict[str, float]
"""Scores of an order: `aicc`, corrected Akaike criterion; `held_out`, rms prediction error of left-out trials [N]."""


def choose(
    segments: Segments, orders: Mapping[str, int | None], knots: Array, noise: float
) -> tuple[dict[str, int | None], dict[str, dict[int, Score]]]:
    """Orders with a number in place of each -1, and the scores of all orders of each symbol with the others as chosen.

    From the constant up, a higher order is taken where both scores fall, one symbol after the other, until none
    changes. The others start at the highest order, so that their misfit does not raise the order of this one.
    """
    open_ones = [symbol for symbol, order in orders.items() if order == -1]
    most = min(MOST_ORDER, len(knots) - 1)
    now = {symbol: most if order == -1 else order for symbol, order in orders.items()}
    scores: dict[str, dict[int, Score]] = {}
    for _ in range(len(open_ones) + 1):
        before = dict(now)
        for symbol in open_ones:
            scores[symbol] = _scores(segments, now, symbol, most, knots, noise)
            best = 0
            for order, score in scores[symbol].items():
                than = scores[symbol][best]
                if score["aicc"] < than["aicc"] - FALL and score["held_out"] < than["held_out"]:
                    best = order
            now[symbol] = best
        if now == before:
            break
    return now, scores


def _scores(
    segments: Segments, orders: Mapping[str, int | None], symbol: str, most: int, knots: Array, noise: float,
) -> dict[int, Score]:  # fmt: skip
    """The scores of orders 0 to `most` of one symbol; trials are left out through their normal equations."""
    forms = forms_of({**orders, symbol: most}, knots)
    highest = solve(segments, knots, noise, forms)
    prior, begin = highest.prior(segments, noise), highest.columns(symbol).start
    trials = [segments.trial == trial for trial in np.unique(segments.trial)]
    found = {}
    for order in range(most + 1):
        kept = np.delete(np.arange(len(highest.theta)), slice(begin + order + 1, begin + most + 1))
        design, weak = highest.design[:, kept], prior[:, kept]
        n, p = len(segments), len(kept) + 1
        (_, theta), *others = without_each(design, segments.force, weak, [np.zeros(n, bool), *trials])
        power = float(np.sum((segments.force - design @ theta) ** 2))
        left_out = zip(trials, others, strict=True)
        missed = sum(float(np.sum((segments.force[mine] - design[mine] @ one) ** 2)) for mine, (_, one) in left_out)
        found[order] = {"aicc": aicc(max(power, 1e-300) / n, n, p), "held_out": sqrt(missed / n)}
    return found


METHOD = "joint"
BELOW = 0.05
"""Range of the forms below the lowest tested pressure, as a share of it."""
ADEQUATE = 1.1
"""Ratio to the residual of straight lines between pressures from which on a form is too simple."""
SIMPLE = "a form is too simple: its interval does not hold that"
TOGETHER = 0.95
"""Correlation of two coefficients from which on it is reported."""
STRAIGHT = "straight lines between pressures"


def compare(campaign: Campaign, pooled: Pooled, options: Mapping[str, Any]) -> Further:
    """The joint fit if `options` has forms, {"forms": ["K=line", ...]}; else an empty `Further`.

    Raises UsageError for an unknown form.
    """
    wanted = {symbol: order_of(form) for symbol, form in asked(options.get("forms") or ()).items()}
    if not wanted:
        return Further()
    least = (1 - BELOW) * campaign.tested[0]
    rows = above(pooled.segments, least)
    segments, noise = pooled.segments.where(rows), rms_of(pooled.noise[rows])
    knots = pooled.fit.knots[pooled.fit.knots >= least]
    if len(knots) < 2:
        text = (
            f"no joint fit: one pressure, {show(campaign.tested[0], 'pressure')}, has no form over pressure: test two"
        )
        return Further(findings=(Finding("doubt", text),))
    orders, scores = choose(segments, {s: wanted.get(s) for s in SYMBOLS}, knots, noise)
    solved = replace(solve(segments, knots, noise, forms_of(orders, knots)), added=pooled.fit.added, least=least)
    trust = pooled.trust_of(solved, rows, pooled.noise[rows])
    note = sentences(_forms(solved), "" if _enough(solved, pooled) else SIMPLE)
    stiffness_is = pooled.diagnosis.stiffness_is
    estimates = values(Solution(campaign, segments, solved, pooled.fit.knots, trust, METHOD, note, stiffness_is))
    known = [e for e in estimates if e.value is not None]
    curved = [s for s in solved.forms if sum(e.symbol == s for e in known) > 1]
    correlation = _correlation(solved, trust, known)
    return Further(
        tuple(estimates),
        tuple(_curve(solved, trust, symbol, known) for symbol in curved),
        (_adequacy(solved, pooled), *_together(correlation, known)),
        {
            "forms": {s: solved.forms[s].name if s in solved.forms else STRAIGHT for s in SYMBOLS},
            "orders": {
                symbol: {str(order): score for order, score in found.items()} for symbol, found in scores.items()
            },
            "residual_rms": solved.rms,
            "correlation": correlation,
        },
    )


def _forms(solved: Fit) -> str:
    """The forms in words."""
    return ", ".join(f"{s} {form.name}" for s, form in solved.forms.items()) or f"every coefficient in {STRAIGHT}"


def _curve(solved: Fit, trust: Trust, symbol: str, known: Sequence[Estimate]) -> Curve:
    """The form of one symbol with its terms; no points scatter about it, since it is the fit: r2 1, residual 0."""
    form = solved.forms[symbol]
    mine = [e for e in known if e.symbol == symbol]
    trials = tuple(dict.fromkeys(trial for e in mine for trial in e.trials))
    first = solved.columns(symbol).start
    terms = []
    for power in range(form.order + 1):
        combination = np.zeros(len(solved.theta))
        combination[first + power] = 1.0
        parts, bias, budget = trust.budget(combination)
        terms.append(
            Estimate(
                symbol, float(solved.theta[first + power]) - bias, *QUANTITY[symbol], METHOD, {}, parts, len(trials),
                bias, True, "", trials, f"z^{power}", budget,
            )
        )  # fmt: skip
    ends = [e.at["pressure"] for e in mine]
    return Curve(
        symbol, f"order {form.order} in z", tuple(terms), "pressure", (min(ends), max(ends)), 1.0, 0.0, METHOD,
        form.centre, form.scale,
    )  # fmt: skip


def _enough(solved: Fit, pooled: Pooled) -> bool:
    return solved.rms <= ADEQUATE * pooled.fit.rms


def _adequacy(solved: Fit, pooled: Pooled) -> Finding:
    """Whether the residual is larger than that of straight lines between pressures, which tests the forms."""
    size = f"joint fit, {_forms(solved)}: residual {show(solved.rms, 'force', 2)} rms"
    comparison = f"straight lines between pressures leave {show(pooled.fit.rms, 'force', 2)}"
    noise = f"noise explains {show(pooled.expected, 'force', 2)}"
    if not _enough(solved, pooled):
        return Finding("doubt", f"{size}, {comparison}, {noise}: a form is too simple for this muscle")
    return Finding("note", f"{size}, {comparison}, {noise}: the forms are enough")


def _correlation(solved: Fit, trust: Trust, known: Sequence[Estimate]) -> dict[str, Any]:
    """Names of the coefficients and the correlation of their scatter, shape (m, m)."""
    rows = np.array([solved.row(e.symbol, e.at.get("pressure", 0.0)) for e in known])
    covariance = rows @ trust.covariance @ rows.T
    width = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    matrix: Array = covariance / np.outer(width, width)
    return {
        "of": [name_of(e.symbol, e.at.get("pressure")) for e in known],
        "matrix": [[round(float(v), 4) for v in row] for row in matrix],
    }


def _together(correlation: Mapping[str, Any], known: Sequence[Estimate]) -> list[Finding]:
    """The most correlated pair at one pressure of each two symbols, above `TOGETHER`."""
    worst: dict[tuple[str, str], tuple[float, str, str]] = {}
    for i, one in enumerate(known):
        for j in range(i):
            other, r = known[j], float(correlation["matrix"][i][j])
            if one.symbol == other.symbol or (one.at and other.at and one.at != other.at):
                continue
            pair = (other.symbol, one.symbol)
            if abs(r) > max(TOGETHER, abs(worst.get(pair, (0.0, "", ""))[0])):
                worst[pair] = (r, correlation["of"][j], correlation["of"][i])
    text = "their sum is known better than each; loads or speeds that differ more part them"
    return [
        Finding("note", f"{first} and {second} hang together (correlation {r:+.3f}): {text}")
        for r, first, second in worst.values()
    ]
