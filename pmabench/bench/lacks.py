"""What a bench lacks, each in one line with what follows from it and its remedy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite

from pmabench.base.quantities import show
from pmabench.bench.compilation import Compilation
from pmabench.bench.interface import ChannelRecord, OutputRecord
from pmabench.bench.trips import SUPPLY_MARGIN


def lacks(c: Compilation, channels: Mapping[str, ChannelRecord], outputs: Mapping[str, OutputRecord]) -> Iterator[str]:
    """Each line goes on after "this bench has"; a relief valve that protects nothing is a problem, not a lack."""
    yield from _air(c, outputs)
    yield from c.driver_lacks
    yield from _calibrations(c, channels)
    if c.bench.weights is not None and c.bench.weights.catch_height is None:
        yield (
            "no catch height: venting drops a raised stack; remedy: a catch under the stack and "
            '"catch_height", or "ramp_down: pressure" before the dump valve opens'
        )
    if c.bench.time == "real":
        yield from _of_a_real_bench(c, channels)


def _air(c: Compilation, outputs: Mapping[str, OutputRecord]) -> Iterator[str]:
    air, never = c.bench.air, c.specimen.limits.pressure.never_above
    if air.relief_valve == "none":
        most = show(never, "pressure") if isfinite(never) else "what the muscle bears"
        yield (
            f"no relief valve: software is the only thing between the supply of {show(air.supply, 'pressure')} and the "
            f"muscle; remedy: one that opens below {most}"
        )
    elif air.relief_valve >= never:
        place = c.specimen_place("limits", "pressure", "never_above")
        opens = show(air.relief_valve, "pressure")
        c.fault(("air", "relief_valve"), f"opens at {opens}, not below the specimen's never_above ({place})")
    elif "pressure" in outputs and air.relief_valve <= outputs["pressure"].high:
        most = f"{show(outputs['pressure'].high, 'pressure')} ({outputs['pressure'].high_from})"
        c.fault(("air", "relief_valve"), f"opens below what may be commanded, {most}")
    if "pressure" in c.bench.set_points and not c.bench.normally_open_dump:
        yield (
            "no normally-open dump valve: pressure stays on when the power or the computer fails; "
            'remedy: "dump_valve" among the outputs with "energised: closed"'
        )
    if "pressure" in outputs and air.supply < outputs["pressure"].high + SUPPLY_MARGIN:
        yield (
            f"a supply of {show(air.supply, 'pressure')}, less than {show(SUPPLY_MARGIN, 'pressure')} above the "
            f"highest set-point {show(outputs['pressure'].high, 'pressure')}: high set-points are not reached; "
            'remedy: more supply, or a lower "command"'
        )


def _calibrations(c: Compilation, channels: Mapping[str, ChannelRecord]) -> Iterator[str]:
    for name, channel in channels.items():
        record = channel.calibration
        if record.valid_until and record.valid_until < c.today.isoformat():
            yield f"an expired calibration of {name}, {record.id}, valid until {record.valid_until}; remedy: a new one"
        if c.bench.time == "real" and not record.id and name in {"pressure", "displacement", "force"}:
            yield (
                f"no calibration of {name}: its uncertainty counts as zero in limits and results; "
                'remedy: a file in calibrations/ and "calibration"'
            )


def _pressure_elsewhere(c: Compilation, channels: Mapping[str, ChannelRecord]) -> Iterator[str]:
    """A line where the guard, which outlives the program, cannot read the pressure by itself."""
    guarded = {file.device for file in c.bench.outputs.values()} | {lock.input.device for lock in c.bench.interlocks}
    guarded |= {name for name, file in c.bench.devices.items() if file.watchdog}
    channel = channels.get("pressure")
    if channel is not None and channel.device not in guarded:
        yield (
            f"its pressure on {channel.device}, which only measures ({c.place('channels', 'pressure', 'device')}): the "
            "guard holds no link to it, so that after the program died no vent is confirmed; remedy: the pressure on a "
            "device that carries an output, valve, interlock or watchdog, too"
        )

    if c.extrapolated:
        yield (
            f"trips beyond the points of a calibration: {'; '.join(c.extrapolated)}; the margin above the command "
            "limit counts it; remedy: points up to the trip, where the reference and the muscle allow it"
        )


def _of_a_real_bench(c: Compilation, channels: Mapping[str, ChannelRecord]) -> Iterator[str]:
    pressurising = {file.device for name, file in c.bench.outputs.items() if name in {"pressure", "dump_valve"}}
    accepted = c.bench.no_watchdog
    for device in sorted(pressurising):
        if c.bench.devices.get(device) is None or c.bench.devices[device].watchdog:
            continue
        if accepted is not None:
            yield f"no watchdog of {device}, accepted by {accepted.accepted_by} on {accepted.date}: {accepted.reason}"
        else:
            yield (
                f"no watchdog of {device}: a computer that dies leaves the pressure at its last value; remedy: "
                '"watchdog" where the device has one, else a normally-open dump valve on one that has; '
                'or "no_watchdog" with who accepts it'
            )
    if "pressure" not in c.bench.set_points:
        return
    yield from _pressure_elsewhere(c, channels)
    if not c.bench.interlocks:
        yield 'no interlock: the program does not see the emergency stop; remedy: "interlocks" with a contact of it'
    watched = {(entry.kind, entry.channel) for entry in c.bench.watch if entry.action in {"stop", "vent"}}
    if "pressure" in channels and not {("stale", "pressure"), ("frozen", "pressure")} & watched:
        yield (
            "nothing that sees a dead pressure sensor; remedy: "
            '"watch: [{stale: pressure, for: 100 ms, action: vent}, {off_range: pressure, action: vent}]"'
        )
    if c.bench.proof is None:
        yield (
            'no proof of the vent path before each use; remedy: "proof: {pressure: 50 kPa, below: 20 kPa, within: 2 s}"'
        )
