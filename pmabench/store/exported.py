"""The record of exported samples: all that a run contains beyond its columns, as `run.json` next to them.

An import that finds it restores the same trials with commands, findings and calibrations. Knows no kind of test. A
record from outside is not trusted, and is checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, model_validator

from pmabench.store.folder import plain
from pmabench.store.json_files import read_model
from pmabench.store.records import Event, RunData, is_number

SCHEMA = "pmabench.exported-run/1"
NAME = "run.json"
Kept = Literal[
    "trial-begin",
    "trial-end",
    "command",
    "acknowledged",
    "found",
    "limit-reached",
    "valve",
    "load",
    "load-check",
    "zero-check",
]
"""Kinds of exported events: what was done to the specimen and what was found; not those of devices and operators."""
MOST_BYTES, MOST_EVENTS = 50_000_000, 1_000_000
Positive = Annotated[float, Field(ge=0)]


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False, populate_by_name=True)


class Known(_Part):
    """A channel's name, uncertainties and sensor lag [SI]."""

    channel: str
    offset_uncertainty: Positive
    gain_uncertainty: Positive
    sensor_lag: Positive


class Line(_Part):
    """One event."""

    t: Annotated[float, Field(ge=-1e9, le=1e9)]
    kind: Kept
    data: dict[str, Any]

    @model_validator(mode="after")
    def _of_a_trial(self) -> Line:
        trial, point = self.data.get("trial"), self.data.get("point") or {}
        numbered = isinstance(trial, int) and not isinstance(trial, bool) and 0 <= trial < 10**6
        if {"kind", "t", "self"} & self.data.keys() or not (numbered or trial is None):
            raise ValueError("the trial is no number, or an entry of the event is there twice")
        if self.kind == "trial-begin" and not (
            numbered
            and isinstance(point, dict)
            and all(is_number(value) and isfinite(value) for value in point.values())
        ):
            raise ValueError("a trial begins whose operating point is no numbers")
        return self


class Exported(_Part):
    """A record that was read and checked."""

    run: Annotated[str, Field(max_length=200)]
    """Name of the run that was exported."""
    kind: Annotated[str, Field(max_length=80)]
    simulated: bool
    started_utc: Annotated[str, Field(max_length=40)] = ""
    """As in the manifest; may be empty."""
    about: dict[str, Any] = {}
    """Entries of the manifest: `specimen`, `protocol`, `source`, `bench`."""
    plan: dict[str, Any] = {}
    """`settings` of the reduction and limits of acceptance, as in plan.json."""
    file: Annotated[str, Field(max_length=200)]
    """Name of the file with the samples."""
    rate: float
    """Sampling rate [Hz]."""
    columns: dict[str, Known]
    """Heading of each column -> its channel."""
    lines: Annotated[list[Line], Field(alias="events", max_length=MOST_EVENTS)]

    @property
    def events(self) -> tuple[Event, ...]:
        """The events of the run."""
        return tuple(Event(number, line.t, line.kind, line.data) for number, line in enumerate(self.lines))


def record_of(run: RunData, file: str, heads: Mapping[str, str]) -> dict[str, Any]:
    """The JSON object for samples of `run` in `file`; `heads`: heading of a column -> channel.

    A trial that a note excludes gets the status `excluded`, since notes are not exported.
    """
    excluded = {trial.index for trial in run.trials if trial.status == "excluded"}
    events = []
    for event in run.events:
        if event.kind not in get_args(Kept):
            continue
        data = dict(event.data)
        if event.kind == "trial-end" and data.get("trial") in excluded and data.get("status") in ("finished", "failed"):
            data["status"] = "excluded"
        events.append({"t": event.t, "kind": event.kind, "data": data})
    known = ("low", "high", "offset_uncertainty", "gain_uncertainty", "sensor_lag", "calibration")
    columns = {
        head: {"channel": name, **{key: getattr(run.channels[name], key) for key in known}}
        for head, name in heads.items()
    }
    found = run.manifest
    record: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "run": run.id,
            "kind": run.kind,
            "simulated": run.simulated,
            "started_utc": found.get("started_utc", ""),
            "about": {key: found.get(key) for key in ("specimen", "protocol", "source", "bench") if found.get(key)},
            "plan": {key: run.plan[key] for key in ("settings", "accept") if run.plan.get(key)},
            "file": file,
            "rate": run.rate,
            "columns": columns,
            "events": events,
        }
    )
    return record


def read_record(path: Path) -> Exported:
    """Read a record; raises InvalidFile where it is missing, of another schema, too large or damaged."""
    missing = "there is no such record of exported samples; it lies next to them as run.json"
    return read_model(Exported, path, SCHEMA, "record of exported samples", MOST_BYTES, missing)
