"""One fit over all trials with chosen forms of the coefficients over pressure (option `forms`).

As they are asked for: `constant`, `line`, `polynomial N`, `polynomial` (its order is chosen), `polygon`, straight lines
between pressures.

    F_L = F_ce(P) - K(P) x - B(P) x' - F_c sign(x'),   B = B_c contracting, B_r relaxing

as in `pooled`, each coefficient in its `Form`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import log, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import sentences
from pmabench.base.errors import UsageError, did_you_mean
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.intervals import Pooled, Trust
from pmabench.kinds.contraction_relaxation.pooled import (
    BEND,
    FLOOR,
    NONE,
    SYMBOLS,
    Solved,
    bent,
    carried,
    follow,
    place,
    rms_of,
    sizes_of,
    spread,
)
from pmabench.kinds.contraction_relaxation.segments import Campaign, Segments
from pmabench.kinds.contraction_relaxation.values import QUANTITY, Further, Solution, name_of, values
from pmabench.store.analyses.results import Curve, Estimate, Finding
from pmabench.store.records import Array

POLYGON = "polygon"
MOST_ORDER = 6
"""Highest order of a polynomial."""
WORDS = {"constant": 0, "line": 1, "polynomial": -1}
"""Form -> order; -1 where the order is chosen."""
_FORM = re.compile(r"(constant|line|polygon|polynomial)(?:[ :-]([0-9]+))?")


@dataclass(frozen=True, eq=False)
class Form:
    """y(P) = sum c_j f_j(P): powers of z = (P - centre) / scale from the constant up, or hat functions at `knots`."""

    size: int
    centre: float = 0.0
    scale: float = 1.0
    knots: Array | None = None
    """[Pa]; None for powers."""

    @property
    def name(self) -> str:
        """The form in words."""
        if self.knots is not None:
            return "straight lines between pressures"
        order = self.size - 1
        return ("constant", "a line")[order] if order < 2 else f"a polynomial of order {order}"

    def basis(self, P: Array) -> Array:
        """f_j at pressures P [Pa] of any shape; shape (*P.shape, size)."""
        if self.knots is None:
            return ((P[..., None] - self.centre) / self.scale) ** np.arange(self.size)
        left, share = place(P, self.knots)
        found = np.zeros((*P.shape, self.size))
        np.put_along_axis(found, left[..., None], (1 - share)[..., None], axis=-1)
        np.put_along_axis(found, left[..., None] + 1, share[..., None], axis=-1)
        return found


def check(options: Mapping[str, Any]) -> None:
    """Raise UsageError for a form that is none among the options of the reduction."""
    asked(options.get("forms", ()))


def asked(texts: Sequence[str]) -> dict[str, str]:
    """Symbol -> form of `SYMBOL=FORM` texts; UsageError says what is wrong with one."""
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
    """Order of a form that was asked for, -1 where it is to be chosen; None for a polygon."""
    word, _, order = form.replace("-", " ").replace(":", " ").partition(" ")
    if word == POLYGON:
        return None
    return int(order) if order else WORDS[word]


def forms_of(orders: Mapping[str, int | None], knots: Array) -> dict[str, Form]:
    """A form for each of `SYMBOLS`; those without an order are polygons on `knots` [Pa]."""
    centre, scale = float(np.mean(knots)), float(np.ptp(knots)) / 2 or 1.0
    return {
        symbol: Form(len(knots), knots=knots)
        if orders.get(symbol) is None
        else Form((orders[symbol] or 0) + 1, centre, scale)
        for symbol in SYMBOLS
    }


RIDGE = 1e-12
"""Added to the normal matrix of columns of length 1: what no sample tells stays near 0."""
FALL = 6.0
"""A higher order is taken where the corrected Akaike criterion falls by more than this, and the held-out error, too:
lower ones have considerably less support then (Burnham and Anderson, Model Selection, 2.6)."""


@dataclass(frozen=True, eq=False)
class Joint(Solved):
    """`theta` holds the terms of each form in the order of `SYMBOLS`, then F_c [N]."""

    forms: Mapping[str, Form]
    least: float
    """Pressure [Pa] above which the forms hold: segments below are left out."""
    added: Array
    """Knots [Pa] of polygons that were put where a residual asked for one."""

    def columns(self, symbol: str) -> slice:
        """See `Solved`."""
        sizes = [*(self.forms[name].size for name in SYMBOLS), 1]
        place = (*SYMBOLS, symbol).index(symbol)
        start = sum(sizes[:place])
        return slice(start, start + sizes[place])

    def row(self, symbol: str, P: float) -> Array:
        """See `Solved`."""
        found = np.zeros(len(self.theta))
        found[self.columns(symbol)] = self.forms[symbol].basis(np.array(P)) if symbol in SYMBOLS else 1.0
        return found

    def values(self, symbol: str, P: Array) -> Array:
        """See `Solved`."""
        return np.asarray(self.forms[symbol].basis(P) @ self.theta[self.columns(symbol)])

    def again(self, segments: Segments, noise: float) -> Joint:
        """See `Solved`."""
        return solve(segments.where(above(segments, self.least)), self.forms, noise, self.least, self.added)

    def followed(self, gain: float, offset: float) -> Joint:
        """See `Solved`."""
        there = follow(self.added, gain, offset)
        forms = {
            symbol: form if form.knots is None else replace(form, knots=carried(form.knots, self.added, there))
            for symbol, form in self.forms.items()
        }
        return replace(self, forms=forms, added=there)

    def bends(self, segments: Segments, noise: float) -> Array:
        """0: what a form leaves shows in the residual, against that of straight lines between pressures."""
        return np.zeros(len(self.theta))


def above(segments: Segments, least: float) -> NDArray[np.bool_]:
    """Which segments lie above a pressure [Pa], shape (n,)."""
    return np.asarray(segments.P.min(axis=1) >= least)


def solve(
    segments: Segments, forms: Mapping[str, Form], noise: float, least: float = 0.0, added: Array = NONE
) -> Joint:
    """Least squares, with the weak prior of `pooled` for polygons; `noise` [N] is what a residual should have."""
    design = np.hstack(_design(segments, forms))
    friction = bool((segments.way > 0).any() and (segments.way < 0).any())
    if not friction:
        design[:, sum(form.size for form in forms.values())] = 0.0
    inverse, theta = _solved(design.T @ design + _prior(segments, forms, noise), design.T @ segments.force)
    return Joint(theta, inverse, design, segments.force - design @ theta, friction, forms, least, added)


def _prior(segments: Segments, forms: Mapping[str, Form], noise: float) -> Array:
    """Normal matrix that draws each knot of a polygon weakly to the line between its neighbours; shape (p, p)."""
    p = sum(form.size for form in forms.values()) + 1
    prior, start = np.zeros((p, p)), 0
    sizes = sizes_of(segments)
    noise = max(noise, FLOOR * sizes[0])
    for form, size in zip(forms.values(), sizes, strict=True):
        if form.knots is not None and form.size > 2:
            mine = slice(start, start + form.size)
            rows = bent(form.knots) * (noise / (BEND * size))
            prior[mine, mine] = rows.T @ rows + np.eye(form.size) * (noise / (1e3 * size)) ** 2
        start += form.size
    return prior


def _solved(normal: Array, right: Array) -> tuple[Array, Array]:
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    unit = normal / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
    inverse = np.linalg.inv(unit) / np.outer(scale, scale)
    return inverse, inverse @ right


def _design(segments: Segments, forms: Mapping[str, Form]) -> list[Array]:
    """Regressors, a block for each symbol and one for F_c; shape (n, size) each."""
    weights = np.broadcast_to(segments.weights, segments.P.shape)
    speed = segments.v / segments.v.shape[1]
    contracting = segments.way[:, None] > 0
    return [
        _sums(segments.P, weights, forms["F_ce"]),
        -_sums(segments.P, weights * segments.x, forms["K"]),
        -np.where(contracting, _sums(segments.P_mid, speed, forms["B_c"]), 0.0),
        -np.where(contracting, 0.0, _sums(segments.P_mid, speed, forms["B_r"])),
        -segments.way[:, None],
    ]


def _sums(P: Array, by: Array, form: Form) -> Array:
    """Sums over the second axis of the form's functions at P (n, w) times `by` (n, w); shape (n, size)."""
    if form.knots is not None:
        return spread(place(P, form.knots), by, len(form.knots))
    z = (P - form.centre) / form.scale
    columns = []
    for _ in range(form.size):
        columns.append(by.sum(axis=1))
        by = by * z
    return np.column_stack(columns)


Score = dict[str, float]
"""How well an order does: `aicc`, corrected Akaike criterion, and `held_out`, what trials are missed by that were left
out, rms [N]."""


def choose(
    segments: Segments, orders: Mapping[str, int | None], knots: Array, noise: float
) -> tuple[dict[str, int | None], dict[str, dict[int, Score]]]:
    """Orders with a number in place of each -1, and the scores of the orders of each symbol, the others as chosen.

    From the constant up, a higher order is taken where both scores fall; symbols in turn, until none changes. At first
    the others have the highest order: what one is short of, another does not make up for.
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
    """The scores of orders 0 to `most` of one symbol; trials are left out by their normal equations."""
    forms = forms_of({**orders, symbol: most}, knots)
    blocks = _design(segments, forms)
    place = SYMBOLS.index(symbol)
    trials = [np.flatnonzero(segments.trial == trial) for trial in np.unique(segments.trial)]
    found = {}
    for order in range(most + 1):
        design = np.hstack([block[:, : order + 1] if i == place else block for i, block in enumerate(blocks)])
        lower = {**forms, symbol: replace(forms[symbol], size=order + 1)}
        normal = design.T @ design + _prior(segments, lower, noise)
        right = design.T @ segments.force
        _, theta = _solved(normal, right)
        n, p = len(segments), design.shape[1] + 1
        power = float(np.sum((segments.force - design @ theta) ** 2))
        missed = 0.0
        for rows in trials:
            mine, force = design[rows], segments.force[rows]
            _, without = _solved(normal - mine.T @ mine, right - mine.T @ force)
            missed += float(np.sum((force - mine @ without) ** 2))
        aicc = n * log(max(power, 1e-300) / n) + 2 * p + 2 * p * (p + 1) / max(1, n - p - 1)
        found[order] = {"aicc": aicc, "held_out": sqrt(missed / n)}
    return found


METHOD = "joint"
BELOW = 0.05
"""So far below the lowest tested pressure the forms reach, as a share of it."""
ADEQUATE = 1.1
"""A residual this many times that of straight lines between pressures says that a form is too simple."""
SIMPLE = "a form is too simple: its interval does not hold that"
TOGETHER = 0.95
"""Correlation from which on it is said that two coefficients hang together."""


def compare(campaign: Campaign, pooled: Pooled, options: Mapping[str, Any]) -> Further:
    """The joint fit where `options` ask for forms, {"forms": ["K=line", ...]}; else nothing.

    Raises UsageError for a form that is none.
    """
    wanted = {symbol: order_of(form) for symbol, form in asked(options.get("forms") or ()).items()}
    if not wanted:
        return Further()
    least = (1 - BELOW) * campaign.tested[0]
    rows = above(pooled.segments, least)
    segments, noise = pooled.segments.where(rows), rms_of(pooled.noise[rows])
    knots = pooled.fit.knots[pooled.fit.knots >= least]
    orders, scores = choose(segments, {s: wanted.get(s) for s in SYMBOLS}, knots, noise)
    solved = solve(segments, forms_of(orders, knots), noise, least, pooled.fit.added)
    trust = pooled.trust_of(solved, rows, pooled.noise[rows])
    note = sentences(_forms(solved.forms), "" if _enough(solved, pooled) else SIMPLE)
    stiffness_is = pooled.diagnosis.stiffness_is
    estimates = values(Solution(campaign, segments, solved, pooled.fit.knots, trust, METHOD, note, stiffness_is))
    known = [e for e in estimates if e.value is not None]
    curved = [s for s in SYMBOLS if solved.forms[s].knots is None and sum(e.symbol == s for e in known) > 1]
    return Further(
        tuple(estimates),
        tuple(_curve(solved, trust, symbol, known) for symbol in curved),
        (_adequacy(solved, pooled), *_together(solved, trust, known)),
        {
            "forms": {symbol: form.name for symbol, form in solved.forms.items()},
            "orders": {
                symbol: {str(order): score for order, score in found.items()} for symbol, found in scores.items()
            },
            "residual_rms": solved.rms,
            "correlation": _correlation(solved, trust, known),
        },
    )


def _forms(forms: Mapping[str, Form]) -> str:
    """The forms in words."""
    chosen = [f"{symbol} {form.name}" for symbol, form in forms.items() if form.knots is None]
    return ", ".join(chosen) or f"every coefficient in {next(iter(forms.values())).name}"


def _curve(solved: Joint, trust: Trust, symbol: str, known: Sequence[Estimate]) -> Curve:
    """The form of one symbol with its terms; it is the fit itself, and nothing scatters about it: r2 1, residual 0."""
    form = solved.forms[symbol]
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
                symbol, float(solved.theta[first + power]) - bias, *QUANTITY[symbol], METHOD, {}, parts, len(trials),
                bias, True, "", trials, f"z^{power}", budget,
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
    return {
        "of": [name_of(e.symbol, e.at.get("pressure")) for e in known],
        "matrix": [[round(float(v), 4) for v in row] for row in matrix],
    }


def _together(solved: Joint, trust: Trust, known: Sequence[Estimate]) -> list[Finding]:
    """Different coefficients at one pressure whose estimates are correlated, the worst pair of each kind."""
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
    text = "their sum is known better than each; loads or speeds that differ more part them"
    return [
        Finding("note", f"{first} and {second} hang together (correlation {r:+.3f}): {text}")
        for r, first, second in worst.values()
    ]
