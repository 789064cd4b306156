"""Outputs of a bench file: scales, and command limits as the intersection of device, bench and specimen; valves."""

from __future__ import annotations

from collections.abc import Mapping

from pmabench.base.errors import did_you_mean
from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.bench.calibration import fit_line
from pmabench.bench.compilation import Compilation
from pmabench.bench.interface import ChannelRecord, OutputRecord, ValveRecord
from pmabench.files.document import Location

SET_POINTS = ("pressure", "displacement")
"""The outputs that take values, by name; every other name is a valve's and needs `energised`."""
LEAST_ROOM = 1e-3
"""A driven end stays below the specimen's contraction limit by the channel's uncertainty, at least by so much [1]."""


def outputs(c: Compilation, channels: Mapping[str, ChannelRecord]) -> dict[str, OutputRecord]:
    """Every output that takes values and has no problem, by name."""
    return {name: output for name in c.bench.set_points if (output := _output(c, name, channels.get(name)))}


def valves(c: Compilation) -> dict[str, ValveRecord]:
    """Every valve, by name."""
    found = {}
    for name, file in c.bench.valves.items():
        at: Location = ("outputs", name)
        if name in SET_POINTS:
            c.fault(at, f'"{name}" takes values and cannot be a valve; give the valve another name', key=True)
        c.unknown((*at, "device"), "device", file.device, c.bench.devices)
        found[name] = ValveRecord(name, file.device, file.output, file.energised)
    return found


def _output(c: Compilation, name: str, measured: ChannelRecord | None) -> OutputRecord | None:
    file = c.bench.set_points[name]
    at: Location = ("outputs", name)
    if name not in SET_POINTS:
        near = did_you_mean(name, SET_POINTS)
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
    elif name == "pressure" and safe > max(low, 0.0):
        c.fault((*at, "safe"), f"the safe value {show(safe, quantity)} leaves pressure on: it must be the lowest")
    rate = c.bench.actuator.speed if c.bench.actuator and name == "displacement" else 0.0
    return OutputRecord(
        name, quantity, file.device, file.output, scale, resolution, safe, low, high, low_from, high_from, rate
    )


def _limits(
    c: Compilation, name: str, quantity: str, ends: list[float], measured: ChannelRecord | None
) -> tuple[float, str, float, str]:
    """The highest of the lower limits and the lowest of the upper ones [SI], each with its place."""
    scale = c.place("outputs", name, "scale")
    lows, highs = [(min(ends), scale)], [(max(ends), scale)]
    limit = c.bench.limits.get("pressure" if name == "pressure" else "displacement")
    if limit is None or limit.command is None:
        c.fault(("limits", name), f'the output "{name}" has no command limit; add "{name}: {{command: ...}}"')
    else:
        highs.append((c.si(limit.command, quantity, ("limits", name, "command")), c.place("limits", name, "command")))
    if limit is not None and limit.command_low is not None:
        place = c.place("limits", name, "command_low")
        lows.append((c.si(limit.command_low, quantity, ("limits", name, "command_low")), place))
    if name == "pressure":
        place = c.specimen_place("limits", "pressure", "command")
        highs.append((c.specimen.limits.pressure.command, place))
    elif c.length is not None:
        most = c.specimen.limits.contraction * c.length
        room = measured.calibration.uncertainty(most) if measured is not None else 0.0
        highs.append((most - max(room, LEAST_ROOM * most), c.specimen_place("limits", "contraction")))
    if c.bench.actuator is not None and name == "displacement":
        stroke = c.bench.actuator.stroke
        lows.append((stroke[0], c.place("actuator", "stroke", 0)))
        highs.append((stroke[1], c.place("actuator", "stroke", 1)))
    return *max(lows), *min(highs)
