"""Cuts a run's samples into trials along its events; must not know files."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pmabench.store.records import Array, Command, Event, Flags, TrialData

ENDED = ("finished", "failed", "excluded")
"""Statuses of a trial that was carried through."""
GOOD = ("finished", "excluded")
"""Those without a verdict against it; a note that leaves a trial out does not bring back an earlier attempt."""
_SLACK = 1e-6
"""Events and samples closer than this [s] are at the same time."""
_COMMAND = ("output", "type", "value", "before", "phase", "trial")


@dataclass
class _Cut:
    """A trial while its events are gathered."""

    begin: float = 0.0
    end: float | None = None
    data: Mapping[str, Any] = field(default_factory=dict)
    status: str = "interrupted"
    commands: list[Command] = field(default_factory=list)
    found: dict[str, Mapping[str, Any]] = field(default_factory=dict)


def cut_trials(
    run: str, events: Sequence[Event], t: Array, channels: Mapping[str, Array], flags: Flags, recorded_until: float
) -> tuple[TrialData, ...]:
    """The trials of a run in order; `t` [s], each of `channels` [SI] and `flags` have shape (n,).

    A trial without an end is `interrupted`, and so is one that claims to be finished after `recorded_until` [s], where
    the samples of a dead run end. A sample at which one trial ends and the next begins belongs to the first of them.
    """
    ordered = bool(np.all(t[1:] >= t[:-1])) if len(t) > 1 else True
    trials = []
    before, taken = -np.inf, 0
    for cut in _cuts(events):
        end = np.inf if cut.end is None else cut.end
        part: Any
        if ordered:
            first, last = (int(at) for at in np.searchsorted(t, [cut.begin - _SLACK, end + _SLACK]))
            part = slice(max(first, taken) if abs(cut.begin - before) <= _SLACK else first, last)
            before, taken = end, last
        else:
            part = (t >= cut.begin - _SLACK) & (t <= end + _SLACK)
        lost = cut.end is None or (cut.status == "finished" and cut.end > recorded_until)
        trials.append(
            TrialData(
                run=run,
                index=int(cut.data["trial"]),
                point={str(key): float(value) for key, value in (cut.data.get("point") or {}).items()},
                repeat=int(cut.data.get("repeat") or 0),
                reference=bool(cut.data.get("reference")),
                status="interrupted" if lost else cut.status,
                t=t[part],
                channels={name: column[part] for name, column in channels.items()},
                flags=flags[part],
                commands=tuple(cut.commands),
                found=cut.found,
                attempt=int(cut.data.get("attempt") or 1),
                again=bool(cut.data.get("again")),
            )
        )
    return supersede(trials)


def supersede(trials: Sequence[TrialData]) -> tuple[TrialData, ...]:
    """Of the attempts at one trial the last good one counts, else the last that came to an end.

    The others that came to an end are `superseded`: a repeat that failed takes nothing away.
    """
    last = {trial.index: number for number, trial in enumerate(trials) if trial.status in ENDED}
    last |= {trial.index: number for number, trial in enumerate(trials) if trial.status in GOOD}
    return tuple(
        replace(trial, status="superseded") if trial.status in ENDED and number != last[trial.index] else trial
        for number, trial in enumerate(trials)
    )


def exclude(trials: Sequence[TrialData], excluded: Collection[int]) -> tuple[TrialData, ...]:
    """The trials, with the status `excluded` where a note leaves out one that came to an end."""
    return tuple(
        replace(trial, status="excluded") if trial.index in excluded and trial.status in ENDED else trial
        for trial in trials
    )


def trial_spans(events: Sequence[Event]) -> list[tuple[float, float]]:
    """Begin and end of each trial [s]; the end is infinite where it is not known."""
    return [(cut.begin, np.inf if cut.end is None else cut.end) for cut in _cuts(events)]


def _cuts(events: Sequence[Event]) -> list[_Cut]:
    """What belongs together: a command or finding of a trial goes to its latest beginning, or to the one to come."""
    cuts: list[_Cut] = []
    latest: dict[Any, _Cut] = {}
    for event in events:
        trial = event.data.get("trial")
        if trial is None:
            continue
        cut = latest.setdefault(trial, _Cut())
        if event.kind == "trial-begin":
            if cut.data:
                cut = latest[trial] = _Cut()
            cut.begin, cut.data = event.t, event.data
            cuts.append(cut)
        elif event.kind == "trial-end":
            cut.end, cut.status = event.t, str(event.data.get("status", "finished"))
        elif event.kind == "command":
            cut.commands.append(command_of(event))
        elif event.kind == "found":
            cut.found[str(event.data.get("phase", ""))] = event.data.get("result") or {}
    return cuts


def command_of(event: Event) -> Command:
    """A `command` event as a Command; what it says besides the usual goes into `data` where it is a number."""
    data = event.data
    return Command(
        t=event.t,
        output=str(data.get("output", "")),
        kind=str(data.get("type", "set")),
        value=_number(data.get("value")),
        before=_number(data.get("before")),
        phase=str(data.get("phase", "")),
        data={key: _number(value) for key, value in data.items() if key not in _COMMAND and _is_number(value)},
    )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _number(value: Any) -> float:
    return float(value) if _is_number(value) else float("nan")
