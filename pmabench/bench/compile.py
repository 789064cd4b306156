"""Bench, specimen and calibration files to one compiled bench: scales, nested limits, trips, safe state.

A limit is the intersection of what device, bench and specimen allow; the binding one is named with its place.
Knows no protocol.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, Problem, did_you_mean
from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.bench.calibration import Calibration, document_text, fit_line, read_calibration
from pmabench.bench.files import BenchFile, LimitFile, SpecimenFile
from pmabench.bench.interface import (
    CalibrationRecord,
    ChannelRecord,
    CompiledBench,
    DeviceRecord,
    OutputRecord,
    SafeAction,
    Scale,
    TripRecord,
)
from pmabench.bench.registry import driver_class
from pmabench.files.document import Document, Location, read_document, validate
from pmabench.files.quantity import unit_factor

LONGEST_DELAY = 1.0
"""Longest delay of a trip [s]."""

LIMIT_CHANNEL = {
    "pressure": "pressure",
    "force": "force",
    "contraction": "displacement",
    "displacement": "displacement",
}


@dataclass(frozen=True)
class Mounted:
    """A bench with a specimen in it: the compiled bench, the files it was made of, and what it lacks."""

    bench: CompiledBench
    bench_file: BenchFile
    specimen_file: SpecimenFile
    documents: dict[str, str]
    """Name in the snapshot -> text."""
    lacks: tuple[str, ...]


class _Compiler:
    def __init__(self, bench: Document, specimen: Document, folder: Path) -> None:
        self.bench_document, self.specimen_document, self.folder = bench, specimen, folder
        self.problems: list[Problem] = []
        self.documents = {"bench.yaml": document_text(bench), "specimen.yaml": document_text(specimen)}
        files: list[Any] = []
        for model, document in ((BenchFile, bench), (SpecimenFile, specimen)):
            try:
                files.append(validate(model, document))
            except InvalidFile as error:
                self.problems.extend(error.problems)
        if self.problems:
            raise InvalidFile(self.problems)
        self.bench: BenchFile = files[0]
        self.specimen: SpecimenFile = files[1]

    def fault(self, location: Location, message: str, *, specimen: bool = False, key: bool = False) -> None:
        document = self.specimen_document if specimen else self.bench_document
        self.problems.append(document.problem(location, message, key=key))

    def si(self, reading: tuple[float, str], quantity: str, location: Location) -> float:
        try:
            return reading[0] * unit_factor(reading[1], quantity)
        except ValueError as error:
            self.fault(location, str(error))
            return 0.0

    # -- channels -----------------------------------------------------------------------------------------------

    def calibration(self, name: str, quantity: str, location: Location) -> Calibration:
        places = [self.folder / "calibrations" / f"{name}.yaml", self.folder.parent / "calibrations" / f"{name}.yaml"]
        path = next((place for place in places if place.is_file()), None)
        if path is None:
            near = sorted(
                file.stem for place in places if place.parent.is_dir() for file in place.parent.glob("*.yaml")
            )
            self.fault(location, f'no calibration "{name}" in calibrations/{did_you_mean(name, near)}')
            return Calibration()
        try:
            found = read_calibration(path, quantity)
        except InvalidFile as error:
            self.problems.extend(error.problems)
            return Calibration()
        self.documents[f"calibrations/{name}.yaml"] = found.text
        return found

    def channel(self, name: str) -> ChannelRecord | None:
        file = self.bench.channels[name]
        at: Location = ("channels", name)
        quantity = CHANNEL_QUANTITY.get(name)
        if quantity is None:
            self.fault(at, f'no channel is called "{name}"{did_you_mean(name, CHANNEL_QUANTITY)}', key=True)
            return None
        if file.device not in self.bench.devices:
            self.fault((*at, "device"), f'no device "{file.device}"{did_you_mean(file.device, self.bench.devices)}')
        if file.calibration is not None:
            found = self.calibration(file.calibration, quantity, (*at, "calibration"))
            scale, record, raw_unit = found.scale, found.record, found.raw_unit
        else:
            raw_unit, record = file.unit or "", CalibrationRecord()
            scale = Scale(self.si((1.0, raw_unit), quantity, (*at, "unit")) or 1.0, 0.0)
        ends: list[float] = []
        for index, reading in enumerate(file.range):
            if reading[1] == raw_unit:
                ends.append(scale.to_si(reading[0]))
            else:
                ends.append(self.si(reading, quantity, (*at, "range", index)))
        low, high = min(ends), max(ends)
        if low == high:
            self.fault((*at, "range"), "the two ends are the same")
        raw_type = "int32" if raw_unit in {"count", "counts"} else "float64"
        return ChannelRecord(
            name, quantity, file.device, file.input, raw_type, raw_unit, scale, low, high, file.reference, record
        )

    # -- outputs and limits -----------------------------------------------------------------------------------

    def output(self, name: str) -> OutputRecord | None:
        file = self.bench.outputs[name]
        at: Location = ("outputs", name)
        quantity = CHANNEL_QUANTITY.get(name)
        if quantity is None or name not in {"pressure", "displacement"}:
            self.fault(at, f'no output is called "{name}"{did_you_mean(name, ["pressure", "displacement"])}', key=True)
            return None
        if file.device not in self.bench.devices:
            self.fault((*at, "device"), f'no device "{file.device}"{did_you_mean(file.device, self.bench.devices)}')
        raw_unit = file.scale[0][0][1]
        points = [(r[0], self.si(v, quantity, (*at, "scale", i, 1))) for i, (r, v) in enumerate(file.scale)]
        if file.scale[1][0][1] != raw_unit:
            self.fault((*at, "scale", 1, 0), f"both device values in one unit, here {raw_unit}")
        if points[0][0] == points[1][0] or points[0][1] == points[1][1]:
            self.fault((*at, "scale"), "the two points do not make a line")
            return None
        scale = fit_line([p[0] for p in points], [p[1] for p in points])
        resolution = 0.0
        if file.resolution is not None:
            resolution = file.resolution[0]
            if file.resolution[1] != raw_unit or resolution <= 0:
                self.fault((*at, "resolution"), f"a step above zero in {raw_unit} is expected")
        safe = 0.0 if file.safe is None else self.si(file.safe, quantity, (*at, "safe"))
        lows = [(min(p[1] for p in points), self.bench_document.where((*at, "scale")))]
        highs = [(max(p[1] for p in points), self.bench_document.where((*at, "scale")))]
        limit = self.bench.limits.get("pressure" if name == "pressure" else "displacement")
        where: Location = ("limits", name)
        if limit is None or limit.command is None:
            self.fault(("limits",), f'the output "{name}" has no command limit; add "{name}: {{command: ...}}"')
        else:
            highs.append((self.si(limit.command, quantity, (*where, "command")), self.place(*where, "command")))
        if limit is not None and limit.command_low is not None:
            lows.append(
                (self.si(limit.command_low, quantity, (*where, "command_low")), self.place(*where, "command_low"))
            )
        if name == "pressure":
            place = self.specimen_document.where(("limits", "pressure", "command"))
            highs.append((self.specimen.limits.pressure.command, place))
        if self.bench.actuator is not None and name == "displacement":
            stroke = self.bench.actuator.stroke
            lows.append((stroke[0], self.place("actuator", "stroke", 0)))
            highs.append((stroke[1], self.place("actuator", "stroke", 1)))
        (low, low_from), (high, high_from) = max(lows), min(highs)
        if low >= high:
            self.fault(where, f"nothing may be commanded: {show(low, quantity)} up to {show(high, quantity)}")
        if not low <= safe <= high:
            self.fault((*at, "safe"), f"the safe value {show(safe, quantity)} is outside the command limits")
        rate = self.bench.actuator.speed if self.bench.actuator and name == "displacement" else 0.0
        return OutputRecord(
            name, quantity, file.device, file.output, scale, resolution, safe, low, high, low_from, high_from, rate
        )

    def place(self, *location: str | int) -> str:
        return self.bench_document.where(location)

    def trips(self, channels: dict[str, ChannelRecord], outputs: dict[str, OutputRecord]) -> Iterator[TripRecord]:
        length = self.specimen.mounted.length
        for name, limit in self.bench.limits.items():
            channel = channels.get(LIMIT_CHANNEL[name])
            if channel is None:
                if limit.trip is not None:
                    self.fault(("limits", name), f'there is no channel "{LIMIT_CHANNEL[name]}" to watch')
                continue
            high = self._trip(name, limit.trip, "trip", length)
            low = self._trip(name, limit.trip_low, "trip_low", length)
            source = self.place("limits", name, "trip")
            if name == "contraction":
                most = self.specimen.limits.contraction * length
                if high is None or most < high:
                    high, source = most, self.specimen_document.where(("limits", "contraction"))
            if high is None and low is None:
                continue
            if low is not None and low <= channel.low:
                shown = show(channel.low, channel.quantity)
                self.fault(("limits", name, "trip_low"), f"is not inside the channel's range, from {shown}")
            if limit.delay > LONGEST_DELAY:
                self.fault(("limits", name, "delay"), f"is longer than {LONGEST_DELAY:g} s: that is no protection")
            if high is not None and low is not None and low >= high:
                self.fault(("limits", name, "trip_low"), "lies at or above the upper trip limit")
            if high is not None:
                self._trip_makes_sense(name, limit, high, channel, outputs.get(name))
            yield TripRecord(channel.name, low, high, limit.delay, limit.action, source)
        if "contraction" not in self.bench.limits and "displacement" in channels:
            where = self.specimen_document.where(("limits", "contraction"))
            yield TripRecord("displacement", None, self.specimen.limits.contraction * length, 0.0, "vent", where)
        if "displacement" not in channels and self.bench.free_end in {"weights", "actuator"}:
            self.fault(("channels",), "nothing measures the displacement, which the specimen's contraction limit needs")
        if "pressure" in outputs and not any(
            name == "pressure" and limit.trip is not None for name, limit in self.bench.limits.items()
        ):
            self.fault(("limits",), 'the output "pressure" has no trip limit; add "pressure: {trip: ...}"')

    def _trip(self, name: str, reading: tuple[float, str] | None, key: str, length: float) -> float | None:
        if reading is None:
            return None
        at: Location = ("limits", name, key)
        if name == "contraction":
            return self.si(reading, "ratio", at) * length
        return self.si(reading, CHANNEL_QUANTITY[LIMIT_CHANNEL[name]], at)

    def _trip_makes_sense(
        self, name: str, limit: LimitFile, high: float, channel: ChannelRecord, output: OutputRecord | None
    ) -> None:
        at: Location = ("limits", name, "trip")
        shown = show(high, channel.quantity)
        if high >= channel.high:
            self.fault(
                at,
                f"the trip {shown} is not inside the channel's range, up to {show(channel.high, channel.quantity)}",
            )
        if output is not None:
            margin = channel.calibration.offset_uncertainty + channel.calibration.gain_uncertainty * high
            margin += self.bench.air.overshoot if name == "pressure" else 0.0
            if high < output.high + margin:
                self.fault(
                    at,
                    f"the trip {shown} must lie at least {show(margin, channel.quantity)} (uncertainty and overshoot) "
                    f"above the command limit {show(output.high, channel.quantity)} ({output.high_from})",
                )
        if name == "pressure":
            never = self.specimen.limits.pressure.never_above
            if high > never:
                place = self.specimen_document.where(("limits", "pressure", "never_above"))
                self.fault(
                    at, f"the trip {shown} lies above the specimen's never_above {show(never, 'pressure')} ({place})"
                )

    # -- the rest -----------------------------------------------------------------------------------------------

    def safe_state(self, channels: dict[str, ChannelRecord], outputs: dict[str, OutputRecord]) -> Iterator[SafeAction]:
        vented = confirmed = False
        for index, action in enumerate(self.bench.safe_state):
            at: Location = ("safe_state", index)
            if action.set is not None and action.to is not None:
                if action.set not in outputs:
                    self.fault((*at, "set"), f'no output "{action.set}"{did_you_mean(action.set, outputs)}')
                    continue
                output = outputs[action.set]
                value = self.si(action.to, output.quantity, (*at, "to"))
                if not output.low <= value <= output.high:
                    self.fault((*at, "to"), f"{show(value, output.quantity)} is outside the limits of the output")
                if action.set == "pressure":
                    vented = value <= output.low
                yield SafeAction("set", action.set, value, action.within)
            elif action.confirm is not None and action.below is not None:
                if action.confirm not in channels:
                    self.fault(
                        (*at, "confirm"), f'no channel "{action.confirm}"{did_you_mean(action.confirm, channels)}'
                    )
                    continue
                below = self.si(action.below, channels[action.confirm].quantity, (*at, "below"))
                confirmed = confirmed or action.confirm == "pressure"
                yield SafeAction("confirm", action.confirm, below, action.within)
        if "pressure" in outputs and not vented:
            self.fault(("safe_state",), 'does not vent: its last "set: pressure" must go to the lowest pressure')
        if "pressure" in outputs and not confirmed:
            self.fault(("safe_state",), 'does not look: "- {confirm: pressure, below: ..., within: ...}" is missing')

    def lacks(self) -> Iterator[str]:
        air = self.bench.air
        if air.relief_valve == "none":
            yield "no relief valve: software is the only thing between the supply and the muscle"
        elif air.relief_valve >= self.specimen.limits.pressure.never_above:
            place = self.specimen_document.where(("limits", "pressure", "never_above"))
            self.fault(
                ("air", "relief_valve"),
                f"opens at {show(air.relief_valve, 'pressure')}, not below the specimen's never_above ({place})",
            )
        if air.dump_valve != "normally open":
            yield "no normally-open dump valve: pressure stays on when the power or the computer fails"
        if self.bench.time == "real":
            yield "no device watchdog: a killed program leaves the regulator at its last value"
        if self.bench.weights is not None and self.bench.weights.catch_height is None:
            yield "no catch height: venting drops a raised stack"

    def compile(self) -> Mounted:
        channels = {name: channel for name in self.bench.channels if (channel := self.channel(name))}
        outputs = {name: output for name in self.bench.outputs if (output := self.output(name))}
        trips = tuple(self.trips(channels, outputs))
        safe_state = tuple(self.safe_state(channels, outputs))
        lacks = tuple(self.lacks())
        devices = []
        for name, file in self.bench.devices.items():
            try:
                driver = driver_class(file.driver)
            except ValueError as error:
                self.fault(("devices", name, "driver"), str(error))
                continue
            devices.append(
                DeviceRecord(
                    name,
                    driver,
                    file.address,
                    file.options,
                    tuple(c for c in channels.values() if c.device == name),
                    tuple(o for o in outputs.values() if o.device == name),
                )
            )
        if self.problems:
            raise InvalidFile(self.problems)
        weights = self.bench.weights
        bench = CompiledBench(
            name=self.bench.name,
            simulated=False,
            realtime=self.bench.time == "real",
            free_end=self.bench.free_end,
            devices=tuple(devices),
            trips=trips,
            safe_state=safe_state,
            hands_below=self.bench.hands.below,
            hands_at_pressure=self.bench.hands.at_pressure,
            gravity=weights.g if weights else 9.81,
            carriage=weights.carriage if weights else 0.0,
            hanging=weights is None or weights.act_as == "mass",
            slack_below=self.bench.slack_below,
            length=self.specimen.mounted.length,
        )
        return Mounted(bench, self.bench, self.specimen, self.documents, lacks)


def mount(bench_path: Path, specimen_path: Path) -> Mounted:
    """Compile a bench with a specimen in it; raises `InvalidFile` with every problem of every file."""
    problems: list[Problem] = []
    documents: list[Document] = []
    for path in (bench_path, specimen_path):
        try:
            documents.append(read_document(path))
        except InvalidFile as error:
            problems.extend(error.problems)
    if problems:
        raise InvalidFile(problems)
    return _Compiler(documents[0], documents[1], bench_path.resolve().parent).compile()
