"""What a bench file says about safety: limits, watch list, interlocks, safe state, proof of the vent path."""

from __future__ import annotations

import datetime
from typing import Annotated, Literal

from pydantic import Field, model_validator

from pmabench.bench.files.parts import Name, PressureAbove0, PressureNotBelow0, RateAbove0, Reading, Text, TimeAbove0
from pmabench.files.document import Strict
from pmabench.files.quantity import Time

Action = Literal["warn", "hold", "stop", "vent"]
"""What follows a crossed limit: a line in the record, no new command until it is over, a controlled stop, a vent."""

WATCH_KEYS = {
    "rate": ("faster_than", "for"),
    "stale": ("for",),
    "frozen": ("for",),
    "off_range": ("for",),
    "following": ("more_than", "for"),
    "burst": ("falls", "within"),
    "slack": ("below", "for"),
}
"""Kind of watch -> the keys that belong to it."""
WATCH_OPTIONAL = {("rate", "for"), ("off_range", "for"), ("slack", "for")}
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
"""Action of the safe state -> the keys that belong to it."""
SAFE_OPTIONAL = {("ramp_down", "to")}


class LimitFile(Strict):
    """Limits on one quantity: `command` is what may be set, `trip` what may be measured."""

    command: Reading | None = None
    command_low: Reading | None = None
    trip: Reading | None = None
    trip_low: Reading | None = None
    delay: Time = 0.0
    action: Action = "vent"


def one_of(model: Strict, kinds: dict[str, tuple[str, ...]], optional: set[tuple[str, str]]) -> str:
    """The one kind of an entry, all of whose keys are given and no others; ValueError in words where it is not so."""
    given = {ALIASES.get(name, name) for name in model.model_fields_set if getattr(model, name) is not None}
    found = [kind for kind in kinds if kind in given]
    if len(found) != 1:
        what = "none" if not found else " and ".join(f'"{kind}"' for kind in found)
        raise ValueError(f"exactly one of {', '.join(kinds)} is expected here, and there is {what}")
    kind = found[0]
    missing = [key for key in kinds[kind] if key not in given and (kind, key) not in optional]
    if missing:
        raise ValueError(f'"{kind}" needs "{missing[0]}"')
    extra = sorted(given - {kind, "action", *kinds[kind]})
    if extra:
        belongs = ", ".join(f'"{key}"' for key in kinds[kind]) or "nothing else"
        raise ValueError(f'"{extra[0]}" does not belong to "{kind}", which takes {belongs}')
    return kind


class WatchFile(Strict):
    """One thing to watch besides the limits; which of the kinds is given says what."""

    rate: Name | None = None
    stale: Name | None = None
    frozen: Name | None = None
    off_range: Name | None = None
    following: Name | None = None
    burst: Name | None = None
    slack: Name | None = None
    faster_than: Reading | None = None
    more_than: Reading | None = None
    falls: Reading | None = None
    below: Reading | None = None
    within: TimeAbove0 | None = None
    for_: Annotated[Time | None, Field(alias="for")] = None
    action: Action

    @property
    def kind(self) -> str:
        """Key of `WATCH_KEYS`."""
        return one_of(self, WATCH_KEYS, WATCH_OPTIONAL)

    @property
    def channel(self) -> str:
        """The channel that is watched."""
        return str(getattr(self, self.kind))

    @model_validator(mode="after")
    def _one_kind(self) -> WatchFile:
        assert self.kind  # noqa: S101  (raises where there is not exactly one)
        return self


class SafeActionFile(Strict):
    """One ordered action of the safe state; which of the verbs is given says what."""

    set: Name | None = None
    ramp_down: Name | None = None
    drive_quick_stop: Name | None = None
    hold: Time | None = None
    open: Name | None = None
    close: Name | None = None
    confirm: Name | None = None
    to: Reading | None = None
    at: Reading | None = None
    below: Reading | None = None
    within: TimeAbove0 | None = None
    """Deadline; the next action follows then at the latest."""

    @property
    def verb(self) -> str:
        """Key of `SAFE_KEYS`."""
        return one_of(self, SAFE_KEYS, SAFE_OPTIONAL)

    @model_validator(mode="after")
    def _one_verb(self) -> SafeActionFile:
        assert self.verb  # noqa: S101  (raises where there is not exactly one)
        return self


class InputFile(Strict):
    """A digital input of a device."""

    device: str
    input: str


class InterlockFile(Strict):
    """A digital input that must stay at its safe level, else the guard vents and latches."""

    name: Name
    input: InputFile
    safe: Literal["high", "low"] = "high"


class StopFile(Strict):
    """A controlled stop: the pressure goes down at a rate, then the safe state follows."""

    ramp: RateAbove0


class ProofFile(Strict):
    """The vent path tried before each use: filled to `pressure`, it must be `below` after `within`."""

    pressure: PressureAbove0
    below: PressureAbove0
    within: TimeAbove0
    fill: TimeAbove0 = 5.0
    """Longest time to fill."""

    @model_validator(mode="after")
    def _in_order(self) -> ProofFile:
        if self.below >= self.pressure:
            raise ValueError('"below" must lie under "pressure", else nothing is proven')
        return self


class NoWatchdogFile(Strict):
    """Who accepts that a pressurising device has no watchdog, when and why."""

    accepted_by: Annotated[str, Field(min_length=1, max_length=100)]
    date: datetime.date
    reason: Annotated[str, Field(min_length=1, max_length=400)]


class HandsFile(Strict):
    """When hands may go in."""

    below: PressureAbove0
    at_pressure: PressureNotBelow0 = 0.0
    """Highest pressure for protocols that need hands at pressure; 0: none are allowed."""


class ReviewFile(Strict):
    """Who read the bench file over, and when."""

    by: Text
    date: datetime.date | Text
