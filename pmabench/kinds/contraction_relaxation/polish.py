"""Contraction runs with the pooled coefficients polished by output error, beside them; where options ask."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pmabench.analysis.results import Estimate, Finding
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.intervals import Pooled
from pmabench.kinds.contraction_relaxation.joint_forms import Beside
from pmabench.kinds.contraction_relaxation.output_error import Polished, polish
from pmabench.kinds.contraction_relaxation.pooled import design_of, rms_of
from pmabench.kinds.contraction_relaxation.trials import Campaign
from pmabench.kinds.contraction_relaxation.values import Told, values

METHOD = "output-error"
MISFIT = 2.0
"""Whitened rows this many times what noise makes put the model's form in doubt."""
FEW = 0.1
"""Share of the coefficients that may move by more than their interval before it is a doubt."""
FEWEST = 10
"""Fewest segments in stretches for a polish."""
MOST_NAMED = 4
"""Coefficients that a sentence names."""


def compare(campaign: Campaign, pooled: Pooled, estimates: Sequence[Estimate], options: Mapping[str, Any]) -> Beside:
    """The pooled fit polished by output error where `options` ask, {"polish": True}; else nothing.

    `estimates` are those of the pooled fit. A polish that does not converge gives no value, and says so.
    """
    if not options.get("polish"):
        return Beside()
    polished = polish(pooled.segments, pooled.fit, campaign.noise, pooled.expected)
    known = np.isfinite(polished.misses)
    if known.sum() < FEWEST:
        text = "output error: no stroke moves for long enough in one piece to be simulated; nothing was polished"
        return Beside(findings=(Finding("doubt", text),))
    residual = pooled.segments.force - design_of(pooled.segments, polished.knots) @ polished.theta
    facts = {
        "converged": polished.converged,
        "steps": polished.steps,
        "segments": int(known.sum()),
        "residual_rms": rms_of(polished.misses[known]),
        "expected_rms": rms_of(polished.expected[known]),
        "whitened_rms": polished.rms / polished.unit,
        "residual_rms_force": rms_of(residual[known]),
        "expected_rms_force": rms_of(pooled.noise[known]),
    }
    if not polished.converged:
        text = (
            f"output error: not converged after {polished.steps} steps, so it gives no value: the coefficients of"
            " measured-pressure stand; trials of too few loads, or a muscle that is not of the model's form, leave"
            " it open"
        )
        return Beside(findings=(Finding("doubt", text),), facts=facts)
    every = np.ones(len(pooled.segments), bool)
    trust = pooled.trust_of(polished, every, np.full(len(every), polished.unit))
    found = values(Told(campaign, pooled.segments, polished, polished.knots, trust, METHOD))
    return Beside(
        estimates=tuple(found),
        findings=(_residual(polished, facts), *_moved(estimates, found), *_open(estimates, found)),
        facts=facts,
    )


def _residual(polished: Polished, facts: Mapping[str, Any]) -> Finding:
    """What is left, in m and in N, and whether noise explains it."""
    left, noise = show(facts["residual_rms"], "length", 2), show(facts["expected_rms"], "length", 2)
    force, shaken = show(facts["residual_rms_force"], "force", 2), show(facts["expected_rms_force"], "force", 2)
    size = (
        f"output error, {facts['steps']} steps: simulated contraction misses the measured one by {left} rms, {force} in"
        f" the equation of motion; noise of the channels explains {noise} and {shaken}"
    )
    if facts["whitened_rms"] > MISFIT:
        times = f"{facts['whitened_rms']:.2g} times what noise makes of it, serial correlation counted"
        return Finding("doubt", f"{size}: {times}; the model does not have the form of this muscle")
    return Finding("note", size)


def _pairs(ours: Sequence[Estimate], theirs: Sequence[Estimate]) -> Iterator[tuple[Estimate, Estimate]]:
    there = {(e.symbol, tuple(e.at.items())): e for e in theirs}
    for e in ours:
        other = there.get((e.symbol, tuple(e.at.items())))
        if other is not None:
            yield e, other


def _moved(before: Sequence[Estimate], after: Sequence[Estimate]) -> Iterator[Finding]:
    """Coefficients that the polish moves by more than their interval, the worst first; or that it moves none."""
    known = [(a, b) for a, b in _pairs(before, after) if a.value is not None and b.value is not None]
    moved = []
    for a, b in known:
        half = a.parts.combined
        if half is not None and a.value is not None and b.value is not None and abs(b.value - a.value) > half:
            moved.append((abs(b.value - a.value) / max(half, 1e-300), a, b, half))
    if not known:
        return
    if not moved:
        yield Finding("note", f"output error moves none of {len(known)} coefficients by more than its interval")
        return
    moved.sort(key=lambda one: -one[0])
    changes = [
        f"{_name(a)} from {show(a.value or 0.0, a.quantity, 5)} to {show(b.value or 0.0, b.quantity, 5)}"
        f" (± {show(half, a.quantity, 2)})"
        for _, a, b, half in moved[:MOST_NAMED]
    ]
    more = f" and {len(moved) - MOST_NAMED} more" if len(moved) > MOST_NAMED else ""
    few = len(moved) <= FEW * len(known)
    why = "" if few else "; methods that agree on a muscle of the model's form part on another: look at the residuals"
    yield Finding(
        "note" if few else "doubt",
        f"output error moves {len(moved)} of {len(known)} coefficients by more than the interval of measured-pressure:"
        f" {', '.join(changes)}{more}{why}",
    )


def _open(before: Sequence[Estimate], after: Sequence[Estimate]) -> Iterator[Finding]:
    """What is identifiable by one of the two alone."""
    lost = [_name(b) for a, b in _pairs(before, after) if a.value is not None and b.value is None]
    if lost:
        more = f" and {len(lost) - MOST_NAMED} more" if len(lost) > MOST_NAMED else ""
        names = ", ".join(lost[:MOST_NAMED])
        yield Finding("note", f"output error leaves open what measured-pressure tells: {names}{more}")


def _name(e: Estimate) -> str:
    at = e.at.get("pressure")
    return e.symbol if at is None else f"{e.symbol} at {show(at, 'pressure', 4)}"
