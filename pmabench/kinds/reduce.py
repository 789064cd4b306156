"""Which reduction belongs to which kind of run, and whether the protocol's acceptance limits are met."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot
from typing import Any

from pmabench.analysis.imported import in_time, without_doubtful
from pmabench.analysis.shared.changes import Change, followed, of_forces, of_values, with_changes
from pmabench.analysis.shared.regulated import regulated, vented
from pmabench.analysis.shared.samples import with_motion
from pmabench.analysis.shared.saturated import saturated
from pmabench.analysis.shared.signals import without_spikes
from pmabench.analysis.shared.sound import sound
from pmabench.analysis.shared.trials import grouped, session_of, six_digits
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.analysis.verdict.acceptance import not_accepted, not_accepted_as_form
from pmabench.analysis.verdict.agreement import KIND as AGREEMENT
from pmabench.analysis.verdict.agreement import Offer, agreement, offers_of, side_by_side, without_diameter
from pmabench.analysis.verdict.checks import repeats_of, with_checks, with_record, with_sessions
from pmabench.analysis.verdict.repeated import repeated
from pmabench.base.errors import UsageError, did_you_mean, invalid
from pmabench.base.kind import Kind, load
from pmabench.base.quantities import show
from pmabench.base.text import clean
from pmabench.kinds import registry
from pmabench.store.analyses.results import POINT_QUANTITIES, Analysis, Estimate
from pmabench.store.records import RunData, TrialData

MOST_REASONS = 3
NUMBER = re.compile(r"[-+]?\d[\d.,]*(e[-+]?\d+)?")
OF_FILE = re.compile(r"^[^:]*\.\w{1,5}: ")
"""The file that a reason of an import begins with."""


def specimen_of(run: RunData) -> str:
    """Type and serial number of the specimen in the run's manifest."""
    specimen = run.manifest.get("specimen")
    if not isinstance(specimen, Mapping):
        return str(specimen or "")
    return f"{specimen.get('type', '')} {specimen.get('serial', '')}".strip()


def of_one_specimen(runs: Sequence[RunData]) -> Sequence[RunData]:
    """The runs, for a report; UsageError where a reader would take values of one specimen for those of another."""
    names = list(dict.fromkeys(specimen_of(run) or "not named" for run in runs))
    if len(names) > 1:
        raise UsageError(
            f"a report is of one specimen, and these runs are of {len(names)}: {clean('; '.join(names), 200)}. "
            "Write one report for each; `pmabench compare` compares them"
        )
    return runs


def _whose(run: RunData) -> tuple[str, bool]:
    """Key of runs that are reduced together: the specimen, and whether they are simulated."""
    return specimen_of(run), run.simulated


def reduction_of(run: RunData) -> str:
    """Name of the kind whose reduction a run needs."""
    asked = (run.plan.get("settings") or {}).get("reduction")
    return f"{run.kind}-{asked.get('method')}" if isinstance(asked, Mapping) else run.kind


def reduce_runs(runs: Sequence[RunData], options: Mapping[str, Mapping[str, Any]] | None = None) -> list[Analysis]:
    """One analysis for each kind of run of each specimen, and their comparison.

    Real and simulated runs are never mixed, nor are specimens. `options`: kind -> options of its reduction. Raises
    InvalidFile for an unknown kind.
    """
    ordered = in_time(runs)
    for run in ordered:
        if registry.find(kind := reduction_of(run)) is None:
            raise invalid(run.path, f'no reduction for runs of kind "{kind}"{did_you_mean(kind, registry.all_kinds())}')
    found: list[Analysis] = []
    for members in grouped(ordered, _whose).values():
        analyses = _of_specimen(grouped(members, reduction_of), options or {})
        difference = compared(analyses)
        found += analyses if difference is None else [*analyses, difference]
    return found


SLOW_ROWS, FORM = "slow rows", "form of all tests"
"""Parts of kinds: function that makes rows of a trial; fit to the rows of all kinds together."""


def reduce_together(form: str, runs: Sequence[RunData]) -> list[Analysis]:
    """One analysis for each specimen, from all runs whose kind has slow rows; `form` is the kind that fits them.

    Real and simulated runs are never mixed. Raises UsageError where no run has such rows.
    """
    rows = {name: load(kind.parts[SLOW_ROWS]) for name, kind in registry.with_part(SLOW_ROWS).items()}
    able = [run for run in in_time(runs) if run.kind in rows]
    specimens = grouped(able, _whose)
    if not specimens:
        kinds = ", ".join(dict.fromkeys(run.kind for run in runs))
        raise UsageError(f"--form {form} takes runs of kind {', '.join(rows)}; these are of kind {kinds}")
    return [_reduced(form, members, {"rows": rows}) for members in specimens.values()]


def _of_specimen(kinds: Mapping[str, Sequence[RunData]], options: Mapping[str, Mapping[str, Any]]) -> list[Analysis]:
    """One analysis for each kind, in their order; kinds that use results of other tests are reduced last."""
    analyses: dict[str, Analysis] = {}
    for name in sorted(kinds, key=lambda name: bool(registry.kind_of(name).after)):
        kind, asked = registry.kind_of(name), options.get(name)
        if kind.after:
            others = {other: _offers(analysis) for other, analysis in analyses.items()}
            asked = {**kind.part("after")(others), **(asked or {})}
        analyses[name] = _reduced(name, kinds[name], asked)
    return [analyses[name] for name in kinds]


def _offers(analysis: Analysis) -> list[Offer]:
    return offers_of(analysis, registry.find(analysis.kind))


def compared(analyses: Sequence[Analysis]) -> Analysis | None:
    """Comparison of the tests of one specimen; None where they have no value in common."""
    known = list(registry.all_kinds())
    ordered = sorted(analyses, key=lambda one: known.index(one.kind) if one.kind in known else len(known))
    instead = next((kind.instead for kind in registry.all_kinds().values() if kind.instead), "")
    return agreement(analyses, [offer for analysis in ordered for offer in _offers(analysis)], instead)


def _reduced(kind: str, runs: Sequence[RunData], options: Mapping[str, Any] | None) -> Analysis:
    """The reduction of a kind, with the checks of its trials."""
    record = registry.kind_of(kind)
    runs, unsound = sound(runs)
    analysis = record.part("reduction")(runs, options)
    poor = not _given(analysis) or any(e.withheld for e in analysis.estimates)
    if poor and (found := without_spikes(runs))[1]:
        again = record.part("reduction")(found[0], options)
        if _given(again) > _given(analysis):
            runs, analysis = found[0], replace(again, findings=(*again.findings, *found[1]))
    sessions = list(grouped(runs, session_of).values())
    if len(sessions) > 1 and FORM not in record.parts:
        analysis = with_sessions(analysis, [record.part("reduction")(one, options) for one in sessions])
    analysis = replace(analysis, dropped=(*analysis.dropped, *unsound))
    count = max((side_by_side(run.manifest.get("specimen")) for run in runs), default=1)
    analysis = without_diameter(analysis, count)
    analysis = with_motion(with_checks(analysis, record, runs), runs, record.moves)
    zero = _zero_of_all(runs) if FORM in record.parts else []
    analysis = with_changes(
        analysis, runs, lambda others: record.part("reduction")(others, options),
        lambda run: [*_changes(record, run), *zero],
    )  # fmt: skip
    analysis = replace(analysis, findings=(*analysis.findings, *repeated(runs)))
    return with_record(without_doubtful(analysis, runs), runs)


def _zero_of_all(runs: Sequence[RunData]) -> list[Sequence[Change]]:
    """The largest zero of the gauge that runs show: others, which are never vented, may have it as well."""
    found = [change for run in runs if (change := vented(run))]
    return [[max(found, key=lambda one: abs(one.offset))]] if found else []


def _changes(kind: Kind, run: RunData) -> list[Sequence[Change]]:
    """Changes of a sensor within a run, each with all that it may be."""
    off = regulated(run) if kind.regulated and not kind.loop else None
    found: list[Sequence[Change]] = [[change] for change in [followed(run), off, *saturated(run, kind.loop)] if change]
    if kind.drifts == "force":
        found += of_forces(run)
    seen = any(not one.throughout and (one.gain or one.offset) for changes in found for one in changes)
    if kind.drifts and not seen and (repeats := repeats_of(kind, [run])):
        found += of_values(run, kind.drifts, kind.repeated_is, (repeats.cell, repeats.t, repeats.value))
    return found


def of_one_trial(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Key numbers of the reduction of one trial, for the display, and why a value is missing; of an angle or place the
    middle one.
    """
    kind = registry.kind_of(run.kind)
    analysis = kind.part("reduction")([replace(run, trials=(trial,))], None)
    headlines = [result.symbol for result in kind.results if result.headline]
    given = grouped((e for e in analysis.estimates if e.symbol in headlines), lambda e: e.symbol)
    shown = [alike[len(alike) // 2] for alike in given.values()]
    withheld = [e for e in analysis.estimates if e.withheld and e not in shown]
    reasons = [one.reason for one in analysis.dropped]
    reasons += [e.note for e in shown if e.value is None] + [f"{e.symbol}: {e.note}" for e in withheld]
    own = [vars(replace(e.parts, calibration=None)) for e in shown]  # repeats share the calibration
    halves = [[half for half in parts.values() if half] for parts in own]
    found = [Measured(e.symbol, e.quantity, e.value, noise=hypot(*half)) for e, half in zip(shown, halves, strict=True)]
    return found, reasons


def _given(analysis: Analysis) -> int:
    """Number of estimates with a value."""
    return sum(e.value is not None and not e.withheld for e in analysis.estimates)


def verdicts(runs: Sequence[RunData], analyses: Sequence[Analysis]) -> list[str]:
    """One sentence for each reason why results are not accepted.

    Reasons: no value at all, a withheld value, a reduction that refuses acceptance, a limit of the protocol exceeded.
    """
    failed: list[str] = []
    for analysis in analyses:
        failed += analysis.refusals
        if analysis.kind == AGREEMENT:
            continue
        withheld = _withheld(analysis)
        failed += withheld
        if not withheld and all(e.value is None for e in analysis.estimates):
            failed.append(f"{analysis.kind}: nothing came out: {_why_nothing(analysis)}")
            continue
        if analysis.kind in registry.with_part(FORM):
            failed += not_accepted_as_form(runs, analysis, _named)
            continue
        failed += not_accepted(runs, analysis, _named)
    return failed


def _withheld(analysis: Analysis) -> list[str]:
    """One sentence for each reason to withhold, with the values concerned: those of the first method of each symbol at
    each operating point, which gives or withholds a value there.

    Reasons that differ in their numbers and files alone are one reason, with those of the first value.
    """
    said = [e for e in analysis.estimates if e.value is not None or e.withheld]
    first = {_key(e): e.method for e in reversed(said)}
    withheld = [e for e in said if e.withheld and e.method == first[_key(e)]]
    return [_sentence(alike) for alike in grouped(withheld, _reason).values()]


def _key(e: Estimate) -> tuple[object, ...]:
    return e.symbol, e.coordinate, six_digits(e.at)


def _reason(estimate: Estimate) -> str:
    return NUMBER.sub("", OF_FILE.sub("", estimate.note))


def _sentence(withheld: Sequence[Estimate]) -> str:
    """Withheld values and their reason: `F_ce (8 values), F_c: withheld: the force ...`."""
    by_symbol = grouped(withheld, lambda e: e.symbol)
    each = {symbol: list(dict.fromkeys(map(_named, of))) for symbol, of in by_symbol.items()}
    few = sum(map(len, each.values())) <= MOST_REASONS
    counted = [of if few or len(of) == 1 else [f"{symbol} ({len(of)} values)"] for symbol, of in each.items()]
    first = withheld[0]
    others = any(estimate.note != first.note for estimate in withheld)
    alike = f" ({_named(first)}; alike for the others)" if others else ""
    return f"{', '.join(name for of in counted for name in of)}: withheld: {first.note}{alike}"


def _named(estimate: Estimate) -> str:
    """A coefficient and its operating point in the units that people read: `K at pressure 300 kPa`."""
    where = [
        f"{name} {show(value, POINT_QUANTITIES[name])}" if name in POINT_QUANTITIES else f"{name} {value:g}"
        for name, value in estimate.at.items()
    ]
    return f"{estimate.symbol} at {', '.join(where)}" if where else estimate.symbol


def _why_nothing(analysis: Analysis) -> str:
    """The faults that were found, else why trials were not used, else why values are missing."""
    reasons = [f.text for f in analysis.findings if f.level == "fault"]
    reasons = reasons or [f"{d.trial}: {d.reason}" for d in analysis.dropped] or [e.note for e in analysis.estimates]
    more = len(dict.fromkeys(reasons)) - MOST_REASONS
    text = "; ".join(list(dict.fromkeys(reasons))[:MOST_REASONS]) or "there is no trial"
    return f"{text}; and {more} more reasons" if more > 0 else text
