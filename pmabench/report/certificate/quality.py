"""Why the values can be believed, in short lines: fit statistics, checks next to the residual, findings that matter."""

from __future__ import annotations

from collections.abc import Sequence

from pmabench.analysis.verdict.checks import checks_of
from pmabench.plotting.wording import brief, clean, printed, rounded, shown, symbol_text
from pmabench.report.document.tables import is_number
from pmabench.report.foremost import costliest
from pmabench.store.analyses.results import Analysis, Curve

MOST = 4
MOST_FINDINGS = 3
LONGEST = 230
"""Letters of a finding on the certificate; the whole text is in the appendix."""
SHORT = {
    "repeat_spread": "repeats scatter by",
    "drift": "first to last trial changes by",
    "held_out": "loads left out are missed by",
    "other_direction": "relaxing by values of contracting, missed by",
    "first_repeat": "first repeat differs by",
    "free_run": "free run, NRMSE",
}
"""Checks in the order in which they matter, in a few words."""


def statistics(analysis: Analysis) -> list[tuple[str, str]]:
    """Up to four lines: trials used, residual against noise, fitted curves."""
    found = []
    used, all_trials = analysis.facts.get("trials_used"), analysis.facts.get("trials")
    if is_number(all_trials):
        some = used if is_number(used) else all_trials - len(analysis.dropped)
        found.append(("Trials", f"{some} of {all_trials} used"))
    residual = next((f.text for f in analysis.findings if f.text.startswith("residual ")), "")
    if residual:
        found.append(("Residual", printed(brief(residual.removeprefix("residual "), 120))))
    curves: dict[str, Curve] = {}
    for curve in sorted(analysis.curves, key=lambda c: c.residual_rms):
        if curve.method == analysis.estimates[0].method and curve.terms and not curve.normalised:
            curves.setdefault(curve.symbol, curve)
    for symbol, curve in curves.items():
        unit = shown(curve.terms[0].quantity, curve.terms[0].unit)
        rms = f"{rounded(curve.residual_rms / unit.scale, None, 2)} {unit.unit}"
        found.append((symbol_text(symbol), f"{clean(curve.form, 40)} over {clean(curve.against, 40)} within {rms} rms"))
    return found[:MOST]


def checks(analysis: Analysis) -> list[tuple[str, str, str]]:
    """Up to four lines of level (`good` or `doubt`), words and value; doubts first."""
    known = {check.name: check for check in checks_of(analysis) if check.quantity == "ratio"}
    order = sorted((n for n in SHORT if n in known), key=lambda n: known[n].level != "doubt")
    return [
        (
            "doubt" if known[name].level == "doubt" else "good",
            SHORT[name],
            f"{rounded(100 * abs(known[name].value), None, 2)}\u00a0%",
        )
        for name in order[:MOST]
    ]


def findings(tests: Sequence[Analysis], failed: Sequence[str]) -> tuple[list[str], int]:
    """What costs most, at most three, and how many more findings the appendix has."""
    found = costliest(tests, failed)
    notes = sum(f.level == "note" for a in tests for f in a.findings)
    cut = [brief(text, LONGEST) for text in found[:MOST_FINDINGS]]
    return [f"{text[:1].upper()}{text[1:]}" for text in cut], len(found[MOST_FINDINGS:]) + notes
