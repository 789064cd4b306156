"""The record of exported samples: what a run knows beyond its columns, as the JSON file `run.json` next to them.

An import that finds it makes the same trials again, with their commands, findings and calibrations. Knows no kind of
test; a record that was read is input from a stranger, and is checked.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, invalid
from pmabench.store.folder import plain
from pmabench.store.records import Event, RunData

SCHEMA = "pmabench.exported-run/1"
NAME = "run.json"
KEPT = frozenset(
    ("trial-begin", "trial-end", "command", "found", "limit-reached", "valve", "load", "load-check", "zero-check")
)
"""Events that say what was done to the specimen and what was found; those of devices and operators are left out."""
MOST_BYTES, MOST_EVENTS, DEEPEST = 50_000_000, 1_000_000, 12


@dataclass(frozen=True)
class Exported:
    """A record as it was read."""

    run: str
    """Name of the run that was exported."""
    kind: str
    simulated: bool
    started: str
    """UTC, as in the manifest; may be empty."""
    about: Mapping[str, Any]
    """Entries of the manifest: `specimen`, `protocol`, `source`, `bench`."""
    plan: Mapping[str, Any]
    """`settings` of the reduction and limits of acceptance, as in plan.json."""
    file: str
    """Name of the file with the samples."""
    rate: float
    """Samples a second [Hz]."""
    columns: Mapping[str, Mapping[str, Any]]
    """Head of a column -> what the record knew of its channel (`channel`, uncertainties, range) in SI."""
    events: tuple[Event, ...]


def record_of(run: RunData, file: str, heads: Mapping[str, str]) -> dict[str, Any]:
    """The JSON object for samples of `run` in `file`; `heads`: head of a column -> channel.

    A trial that a note excludes is `excluded` here, since notes are not exported.
    """
    excluded = {trial.index for trial in run.trials if trial.status == "excluded"}
    events = []
    for event in run.events:
        if event.kind not in KEPT:
            continue
        data = dict(event.data)
        if event.kind == "trial-end" and data.get("trial") in excluded and data.get("status") in ("finished", "failed"):
            data["status"] = "excluded"
        events.append({"t": event.t, "kind": event.kind, "data": data})
    columns = {}
    for head, name in heads.items():
        info = run.channels[name]
        columns[head] = {
            "channel": name,
            "low": info.low,
            "high": info.high,
            "offset_uncertainty": info.offset_uncertainty,
            "gain_uncertainty": info.gain_uncertainty,
            "sensor_lag": info.sensor_lag,
            "calibration": info.calibration,
        }
    told = run.manifest
    record: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "run": run.id,
            "kind": run.kind,
            "simulated": run.simulated,
            "started_utc": told.get("started_utc", ""),
            "about": {key: told.get(key) for key in ("specimen", "protocol", "source", "bench") if told.get(key)},
            "plan": {key: run.plan[key] for key in ("settings", "accept") if run.plan.get(key)},
            "file": file,
            "rate": run.rate,
            "columns": columns,
            "events": events,
        }
    )
    return record


def read_record(path: Path) -> Exported:
    """A record file; raises InvalidFile where it is none, is too large or is damaged."""
    try:
        if not path.is_file():
            raise invalid(path, "there is no such record of exported samples; it lies next to them as run.json")
        if path.stat().st_size > MOST_BYTES:
            raise invalid(path, f"is larger than {MOST_BYTES // 1_000_000} MB: no record of exported samples")
        data = json.loads(path.read_bytes())
    except OSError as error:
        raise invalid(path, f"cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise invalid(path, f"is not JSON ({' '.join(str(error).split())[:120]})") from error
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise invalid(path, f"is no record of exported samples: its schema is not {SCHEMA}")
    try:
        return _checked(path, data)
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise invalid(path, f"is a damaged record of exported samples ({type(error).__name__}: {error})") from error


def _checked(path: Path, data: Mapping[str, Any]) -> Exported:
    events = data["events"]
    if not isinstance(events, list) or len(events) > MOST_EVENTS:
        raise _damaged(path, "its events are no list, or too long a one")
    kept = tuple(_event(path, number, event) for number, event in enumerate(events))
    columns = data["columns"]
    for head, column in columns.items():
        numbers = [column[key] for key in ("offset_uncertainty", "gain_uncertainty", "sensor_lag")]
        if not all(_finite(number) and number >= 0 for number in numbers) or not isinstance(column["channel"], str):
            raise _damaged(path, f'column "{head[:60]}" has an uncertainty or a lag that is none')
    about, plan = data.get("about") or {}, data.get("plan") or {}
    if not isinstance(data["simulated"], bool) or not isinstance(about, dict) or not isinstance(plan, dict):
        raise _damaged(path, '"simulated", "about" or "plan" is of another kind')
    if not _finite(data["rate"]) or not _shallow(data, DEEPEST):
        raise _damaged(path, "its rate is no number, or it is nested too deeply")
    return Exported(
        run=str(data["run"])[:200],
        kind=str(data["kind"])[:80],
        simulated=data["simulated"],
        started=str(data.get("started_utc") or "")[:40],
        about=about,
        plan=plan,
        file=str(data["file"])[:200],
        rate=float(data["rate"]),
        columns=columns,
        events=kept,
    )


def _event(path: Path, number: int, event: Any) -> Event:
    t, kind, data = event["t"], event["kind"], event["data"]
    known = kind in KEPT and isinstance(data, dict) and not {"kind", "t", "self"} & data.keys()
    if not known or not _finite(t) or abs(t) > 1e9:
        raise _damaged(path, f"event {number + 1} has no time, an unknown kind or no data")
    trial = data.get("trial")
    if trial is not None and (not isinstance(trial, int) or isinstance(trial, bool) or not 0 <= trial < 10**6):
        raise _damaged(path, f"event {number + 1} is of a trial that is no number")
    if kind == "trial-begin":
        point = data.get("point") or {}
        if trial is None or not isinstance(point, dict) or not all(map(_finite, point.values())):
            raise _damaged(path, f"event {number + 1} begins a trial whose operating point is no numbers")
    return Event(number, float(t), kind, data)


def _damaged(path: Path, what: str) -> InvalidFile:
    return invalid(path, f"is a damaged record of exported samples: {what}")


def _finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _shallow(value: Any, left: int) -> bool:
    """Whether a value is nested no deeper than `left` levels."""
    if isinstance(value, dict):
        return left > 0 and all(_shallow(item, left - 1) for item in value.values())
    if isinstance(value, list):
        return left > 0 and all(_shallow(item, left - 1) for item in value)
    return True
