"""Opens a run folder, closed or not, as plain records in SI; never writes into it.

Samples of a trial come from the stream that has `pressure` (else from the first); channels of other streams are added
where those have the same time stamps, and are otherwise to be had from `read_stream` only.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import invalid
from pmabench.base.quantities import QUANTITIES
from pmabench.store import folder as files
from pmabench.store.archive import read_archive
from pmabench.store.arrow import pa
from pmabench.store.folder import read_file, read_manifest, read_seal, status_of
from pmabench.store.journal import Journal, decode
from pmabench.store.livestream import FLAGS, TIME, LiveReader
from pmabench.store.records import Array, ChannelInfo, Event, Flags, RunData
from pmabench.store.trials import cut_trials

if TYPE_CHECKING:
    import pandas as pd


def open_run(path: Path | str) -> RunData:
    """Load a run with all its trials.

    Files of a closed run are checked against its seal; of a dead or running one, whole batches and events are read.
    Raises InvalidFile for what is no run, is damaged, was changed, or was written by a newer pmabench.
    """
    folder = RunFiles(Path(path))
    journal = folder.journal()
    events = events_of(journal)
    streams = [folder.stream(name, events) for name in folder.stream_names()]
    main = next((s for s in streams if "pressure" in s.channels), streams[0] if streams else Samples.none())
    channels, infos = dict(main.channels), dict(main.infos)
    for other in streams:
        infos = {**other.infos, **infos}
        if other is not main and np.array_equal(other.time_ns, main.time_ns):
            channels = {**other.channels, **channels}
    until = np.inf
    if folder.seal is None or not main.whole:
        until = float(main.t[-1]) + 2.0 / main.rate if len(main.t) and main.rate > 0 else -np.inf
    try:
        trials = cut_trials(folder.manifest["id"], events, main.t, channels, main.flags, until)
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise invalid(folder.path / files.EVENTS, f"tells trials in a way that cannot be read ({error})") from error
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
    )


def read_stream(path: Path | str, name: str = "", raw: bool = False) -> pd.DataFrame:
    """A whole stream (the first, where no name is given): `t` [s], the channels [SI] and `flags`.

    With `raw` the columns are `time_ns` and the values as the device gave them. Units stand in `frame.attrs["units"]`.
    Raises InvalidFile as `open_run` does.
    """
    import pandas as pd

    folder = RunFiles(Path(path))
    names = folder.stream_names()
    if not names or (name and name not in names):
        raise invalid(path, f'has no stream "{name}"; it has: {", ".join(names) or "none"}')
    samples = folder.stream(name or names[0], events_of(folder.journal()))
    columns: dict[str, NDArray[Any]]
    if raw:
        columns = {TIME: samples.time_ns, **samples.raw, FLAGS: samples.flags}
        units = {TIME: "ns", **samples.raw_units}
    else:
        columns = {"t": samples.t, **samples.channels, FLAGS: samples.flags}
        units = {"t": "s", **{info.name: info.unit for info in samples.infos.values()}}
    frame = pd.DataFrame(columns)
    frame.attrs["units"] = units
    return frame


def events_of(journal: Journal) -> tuple[Event, ...]:
    """The lines of a journal as events."""
    return tuple(Event(line["seq"], float(line["t"]), line["kind"], line["data"]) for line in journal.lines)


@dataclass(frozen=True)
class Samples:
    """One stream, loaded; arrays of shape (n,)."""

    rate: float
    time_ns: NDArray[np.int64]
    t: Array
    raw: Mapping[str, NDArray[Any]]
    raw_units: Mapping[str, str]
    channels: Mapping[str, Array]
    infos: Mapping[str, ChannelInfo]
    flags: Flags
    whole: bool

    @classmethod
    def none(cls) -> Samples:
        """No sample of no channel."""
        return cls(0.0, np.empty(0, np.int64), np.empty(0), {}, {}, {}, {}, np.empty(0, np.uint16), False)


class RunFiles:
    """The files of one run, checked as they are read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.manifest = read_manifest(path)
        self.seal = read_seal(path)

    def read(self, name: str) -> bytes:
        """The bytes of a file, as they were sealed."""
        raw = read_file(self.path, name)
        expected = ""
        if self.seal is not None:
            entry = self.seal["files"].get(name)
            expected = entry["sha256"] if entry else "not sealed"
        elif name in self.manifest.get("snapshots", {}):
            expected = self.manifest["snapshots"][name]
        if expected and hashlib.sha256(raw).hexdigest() != expected:
            raise invalid(self.path / name, "was changed after it was written; `pmabench runs verify` tells more")
        return raw

    def journal(self) -> Journal:
        """The events; of an unsealed run those before the first that is not whole."""
        if not (self.path / files.EVENTS).exists() and self.seal is None:
            return Journal(())
        return decode(self.read(files.EVENTS))

    def plan(self) -> dict[str, Any]:
        """The plan as it was kept; empty where there is none, as in imports."""
        if not (self.path / files.PLAN).exists():
            return {}
        plan = json.loads(self.read(files.PLAN))
        return plan if isinstance(plan, dict) else {}

    def described(self, journal: Journal) -> dict[str, Any]:
        """The manifest with how the run ended."""
        if self.seal is None:
            return {**self.manifest, "why": journal.fault or "it was never closed"}
        told = ("why", "end", "closed_utc", "trials_finished", "duration", "streams")
        return {**self.manifest, **{key: self.seal.get(key) for key in told}}

    def stream_names(self) -> list[str]:
        """Names of the streams, sorted."""
        found = (self.path / files.STREAMS).glob("*")
        return sorted({file.stem for file in found if file.suffix in (".arrows", ".parquet")})

    def stream(self, name: str, events: tuple[Event, ...]) -> Samples:
        """A stream in SI; of an unsealed run as far as its batches are whole."""
        parquet, live = (f"{files.STREAMS}/{name}{suffix}" for suffix in (".parquet", ".arrows"))
        sealed = self.seal is not None
        use_live = (self.path / live).exists() and not (sealed and (self.path / parquet).exists())
        raw = pa.py_buffer(self.read(live if use_live else parquet))
        try:
            if use_live:
                reader = LiveReader(raw)
                table, about = pa.Table.from_batches(list(reader), reader.schema), reader.about
                whole = not reader.fault
            else:
                table, about = read_archive(pa.BufferReader(raw))
                whole = sealed and not (self.seal or {})["streams"].get(name, {}).get("fault")
            return _in_si(table, about, [e.data for e in events if e.kind == "clock"], whole)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            if use_live and not sealed:
                return Samples.none()
            raise invalid(self.path / (live if use_live else parquet), str(error)) from error


def _in_si(table: Any, about: Mapping[str, Any], clocks: list[Mapping[str, Any]], whole: bool) -> Samples:
    """Device time becomes seconds of the run with the last `clock` event of the stream: (1 + drift) t + offset."""
    columns = {name: table.column(name).combine_chunks().to_numpy() for name in table.column_names}
    time_ns = columns.pop(TIME)
    flags = columns.pop(FLAGS)
    t = time_ns / 1e9
    for clock in clocks:
        if clock.get("stream") == about["stream"]:
            t = time_ns / 1e9 * (1.0 + float(clock.get("drift") or 0.0)) + float(clock.get("offset") or 0.0)
    infos = {column["name"]: _info(column) for column in about["columns"]}
    with np.errstate(all="ignore"):  # an imported file may hold any bits
        channels = {name: values * infos[name].slope for name, values in columns.items()}
        for name, values in channels.items():
            values += infos[name].offset
    return Samples(
        rate=float(about.get("rate") or 0.0),
        time_ns=time_ns,
        t=t,
        raw=columns,
        raw_units={column["name"]: str(column.get("raw_unit", "")) for column in about["columns"]},
        channels=channels,
        infos=infos,
        flags=flags,
        whole=whole,
    )


def _info(column: Mapping[str, Any]) -> ChannelInfo:
    scale, calibration = column.get("scale") or {}, column.get("calibration") or {}
    quantity = str(column.get("quantity", ""))
    return ChannelInfo(
        name=column["name"],
        quantity=quantity,
        unit=QUANTITIES[quantity].unit if quantity in QUANTITIES else "",
        slope=float(scale.get("slope", 1.0)),
        offset=float(scale.get("offset", 0.0)),
        low=_limit(column.get("low"), -np.inf),
        high=_limit(column.get("high"), np.inf),
        offset_uncertainty=float(calibration.get("offset_uncertainty") or 0.0),
        gain_uncertainty=float(calibration.get("gain_uncertainty") or 0.0),
        sensor_lag=float(calibration.get("sensor_lag") or 0.0),
        calibration=str(calibration.get("id") or ""),
    )


def _limit(value: Any, otherwise: float) -> float:
    return otherwise if value is None else float(value)
