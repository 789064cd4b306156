"""What a bench file says of safety: limits, watch list, safe state, interlocks, proof of the vent path, hands."""

from __future__ import annotations

import datetime
from typing import Annotated, Literal

from pydantic import Field, model_validator

from pmabench.bench.files import specimen as s
from pmabench.files import quantity as q
from pmabench.files.document import Strict

Action = Literal["warn", "hold", "stop", "vent"]
"""Consequence of a crossed limit: a line in the record, no new command until it is over, a controlled stop, a vent."""

WATCH_KEYS = {
    "rate": ("faster_than", "for"),
    "stale": ("for",),
    "frozen": ("for",),
    "off_range": ("for",),
    "following": ("more_than", "for"),
    "burst": ("falls", "within"),
    "slack": ("below", "for"),
}
"""Kind of watch -> its keys."""
WATCH_OPTIONAL = {("rate", "for"), ("off_range", "for"), ("slack", "for")}
UpToAMinute = Annotated[q.Time, s.within(0.0, 60.0, "time")]
"""A wait of the watch list, the safe state or the proof of the vent path; the muscle may be full meanwhile."""
Deadline = Annotated[s.TimeAbove0, s.within(0.0, 60.0, "time")]
"""The same, above zero."""
ALIASES = {"for_": "for"}
"""Field of a model -> its key in the file."""

SAFE_KEYS = {
    "set": ("to", "within"),
    "ramp_down": ("at", "to", "within"),
    "drive_quick_stop": ("within",),
    "hold": (),
    "open": ("within",),
    "close": ("within",),
    "confirm": ("below", "within"),
}
"""Action of the safe state -> its keys."""
SAFE_OPTIONAL = {("ramp_down", "to")}


class LimitFile(Strict):
    """Limits on one quantity: `command` is what may be set, `trip` what may be measured."""

    command: s.Reading | None = None
    command_low: s.Reading | None = None
    trip: s.Reading | None = None
    trip_low: s.Reading | None = None
    delay: q.Time = 0.0
    action: Action = "vent"


def one_of(model: Strict, kinds: dict[str, tuple[str, ...]], optional: set[tuple[str, str]]) -> str:
    """The kind of an entry; raises ValueError if that is not clear, a key is missing or one does not belong to it."""
    given = {ALIASES.get(name, name) for name in model.model_fields_set if getattr(model, name) is not None}
    found = [kind for kind in kinds if kind in given]
    if len(found) != 1:
        what = "none" if not found else " and ".join(f'"{kind}"' for kind in found)
        raise ValueError(f"exactly one of {', '.join(kinds)} is expected here, and there is {what}")
    kind = found[0]
    missing = [key for key in kinds[kind] if key not in given and (kind, key) not in optional]
    if missing:
        raise ValueError(f'"{kind}" needs "{missing[0]}"')
    if extra := sorted(given - {kind, "action", *kinds[kind]}):
        belongs = ", ".join(f'"{key}"' for key in kinds[kind]) or "nothing else"
        raise ValueError(f'"{extra[0]}" does not belong to "{kind}", which takes {belongs}')
    return kind


class WatchFile(Strict):
    """One thing to watch in addition to the limits; which of the kinds is given says what."""

    rate: s.Name | None = None
    stale: s.Name | None = None
    frozen: s.Name | None = None
    off_range: s.Name | None = None
    following: s.Name | None = None
    burst: s.Name | None = None
    slack: s.Name | None = None
    faster_than: s.Reading | None = None
    more_than: s.Reading | None = None
    falls: s.Reading | None = None
    below: s.Reading | None = None
    within: Deadline | None = None
    for_: Annotated[UpToAMinute | None, Field(alias="for")] = None
    action: Action

    @property
    def kind(self) -> str:
        """Kind of the entry, a key of `WATCH_KEYS`."""
        return one_of(self, WATCH_KEYS, WATCH_OPTIONAL)

    @property
    def channel(self) -> str:
        """The watched channel."""
        return str(getattr(self, self.kind))

    @model_validator(mode="after")
    def _one_kind(self) -> WatchFile:
        assert self.kind  # noqa: S101  (raises unless there is exactly one)
        return self


class SafeActionFile(Strict):
    """One ordered action of the safe state; which of the verbs is given says what."""

    set: s.Name | None = None
    ramp_down: s.Name | None = None
    drive_quick_stop: s.Name | None = None
    hold: UpToAMinute | None = None
    open: s.Name | None = None
    close: s.Name | None = None
    confirm: s.Name | None = None
    to: s.Reading | None = None
    at: s.Reading | None = None
    below: s.Reading | None = None
    within: Deadline | None = None
    """Deadline, after which the next action starts in any case."""

    @property
    def verb(self) -> str:
        """Verb of the action, a key of `SAFE_KEYS`."""
        return one_of(self, SAFE_KEYS, SAFE_OPTIONAL)

    @model_validator(mode="after")
    def _one_verb(self) -> SafeActionFile:
        assert self.verb  # noqa: S101  (raises unless there is exactly one)
        return self


class InputFile(Strict):
    """A digital input of a device."""

    device: str
    input: str


class InterlockFile(Strict):
    """A digital input that must stay at its safe level, else the guard vents and latches."""

    name: s.Name
    input: InputFile
    safe: Literal["high", "low"] = "high"


class StopFile(Strict):
    """A controlled stop: the pressure goes down at a rate, then the safe state follows."""

    ramp: s.RateAbove0


PROVEN = 0.8
"""Largest fraction of the filled pressure to which a vent path that is proven may leave it [1]."""


class ProofFile(Strict):
    """The vent path tried before each use: filled to `pressure`, it must be `below` after `within`."""

    pressure: s.PressureAbove0
    below: s.PressureAbove0
    within: Deadline
    fill: Deadline = 5.0
    """Longest time for filling."""

    @model_validator(mode="after")
    def _in_order(self) -> ProofFile:
        if self.below > PROVEN * self.pressure:
            raise ValueError(f'"below" must be at most {PROVEN:g} of "pressure": a small leak proves no vent path')
        return self


class NoWatchdogFile(Strict):
    """Who accepts that a pressurising device has no watchdog, when and why."""

    accepted_by: Annotated[str, Field(min_length=1, max_length=100)]
    date: datetime.date
    reason: Annotated[str, Field(min_length=1, max_length=400)]


class HandsFile(Strict):
    """When hands may go in."""

    below: s.PressureAbove0
    at_pressure: s.PressureNotBelow0 = 0.0
    """Highest pressure for protocols that need hands at pressure; 0: none are allowed."""
