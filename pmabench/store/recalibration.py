"""The same raw samples with another calibration, or moved in time: a view of a run, which itself is never touched.

Knows the columns of a stream and its samples; not the files that calibrations are written in.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pmabench.base.errors import InvalidFile, Problem, UsageError, invalid
from pmabench.store.records import UNUSABLE, Flag, RunData, TrialData

if TYPE_CHECKING:
    from pmabench.store.reader import Samples

LONGEST = 60.0
"""Most that a channel can be moved in time [s]."""
Line = tuple[float, float]
"""What becomes of a value [SI] of the old scale: factor and summand."""


@dataclass(frozen=True)
class NewScale:
    """A straight line from raw to SI, and what is known of it."""

    quantity: str
    raw_unit: str
    slope: float
    offset: float
    calibration: Mapping[str, Any]
    """As a stream's column has it: id, reference, date, uncertainties, sha256."""


@dataclass(frozen=True)
class Recalibration:
    """What is to be taken otherwise than it was recorded."""

    scales: Mapping[str, NewScale] = field(default_factory=dict)
    """By channel."""
    late: Mapping[str, float] = field(default_factory=dict)
    """Channel -> how much older its values are than their time stamps [s]."""

    def columns(self, about: Mapping[str, Any], path: object) -> tuple[dict[str, Any], dict[str, Line]]:
        """What a stream says of its columns, with the new scales, and what becomes of old values by channel.

        A zero that the session took stays what it was: the reading that stood for 0 does so on the new scale.
        Raises InvalidFile for a channel of another quantity, or whose readings have another unit.
        """
        columns, lines = [], dict[str, Line]()
        for column in about["columns"]:
            new = self.scales.get(column["name"])
            if new is None:
                columns.append(column)
                continue
            for what, is_, wanted in (
                ("measures", column.get("quantity"), new.quantity),
                ("gives readings in", column.get("raw_unit"), new.raw_unit),
            ):
                if is_ != wanted:
                    text = f"{column['name']} {what} {is_ or 'nothing that is known'}, the calibration is of {wanted}"
                    raise invalid(path, text)
            old = column.get("scale") or {}
            slope, offset = float(old.get("slope", 1.0)), float(old.get("offset", 0.0))
            factor = new.slope / slope
            after = offset * factor if column.get("zero") is not None else new.offset
            lines[column["name"]] = (factor, after - offset * factor)
            scale = {"slope": new.slope, "offset": after}
            columns.append({**column, "scale": scale, "calibration": dict(new.calibration)})
        return {**about, "columns": columns}, lines

    def moved(self, samples: Samples) -> Samples:
        """The samples with each late channel read where its values belong, by straight lines between samples.

        A row whose value lies between two of which one is flagged carries that flag; where there is none, GAP.
        """
        late = {name: self.late[name] for name in samples.channels if self.late.get(name)}
        if not late or len(samples.t) < 2:
            return samples
        channels, flags = dict(samples.channels), samples.flags.copy()
        for name, by in late.items():
            at = samples.t + by
            after = np.clip(np.searchsorted(samples.t, at), 1, len(samples.t) - 1)
            channels[name] = np.interp(at, samples.t, samples.channels[name])
            flags |= (samples.flags[after - 1] | samples.flags[after]) & np.uint16(UNUSABLE)
            flags[(at < samples.t[0]) | (at > samples.t[-1])] |= np.uint16(Flag.GAP)
        return replace(samples, channels=channels, flags=flags)


def refound(trials: Sequence[TrialData], lines: Mapping[str, Line]) -> tuple[TrialData, ...]:
    """The trials with what searches found of a channel (its value where a load lifted off) on the new scale."""

    def one(name: str, value: Any) -> Any:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        return lines[name][0] * value + lines[name][1] if name in lines and number else value

    return tuple(
        replace(
            trial,
            found={
                phase: {name: one(name, value) for name, value in found.items()} for phase, found in trial.found.items()
            },
        )
        for trial in trials
    )


def channel_for(runs: Sequence[RunData], quantity: str, name: str = "") -> str:
    """The channel that a calibration of `quantity` is for: `name`, or the only measured one of every run.

    Raises UsageError where that is none or several.
    """
    names = {
        channel.name
        for run in runs
        for channel in run.channels.values()
        if channel.quantity == quantity and not channel.name.endswith("_command")
    }
    if name and any(name in run.channels for run in runs):
        return name
    found = ", ".join(sorted(names)) or "none"
    if name:
        raise UsageError(f"no run has a channel {name}; channels that measure {quantity}: {found}")
    if len(names) != 1:
        raise UsageError(f"say CHANNEL=FILE: channels that measure {quantity}: {found}")
    return names.pop()


def refuse_loops(runs: Sequence[RunData], loops: Collection[str]) -> None:
    """Raise InvalidFile for runs whose results rest on what a loop did with the values that it was given.

    `loops`: the kinds of test whose loop acts on calibrated values.
    """
    problems: list[Problem] = []
    for run in runs:
        if run.kind in loops:
            what = f"is of kind {run.kind}: its loop acted on the old values; another calibration needs a new run"
            problems.extend(invalid(run.path, what).problems)
    if problems:
        raise InvalidFile(problems)
