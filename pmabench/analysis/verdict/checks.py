"""Checks of an analysis besides its residual, open questions of its runs, and scatter between sessions.

A check is plain data in `Analysis.facts["checks"]`, so that reports made from files have it too. Checks of trials
(spread of repeats, first repeat, drift) are made here for every kind of test with a value per trial; those of the
pooled fit come from the kind.

Imports store unanswered questions, benches store doubts about their files (another muscle than the simulated one).
Every analysis of such runs repeats them.

Trials of one session share mounting, zeros and temperature, so their scatter alone underestimates the interval of a
mean over sessions. Where the sessions together do not have the form of one muscle, values are means of theirs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import sqrt

import numpy as np

from pmabench.analysis.imported import in_time
from pmabench.analysis.shared import student
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.shared.trials import Point, grouped, six_digits
from pmabench.base.kind import Kind
from pmabench.base.quantities import QUANTITIES, show
from pmabench.base.text import printable
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts
from pmabench.store.records import Array, RunData, TrialData, is_number

LONGEST = 1000
"""Most characters of a text from a record."""
ALTERED = (
    "the results come from the samples, which are whole; what they were made of can no longer be checked; bring the "
    "file back, or import it again"
)
REMEDY = "write the answer into the map, import again and process the new run"


def with_record(analysis: Analysis, runs: Sequence[RunData]) -> Analysis:
    """The analysis with doubts from the runs' records as findings, and with refusals.

    Refusals are the questions that were open at import, and files that were altered since.
    """
    doubts = [(run.id, str(doubt)) for run in runs for doubt in run.manifest.get("doubts") or ()]
    findings = tuple(Finding("doubt", text) for text in _counted(doubts))
    questions = []
    for asked, entry in ((run.id, entry) for run in runs for entry in unresolved_of(run)):
        used = f"; taken here: {entry['used']}" if entry.get("used") else ""
        where = f" ({entry['where']})" if entry.get("where") else ""
        questions.append((asked, f"{entry['what']}: {entry['question']}{used}{where}; {REMEDY}"))
    refusals = [f"{analysis.kind}: not answered: {text}" for text in _counted(questions)]
    refusals += [f"{run.id}: {fault}: {ALTERED}" for run in runs for fault in run.since.altered]
    return replace(analysis, findings=(*analysis.findings, *findings), refusals=(*analysis.refusals, *refusals))


def unresolved_of(run: RunData) -> Iterator[Mapping[str, object]]:
    """Questions that were open when a run was imported, from its manifest."""
    imported = run.manifest.get("imported")
    entries = imported.get("unresolved") if isinstance(imported, Mapping) else None
    for entry in entries if isinstance(entries, list | tuple) else ():
        if isinstance(entry, Mapping) and {"what", "question"} <= set(entry):
            yield entry


def _counted(sentences: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Each text once, with its run or the number of runs."""
    for text, reported in grouped(sentences, lambda one: one[1]).items():
        names = dict.fromkeys(run for run, _ in reported)
        yield f"{reported[0][0] if len(names) == 1 else f'{len(names)} runs'}: {printable(text, LONGEST)}"


SPREAD = 0.03
"""Relative spread of repeats above which they are doubted [1]."""
FIRST = 0.01
"""Relative difference of first repeats above which it is doubted, if it exceeds its interval [1]."""
DRIFT = 0.02
"""Relative change from first to last trial above which it is doubted, if it exceeds its interval [1]."""
APART = 0.1
"""Least rms distance in time of repeats from their mean, over the whole time, for a drift to be evaluated [1]."""
LEAST = 0.05
"""Share of the largest value below which values are left out, because their relative scatter is unbounded."""
FEWEST = 3
"""Fewest operating points for a first-repeat effect, and fewest degrees of freedom for a drift."""


@dataclass(frozen=True)
class Check:
    """One number with its sentence."""

    name: str
    """Key of `NAMES`."""
    value: float
    """[SI]"""
    quantity: str
    level: str
    """`note` or `doubt`."""
    text: str


NAMES = {
    "repeat_spread": "standard deviation between repeats of an operating point, of their mean",
    "first_repeat": "what the first repeat is above the later ones, of their mean",
    "drift": "change from the first to the last trial, of the mean",
    "free_run": "NRMSE of the fitted muscle run freely through whole trials with the measured pressure",
    "held_out": "error of loads that were left out of the fit, of the largest load",
    "other_direction": "what relaxation is missed by with K and F_ce of contraction, of the largest load",
}
"""Checks that a protocol can limit, with their meaning."""


def with_checks(analysis: Analysis, kind: Kind, runs: Sequence[RunData]) -> Analysis:
    """The analysis with the checks of its trials, and a finding for every check."""
    known = checks_of(analysis)
    own = trial_checks(kind, runs)
    if not known and not own:
        return analysis
    every = (*known, *own)
    return replace(
        analysis,
        findings=(*analysis.findings, *(Finding(check.level, check.text) for check in every)),
        facts={**analysis.facts, "checks": [asdict(check) for check in every]},
    )


def checks_of(analysis: Analysis) -> tuple[Check, ...]:
    """Checks in an analysis' facts, which may come from a file: invalid entries are ignored."""
    entries = analysis.facts.get("checks")
    found = []
    for entry in entries if isinstance(entries, list | tuple) else ():
        if isinstance(entry, Mapping) and set(entry) == set(Check.__dataclass_fields__):
            value = entry["value"]
            texts = [entry[name] for name in ("name", "quantity", "level", "text")]
            if is_number(value) and all(isinstance(text, str) for text in texts) and entry["quantity"] in QUANTITIES:
                found.append(Check(**entry))
    return tuple(found)


@dataclass(frozen=True)
class Repeats:
    """One value per trial: arrays of shape (n,). `cell` numbers operating points, `t` is the time of a trial [s]."""

    what: str
    cell: Array
    repeat: Array
    t: Array
    value: Array

    @property
    def off(self) -> Array:
        """Relative deviation of each value from the mean of its operating point, shape (n,)."""
        return self.value / self.means(self.value) - 1.0

    def means(self, of: Array) -> Array:
        """Mean of `of` over the operating point of each trial, shape (n,)."""
        cell = self.cell.astype(np.intp)
        return np.asarray((np.bincount(cell, of) / np.maximum(np.bincount(cell), 1))[cell])

    @property
    def free(self) -> int:
        """Degrees of freedom within operating points."""
        return len(self.value) - len(np.unique(self.cell))


def trial_checks(kind: Kind, runs: Sequence[RunData]) -> list[Check]:
    """Checks of repeat spread, first-repeat effect and drift; empty for kinds of test without a value per trial."""
    repeats = repeats_of(kind, runs)
    every = () if repeats is None else (spread(repeats), first_repeat(repeats), drift(repeats))
    return [check for check in every if check is not None]


def repeats_of(kind: Kind, runs: Sequence[RunData]) -> Repeats | None:
    """The value of each trial of a repeated operating point; None for kinds without one, and below two values."""
    if not kind.repeated:
        return None
    value_of = kind.part("repeated")
    begun, values = 0.0, list[tuple[Point, RunData, TrialData, float]]()
    for run in in_time(runs):
        sampled = [trial for trial in run.trials if len(trial.t)]
        for trial in (one for one in sampled if one.status == "finished" and not one.again):
            values.append((six_digits(trial.point), run, trial, begun + float(trial.t[0])))
        begun += max((float(trial.t[-1]) for trial in sampled), default=0.0)
    times = Counter(point for point, *_ in values)
    rows: list[tuple[Point, int, float, float]] = []
    for point, run, trial, t in values:
        try:
            value = value_of(run, trial) if times[point] > 1 else None
        except NotUsable:
            continue
        if value is not None and np.isfinite(value) and value > 0:
            rows.append((point, -1 if trial.reference else trial.repeat, t, value))
    largest = max((row[3] for row in rows), default=0.0)
    rows = [row for row in rows if row[3] > LEAST * largest]
    if len(rows) < 2:
        return None
    numbers = {point: number for number, point in enumerate(dict.fromkeys(row[0] for row in rows))}
    cell = np.array([numbers[row[0]] for row in rows], dtype=np.float64)
    columns = (np.array([row[i] for row in rows], dtype=np.float64) for i in (1, 2, 3))
    return Repeats(kind.repeated_is, cell, *columns)


def spread(r: Repeats) -> Check | None:
    """Pooled relative standard deviation of repeats; None without repeats.

    s = sqrt(sum (v / mean of its cell - 1)^2 / (trials - cells)).
    """
    if r.free < 1:
        return None
    s = sqrt(float(r.off @ r.off) / r.free)
    text = f"repeats of an operating point scatter by {100 * s:.2g} % of the {r.what} ({r.free} degrees of freedom)"
    return Check("repeat_spread", s, "ratio", "doubt" if s > SPREAD else "note", text)


def first_repeat(r: Repeats) -> Check | None:
    """Mean over operating points of first / mean of later repeats - 1, with Student's t; None with fewer than three.

    Reference trials are not counted, because they are far apart in time.
    """
    apart = []
    for number in np.unique(r.cell):
        mine = (r.cell == number) & (r.repeat >= 0)
        first, later = r.value[mine & (r.repeat == 0)], r.value[mine & (r.repeat > 0)]
        if len(first) == 1 and len(later):
            apart.append(float(first[0] / later.mean() - 1.0))
    if len(apart) < FEWEST:
        return None
    mean, known = student.mean_with_half(apart)
    half = known or 0.0
    size = f"{100 * mean:+.2g} ± {100 * half:.2g} % of the {r.what} over {len(apart)} operating points"
    level, relation, advice = "note", "is like the" if abs(mean) <= half else "differs a little from", ""
    if abs(mean) > max(half, FIRST):
        level, relation = "doubt", "differs from"
        advice = "; more cycles before the first trial would even it out"
    return Check("first_repeat", mean, "ratio", level, f"the first repeat {relation} later ones: {size}{advice}")


def drift(r: Repeats) -> Check | None:
    """Relative change from first to last trial, by a line through deviations from the points' means over time.

    The slope is that of least squares within operating points (each with its own mean). None with too few repeats, or
    where these are too close in time.
    """
    within = r.t - r.means(r.t)
    lever = float(within @ within)
    left = r.free - 1
    length = float(r.t.max() - r.t.min())
    if left < FEWEST or lever <= len(within) * (APART * length) ** 2:
        return None
    slope = float(within @ r.off) / lever
    residual = r.off - slope * within
    half = float(student.ppf(0.975, left)) * sqrt(float(residual @ residual) / left / lever) * length
    whole = slope * length
    drifts = abs(whole) > half
    size = f"{100 * whole:+.2g} ± {100 * half:.2g} % of the {r.what} from the first trial to the last"
    cause = "the specimen or a sensor drifted" if drifts else "no drift beyond the scatter"
    level = "doubt" if drifts and abs(whole) > DRIFT else "note"
    return Check("drift", whole, "ratio", level, f"{cause}: {size}")


CHANCE = 0.05
"""Significance level of the F test between sessions."""
NAME = "scatter between sessions"
WITHIN = 3
"""Degrees of freedom of the interval of a single trial, from its cycles [1]."""
CLEARER = 2.0
"""What joined sessions miss their form by beyond noise, over the worst of them by itself: less is a fault of each."""


def with_sessions(together: Analysis, alone: Sequence[Analysis]) -> Analysis:
    """The analysis of all sessions with the scatter between sessions in its intervals; `alone` has one per session.

    The half width is by Student's t over the values of the sessions, where these differ by more than repeats (F test).
    Values of a single session are not changed. A value that is withheld because the sessions do not fit together, while
    each of them gives it, is the mean of theirs; the `state` of the form is then `sessions`.
    """
    values = [{_key(e): e for e in one.estimates if e.value is not None and not e.withheld} for one in alone]
    made, apart, differ = [], list[str](), _differ(together, alone)
    for e in together.estimates:
        each = [mine[_key(e)] for mine in values if _key(e) in mine]
        if differ and e.withheld and len(each) == len(alone):
            made.append(_mean(e, each))
            continue
        half, before = _between(each), e.parts.repeats
        if e.value is None or before is None or half is None or half <= before:
            made.append(e)
            continue
        made.append(weighed(e, [Doubt(NAME, "repeats", sqrt(half**2 - before**2), False)]))
        apart.append(f"{e.symbol} (+- {show(half, e.quantity, 2)})")
    found, facts, kept = [], together.facts, list(together.findings)
    if differ:
        facts = {**facts, "form": {**facts["form"], "state": "sessions"}}
        kept = [one for one in kept if not one.text.startswith("form: ")]
        text = f"the {len(alone)} sessions do not fit one muscle, and each by itself does: values are means of theirs, "
        text += "with intervals by Student's t over sessions. Look at mounting, temperature and wear"
        found.append(Finding("doubt", text))
    if apart:
        text = f"{len(apart)} values differ between the {len(alone)} sessions by more than repeats of one session do, "
        text += f"which is in their intervals: {', '.join(apart[:3])}{', ...' if len(apart) > 3 else ''}"
        found.append(Finding("note", text))
    return replace(together, estimates=tuple(made), findings=(*kept, *found), facts=facts)


def _differ(together: Analysis, alone: Sequence[Analysis]) -> bool:
    """Whether each session has the form of the model by itself, and all of them together clearly have not."""
    whole, *each = (one.facts.get("form", {}) for one in (together, *alone))
    if whole.get("state") != "withheld" or any(form.get("state") != "sound" for form in each):
        return False
    return bool(whole["ratio_before"] ** 2 - 1 >= CLEARER * max(form["ratio"] ** 2 - 1 for form in each))


def _mean(e: Estimate, each: Sequence[Estimate]) -> Estimate:
    """A value of all sessions; what they share is not made smaller by their number."""
    mean, half = student.mean_with_half([one.value or 0.0 for one in each])

    def typical(cause: str) -> float | None:
        halves = [part for one in each if (part := getattr(one.parts, cause)) is not None]
        return float(np.mean(halves)) if halves else None

    parts = Parts(
        max(half or 0.0, (typical("repeats") or 0.0) / sqrt(len(each))),
        typical("method"), typical("calibration"), typical("skew") or 0.0, typical("drift") or 0.0,
    )  # fmt: skip
    note = f"mean of {len(each)} sessions, each by itself: they differ"
    return replace(e, value=mean, parts=parts, withheld=False, note=note)


def _key(e: Estimate) -> tuple[object, ...]:
    return e.symbol, e.method, e.coordinate, six_digits(e.at)


def _between(each: Sequence[Estimate]) -> float | None:
    """95 % half width of the mean of the sessions' values; None for one session or an insignificant difference."""
    known = [(one.value or 0.0, one.parts.repeats, one.n - 1 if one.n > 1 else WITHIN) for one in each]
    if len(known) < 2 or not all(half for _, half, _ in known):
        return None
    numbers, halves, freedoms = zip(*known, strict=True)
    within = float(np.mean((np.array(halves) / student.ppf(0.975, np.array(freedoms))) ** 2))
    from scipy.special import fdtrc

    share = fdtrc(len(numbers) - 1, sum(freedoms), float(np.var(numbers, ddof=1)) / within)
    return student.mean_with_half(numbers)[1] if share <= CHANCE else None
