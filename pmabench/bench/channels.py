"""Channels and outputs of a bench file with their scales: calibrations, command limits, valves.

Calibrations are in a folder next to the file that names them. A command limit is the intersection of device, bench and
specimen.

Muscles that valves fill and empty in pulses: an exhaust valve does not empty a muscle whose fill valve is stuck open
(5.2 of 7 bar remain). So the supply is shut first, then dumps that are open without power empty all muscles at once.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from pmabench.base.errors import InvalidFile, Problem, did_you_mean
from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.bench import interface as b
from pmabench.bench.compilation import Compilation
from pmabench.bench.files.specimen import CalibrationFile
from pmabench.files.document import Location, document_text, read_document, validate
from pmabench.files.quantity import unit_factor

SUPPLY_VALVE = "supply_valve"
LONGEST_PULSE = 0.1
"""A longer pulse [s] could bring a muscle from zero to its limit at once."""
PLATFORM_MUSCLES = 3
MEASURED = ("acceleration_x", "acceleration_y", "acceleration_z")
COUNTERPART = {"fill": "exhaust", "exhaust": "fill"}


def paired(c: Compilation, name: str, valve: b.ValveRecord) -> b.ValveRecord:
    """Record of a valve, with its longest pulse and its counterpart if it opens in pulses."""
    pulse, at = c.bench.valves[name].pulse, ("outputs", name)
    kind, _, number = name.partition("_")
    if pulse is None:
        return valve
    if kind not in COUNTERPART or number not in c.bench.muscles or c.bench.platform is None:
        c.fault(at, 'opens in pulses, and only "fill_1", "exhaust_1" and so on of a platform can', key=True)
    if pulse > LONGEST_PULSE:
        c.fault((*at, "pulse"), f"is longer than {show(LONGEST_PULSE, 'time')}")
    if valve.energised != "open":
        c.fault((*at, "energised"), "a valve that opens in pulses is open while it is energised")
    return replace(valve, longest=pulse, never_with=f"{COUNTERPART.get(kind, kind)}_{number}", safe="closed")


def aims(c: Compilation) -> tuple[b.AimRecord, ...]:
    """Limits of each pressure and of the tilt of a platform; adds every problem of valves that open in pulses."""
    if (platform := c.bench.platform) is None:
        return ()
    if len(c.bench.muscles) != PLATFORM_MUSCLES:
        c.fault(("platform",), f"a platform has {PLATFORM_MUSCLES} muscles, not {len(c.bench.muscles)}", key=True)
    for name in MEASURED:
        if name not in c.bench.channels:
            c.fault(("channels",), f'nothing measures the attitude: add a channel "{name}" of the accelerometer')
    _refuse_without_valves(c)
    tilt = b.AimRecord("tilt", "angle", 0.0, platform.tilt, c.place("platform", "tilt"))
    return (*(aim for name in c.bench.steered if (aim := _pressure(c, name)) is not None), tilt)


def _pressure(c: Compilation, name: str) -> b.AimRecord | None:
    """Limits of the pressure of one muscle, from bench, muscle and specimen; None with a problem."""
    limit, at = c.bench.limits.get(name), ("limits", name)
    if limit is None or limit.command is None or limit.command_low is None:
        c.fault(at, f'lacks a limit of what valves may bring about; add "{name}: {{command_low: ..., command: ...}}"')
        return None
    low = c.si(limit.command_low, "pressure", (*at, "command_low"))
    highs = [(c.si(limit.command, "pressure", (*at, "command")), c.place(*at, "command"))]
    highs += [(borne.limits.pressure.command, borne.place("pressure", "command")) for borne in c.borne(name)]
    high, source = min(highs)
    channel = c.channels.get(name)
    if not 0 <= low < high:
        c.fault((*at, "command_low"), f"must be at least 0 and below {show(high, 'pressure')} ({source})")
    elif limit.trip is not None and channel is not None:
        trip = c.si(limit.trip, "pressure", (*at, "trip"))
        margin = channel.calibration.uncertainty(trip) + c.bench.air.overshoot
        if trip < high + margin * (1 - 1e-9):
            least = f"{show(margin, 'pressure')} (uncertainty and overshoot) above {show(high, 'pressure')} ({source})"
            c.fault((*at, "trip"), f"the trip {show(trip, 'pressure')} must lie at least {least}")
    return b.AimRecord(name, "pressure", low, high, source)


def _refuse_without_valves(c: Compilation) -> None:
    """Require two pulsed valves per muscle, a shut-off of the supply, and dumps that open without power."""
    valves: Mapping[str, b.ValveRecord] = c.valves
    for number in c.bench.muscles:
        for kind in COUNTERPART:
            name = f"{kind}_{number}"
            if name not in valves or not valves[name].longest:
                at = ("outputs", name) if name in valves else ("outputs",)
                remedy = 'add it with "energised: open" and "pulse: 20 ms"'
                c.fault(at, f'lacks the valve "{name}" that opens in pulses; {remedy}')
    if SUPPLY_VALVE not in valves or valves[SUPPLY_VALVE].energised != "open":
        at = ("outputs", SUPPLY_VALVE) if SUPPLY_VALVE in valves else ("outputs",)
        what = f'"{SUPPLY_VALVE}", which shuts the air off before the fill valves without power (energised: open)'
        c.fault(at, f"lacks {what}: a muscle whose fill valve is stuck open cannot be emptied while the supply is on")
    if not c.bench.switched_dump:
        which = '"dump_valve" for all muscles, or "dump_valve_1" and so on, open without power (energised: closed)'
        why = "an exhaust valve cannot empty a muscle whose fill valve is stuck open"
        c.fault(("outputs",), f"lacks dumps: {which} and four times as wide as a fill valve; {why}")


def refuse_unsafe_order(c: Compilation, actions: tuple[b.SafeAction, ...]) -> None:
    """Require a safe state that shuts the supply first, opens every dump at once, and confirms pressures at the end."""
    at: Location = ("safe_state",)
    if not actions or (actions[0].do, actions[0].target) != ("close", SUPPLY_VALVE):
        c.fault((*at, 0), f'the supply is shut first: "- {{close: {SUPPLY_VALVE}, within: ...}}"')
    begins = list(_before_any_wait(actions))
    for name in c.valves:
        if name.startswith("dump_valve") and ("open", name) not in begins:
            c.fault(at, f'opens "{name}" too late or never: it comes before anything that is waited for')
    for name in c.bench.steered:
        if not any(action.do == "confirm" and action.target == name for action in actions):
            c.fault(at, f'does not look: "- {{confirm: {name}, below: ..., within: ...}}" is missing')
    if c.bench.vents != "together":
        c.fault(("vents",), 'a platform vents all muscles "together": one alone would turn it with all that it has')


def _before_any_wait(actions: tuple[b.SafeAction, ...]) -> Iterator[tuple[str, str]]:
    for action in actions:
        if action.do not in {"open", "close"}:
            return
        yield action.do, action.target


def numbers(c: Compilation) -> dict[str, float]:
    """Numbers for the control of the platform, in SI, by the names of `model.many.platform.described`; else empty."""
    platform, air = c.bench.platform, c.bench.air
    if platform is None:
        return {}
    given = platform.model_dump(exclude={"tilt"})
    found = {**given, "supply": air.supply, "atmosphere": air.atmosphere}
    if c.specimen_document is not None:
        angle = c.specimen.braid_angle
        found |= {"diameter": c.specimen.inner_diameter, "length": c.specimen.mounted.length}
        found |= {} if angle is None else {"braid_angle": angle}
    return found


MOST = 1e100
"""Largest accepted number; its square must not overflow."""


@dataclass(frozen=True)
class Calibration:
    """A channel's scale, its record, the unit of its raw readings, the calibrated range, and the text of the file."""

    scale: b.Scale = field(default_factory=b.Scale)
    record: b.CalibrationRecord = field(default_factory=b.CalibrationRecord)
    raw_unit: str = ""
    text: str = ""
    low: float = 0.0
    """Lowest reference value [SI]."""
    high: float = 0.0
    """Highest reference value [SI]."""


def read_calibration(path: Path, quantity: str) -> Calibration:
    """Read the calibration file of a channel that measures `quantity`; raises `InvalidFile` with every problem."""
    document = read_document(path)
    file = validate(CalibrationFile, document)
    problems: list[Problem] = []
    raw_unit, raw = file.points[0][0][1], [reading[0] for reading, _ in file.points]
    if file.id != path.stem:
        raise InvalidFile([document.problem(("id",), f'the id "{file.id}" is not the name of the file, "{path.stem}"')])
    if file.quantity != quantity:
        raise InvalidFile([document.problem(("quantity",), f"is of {file.quantity}, the channel measures {quantity}")])

    def si(reading: tuple[float, str], *at: str | int) -> float:
        try:
            return reading[0] * unit_factor(reading[1], quantity)
        except ValueError as error:
            problems.append(document.problem(at, str(error)))
            return 0.0

    for index, (reading, _) in enumerate(file.points):
        if reading[1] != raw_unit:
            problems.append(document.problem(("points", index, 0), f"all readings in one unit, here {raw_unit}"))
    value = [si(reference, "points", index, 1) for index, (_, reference) in enumerate(file.points)]
    if file.valid_until is not None and file.valid_until < file.date:
        problems.append(document.problem(("valid_until",), "ends before the calibration was made"))
    if (uncertainty := si(file.expanded_uncertainty, "expanded_uncertainty")) < 0:
        problems.append(document.problem(("expanded_uncertainty",), "an uncertainty is not below zero"))
    if problems:
        raise InvalidFile(problems)
    try:
        scale = fit_line(raw, value)
    except ValueError as error:
        raise InvalidFile([document.problem(("points",), str(error))]) from error
    bend = max(abs(scale.to_si(r) - v) for r, v in zip(raw, value, strict=True))
    if bend > max(uncertainty, 1e-9 * max(abs(v) for v in value)):
        message = f"bend away from a straight line by {show(bend, quantity)}, more than the uncertainty"
        raise InvalidFile([document.problem(("points",), message)])
    text = document_text(document)
    record = b.CalibrationRecord(
        **file.model_dump(include={"id", "reference", "gain_uncertainty", "sensor_lag"}),
        date=file.date.isoformat(),
        valid_until=file.valid_until.isoformat() if file.valid_until else "",
        offset_uncertainty=uncertainty,
        sha256=hashlib.sha256(text.encode()).hexdigest(),
    )
    return Calibration(scale, record, raw_unit, text, min(value), max(value))


def fit_line(raw: list[float], value: list[float]) -> b.Scale:
    """Least-squares line of value over raw; raises ValueError if the points do not define one."""
    if any(abs(number) > MOST for number in (*raw, *value)):
        raise ValueError("a number is out of all range")
    n = len(raw)
    raw_mean, value_mean = sum(raw) / n, sum(value) / n
    if (spread := sum((r - raw_mean) ** 2 for r in raw)) == 0:
        raise ValueError("all readings are the same: they make no line")
    slope = sum((r - raw_mean) * (v - value_mean) for r, v in zip(raw, value, strict=True)) / spread
    if slope == 0:
        raise ValueError("the readings do not change with the reference: they make no line")
    return b.Scale(slope, value_mean - slope * raw_mean)


NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")
"""Valid ids of calibrations, which are file names."""


def channels(c: Compilation) -> dict[str, b.ChannelRecord]:
    """Every channel without a problem, by name."""
    return {name: channel for name in c.bench.channels if (channel := _channel(c, name))}


def _channel(c: Compilation, name: str) -> b.ChannelRecord | None:
    file = c.bench.channels[name]
    at: Location = ("channels", name)
    if name not in c.names:
        c.fault(at, f'no channel is called "{name}"{did_you_mean(name, c.names)}', key=True)
        return None
    quantity = CHANNEL_QUANTITY[name]
    before = len(c.problems)
    c.unknown((*at, "device"), "device", file.device, c.bench.devices)
    if file.calibration is not None:
        if (found := _calibration(c, file.calibration, quantity, (*at, "calibration"))) is None:
            return None
        c.calibrated[name] = (found.low, found.high)
        scale, record, raw_unit = found.scale, found.record, found.raw_unit
    else:
        raw_unit, record = file.unit or "", b.CalibrationRecord()
        scale = b.Scale(c.si((1.0, raw_unit), quantity, (*at, "unit")), 0.0)
    if len(c.problems) > before:
        return None
    ends = [
        scale.to_si(reading[0]) if reading[1] == raw_unit else c.si(reading, quantity, (*at, "range", index))
        for index, reading in enumerate(file.range)
    ]
    if len(c.problems) > before:
        return None
    if ends[0] == ends[1]:
        c.fault((*at, "range"), "the two ends are the same")
        return None
    raw_type = "int32" if raw_unit in {"count", "counts"} else "float64"
    low, high = min(ends), max(ends)
    return b.ChannelRecord(
        name, quantity, file.device, file.input, raw_type, raw_unit, scale, low, high, file.reference, record
    )


def _calibration(c: Compilation, name: str, quantity: str, location: Location) -> Calibration | None:
    if not NAME.fullmatch(name):
        c.fault(location, "the id of a calibration is expected: letters, digits, points and dashes")
        return None
    folders = _folders(c, location)
    path = next((folder / f"{name}.yaml" for folder in folders if (folder / f"{name}.yaml").is_file()), None)
    if path is None:
        near = sorted({file.stem for folder in folders if folder.is_dir() for file in folder.glob("*.yaml")})
        c.fault(location, f'no calibration "{name}" in calibrations/{did_you_mean(name, near)}')
        return None
    try:
        found = read_calibration(path, quantity)
    except InvalidFile as error:
        c.problems.extend(problem for problem in error.problems if problem not in c.problems)
        return None
    c.texts[f"calibrations/{name}.yaml"] = found.text
    return found


def _folders(c: Compilation, location: Location) -> list[Path]:
    """Folders that may hold calibrations: next to the file that names the calibration, then next to all others."""
    files = [c.bench_document.place(location)[0], *c.bench_document.texts]
    parents = dict.fromkeys(Path(file).resolve().parent for file in files)
    return [folder for parent in parents for folder in (parent / "calibrations", parent.parent / "calibrations")]


SET_POINTS = ("pressure", "displacement")
"""Names of outputs that take values; any other name is a valve's and needs `energised`."""
DRIVES = {"displacement": "actuator", "angle": "joint"}
"""Output that a drive moves -> section of the bench file with its stroke and speed."""
LEAST_ROOM = 1e-3
"""Least margin of a driven end below the specimen's contraction limit, if the channel's uncertainty is less [1]."""


def outputs(c: Compilation) -> dict[str, b.OutputRecord]:
    """Every output that takes values and has no problem, by name."""
    return {name: output for name in c.bench.set_points if (output := _output(c, name, c.channels.get(name)))}


def set_points(c: Compilation) -> tuple[str, ...]:
    """Names of outputs that take values on this bench."""
    if c.bench.platform is not None:
        return ()
    return ("angle", *(f"pressure_{number}" for number in c.bench.muscles)) if c.bench.muscles else SET_POINTS


def valves(c: Compilation) -> dict[str, b.ValveRecord]:
    """Every valve, by name."""
    found = {}
    for name, file in c.bench.valves.items():
        at: Location = ("outputs", name)
        if name in set_points(c):
            c.fault(at, f'"{name}" takes values and cannot be a valve; give the valve another name', key=True)
        c.unknown((*at, "device"), "device", file.device, c.bench.devices)
        found[name] = paired(c, name, b.ValveRecord(name, file.device, file.output, file.energised))
    return found


def _output(c: Compilation, name: str, measured: b.ChannelRecord | None) -> b.OutputRecord | None:
    file = c.bench.set_points[name]
    at: Location = ("outputs", name)
    if name not in set_points(c):
        near = did_you_mean(name, set_points(c))
        c.fault(at, f'no output is called "{name}"{near}; a valve needs "energised: closed" or "open"', key=True)
        return None
    quantity = CHANNEL_QUANTITY[name]
    before = len(c.problems)
    c.unknown((*at, "device"), "device", file.device, c.bench.devices)
    raw_unit = file.scale[0][0][1]
    points = [(raw[0], c.si(value, quantity, (*at, "scale", i, 1))) for i, (raw, value) in enumerate(file.scale)]
    if len(c.problems) > before:
        return None
    if file.scale[1][0][1] != raw_unit:
        c.fault((*at, "scale", 1, 0), f"both device values in one unit, here {raw_unit}")
    try:
        scale = fit_line([point[0] for point in points], [point[1] for point in points])
    except ValueError as error:
        c.fault((*at, "scale"), str(error))
        return None
    resolution = 0.0
    if file.resolution is not None:
        resolution = file.resolution[0]
        if file.resolution[1] != raw_unit or resolution <= 0:
            c.fault((*at, "resolution"), f"a step above zero in {raw_unit} is expected")
    safe = 0.0 if file.safe is None else c.si(file.safe, quantity, (*at, "safe"))
    if len(c.problems) > before:
        return None
    low, low_from, high, high_from = _limits(c, name, quantity, [point[1] for point in points], measured)
    if len(c.problems) > before:
        return None
    if low >= high:
        where: Location = ("limits", name)
        c.fault(where, f"nothing may be commanded: {show(low, quantity)} ({low_from}) up to {show(high, quantity)}")
    elif not low <= safe <= high:
        c.fault((*at, "safe"), f"the safe value {show(safe, quantity)} is outside the command limits")
    elif quantity == "pressure" and safe > max(low, 0.0):
        c.fault((*at, "safe"), f"the safe value {show(safe, quantity)} leaves pressure on: it must be the lowest")
    drive = getattr(c.bench, DRIVES[name]) if name in DRIVES else None
    rate = drive.speed if drive is not None else 0.0
    return b.OutputRecord(
        name, quantity, file.device, file.output, scale, resolution, safe, low, high, low_from, high_from, rate
    )


def _limits(
    c: Compilation, name: str, quantity: str, ends: list[float], measured: b.ChannelRecord | None
) -> tuple[float, str, float, str]:
    """Highest of the lower limits and lowest of the upper limits [SI], each followed by its place in a file."""
    scale = c.place("outputs", name, "scale")
    lows, highs = [(min(ends), scale)], [(max(ends), scale)]
    limit = c.bench.limits.get(name)
    if limit is None or limit.command is None:
        c.fault(("limits", name), f'the output "{name}" has no command limit; add "{name}: {{command: ...}}"')
    else:
        highs.append((c.si(limit.command, quantity, ("limits", name, "command")), c.place("limits", name, "command")))
    if limit is not None and limit.command_low is not None:
        place = c.place("limits", name, "command_low")
        lows.append((c.si(limit.command_low, quantity, ("limits", name, "command_low")), place))
    if quantity == "pressure":
        highs += [(borne.limits.pressure.command, borne.place("pressure", "command")) for borne in c.borne(name)]
    elif c.length is not None and name != "angle":
        most = c.specimen.limits.contraction * c.length
        room = measured.calibration.uncertainty(most) if measured is not None else 0.0
        highs.append((most - max(room, LEAST_ROOM * most), c.specimen_place("limits", "contraction")))
    section = DRIVES.get(name, "")
    drive = getattr(c.bench, section) if section else None
    if drive is not None:
        lows.append((drive.stroke[0], c.place(section, "stroke", 0)))
        highs.append((drive.stroke[1], c.place(section, "stroke", 1)))
    return *max(lows), *min(highs)
