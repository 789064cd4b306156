"""What imported runs hold besides samples: the analysis rule of the map, lateness of channels, findings of the import.

Reads the manifest of imports; reduces nothing.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pmabench.store.analyses.results import Analysis, Estimate, Finding, withhold
from pmabench.store.records import Flag, RunData, TrialData

LEVELS = ("fault", "doubt", "note")
UNTOLD = 0.005
"""Assumed bound of the time between pressure and position [s] where the map gives no `late_by`."""
UNTOLD_TIME = "nothing is known of the time between the channels"
NUMBER = re.compile(r"(\d+)")


def import_of(run: RunData) -> Mapping[str, Any]:
    """The `imported` entry of the manifest; empty for runs of a bench."""
    entry = run.manifest.get("imported")
    return entry if isinstance(entry, Mapping) else {}


def in_time(runs: Iterable[RunData]) -> list[RunData]:
    """Runs in order of their start; those without a time by file and test name, with T10 after T9."""

    def key(run: RunData) -> tuple[str, list[tuple[int, str]]]:
        name = f"{import_of(run).get('file', '')} {import_of(run).get('test', '')}"
        parts = enumerate(NUMBER.split(name))
        begun = str(run.manifest.get("started_utc", ""))
        # of two numbers the one with more digits is larger, however many there are
        return begun, [(len(p.lstrip("0")), p.lstrip("0")) if n % 2 else (0, p) for n, p in parts]

    return sorted(runs, key=key)


def rule_of(runs: Sequence[RunData], options: Mapping[str, Any]) -> tuple[dict[str, Any], list[Finding]]:
    """The analysis rule of the map, overridden by options, and findings: a doubt where maps of the runs disagree."""
    rules = [dict(import_of(run).get("analysis") or {}) for run in runs]
    findings: list[Finding] = []
    if any(rule != rules[0] for rule in rules):
        findings.append(Finding("doubt", "the runs were imported with different analysis rules; the first one counts"))
    rule = {**(rules[0] if rules else {}), **options}
    changed = sorted(name for name in options if rules and rules[0].get(name) != options[name])
    if changed and rules[0]:
        findings.append(Finding("note", f"not the rule that the map gives: changed by options: {', '.join(changed)}"))
    return rule, findings


def late_by(run: RunData, channel: str) -> tuple[float, float] | None:
    """Age of a channel's values at their time stamps, least and most [s]; None where it is not known."""
    late = (import_of(run).get("late_by") or {}).get(channel)
    return None if late is None else (float(late[0]), float(late[1]))


def apart_is_known(runs: Sequence[RunData]) -> bool:
    """Whether all runs state how late their pressure is, or their displacement."""
    return all(late_by(run, "pressure") or late_by(run, "displacement") for run in runs)


def import_findings(runs: Sequence[RunData]) -> list[Finding]:
    """Findings of the import: faults and doubts of each file, and one note per kind with its count over all files.

    Spikes are reported once per channel.
    """
    findings: list[Finding] = []
    notes: dict[str, list[Mapping[str, Any]]] = {}
    spikes: dict[str, list[Finding]] = {}
    for run in runs:
        for found in import_of(run).get("findings") or ():
            said = Finding(str(found.get("level", "doubt")), f"{_file_of(run)}: {found.get('text', '')}")
            if found.get("level") == "note":
                notes.setdefault(str(found.get("kind")), []).append(found)
            elif found.get("kind") == "spike":
                spikes.setdefault(str(found.get("channel")), []).append(said)
            else:
                findings.append(said)
    for group in spikes.values():
        more = f" (and in {len(group) - 1} more file{'s'[: len(group) > 2]})" if len(group) > 1 else ""
        findings.append(replace(group[0], text=group[0].text + more))
    for kind, members in sorted(notes.items()):
        more = f" (and {len(members) - 1} more of this kind)" if len(members) > 1 else ""
        findings.append(Finding("note", f"import, {kind}: {members[0].get('text', '')}{more}"))
    return sorted(findings, key=lambda finding: LEVELS.index(finding.level) if finding.level in LEVELS else 0)


def _file_of(run: RunData) -> str:
    """`folder/file` from which a run was imported."""
    return f"{import_of(run).get('folder', '')}/{import_of(run).get('file', run.id)}"


def without_doubtful(analysis: Analysis, runs: Sequence[RunData]) -> Analysis:
    """The analysis without values that rest on files with a withholding finding, for instance a doubtful unit.

    Such a fault changes numbers without a trace, and no rule can correct it.
    """
    reasons = {run.id: reason for run in runs if (reason := _withholding(run))}
    if not reasons:
        return analysis

    def kept(estimate: Estimate) -> Estimate:
        of = {trial.rpartition("/")[0] for trial in estimate.trials} or set(analysis.runs)
        why = [reason for run, reason in reasons.items() if run in of]
        return withhold(estimate, "; ".join(why)) if why and estimate.value is not None else estimate

    estimates = tuple(kept(estimate) for estimate in analysis.estimates)
    curves = tuple(replace(curve, terms=tuple(kept(term) for term in curve.terms)) for curve in analysis.curves)
    known = {estimate.note for estimate in estimates if estimate.withheld}
    more = tuple(reason for reason in reasons.values() if not any(reason in note for note in known))
    return replace(analysis, estimates=estimates, curves=curves, refusals=(*analysis.refusals, *more))


def _withholding(run: RunData) -> str:
    """Why values from an imported run are withheld; empty where they are not."""
    found = [found for found in import_of(run).get("findings") or () if found.get("withholds")]
    answer = ", ".join(dict.fromkeys(str(each.get("kind")) for each in found))
    texts = "; ".join(str(each.get("text", "")) for each in found)
    return f"{_file_of(run)}: {texts}. If it is right as it is, import with confirmed: [{answer}]" if found else ""


def unusable_because(trial: TrialData) -> str:
    """Flags that exclude samples of a trial, with counts, for instance `29000 suspect, 3 dropout`; else `none`."""
    against = [flag for flag in Flag if flag and flag not in {Flag.LATE, Flag.SLACK}]
    counts = {str(flag.name).lower(): int(np.count_nonzero(trial.flags & np.uint16(flag))) for flag in against}
    return ", ".join(f"{count} {name}" for name, count in counts.items() if count) or "none"


def flagged_counts(runs: Sequence[RunData]) -> dict[str, int]:
    """Number of flagged samples of all imported runs, by flag name."""
    counts: Counter[str] = Counter()
    for run in runs:
        counts.update({str(name): int(count) for name, count in (import_of(run).get("flagged") or {}).items()})
    return dict(counts)
