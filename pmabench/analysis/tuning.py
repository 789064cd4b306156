"""Controller settings from an ultimate gain and period by tuning rules, and plausibility of these two.

Paper 0 prints 2.195 and 3 for the PI settings of K_u = 7.1 and T_u = 9 s; its own table gives 3.195 and 7.5 s.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import isfinite, sqrt
from typing import Any

from pmabench.base.errors import did_you_mean
from pmabench.model.loop import Controller, Loop, Margins, margins, ultimate
from pmabench.model.rules import Rule, all_rules
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts

FOLLOWING: dict[str, tuple[tuple[str, str], tuple[str, str]]] = {
    "Pa/m": (("Pa/(m.s)", "integral gain"), ("Pa.s/m", "derivative gain"))
}
"""Unit of K_p -> units and quantities of K_i and K_d."""


@dataclass(frozen=True)
class Gains:
    """Settings of one rule: the ideal form K_p, T_i, T_d, and the parallel form K_i = K_p/T_i, K_d = K_p T_d."""

    rule: Rule
    K_p: Estimate
    T_i: Estimate | None = None
    T_d: Estimate | None = None
    K_i: Estimate | None = None
    K_d: Estimate | None = None
    margins: Margins | None = None
    """Stability margins; None without a model of the loop."""

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates of all settings of the rule."""
        return tuple(e for e in (self.K_p, self.T_i, self.T_d, self.K_i, self.K_d) if e is not None)

    def to_dict(self) -> dict[str, Any]:
        """Plain data; infinite margins as None."""
        found = {} if self.margins is None else asdict(self.margins)
        return {
            "rule": self.rule.title,
            **{name: getattr(self.rule, name) for name in ("name", "form", "source")},
            "gains": {e.symbol: e.to_dict() for e in self.estimates},
            "margins": {name: value if isfinite(value) else None for name, value in found.items()} or None,
        }


def rules_named(text: str) -> tuple[Rule, ...]:
    """Rules whose name, form or title is `text`, ignoring case; raises ValueError with the nearest name."""
    every = all_rules()
    wanted = text.casefold().replace("_", "-")
    chosen = tuple(r for r in every if wanted in (r.name.casefold(), r.form.casefold(), r.title.casefold()))
    if not chosen:
        names = {name for r in every for name in (r.name, r.title)}
        raise ValueError(f"no tuning rule {text!r}{did_you_mean(text, names)}")
    return chosen


def tune(
    K_u: Estimate, T_u: Estimate, rules: Iterable[Rule] | None = None, loop: Loop | None = None
) -> tuple[Gains, ...]:
    """Settings of every rule from the ultimate gain `K_u` [Pa/m, or any unit] and period `T_u` [s], with intervals.

    Relative half widths of K_u and T_u are added as squares for each cause, as if independent. With the model `loop`
    each rule also gets its margins. Rules that use the loop itself are left out where it is not known or not of their
    kind; their settings have no intervals.

    Raises ValueError where K_u or T_u has no value, or one that is not above 0.
    """
    if not K_u.value or not T_u.value or K_u.value <= 0 or T_u.value <= 0:
        raise ValueError("no settings without an ultimate gain and a period above 0")
    made = []
    for rule in all_rules() if rules is None else rules:
        try:
            settings = rule.settings(K_u.value, T_u.value, loop)
        except ValueError:
            if rule.from_loop:
                continue
            raise
        gains = _of_loop(rule, K_u, settings) if rule.from_loop else _scaled(rule, K_u, K_u.value, T_u, T_u.value)
        if loop is not None:
            gains = replace(gains, margins=margins(loop, settings))
        made.append(gains)
    return tuple(made)


def _made(rule: Rule, K_u: Estimate, common: Estimate, settings: Mapping[str, tuple[float, Parts]]) -> Gains:
    """The settings of a rule as estimates like `common`, by symbol, with units from that of K_u.

    They have no budget, because that of K_u is in its unit.
    """
    bare = (f"{K_u.unit}/s", ""), (f"{K_u.unit}.s" if K_u.unit != "1" else "s", "")
    time, (of_i, of_d) = ("s", "time"), FOLLOWING.get(K_u.unit, bare)
    kinds = {"K_p": (K_u.unit, K_u.quantity), "T_i": time, "T_d": time, "K_i": of_i, "K_d": of_d}
    found: dict[str, Any] = {}
    for symbol, (value, parts) in settings.items():
        unit, quantity = kinds[symbol]
        found[symbol] = replace(
            common, symbol=symbol, value=value, unit=unit, quantity=quantity, parts=parts, budget=()
        )
    return Gains(rule, **found)


def _scaled(rule: Rule, K_u: Estimate, gain: float, T_u: Estimate, period: float) -> Gains:
    """Settings that are a factor times K_u^n T_u^m."""
    terms: dict[str, tuple[float, int, int]] = {"K_p": (rule.gain, 1, 0)}
    if rule.integral is not None:
        terms |= {"T_i": (rule.integral, 0, 1), "K_i": (rule.gain / rule.integral, 1, -1)}
    if rule.derivative is not None:
        terms |= {"T_d": (rule.derivative, 0, 1), "K_d": (rule.gain * rule.derivative, 1, 1)}
    values = {symbol: (factor * gain**n * period**m, n, m) for symbol, (factor, n, m) in terms.items()}
    settings = {symbol: (value, _combine(value, K_u, n, T_u, m)) for symbol, (value, n, m) in values.items()}
    return _made(rule, K_u, replace(K_u, method=rule.title, bias=None, corrected=False, coordinate=""), settings)


def _of_loop(rule: Rule, K_u: Estimate, c: Controller) -> Gains:
    """Settings that a rule takes from the loop, with the units and operating point of K_u."""
    common = replace(K_u, method=rule.title, bias=None, corrected=False, note="from the fitted loop, no interval")
    values = {"K_p": c.K_p, "T_i": c.T_i, "K_i": c.K_p / c.T_i}
    values |= {"T_d": c.T_d, "K_d": c.K_p * c.T_d} if c.T_d > 0 else {}
    return _made(rule, K_u, common, {symbol: (value, Parts()) for symbol, value in values.items()})


def _combine(value: float, K_u: Estimate, n: int, T_u: Estimate, m: int) -> Parts:
    """Half widths of K_u^n T_u^m by cause: relative half widths times |n| and |m|, added as squares."""

    def part(cause: str) -> float | None:
        terms = []
        for estimate, exponent in ((K_u, n), (T_u, m)):
            half: float | None = getattr(estimate.parts, cause)
            if exponent and estimate.value:
                if half is None:
                    return None
                terms.append(exponent * half / estimate.value)
        return abs(value) * sqrt(sum(term * term for term in terms))

    return Parts(repeats=part("repeats"), method=part("method"), calibration=part("calibration"))


AGREES, DOUBTED = 0.15, 0.5
"""Relative difference from the model up to which a measured value agrees, and above which it is impossible."""


def plausibility(T_u: float, loop: Loop) -> Finding:
    """Finding on whether T_u [s] can come from the linear model `loop`."""
    expected = ultimate(loop)
    lags = ", ".join(f"{abs(complex(lag)):.3g} s" for lag in loop.lags)
    plant = f"a linear loop with dead time {loop.dead_time * 1e3:.3g} ms and lag{'s' * (len(loop.lags) > 1)} {lags}"
    off = abs(T_u / expected.period - 1)
    if off > DOUBTED:
        cycle = "; a cycle so slow is what stiction makes, not an ultimate oscillation" if T_u > expected.period else ""
        text = f"T_u = {T_u:.3g} s is impossible for {plant}: that oscillates at {expected.period:.3g} s"
        return Finding("fault", f"{text}{cycle}")
    sentence = f"T_u = {T_u:.3g} s, where {plant} gives {expected.period:.3g} s"
    if off > AGREES:
        return Finding("doubt", f"{sentence}: more than {AGREES:.0%} apart")
    return Finding("note", f"{sentence}: they agree")


def loop_of(K_u: float, T_u: float, dead_time: float, lags: Sequence[float]) -> tuple[Loop | None, Finding]:
    """The loop of `dead_time` and `lags` [s] with the ultimate gain `K_u`, and a finding on its period T_u [s].

    The loop is None unless T_u agrees. Raises ValueError for times that form no loop, or one that never oscillates.
    """
    loop = Loop(1.0, dead_time, tuple(lags))
    finding = plausibility(T_u, loop)
    return (replace(loop, gain=ultimate(loop).gain / K_u) if finding.level == "note" else None), finding


def measured_loops(analysis: Analysis) -> list[tuple[Estimate, Estimate, Loop | None]]:
    """K_u, T_u and the identified loop or None at each operating point, by the first method with values."""
    loops = {}
    for fact in analysis.facts.get("loops", []):
        lags = tuple(complex(*lag) if isinstance(lag, list) else float(lag) for lag in fact["lags"])
        loops[_point(fact["at"])] = Loop(fact["gain"], fact["dead_time"], lags)
    known = [e for e in analysis.estimates if e.value is not None]
    periods = {(e.method, _point(e.at)): e for e in known if e.symbol == "T_u"}
    gains = [e for e in known if e.symbol == "K_u" and (e.method, _point(e.at)) in periods]
    first = {_point(e.at): e for e in reversed(gains)}
    return [(e, periods[e.method, point], loops.get(point)) for point, e in sorted(first.items())]


def _point(at: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted(at.items()))


def facts(gains: Iterable[Gains], at: Mapping[str, float]) -> list[dict[str, Any]]:
    """Settings at the operating point `at` [SI] as plain data, for `Analysis.facts`."""
    return [{"at": dict(at), **g.to_dict()} for g in gains]
