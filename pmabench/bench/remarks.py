"""What a bench lacks, and likely mistakes in its files; each a line with its remedy or place."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

from pmabench.base.quantities import show, without_number
from pmabench.bench.channels import DRIVES
from pmabench.bench.compilation import Compilation
from pmabench.bench.interface import ChannelRecord
from pmabench.bench.safety import ENDS, SUPPLY_MARGIN, watched_by


def lacks(c: Compilation) -> Iterator[str]:
    """Lines that continue the sentence "this bench has"; a relief valve that protects nothing is added as a problem."""
    yield from _air(c)
    yield from _calibrations(c)
    if c.bench.weights is not None and c.bench.weights.catch_height is None:
        remedy = 'a catch under the stack and "catch_height", or "ramp_down: pressure" before the dump valve opens'
        yield f"no catch height: venting drops a raised stack; remedy: {remedy}"
    if c.bench.time == "real":
        yield from _of_a_real_bench(c)


def _air(c: Compilation) -> Iterator[str]:
    air, output = c.bench.air, c.highest
    bears = [borne for name in c.bench.pressures or [""] for borne in c.borne(name)]
    least = min(bears, key=lambda borne: borne.limits.pressure.never_above)
    never = least.limits.pressure.never_above
    if air.relief_valve == "none":
        most = show(never, "pressure") if isfinite(never) else "what the muscle bears"
        alone = f"software is the only thing between the supply of {show(air.supply, 'pressure')} and the muscle"
        yield f"no relief valve: {alone}; remedy: one that opens below {most}"
    elif air.relief_valve >= never:
        place = least.place("pressure", "never_above")
        opens = show(air.relief_valve, "pressure")
        c.fault(("air", "relief_valve"), f"opens at {opens}, not below {least.whose} never_above ({place})")
    elif output is not None and air.relief_valve <= output.high:
        most = f"{show(output.high, 'pressure')} ({output.high_from})"
        c.fault(("air", "relief_valve"), f"opens below what may be commanded, {most}")
    if c.bench.pressures and not c.bench.normally_open_dump:
        remedy = '"dump_valve" among the outputs with "energised: closed"'
        yield f"no normally-open dump valve: pressure stays on when the power or the computer fails; remedy: {remedy}"
    if output is not None and air.supply < output.high + SUPPLY_MARGIN:
        supply, margin, highest = (show(P, "pressure") for P in (air.supply, SUPPLY_MARGIN, output.high))
        few = f"a supply of {supply}, less than {margin} above the highest set-point {highest}"
        yield f'{few}: high set-points are not reached; remedy: more supply, or a lower "command"'


CALIBRATED = ("pressure", "displacement", "force", "torque")
"""Channels that need a calibration on a real bench."""


def _calibrations(c: Compilation) -> Iterator[str]:
    for name, channel in c.channels.items():
        record = channel.calibration
        if record.valid_until and record.valid_until < c.today.isoformat():
            yield f"an expired calibration of {name}, {record.id}, valid until {record.valid_until}; remedy: a new one"
        if c.bench.time == "real" and not record.id and without_number(name)[0] in CALIBRATED:
            remedy = 'a file in calibrations/ and "calibration"'
            yield f"no calibration of {name}: its uncertainty counts as zero in limits and results; remedy: {remedy}"


def _pressure_elsewhere(c: Compilation) -> Iterator[str]:
    """Lines on pressures that the guard, which outlives the program, cannot read, and on extrapolated trips."""
    guarded = {file.device for file in c.bench.outputs.values()} | {lock.input.device for lock in c.bench.interlocks}
    guarded |= {name for name, file in c.bench.devices.items() if file.watchdog}
    apart = [c.channels[name] for name in c.bench.pressures if name in c.channels]
    for channel in [channel for channel in apart if channel.device not in guarded]:
        where = f"{channel.device}, which only measures ({c.place('channels', channel.name, 'device')})"
        why = "the guard holds no link to it, so that after the program died no vent is confirmed"
        remedy = "the pressure on a device that carries an output, valve, interlock or watchdog, too"
        yield f"its {channel.name} on {where}: {why}; remedy: {remedy}"
    if c.extrapolated:
        beyond = f"trips beyond the points of a calibration: {'; '.join(c.extrapolated)}"
        remedy = "points up to the trip, where the reference and the muscle allow it"
        yield f"{beyond}; the margin above the command limit counts it; remedy: {remedy}"


LEAVES = {
    **dict.fromkeys(("pressure", "dump_valve", "fill", "supply_valve"), "the pressure at its last value"),
    **dict.fromkeys(DRIVES, "a drive in motion"),
}
"""Name of the output -> what a failing computer leaves if its device has no watchdog."""
AT_LEAST = {"displacement": "2 mm", "angle": "3 deg"}
"""Usual deviation of a moving drive from its command."""


def _watchdogs(c: Compilation) -> Iterator[str]:
    """A line for each device that pressurises or moves something without a watchdog."""
    left = {file.device: LEAVES.get(without_number(name)[0], "") for name, file in c.bench.valves.items()}
    left |= {
        file.device: LEAVES[without_number(name)[0]] for name, file in c.bench.set_points.items() if name in c.outputs
    }
    accepted = c.bench.no_watchdog
    for device, what in sorted(left.items()):
        if not what or c.bench.devices.get(device) is None or c.bench.devices[device].watchdog:
            continue
        if accepted is not None:
            yield f"no watchdog of {device}, accepted by {accepted.accepted_by} on {accepted.date}: {accepted.reason}"
        else:
            other = "" if what == LEAVES["angle"] else "else a normally-open dump valve on one that has; "
            remedy = f'"watchdog" where the device has one, {other}or "no_watchdog" with who accepts it'
            yield f"no watchdog of {device}: a computer that dies leaves {what}; remedy: {remedy}"


def _drives(c: Compilation) -> Iterator[str]:
    """Lines for each drive whose deviation from its command, or travel below its lower end, is not monitored."""
    watched = {entry.channel for entry in c.bench.watch if entry.kind == "following" and entry.action in ENDS}
    below = {watched_by(key) for key, one in c.bench.limits.items() if one.trip_low and one.action in ENDS}
    for name in [name for name in DRIVES if name in c.outputs and name in c.channels]:
        if name not in watched:
            remedy = f'"watch: [{{following: {name}, more_than: {AT_LEAST[name]}, for: 300 ms, action: vent}}]"'
            yield f"nothing that sees a drive that goes where it was not sent; remedy: {remedy}"
        if name not in below:
            remedy = f'"limits: {{{name}: {{trip_low: ..., action: vent}}}}"'
            yield f"no lower limit of the {name}, to which a drive may stretch the muscle; remedy: {remedy}"


BEYOND = 1.5
"""A line that is closed stays closed for 1.5 times its watchdog, after 0.7 s without effect; then it is opened [s]."""


def _hasty_confirmations(c: Compilation) -> Iterator[str]:
    """A line where a vent is judged before a device is back that was left to its watchdog."""
    longest = max((file.watchdog or 0.0 for file in c.bench.devices.values()), default=0.0)
    needs = 1.5 * longest + BEYOND
    for action in c.bench.safe_state:
        if longest and action.confirm and action.within is not None and action.within < needs:
            why = f"a device that does not obey is left to its watchdog of {longest:g} s, and not heard before that"
            yield f"{action.within:g} s to confirm {action.confirm}: {why}; remedy: within {needs:g} s or more"


def _of_a_real_bench(c: Compilation) -> Iterator[str]:
    yield from _watchdogs(c)
    yield from _hasty_confirmations(c)
    yield from _drives(c)
    if not c.bench.pressures:
        return
    yield from _pressure_elsewhere(c)
    if not c.bench.interlocks:
        yield 'no interlock: the program does not see the emergency stop; remedy: "interlocks" with a contact of it'
    watched = {(entry.kind, entry.channel) for entry in c.bench.watch if entry.action in {"stop", "vent"}}
    moving = {entry.channel for entry in c.bench.watch if entry.kind in {"frozen", "following"}}
    for name in [n for n in c.bench.pressures if n in c.channels and not {("stale", n), ("frozen", n)} & watched]:
        remedy = f'"watch: [{{stale: {name}, for: 100 ms, action: vent}}, {{off_range: {name}, action: vent}}]"'
        yield f"nothing that sees a dead pressure sensor; remedy: {remedy}"
    for name in [n for n in c.bench.pressures if n in c.channels and n not in moving]:
        still = f'nothing that sees that "{name}" stands still while its device answers: it would confirm a vent'
        yield f'{still}; remedy: "watch: [{{following: {name}, more_than: 60 kPa, for: 3 s, action: stop}}]"'
    if c.bench.proof is None:
        remedy = '"proof: {pressure: 50 kPa, below: 20 kPa, within: 2 s}"'
        yield f"no proof of the vent path before each use; remedy: {remedy}"


UNCOVERED = 0.1
"""Fraction of a channel's range that its calibration may leave out at an end."""
TOO_WIDE = 2.0
"""A calibration over more than this multiple of its channel's range is probably another sensor's."""


def mistaken(c: Compilation) -> Iterator[str]:
    """Warn if a calibration does not fit the range of its channel."""
    for name, (low, high) in c.calibrated.items():
        if name in c.channels and not name.endswith("_command"):
            yield from _of_another_range(c, c.channels[name], low, high)


def _of_another_range(c: Compilation, channel: ChannelRecord, low: float, high: float) -> Iterator[str]:
    """Warn of points far wider than the range (another sensor's?), and of a range far beyond the points."""
    allowed = UNCOVERED * (channel.high - channel.low)
    points = f"{show(low, channel.quantity)} to {show(high, channel.quantity)}"
    reads = f"{show(channel.low, channel.quantity)} to {show(channel.high, channel.quantity)}"
    place = f"{c.place('channels', channel.name, 'range')}  {channel.name} reads {reads}, and its calibration"
    if high - low > TOO_WIDE * (channel.high - channel.low):
        yield f"{place} {channel.calibration.id} has points from {points}: is it the calibration of this sensor?"
    elif channel.low < low - allowed or channel.high > high + allowed:
        covers = f"{channel.calibration.id} covers {points} only: what lies beyond is not calibrated"
        yield f"{place} {covers}; give points up to there, or a smaller range"
