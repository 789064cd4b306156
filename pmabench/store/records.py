"""Plain records of a loaded run, which analysis and report use; no file formats.

All arrays are SI on one time base; `t` counts seconds from the start of the run. Flags mark faults per sample. Trials
are cut from the samples by the events of the run.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntFlag
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from pmabench.store.since import Since

if TYPE_CHECKING:
    from pmabench.store.notes import Note

Array = NDArray[np.float64]
Flags = NDArray[np.uint16]


class Flag(IntFlag):
    """Faults of a sample; flagged samples are kept and counted, most flags exclude them from fits, none is repaired."""

    OK = 0
    GAP = 1
    """Samples are missing right before this one."""
    LATE = 2
    """Taken later than its deadline by more than half a period."""
    OVERRANGE = 4
    """A channel is at or beyond the end of its range."""
    STALE = 8
    """A channel has not changed for longer than its signal allows."""
    TIME_JUMP = 16
    """The clock went back or jumped."""
    DROPOUT = 32
    """A channel has the reading of a broken wire, or no value."""
    SLACK = 64
    """The specimen carries no force."""
    SUSPECT = 128
    """Doubtful by a check of the import."""


UNUSABLE = Flag.GAP | Flag.OVERRANGE | Flag.STALE | Flag.TIME_JUMP | Flag.DROPOUT | Flag.SUSPECT
"""Samples with one of these flags are left out of fits."""


@dataclass(frozen=True)
class Event:
    """One event of the run: time [s from the start], kind, and data in SI."""

    seq: int
    t: float
    kind: str
    data: Mapping[str, Any]


@dataclass(frozen=True)
class Command:
    """A value, ramp or sine commanded to an output [SI]."""

    t: float
    output: str
    kind: str
    """`set`, `ramp` or `sine`."""
    value: float
    """Target of a set or ramp, mean of a sine."""
    before: float
    """Value commanded before."""
    phase: str
    data: Mapping[str, float] = field(default_factory=dict)

    @property
    def recorded(self) -> bool:
        """Whether the command itself was recorded; else an import detected it in the measured channel."""
        return not self.data.get("found")


@dataclass(frozen=True)
class TrialData:
    """One trial with its samples.

    `channels` maps `pressure` [Pa], `displacement` [m, contraction positive], `force` [N], `pressure_command` [Pa],
    `displacement_command` [m] (those that the bench has) to arrays as long as `t` [s]. Where another
    stream has no value near a sample time its channels are NaN, and the sample is flagged GAP.
    """

    run: str
    index: int
    point: Mapping[str, float]
    repeat: int
    reference: bool
    status: str
    """`finished` or how it ended; `excluded` by a note, `superseded` by a later attempt."""
    t: Array
    channels: Mapping[str, Array]
    flags: Flags
    commands: tuple[Command, ...]
    found: Mapping[str, Mapping[str, Any]]
    """Results of searches, keyed by the phase of the seek."""
    attempt: int = 1
    """Number of the attempt, from 1."""
    again: bool = False
    """Whether it is a reference trial repeated by a run that continues another one: for comparison only, in no fit."""

    @property
    def number(self) -> int:
        """Number of the trial for users, from 1; the index counts from 0."""
        return self.index + 1

    @property
    def name(self) -> str:
        """`run/number`, the name of the trial in results."""
        return f"{self.run}/{self.number}"

    @cached_property
    def usable(self) -> NDArray[np.bool_]:
        """Mask of samples that may be used in a fit, shape (n,); read-only."""
        mask = np.asarray((self.flags & np.uint16(UNUSABLE)) == 0)
        mask.flags.writeable = False
        return mask


@dataclass(frozen=True)
class ChannelInfo:
    """Scale of a channel from raw values to SI, its range and uncertainties [SI]."""

    name: str
    quantity: str
    unit: str
    slope: float
    offset: float
    low: float
    high: float
    offset_uncertainty: float = 0.0
    gain_uncertainty: float = 0.0
    sensor_lag: float = 0.0
    calibration: str = ""
    stream: str = ""
    rate: float = 0.0
    """Sampling rate of its stream [Hz]; 0 if it is not regular."""


@dataclass(frozen=True)
class ClockInfo:
    """A stream's own clock against the time of the run: t = at + (1 + drift) (device - reference)."""

    reference_ns: int = 0
    """A reading of the device's clock [ns]."""
    at: float = 0.0
    """Time of the run at that reading [s]."""
    drift: float = 0.0
    """Relative rate of the time of the run compared with the device's clock, minus 1 [1]."""
    uncertainty: float = 0.0
    """Half width of the 95 % interval of t over the whole stream [s], without constant delays."""
    how: str = "stated equal"
    """Their source: `stated equal`, `clock event`, `host arrivals` (a fit), or `stamped by the computer` (polled)."""

    @property
    def offset(self) -> float:
        """Time of the run minus the device's clock, at the reference [s]."""
        return self.at - self.reference_ns / 1e9

    def time(self, device_ns: NDArray[np.int64]) -> Array:
        """Time of the run [s] at readings of the device's clock, shape (n,)."""
        if (self.reference_ns, self.at, self.drift) == (0, 0.0, 0.0):
            return np.asarray(device_ns / 1e9)
        t: Array = (device_ns - self.reference_ns) / 1e9
        t *= 1.0 + self.drift
        t += self.at
        return t


@dataclass(frozen=True)
class RunData:
    """A run, loaded."""

    id: str
    path: str
    kind: str
    status: str
    simulated: bool
    manifest: Mapping[str, Any]
    plan: Mapping[str, Any]
    events: tuple[Event, ...]
    channels: Mapping[str, ChannelInfo]
    rate: float
    trials: tuple[TrialData, ...]
    notes: tuple[Note, ...] = ()
    clocks: Mapping[str, ClockInfo] = field(default_factory=dict)
    """Stream -> its clock."""
    interpolated: Mapping[str, str] = field(default_factory=dict)
    """Channel of another stream, interpolated to the time base of the trials -> sentence that states how."""
    since: Since = field(default_factory=Since)
    """Changes after the run was sealed; not part of it."""

    def skew(self, one: str, other: str) -> float:
        """Bound (95 %) of the time skew between two channels due to the clocks of their streams [s]."""
        streams = {self.channels[name].stream for name in (one, other)}
        if len(streams) == 1:
            return 0.0
        return sum(self.clocks[stream].uncertainty for stream in streams)


ENDED = ("finished", "failed", "excluded")
"""Statuses of a completed trial."""
GOOD = ("finished", "excluded")
"""Statuses without a negative verdict; excluding a trial by a note does not restore an earlier attempt."""
_SLACK = 1e-6
"""Events and samples closer than this [s] count as simultaneous."""
_COMMAND = ("output", "type", "value", "before", "phase", "trial")


@dataclass
class _Cut:
    """A trial while its events are collected."""

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

    A trial without an end is `interrupted`, and so is one that finished after `recorded_until` [s], the end of the
    samples of an unfinished run. A sample at which one trial ends and the next begins belongs to the first.
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
                point={str(key): _rounded(value) for key, value in (cut.data.get("point") or {}).items()},
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
    """Mark all completed attempts at a trial as `superseded` except the last good one, or else the last.

    So a failed repeat does not replace a good attempt.
    """
    last = {trial.index: number for number, trial in enumerate(trials) if trial.status in ENDED}
    last |= {trial.index: number for number, trial in enumerate(trials) if trial.status in GOOD}
    return tuple(
        replace(trial, status="superseded") if trial.status in ENDED and number != last[trial.index] else trial
        for number, trial in enumerate(trials)
    )


def exclude(trials: Sequence[TrialData], excluded: Collection[int]) -> tuple[TrialData, ...]:
    """The trials, with the status `excluded` for completed ones that notes leave out."""
    return tuple(
        replace(trial, status="excluded") if trial.index in excluded and trial.status in ENDED else trial
        for trial in trials
    )


def trial_spans(events: Sequence[Event]) -> list[tuple[float, float]]:
    """Begin and end of each trial [s]; the end is infinite where unknown."""
    return [(cut.begin, np.inf if cut.end is None else cut.end) for cut in _cuts(events)]


def _cuts(events: Sequence[Event]) -> list[_Cut]:
    """Events grouped by attempt: commands and findings belong to the latest begin of their trial, or to the next."""
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
        elif event.kind == "acknowledged" and cut.commands:
            cut.commands[-1] = _sent_within(cut.commands[-1], _number(event.data.get("took")))
        elif event.kind == "found":
            cut.found[str(event.data.get("phase", ""))] = event.data.get("result") or {}
    return cuts


def _sent_within(command: Command, took: float) -> Command:
    """A command that its device received within `took` [s]: at the middle of that time, with the tolerance `late`."""
    return replace(command, t=command.t + 0.5 * took, data={**command.data, "late": 0.5 * took})


def command_of(event: Event) -> Command:
    """A `command` event as a Command; its other numeric entries go into `data`."""
    data = event.data
    return Command(
        t=event.t,
        output=str(data.get("output", "")),
        kind=str(data.get("type", "set")),
        value=_number(data.get("value")),
        before=_number(data.get("before")),
        phase=str(data.get("phase", "")),
        data={key: _number(value) for key, value in data.items() if key not in _COMMAND and is_number(value)},
    )


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a JSON value is a number; true and false are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _rounded(value: Any) -> float:
    """A coordinate rounded to twelve digits, so that 2.3 bar and 230 kPa, which differ in the last digit, are equal."""
    return float(f"{float(value):.12g}")


def _number(value: Any) -> float:
    return float(value) if is_number(value) else float("nan")
