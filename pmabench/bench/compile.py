"""Compiles bench, specimen and calibration files to one bench. Independent of the protocol.

Made of `channels` (calibrations, command limits, valves), `safety` (limits on what is measured, watch list, safe state
with its proof and interlocks), `session` and `remarks`; they share a `Compilation`. `??` as a value in a file is a
question that the lab still has to answer, never a value.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, Problem
from pmabench.bench.channels import NAME, aims, channels, numbers, outputs, valves
from pmabench.bench.compilation import Compilation, known_places, unconfirmed
from pmabench.bench.driver_options import HARDWARE, checked, driver_class
from pmabench.bench.files.bench import BenchFile, DeviceFile
from pmabench.bench.files.specimen import SpecimenFile
from pmabench.bench.interface import CompiledBench, DeviceRecord, SafeAction, ValveRecord, place
from pmabench.bench.remarks import lacks, mistaken
from pmabench.bench.safety import interlocks, proof, safe_state, setup_pressure, trips
from pmabench.bench.session import Session, lacks_session, session
from pmabench.files.document import Document, Location, read_document

OPEN = "??"
"""Placeholder for a missing value, also written by `import --guess`."""


def unfilled(bench: Path, documents: Sequence[Document]) -> list[Problem]:
    """A problem for each `??` in these files and in the calibrations next to the bench file."""
    found = [problem for document in documents for problem in _open_places(document)]
    channels = documents[0].data.get("channels")
    for channel in channels.values() if isinstance(channels, dict) else ():
        name = channel.get("calibration") if isinstance(channel, dict) else None
        if not isinstance(name, str) or not NAME.fullmatch(name):
            continue  # reported with all that is wrong with the bench
        path = bench.parent / "calibrations" / f"{name}.yaml"
        if path.is_file():
            try:
                found += _open_places(read_document(path))
            except InvalidFile:
                continue  # reported with all that is wrong with the bench
    return list(dict.fromkeys(found))


def _open_places(document: Document) -> Iterator[Problem]:
    for location in _open(document.data, ()):
        name = next((str(part) for part in reversed(location) if isinstance(part, str)), "a value")
        text = f'"{name}" is not filled in yet ({OPEN}): write here what is true at your bench'
        yield document.problem(location, text)


def _open(data: Any, at: Location) -> Iterator[Location]:
    if data == OPEN:
        yield at
    elif isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _open(value, (*at, key))


@dataclass(frozen=True)
class Mounted:
    """A bench with a specimen mounted: the compiled bench, its source files, and what it lacks."""

    bench: CompiledBench
    bench_file: BenchFile
    specimen_file: SpecimenFile
    documents: dict[str, str]
    """Name in the snapshot -> text."""
    lacks: tuple[str, ...]
    session: Session | None = None
    """The session that the bench file declares; None without one."""
    doubts: tuple[str, ...] = ()
    """Possible mistakes in the files, a line each."""
    in_session: Mapping[str, Any] | None = None
    """Session whose zeros the bench uses, as written to manifests; None without one."""
    unconfirmed: tuple[Problem, ...] = ()
    """Values that a program derived and nobody has confirmed; they must be confirmed before a run in real time."""

    def refuse_unconfirmed(self) -> None:
        """Raise `InvalidFile` with every unconfirmed value if the bench runs in real time."""
        if self.bench.realtime and self.unconfirmed:
            raise InvalidFile(self.unconfirmed)


def mount(bench_path: Path, specimen_path: Path, today: datetime.date | None = None) -> Mounted:
    """Compile a bench with a specimen mounted; raises `InvalidFile` with every problem of every file.

    Calibrations that expired before `today` are listed in `lacks`.
    """
    return _compile(_compilation([bench_path, specimen_path], today), bench_path)


def mount_alone(bench_path: Path, today: datetime.date | None = None) -> Mounted:
    """Compile a bench without a specimen, for inspection only: no limits of a specimen, and it cannot be run."""
    return _compile(_compilation([bench_path], today), bench_path)


def _compilation(paths: list[Path], today: datetime.date | None) -> Compilation:
    problems: list[Problem] = []
    documents: list[Document] = []
    for path in paths:
        try:
            documents.append(read_document(path))
        except InvalidFile as error:
            problems.extend(error.problems)
    problems += unfilled(paths[0], documents) if len(documents) == len(paths) else []
    if problems:
        raise InvalidFile(problems)
    bench, *specimens = documents
    return Compilation(bench, specimens[0] if specimens else None, today or datetime.date.today())


def _compile(c: Compilation, path: Path) -> Mounted:
    c.channels = channels(c)
    c.outputs, c.valves = outputs(c), valves(c)
    trip_records = tuple(trips(c))
    actions = safe_state(c)
    steered, platform = aims(c), numbers(c)
    missing = (*lacks(c), *lacks_session(c))
    most = setup_pressure(c)
    proof_test, before = proof(c, most), session(c, most)
    known_places(c)
    devices = tuple(_devices(c, actions))
    _refuse_twice(c, devices)
    if c.problems:
        raise InvalidFile(c.problems)
    weights = c.bench.weights
    bench = CompiledBench(
        name=c.bench.name,
        simulated=False,
        realtime=c.bench.time == "real",
        free_end=c.bench.free_end,
        devices=devices,
        trips=trip_records,
        safe_state=actions,
        hands_below=c.bench.hands.below,
        hands_at_pressure=c.bench.hands.at_pressure,
        gravity=weights.g if weights else 9.81,
        carriage=weights.carriage if weights else 0.0,
        hanging=weights is None or weights.act_as == "mass",
        load_tolerance=weights.load_tolerance if weights else 0.0,
        load_action=weights.load_action if weights else "warn",
        slack_below=c.bench.slack_below,
        length=c.length or 0.0,
        setup_pressure=most,
        stop_rate=c.bench.stop.ramp if c.bench.stop is not None else 0.0,
        proof=proof_test,
        aims=steered,
        together="platform" if platform else "",
        platform=platform,
        path=str(path.resolve()),
    )
    doubts, open_values = tuple(mistaken(c)), tuple(unconfirmed(c))
    return Mounted(bench, c.bench, c.specimen, c.texts, missing, before, doubts, unconfirmed=open_values)


def _devices(c: Compilation, actions: tuple[SafeAction, ...]) -> Iterator[DeviceRecord]:
    locked = interlocks(c)
    for name, file in c.bench.devices.items():
        try:
            driver = driver_class(file.driver)
        except ValueError as error:
            c.fault(("devices", name, "driver"), str(error))
            continue
        record = DeviceRecord(
            name,
            driver,
            file.address,
            file.options,
            tuple(channel for channel in c.channels.values() if channel.device == name),
            tuple(output for output in c.outputs.values() if output.device == name),
            tuple(_left_safe(valve, actions) for valve in c.valves.values() if valve.device == name),
            tuple(locked[name]),
            file.watchdog or 0.0,
            _verified(file),
            file.verified.firmware if file.verified is not None else "",
        )
        yield checked(c, record)


def _refuse_twice(c: Compilation, devices: Sequence[DeviceRecord]) -> None:
    """Add a problem for each address, input and output that occurs twice in the file.

    If a second regulator had a copy of the first one's address, it would never be vented, and its vent confirmed.
    """
    seen: dict[tuple[str, ...], Location] = {}

    def refuse(location: Location, *what: str) -> None:
        if (first := seen.setdefault(what, location)) != location:
            there = f'"{first[1]}" ({c.place(*first)})'
            c.fault(location, f"{' '.join(what)} is that of {there} already: one of the two is wrong")

    for device in devices:
        if where := place(device.address, device.options, resolve=False):
            refuse(("devices", device.name, "address"), where)
    for name, channel in c.bench.channels.items():
        refuse(("channels", name, "input"), "the input", f"{channel.device}.{channel.input}")
    for name, output in c.bench.outputs.items():
        refuse(("outputs", name, "output"), "the output", f"{output.device}.{output.output}")


def _verified(file: DeviceFile) -> str:
    """Statement of the bench file on how the driver was verified; empty without one."""
    if file.verified is None:
        return ""
    firmware = f", firmware {file.verified.firmware}" if file.verified.firmware else ""
    return f"{HARDWARE} ({file.verified.by}, {file.verified.date.isoformat()}{firmware})"


def _left_safe(valve: ValveRecord, actions: tuple[SafeAction, ...]) -> ValveRecord:
    """The valve with the position in which the safe state leaves it."""
    last = [action.do for action in actions if action.target == valve.name and action.do in {"open", "close"}]
    return valve if valve.longest else replace(valve, safe="closed" if last and last[-1] == "close" else "open")
