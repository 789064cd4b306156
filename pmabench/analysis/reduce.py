"""Which reduction belongs to which kind of run, and whether the protocol's acceptance limits are met."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module

from pmabench.analysis.agreement import agreement
from pmabench.analysis.results import Analysis
from pmabench.base.errors import did_you_mean, invalid
from pmabench.store.records import RunData

REDUCTIONS = {
    "static-load": "static_load",
    "contraction-relaxation": "contraction",
    "sinusoidal-displacement": "sine",
    "ultimate-gain": "ultimate_gain",
    "isometric": "isometric",
    "recorded-step": "recorded_steps",
    "recorded-sine": "recorded_sines",
    "recorded-pull": "isometric",
}
"""Kind of run -> module in this package with `reduce(runs, options) -> Analysis`."""


def specimen_of(run: RunData) -> str:
    """Which specimen a run is of: type and serial as its manifest has them."""
    told = run.manifest.get("specimen")
    return f"{told.get('type', '')} {told.get('serial', '')}".strip() if isinstance(told, Mapping) else str(told or "")


def reduce_runs(runs: Sequence[RunData]) -> list[Analysis]:
    """One analysis for each kind of run of each specimen, and what these say about each other.

    Real and simulated runs are never mixed, nor are specimens. Raises InvalidFile for an unknown kind.
    """
    specimens: dict[tuple[str, bool], dict[str, list[RunData]]] = {}
    for run in runs:
        if run.kind not in REDUCTIONS:
            raise invalid(run.path, f'no reduction for runs of kind "{run.kind}"{did_you_mean(run.kind, REDUCTIONS)}')
        kinds = specimens.setdefault((specimen_of(run), run.simulated), {})
        kinds.setdefault(run.kind, []).append(run)
    found: list[Analysis] = []
    for kinds in specimens.values():
        analyses = [
            import_module(f"pmabench.analysis.{REDUCTIONS[kind]}").reduce(group) for kind, group in kinds.items()
        ]
        compared = agreement(analyses)
        found += analyses if compared is None else [*analyses, compared]
    return found


def verdicts(runs: Sequence[RunData], analyses: Sequence[Analysis]) -> list[str]:
    """One sentence for each coefficient whose interval is wider than the protocol accepts."""
    failed: list[str] = []
    for analysis in analyses:
        accept: dict[str, float] = {}
        for run in runs:
            if run.id in analysis.runs:
                accept |= dict(run.plan.get("accept") or {})
        primary = analysis.estimates[0].method if analysis.estimates else ""
        known = {e.symbol for e in analysis.estimates if e.method == primary and e.value is not None}
        for estimate in analysis.estimates:
            widest = accept.get(estimate.symbol)
            ci = estimate.ci95
            if widest is None or estimate.method != primary or estimate.coordinate:
                continue
            where = ", ".join(f"{name} {value:g}" for name, value in estimate.at.items())
            if ci is None or not estimate.value:
                if estimate.symbol not in known:
                    failed.append(f"{estimate.symbol} at {where}: not identifiable, accepted +-{100 * widest:g} %")
                continue
            relative = (ci[1] - ci[0]) / 2 / abs(estimate.value)
            if relative > widest:
                failed.append(
                    f"{estimate.symbol} at {where}: interval +-{100 * relative:.2g} %, accepted +-{100 * widest:g} %"
                )
    return failed
