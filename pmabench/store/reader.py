"""Opens a run folder, closed or not, as plain records in SI; never writes into it.

Each stream is converted to the time of the run by its own clock. Trials have the sample times of the stream with
`displacement` (else `angle`, else `pressure`, else of the first); `timebase` interpolates other streams to these. The
same raw samples can be read with another calibration or shifted in time (`Recalibration`); the run is not changed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import InvalidFile, Problem, UsageError, invalid
from pmabench.base.quantities import QUANTITIES
from pmabench.store import folder as files
from pmabench.store.folder import Journal, decode_lines, is_regular, read_file, read_manifest, read_seal, status_of
from pmabench.store.livestream import FLAGS, TIME, LiveReader, numbers, pa
from pmabench.store.notes import read_notes
from pmabench.store.records import (
    UNUSABLE,
    ChannelInfo,
    ClockInfo,
    Event,
    Flag,
    Flags,
    RunData,
    TrialData,
    cut_trials,
    exclude,
    is_number,
)
from pmabench.store.seal import archived
from pmabench.store.since import late_guard, since
from pmabench.store.timebase import fit_clock, onto, stamped

if TYPE_CHECKING:
    import pandas as pd


TIMING = ("displacement", "angle", "pressure")
"""The stream with the first of these channels gives the sample times."""


def open_run(path: Path | str, *, honour_notes: bool = True, anew: Recalibration | None = None) -> RunData:
    """Load a run with all its trials; notes may exclude some of them unless `honour_notes` is False.

    `anew`: other calibrations for the same raw samples, and shifts of channels in time. Files of a closed run are
    checked against its seal. Added files are not read but listed in `since`, as are changed files that contain no
    samples. Of an unfinished run all complete batches and events are read. Raises InvalidFile for a folder that is not
    a run, is damaged, was changed, or was written by a newer pmabench.
    """
    folder = RunFiles(Path(path), anew)
    journal = folder.journal()
    events = events_of(journal)
    streams = [folder.stream(name, events) for name in folder.stream_names()]
    named = (stream for channel in TIMING for stream in streams if channel in stream.channels)
    main = next(named, streams[0] if streams else Samples.none(""))
    channels, flags, infos = dict(main.channels), main.flags, dict(main.infos)
    interpolated: dict[str, str] = {}
    for other in streams:
        infos = {**other.infos, **infos}
        wanted = {name: values for name, values in other.channels.items() if name not in channels}
        if other is not main and wanted:
            moved, flags, how = onto(main.t, flags, other.t, other.flags, wanted, other.rate)
            channels |= moved
            text = f"{how} the stream {other.name} ({other.rate:g} Hz), on the times of {main.name} ({main.rate:g} Hz)"
            interpolated |= dict.fromkeys(wanted, text) if how else {}
    until = np.inf
    if folder.seal is None or not all(stream.whole for stream in streams):
        regular = [stream for stream in streams if stream is main or stream.rate > 0 or not len(stream.t)]
        until = min((_reaches(stream) for stream in regular), default=-np.inf)
    try:
        trials = cut_trials(folder.manifest["id"], events, main.t, channels, flags, until)
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise invalid(folder.path / files.EVENTS, f"describes trials in a way that cannot be read ({error})") from error
    if folder.lines:
        trials = refound(trials, folder.lines)
    notes = read_notes(folder.path)
    if honour_notes:
        trials = exclude(trials, {note.exclude for note in notes if note.exclude is not None})
    return RunData(
        id=str(folder.manifest["id"]),
        path=str(path),
        kind=str(folder.manifest.get("kind", "")),
        status=status_of(folder.manifest, folder.seal),
        simulated=bool(folder.manifest.get("simulated")),
        manifest=folder.described(journal),
        plan=folder.plan(),
        events=events,
        channels=infos,
        rate=main.rate,
        trials=trials,
        notes=notes,
        clocks={stream.name: stream.clock for stream in streams},
        interpolated=interpolated,
        since=since(folder.path, folder.manifest, folder.seal),
    )


def _reaches(stream: Samples) -> float:
    """Time up to which a stream is certainly recorded [s]."""
    return float(stream.t[-1]) + 2.0 / stream.rate if len(stream.t) and stream.rate > 0 else -np.inf


def read_stream(path: Path | str, name: str = "", raw: bool = False) -> pd.DataFrame:
    """A whole stream (the first without a name): `t` [s], the channels [SI] and `flags`.

    With `raw` the columns are `time_ns`, the raw values of the device and `flags`. Units are in `frame.attrs["units"]`.
    Raises InvalidFile as `open_run` does.
    """
    import pandas as pd

    folder = RunFiles(Path(path))
    names = folder.stream_names()
    if not names or (name and name not in names):
        raise invalid(path, f'has no stream "{name}"; it has: {", ".join(names) or "none"}')
    samples = folder.stream(name or names[0], events_of(folder.journal()), raw)
    if raw:
        frame = pd.DataFrame({TIME: samples.t, **samples.channels, FLAGS: samples.flags})
        frame.attrs["units"] = {TIME: "ns", **samples.raw_units}
    else:
        frame = pd.DataFrame({"t": samples.t, **samples.channels, FLAGS: samples.flags})
        frame.attrs["units"] = {"t": "s", **{info.name: info.unit for info in samples.infos.values()}}
    return frame


def events_of(journal: Journal) -> tuple[Event, ...]:
    """The lines of a journal as events."""
    return tuple(Event(line["seq"], float(line["t"]), line["kind"], line["data"]) for line in journal.lines)


@dataclass(frozen=True)
class Samples:
    """One stream, loaded; arrays of shape (n,)."""

    name: str
    rate: float
    t: NDArray[Any]
    raw_units: Mapping[str, str]
    channels: Mapping[str, NDArray[Any]]
    infos: Mapping[str, ChannelInfo]
    flags: Flags
    whole: bool
    clock: ClockInfo

    @classmethod
    def none(cls, name: str) -> Samples:
        """A stream without channels and samples."""
        return cls(name, 0.0, np.empty(0), {}, {}, {}, np.empty(0, np.uint16), False, ClockInfo())


class RunFiles:
    """The files of one run, checked as they are read."""

    def __init__(self, path: Path, anew: Recalibration | None = None) -> None:
        self.path = path
        self.anew = anew or Recalibration()
        self.lines: dict[str, Line] = {}
        """Channel -> conversion from the old to the new scale, for the streams read so far."""
        self.manifest = read_manifest(path)
        self.seal = read_seal(path)

    def has(self, name: str) -> bool:
        """Whether a file is part of the run: listed in its seal, or present while the run is not closed."""
        return name in self.seal["files"] if self.seal is not None else is_regular(self.path / name)

    def read(self, name: str) -> bytes:
        """The bytes of a file; raises InvalidFile where they are not those that were written."""
        expected, most = "", None
        if self.seal is not None:
            entry = self.seal["files"].get(name) or {"sha256": "not sealed", "bytes": 0}
            expected, most = entry["sha256"], int(entry["bytes"]) + 1  # one more, to detect that it has grown
        elif name in self.manifest.get("snapshots", {}):
            expected = self.manifest["snapshots"][name]
        raw = read_file(self.path, name, most)
        if expected and hashlib.sha256(raw).hexdigest() != expected:
            raise invalid(self.path / name, "was changed after it was written; `pmabench runs verify` says more")
        return raw

    def journal(self) -> Journal:
        """The events before the first invalid line."""
        if self.seal is None and not self.has(files.EVENTS):
            return Journal(())
        return decode_lines(self.read(files.EVENTS))

    def plan(self) -> dict[str, Any]:
        """The stored plan; empty where there is none, as in most imports."""
        if not self.has(files.PLAN):
            return {}
        plan = json.loads(self.read(files.PLAN))
        return plan if isinstance(plan, dict) else {}

    def described(self, journal: Journal) -> dict[str, Any]:
        """The manifest, with entries about the end of the run."""
        guard = self.guard()
        data = {**self.manifest, **({"guard": guard} if guard else {})}
        if self.seal is None:
            return {**data, "why": journal.fault or "it was never closed"}
        kept = ("why", "end", "closed_utc", "trials_finished", "duration", "streams")
        return {**data, **{key: self.seal.get(key) for key in kept}}

    def guard(self) -> dict[str, Any]:
        """The guard's report of a vent after the program had died; empty where there is none."""
        if not self.has(files.GUARD):
            return late_guard(self.path) if self.seal is None else {}
        try:
            found = json.loads(self.read(files.GUARD))
        except ValueError as error:
            if self.seal is None:  # it may be incomplete while it is being written
                return {}
            raise invalid(self.path / files.GUARD, "is not JSON") from error
        return found if isinstance(found, dict) else {}

    def stream_names(self) -> list[str]:
        """Names of the streams, sorted."""
        if self.seal is not None:
            found = [Path(name) for name in self.seal["files"] if name.startswith(f"{files.STREAMS}/")]
        else:
            found = [path for path in (self.path / files.STREAMS).glob("*") if is_regular(path)]
        return sorted({file.stem for file in found if file.suffix in (".arrows", ".parquet")})

    def stream(self, name: str, events: tuple[Event, ...], raw: bool = False) -> Samples:
        """A stream in SI, or with `raw` as recorded, with `t` in ns; of an unsealed run its complete batches."""
        parquet, live = (f"{files.STREAMS}/{name}{suffix}" for suffix in (".parquet", ".arrows"))
        sealed = self.seal is not None
        found = (self.seal or {}).get("streams", {}).get(name, {})
        use_live = self.has(live) and not (sealed and self.has(parquet))
        data = pa.py_buffer(self.read(live if use_live else parquet))
        try:
            if use_live:
                reader = LiveReader(data)
                batches: Iterable[Any] = list(reader)
                rows, about, arrivals, whole = reader.rows, reader.about, reader.arrivals, not reader.fault
            else:
                batches, rows, about, arrivals = archived(pa.BufferReader(data))
                whole = sealed and not found.get("fault")
            device = self.manifest.get("devices", {}).get(name, {})
            clock = _clock(name, events, arrivals, own=device.get("clock", "own") == "own")
            changed, lines = self.anew.columns(about, self.path)
            self.lines |= lines
            return self.anew.moved(_filled(batches, rows, changed, clock, whole, raw))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            if use_live and (not sealed or found.get("rows", 0) is None):
                return Samples.none(name)
            raise invalid(self.path / (live if use_live else parquet), str(error)) from error


def _clock(name: str, events: tuple[Event, ...], arrivals: list[tuple[int, int]], *, own: bool) -> ClockInfo:
    """The clock of a stream from its last `clock` event, else from arrivals; without both the clocks are equal.

    `own`: the device has its own clock; otherwise the computer stamps its samples.
    """
    found = [event.data for event in events if event.kind == "clock" and event.data.get("stream") == name]
    if found:
        offset, drift, uncertainty = (float(found[-1].get(key) or 0.0) for key in ("offset", "drift", "uncertainty"))
        return ClockInfo(0, offset, drift, uncertainty, "clock event")
    return (fit_clock if own else stamped)(*zip(*arrivals, strict=True)) if arrivals else ClockInfo()


def _filled(
    batches: Iterable[Any], rows: int, about: Mapping[str, Any], clock: ClockInfo, whole: bool, raw: bool
) -> Samples:
    """The samples of batches, one after the other, so that they are in memory only once."""
    rate = float(about.get("rate") or 0.0)
    infos = {column["name"]: channel_info(column, about["stream"], rate) for column in about["columns"]}
    kinds = {column["name"]: column.get("raw_type", "float64") if raw else "float64" for column in about["columns"]}
    samples = Samples(
        name=str(about["stream"]),
        rate=rate,
        t=np.empty(rows, np.int64 if raw else np.float64),
        raw_units={column["name"]: str(column.get("raw_unit", "")) for column in about["columns"]},
        channels={name: np.empty(rows, kind) for name, kind in kinds.items()},
        infos=infos,
        flags=np.empty(rows, np.uint16),
        whole=whole,
        clock=clock,
    )
    first = 0
    for batch in batches:
        part = slice(first, first := first + batch.num_rows)
        time_ns, *values, flags = map(numbers, batch.columns)
        samples.t[part], samples.flags[part] = time_ns if raw else clock.time(time_ns), flags
        with np.errstate(all="ignore"):  # an imported file may have any values
            for (name, info), one in zip(infos.items(), values, strict=True):
                into = samples.channels[name][part]
                if raw:
                    into[...] = one
                else:
                    np.multiply(one, info.slope, out=into)
                    into += info.offset
    if first != rows:
        raise ValueError(f"has {first} of {rows} rows")
    return samples


def channel_info(column: Mapping[str, Any], stream: str, rate: float) -> ChannelInfo:
    """A channel from the description in its stream."""
    scale, calibration = column.get("scale") or {}, column.get("calibration") or {}
    quantity = str(column.get("quantity", ""))
    unsure = ("offset_uncertainty", "gain_uncertainty", "sensor_lag")
    low, high = column.get("low"), column.get("high")
    return ChannelInfo(
        name=column["name"],
        quantity=quantity,
        unit=QUANTITIES[quantity].unit if quantity in QUANTITIES else "",
        slope=float(scale.get("slope", 1.0)),
        offset=float(scale.get("offset", 0.0)),
        low=-np.inf if low is None else float(low),
        high=np.inf if high is None else float(high),
        **{name: float(calibration.get(name) or 0.0) for name in unsure},
        calibration=str(calibration.get("id") or ""),
        stream=stream,
        rate=rate,
    )


LONGEST = 60.0
"""Largest shift of a channel in time [s]."""
Line = tuple[float, float]
"""Conversion of a value [SI] from the old to the new scale: factor and offset [SI]."""


@dataclass(frozen=True)
class NewScale:
    """A linear scale from raw values to SI, and its calibration data."""

    quantity: str
    raw_unit: str
    slope: float
    offset: float
    calibration: Mapping[str, Any]
    """As in a stream's column: id, reference, date, uncertainties, sha256."""


@dataclass(frozen=True)
class Recalibration:
    """Scales and shifts in time that replace those of the record."""

    scales: Mapping[str, NewScale] = field(default_factory=dict)
    """By channel."""
    late: Mapping[str, float] = field(default_factory=dict)
    """Channel -> delay of its time stamps: values are older than stamped by this [s]."""

    def columns(self, about: Mapping[str, Any], path: object) -> tuple[dict[str, Any], dict[str, Line]]:
        """The description of a stream with the new scales, and by channel the conversion of old values.

        A zero from the session is preserved: the reading that meant 0 also means 0 on the new scale. Raises InvalidFile
        for a channel of another quantity or with another raw unit.
        """
        columns, lines = [], dict[str, Line]()
        for column in about["columns"]:
            new = self.scales.get(column["name"])
            if new is None:
                columns.append(column)
                continue
            more = "; where the unit of an import was wrong, write the right one into its map, and import again"
            for what, key, hint in (("measures", "quantity", ""), ("gives readings in", "raw_unit", more)):
                if (is_ := column.get(key)) != (wanted := getattr(new, key)):
                    text = f"{column['name']} {what} {is_ or 'nothing that is known'}, the calibration is of {wanted}"
                    raise invalid(path, text + hint)
            old = column.get("scale") or {}
            slope, offset = float(old.get("slope", 1.0)), float(old.get("offset", 0.0))
            factor = new.slope / slope
            after = offset * factor if column.get("zero") is not None else new.offset
            lines[column["name"]] = (factor, after - offset * factor)
            scale = {"slope": new.slope, "offset": after}
            columns.append({**column, "scale": scale, "calibration": dict(new.calibration)})
        return {**about, "columns": columns}, lines

    def moved(self, samples: Samples) -> Samples:
        """The samples with each late channel shifted in time, by linear interpolation.

        A value between two samples gets the flags of both that make them unusable; a row without a value gets GAP.
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
    """The trials with results of searches (such as the lift-off of a load) converted to the new scale."""

    def one(name: str, value: Any) -> Any:
        return lines[name][0] * value + lines[name][1] if name in lines and is_number(value) else value

    def of_trial(trial: TrialData) -> dict[str, Mapping[str, Any]]:
        return {phase: {name: one(name, value) for name, value in at.items()} for phase, at in trial.found.items()}

    return tuple(replace(trial, found=of_trial(trial)) for trial in trials)


def channel_for(runs: Sequence[RunData], quantity: str, name: str = "") -> str:
    """The channel for a calibration of `quantity`: `name`, or the only measured one in all runs.

    Raises UsageError where there is none or more than one.
    """
    every = {channel for run in runs for channel in run.channels.values() if channel.quantity == quantity}
    names = {channel.name for channel in every if not channel.name.endswith("_command")}
    if name and any(name in run.channels for run in runs):
        return name
    found = ", ".join(sorted(names)) or "none"
    if name:
        raise UsageError(f"no run has a channel {name}; channels that measure {quantity}: {found}")
    if len(names) != 1:
        raise UsageError(f"say CHANNEL=FILE: channels that measure {quantity}: {found}")
    return names.pop()


def refuse_loops(runs: Sequence[RunData], loops: Collection[str]) -> None:
    """Raise InvalidFile for runs whose control loop used the old calibration, so that a new one needs a new run.

    `loops`: kinds of test whose loop acts on calibrated values.
    """
    what = "is of kind {}: its loop acted on the old values; another calibration needs a new run".format
    if problems := [Problem(run.path, 0, 0, what(run.kind)) for run in runs if run.kind in loops]:
        raise InvalidFile(problems)
