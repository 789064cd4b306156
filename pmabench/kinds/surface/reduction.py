"""All slow tests of a specimen to one muscle: rows from each kind of test, the fit, values, sentences, loops.

Which rows a run has is said by its kind of test; this room names none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.surface.choice import Choice, Score, choose
from pmabench.analysis.surface.fit import Data
from pmabench.analysis.surface.muscle import ALWAYS
from pmabench.analysis.surface.record import RATE, Record
from pmabench.base.quantities import show
from pmabench.kinds.surface import RESULTS
from pmabench.kinds.surface.values import estimates, tested
from pmabench.store.analyses.results import Analysis, Dropped, Finding, Trace
from pmabench.store.records import RunData, TrialData

KIND = "surface"
MOST_ROWS = 60_000
"""Rows above which they are taken less often."""
SLACK = 0.02
"""Share of the largest force below which the muscle hangs slack, or nearly: these rows do not count."""
FEWEST = 3
"""Trials that a surface needs."""
PAUSE = 15.0
"""Time between two trials [s] up to which the muscle is taken to go straight from the end of one to the other; after a
longer one, in which it may have been vented, the next trial begins anew.
"""
LOOPS, POINTS = 8, 1200
"""Most measured loops that are drawn, and points of each."""
Rows = Callable[[RunData, TrialData, float], Record | str]


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Force F [N] and stiffness K [N/m] at places, loops H [N] and W [J], damping [N.s/m] and creep of one muscle.

    `options`: `rows`, kind of run -> the function that makes a `Record` of a trial of it, or a sentence why there is
    none; runs of other kinds tell nothing here.
    """
    rows: Mapping[str, Rows] = (options or {}).get("rows", {})
    records, dropped = records_of(runs, rows)
    if len(records) < FEWEST:
        text = (
            f"a surface needs at least {FEWEST} trials with force, pressure and contraction; there are {len(records)}"
        )
        return Analysis.of(KIND, runs, results=RESULTS, dropped=dropped, findings=[Finding("fault", text)])
    choice = choose(Data.of(records))
    scales = Scales.of(runs)
    lack = scales.lack(("force",))
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=estimates(choice, scales),
        dropped=dropped,
        findings=[*sentences(choice), *([Finding("note", lack)] if lack else [])],
        traces=loops(choice),
        facts=facts(choice),
    )


def records_of(runs: Sequence[RunData], rows: Mapping[str, Rows]) -> tuple[list[Record], list[Dropped]]:
    """The slow rows of all finished trials, and the trials that have none."""
    trials = [(run, trial) for run in runs if run.kind in rows for trial in run.trials if not trial.again]
    seconds = sum(float(trial.t[-1] - trial.t[0]) for _, trial in trials if len(trial.t))
    rate = min(RATE, MOST_ROWS / max(seconds, 1.0))
    found: list[Record] = []
    dropped = []
    before: tuple[str, float] = "", 0.0
    for run, trial in trials:
        one = rows[run.kind](run, trial, rate) if trial.status == "finished" else f"it is {trial.status}"
        if isinstance(one, str):
            dropped.append(Dropped(trial.name, trial.point, one))
        else:
            found.append(replace(one, goes_on=run.id == before[0] and one.t[0] - before[1] < PAUSE))
            before = run.id, float(one.t[-1])
    largest = max((float(np.max(one.F)) for one in found), default=0.0)
    found = [replace(one, used=one.used & (one.F > SLACK * largest)) for one in found]
    return found, dropped


def sentences(choice: Choice) -> list[Finding]:
    """How well left-out trials are predicted, which terms are needed, and what cannot be told."""
    full = choice.data.largest
    best = choice.score
    named = ", ".join(best.terms[len(ALWAYS) :]) or "neither hysteresis nor creep"
    found = [
        Finding(
            "note",
            f"trials that were left out are predicted to {_share(best, full)}, with {named}; by the smooth surface "
            f"and damping alone to {_share(choice.plain, full)}, by straight lines over contraction to "
            f"{_share(choice.straight, full)}",
        )
    ]
    for taken, other in choice.undecided:
        found.append(
            Finding(
                "doubt",
                f"{taken} explains the difference between both ways, and {other} in its place does nearly as well: one "
                "cycle at one speed does not tell hysteresis from creep. Add small loops inside the large one, another "
                "speed, and holds of at least 30 s",
            )
        )
    if any(record.by_hand for record in choice.data.records):
        text = "lengths were set by hand: the force of each trial has a constant of its own, which is fitted"
        found.append(Finding("note", text))
    return found


def _share(score: Score, full: float) -> str:
    return f"{show(score.rms, 'force', 2)} rms ({100 * score.rms / full:.2g} % of {show(full, 'force', 4)})"


def facts(choice: Choice) -> dict[str, Any]:
    """What was fitted, in numbers."""
    frame = choice.data.frame
    return {
        "trials": len(choice.data.records),
        "rows": int(choice.data.rows.used.sum()),
        "pressure": [frame.P.low, frame.P.high],
        "contraction": [frame.x.low, frame.x.high],
        "tested": tested(choice).ranges(frame),
        "terms": list(choice.terms),
        "held_out_rms": choice.score.rms,
        "straight_form_rms": choice.straight.rms,
        "smoothness": choice.score.smooth,
        "tried": [{"terms": list(score.terms), "held_out_rms": score.rms} for score in choice.tried],
        "undecided": [list(pair) for pair in choice.undecided],
        "muscle": choice.muscle.identified("surface").to_dict(),
        "straight_form": choice.lines.straight_form(),
    }


def loops(choice: Choice) -> list[Trace]:
    """Measured force of trials that move at one pressure, and that of the muscle."""
    span = choice.data.frame.x.span
    moving = [one for one in choice.data.records if span > 0 and np.ptp(one.x[one.used]) > 0.25 * span]
    every = choice.muscle.force(choice.data.records)
    ends = np.cumsum([0, *(len(one.t) for one in choice.data.records)])
    found: list[Trace] = []
    for number, one in enumerate(choice.data.records):
        if one not in moving or len(found) >= LOOPS:
            continue
        step = max(1, int(one.used.sum()) // POINTS)
        kept = np.flatnonzero(one.used)[::step]
        found.append(
            Trace(
                f"loop-{number}-surface",
                "loop",
                f"Force over contraction, {one.group}",
                {"displacement": one.x[kept], "force": one.F[kept], "model": every[ends[number] :][kept]},
                {"displacement": "length", "force": "force", "model": "force"},
                {"pressure": float(np.median(one.P))},
            )
        )
    return found
