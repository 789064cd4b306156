"""Grouping of trials: operating points and repeats, reference trials and their drift, sessions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from pmabench.analysis.imported import in_time
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.shared.student import mean_with_half
from pmabench.base.kind import Result
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Analysis, Dropped, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData, TrialData

Members = list[tuple[RunData, TrialData]]
Point = tuple[tuple[str, float], ...]
One = TypeVar("One")
Key = TypeVar("Key")


def measured_trials(
    runs: Sequence[RunData], measure: Callable[[RunData, TrialData], One]
) -> tuple[list[One], list[Dropped]]:
    """Results of `measure` for all trials, and the trials for which it raises `NotUsable`."""
    found: list[One] = []
    dropped: list[Dropped] = []
    for run in runs:
        for trial in run.trials:
            try:
                found.append(measure(run, trial))
            except NotUsable as reason:
                dropped.append(Dropped(trial.name, trial.point, str(reason)))
    return found, dropped


@dataclass
class Reduction(Generic[One]):
    """The reduction of all trials of one kind of test: what was measured of each, and what has come out so far."""

    kind: str
    results: Sequence[Result]
    runs: Sequence[RunData]
    options: Mapping[str, Any]
    measured: list[One]
    dropped: list[Dropped]
    scales: Scales
    estimates: list[Estimate] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    traces: list[Trace] = field(default_factory=list)

    @classmethod
    def of(
        cls, kind: str, results: Sequence[Result], runs: Sequence[RunData], options: Mapping[str, Any] | None,
        measure: Callable[[RunData, TrialData, Mapping[str, Any]], One],
    ) -> Reduction[One]:  # fmt: skip
        """`measure` makes what is known of one trial; a trial for which it raises `NotUsable` is dropped."""
        options = options or {}
        measured, dropped = measured_trials(runs, lambda run, trial: measure(run, trial, options))
        return cls(kind, results, runs, options, measured, dropped, Scales.of(runs))

    def cells(self, key: Callable[[One], Key]) -> list[tuple[Key, list[One]]]:
        """What was measured at each operating point, in rising order."""
        return sorted(grouped(self.measured, key).items())

    def add(self, estimates: Iterable[Estimate], findings: Iterable[Finding], traces: Iterable[Trace]) -> None:
        """Add what came out of a part of the trials."""
        self.estimates += estimates
        self.findings += findings
        self.traces += traces

    def doubt_dropped(self) -> None:
        """Add a doubt for each trial that is not used."""
        self.findings += [Finding("doubt", f"{one.trial}: {one.reason}") for one in self.dropped]

    def note_lack(self, gains: Iterable[str], offsets: Iterable[str] = ()) -> None:
        """Add a note on channels without a recorded uncertainty (`Scales.findings`)."""
        self.findings += self.scales.findings(self.estimates, gains, offsets)

    def analysis(self, **facts: Any) -> Analysis:
        """The result, with further `facts`."""
        facts = {"options": dict(self.options), "trials": len(self.measured), **facts}
        return Analysis.of(
            self.kind, self.runs, results=self.results, estimates=self.estimates, dropped=self.dropped,
            findings=self.findings, traces=self.traces, facts=facts,
        )  # fmt: skip


def grouped(items: Iterable[One], key: Callable[[One], Key]) -> dict[Key, list[One]]:
    """Items by key, in their order."""
    groups: dict[Key, list[One]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def point_of(trial: TrialData) -> Point:
    """Operating point of a trial as a key: sorted names and values [SI] to nine decimals."""
    return tuple(sorted((name, round(value, 9)) for name, value in trial.point.items()))


def point_by(trial: TrialData, names: Sequence[str]) -> Point:
    """Entries of the operating point with these names, in the order of `names`, as a key."""
    return tuple((name, round(trial.point[name], 9)) for name in names if name in trial.point)


def six_digits(at: Mapping[str, float], without: str = "") -> Point:
    """Operating point to six digits as a key, without the entry `without`."""
    return tuple((name, float(f"{value:.6g}")) for name, value in sorted(at.items()) if name != without)


def by_point(members: Sequence[tuple[RunData, TrialData]]) -> list[tuple[dict[str, float], Members]]:
    """Operating points [SI] in rising order, each with its runs and trials in their order."""
    return [(dict(key), group) for key, group in sorted(grouped(members, lambda one: point_of(one[1])).items())]


ONE_SESSION = (
    "all tests are of one session, as far as the record shows (its start, the day of a file, its folder): scatter "
    "between sessions is in no interval; tests on another day would show it"
)


def session_of(run: RunData) -> str:
    """Identifier of the session of a run.

    The session of the bench in the manifest; for imports the day where the file gives it, else the folder; else the
    id of the run.
    """
    return session_in(run.manifest) or run.id


def session_in(manifest: Mapping[str, Any]) -> str:
    """The same by the manifest of a run; empty where it says nothing."""
    session, imported = manifest.get("session"), manifest.get("imported")
    if isinstance(session, Mapping) and session.get("at"):
        return str(session["at"])
    if isinstance(imported, Mapping):
        known = imported.get("started_known")
        return str(manifest.get("started_utc", ""))[:10] if known else str(imported.get("folder", ""))
    return ""


def mean_over_sessions(values: Sequence[float] | Array, sessions: Sequence[str]) -> tuple[float, float | None]:
    """Mean of the sessions' means and its 95 % half width by Student's t; over values where there is one session.

    The half width is None with fewer than two values.
    """
    groups = grouped(zip(map(float, values), sessions, strict=True), lambda one: one[1]).values()
    means = [float(np.mean([value for value, _ in group])) for group in groups]
    return mean_with_half(means if len(means) > 1 else [float(value) for value in values])


def mean_of_trials(
    symbol: str, kind: tuple[str, str], method: str, at: Mapping[str, float], trials: tuple[str, ...],
    values: Sequence[float] | Array, extra: float | None, calibration: float | None, once: str, more: str = "",
) -> Estimate:  # fmt: skip
    """Mean of one value per trial, with the half width from their scatter; `kind` is unit and quantity.

    `extra` is the method part. `once` is the note for a single trial, `more` any other note.
    """
    mean, half = mean_with_half(values)
    note, parts = sentences(once if half is None else "", more), Parts(half, extra, calibration)
    return Estimate(symbol, mean, *kind, method, at, parts, len(values), note=note, trials=trials)


DOUBTED = 0.02
"""Relative change of stroke from the first reference trial above which it is doubted [1]."""


@dataclass(frozen=True)
class Compared:
    """A reference trial compared with the first at the same point; strokes in m."""

    trial: TrialData
    first: float
    stroke: float

    @property
    def off(self) -> float:
        """Relative change since the first [1]."""
        return self.stroke / self.first - 1.0


def compared(runs: Sequence[RunData]) -> list[Compared]:
    """All finished reference trials but the first of each point and specimen, in order of time.

    The stroke is the contraction from rest before the first pressure command to the last fifth of the hold [m].
    """
    first: dict[tuple[object, ...], float] = {}
    found = []
    for run, trial in ((one, trial) for one in in_time(runs) for trial in one.trials):
        stroke = stroke_of(run, trial) if trial.reference and trial.status == "finished" else None
        if stroke is None:
            continue
        point = tuple(sorted((name, round(value, 3)) for name, value in trial.point.items()))
        key = (str(run.manifest.get("specimen")), point)
        if key in first:
            found.append(Compared(trial, first[key], stroke))
        elif stroke > 0:
            first[key] = stroke
    return found


def reference_findings(runs: Sequence[RunData]) -> list[Finding]:
    """Findings about reference trials: one for each repeated when a run was resumed, and one for all others."""
    every = compared(runs)
    lines = [
        _finding(one, f"the reference trial, done again when the run went on ({one.trial.name}),")
        for one in every
        if one.trial.again
    ]
    if planned := [one for one in every if not one.trial.again]:
        widest = max(planned, key=lambda one: abs(one.off))
        furthest = f"of {len(planned)} further reference trials the one that differs most"
        what = furthest if len(planned) > 1 else "the second reference trial"
        lines.append(_finding(widest, f"{what} ({widest.trial.name})"))
    return lines


def _finding(one: Compared, what: str) -> Finding:
    values = f"came to {show(one.stroke, 'length', 4)} and the first to {show(one.first, 'length', 4)}: {one.off:+.2%}"
    drifts = abs(one.off) > DOUBTED
    return Finding("doubt" if drifts else "note", f"{what} {values}{'; the specimen is not what it was' * drifts}")


def stroke_of(run: RunData, trial: TrialData) -> float | None:
    """Contraction at the end of the hold minus that at rest [m]; None without usable samples or pressure commands."""
    if "displacement" not in trial.channels:
        return None
    times = sorted(c.t for c in trial.commands if c.output == "pressure" and c.phase != "precondition")
    if len(times) < 2 or not len(trial.t):
        return None
    up, down = times[0], times[1]
    x = trial.channels["displacement"]
    rest = trial.usable & (trial.t < up) & np.isfinite(x)
    held = trial.usable & (trial.t >= down - 0.2 * (down - up)) & (trial.t < down) & np.isfinite(x)
    return float(x[held].mean() - x[rest].mean()) if rest.any() and held.any() else None


LONGEST_TRACE = 1500


def thinned(columns: Mapping[str, Array], most: int = LONGEST_TRACE) -> dict[str, Array]:
    """Columns of a figure with every n-th row, at most `most` rows."""
    stride = max(1, -(-max(map(len, columns.values()), default=0) // most))
    return {name: column[::stride] for name, column in columns.items()}
