"""Limits, watch list, safe state, proof and interlocks of a bench file as records.

A trip that protects nothing is refused, and so is a safe state that does not vent.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

from pmabench.base.quantities import CHANNEL_QUANTITY, show, without_number
from pmabench.bench.channels import refuse_unsafe_order
from pmabench.bench.compilation import Compilation
from pmabench.bench.files.safety import LimitFile, SafeActionFile, WatchFile
from pmabench.bench.files.specimen import Reading
from pmabench.bench.interface import ChannelRecord, InterlockRecord, ProofTest, SafeAction, TripRecord
from pmabench.files.document import Location

LONGEST_DELAY = 1.0
"""Longest delay of a limit that stops or vents [s]."""
EXTRAPOLATED = 0.25
"""Largest extrapolation of a calibration line, as a fraction of the calibrated range."""
SUPPLY_MARGIN = 50e3
"""Least margin of the supply above the highest set-point [Pa]."""
SUPPLY_DELAY = 1.0
"""Time of low supply after which the bench holds [s]."""

HANDS = 50e3
"""Highest pressure at which hands may go in [Pa]: that from which on vessels count as under pressure (2014/68/EU)."""

LIMIT_CHANNEL = {"contraction": "displacement"}
"""Key of `limits`, without the number of a muscle -> the watched channel, if that has another name."""
RATE_OF = {
    "pressure": "pressure rate",
    "length": "speed",
    "force": "force rate",
    "angle": "angular speed",
    "torque": "torque rate",
}
"""Quantity -> its rate of change."""
BOUNDS = {"rate": "faster_than", "following": "more_than", "burst": "falls"}
"""Kind of watch -> its key for what it allows at most."""
ENDS = ("stop", "vent")
"""Actions that release the pressure."""


def watched_by(limit: str) -> str:
    """Channel that a limit watches: `displacement_2` for `contraction_2`."""
    name, number = without_number(limit)
    return LIMIT_CHANNEL.get(name, name) + number


def trips(c: Compilation) -> Iterator[TripRecord]:
    """Every limit of bench and specimen on a channel, and every entry of the watch list."""
    found = list(_limits(c))
    yield from (trip for _name, trip in found)
    yield from _of_the_specimen(c, {t.channel for name, t in found if name == "contraction" and t.action in ENDS})
    yield from _supply(c)
    for output in c.bench.pressures:
        limit_of = c.bench.limits.get(output)
        if limit_of is None or limit_of.trip is None:
            c.fault(("limits", output), f'the output "{output}" has no trip limit; add "{output}: {{trip: ...}}"')
    if c.bench.free_end == "joint":
        _of_the_joint(c)
    for index, entry in enumerate(c.bench.watch):
        if (watch := _watch(c, index, entry)) is not None:
            yield watch


def _limits(c: Compilation) -> Iterator[tuple[str, TripRecord]]:
    """Every limit of the bench on a channel, with its key without the number of a muscle."""
    for name, limit in c.bench.limits.items():
        if without_number(name)[1] and watched_by(name) not in c.names:
            c.fault(("limits", name), f'the bench file names no muscle "{name[-1]}"', key=True)
            continue
        for key in ("command", "command_low"):
            if getattr(limit, key) is not None and name not in (*c.bench.set_points, *c.bench.steered):
                c.fault(("limits", name, key), f'nothing commands "{name}" on this bench')
        if (channel := c.channels.get(watched_by(name))) is None:
            if (limit.trip or limit.trip_low) and watched_by(name) not in c.bench.channels:
                c.fault(("limits", name), f'there is no channel "{watched_by(name)}" to watch')
            continue
        if (found := _range(c, name, limit, channel)) is not None:
            yield without_number(name)[0], found


def _range(c: Compilation, name: str, limit: LimitFile, channel: ChannelRecord) -> TripRecord | None:
    at: Location = ("limits", name)
    before, quantity = len(c.problems), without_number(name)[0]
    high, low = _bound(c, name, limit.trip, "trip"), _bound(c, name, limit.trip_low, "trip_low")
    source = c.place(*at, "trip" if limit.trip is not None else "trip_low")
    if quantity == "contraction" and limit.action in ENDS and c.length is not None:
        most, place = _most_contraction(c, name, c.length)
        if high is None or most < high:
            high, source = most, place
    if len(c.problems) > before or (high is None and low is None):
        return None
    if low is not None:
        _inside(c, (*at, "trip_low"), low, channel)
        _below_commands(c, name, low, channel)
        if low >= 0 and quantity != "supply" and limit.action in ENDS:  # all else rests at 0
            c.fault((*at, "trip_low"), "a value below zero is expected: the bench would trip where it rests")
    if limit.delay > LONGEST_DELAY and limit.action in ENDS:
        c.fault((*at, "delay"), f"is longer than {LONGEST_DELAY:g} s: that is no protection")
    if high is not None and low is not None and low >= high:
        c.fault((*at, "trip_low"), "lies at or above the upper trip limit")
    if high is not None:
        if high <= 0:
            c.fault((*at, "trip"), "a value above zero is expected: the bench would trip where it rests")
            return None
        _inside(c, (*at, "trip"), high, channel)
        _above_commands(c, name, high, channel)
        if quantity == "pressure":
            _protects_the_muscle(c, name, limit, high)
    return TripRecord(channel.name, low, high, limit.delay, limit.action, source)


def _most_contraction(c: Compilation, name: str, length: float) -> tuple[float, str]:
    """Lowest contraction limit [m] for the muscle of a channel or limit, and its place in a file."""
    return min((borne.limits.contraction * length, borne.place("contraction")) for borne in c.borne(name))


def _bound(c: Compilation, name: str, reading: Reading | None, key: str) -> float | None:
    if reading is None:
        return None
    at: Location = ("limits", name, key)
    if without_number(name)[0] == "contraction":
        ratio = c.si(reading, "ratio", at)
        return ratio * c.length if c.length is not None else None
    return c.si(reading, CHANNEL_QUANTITY[watched_by(name)], at)


def _inside(c: Compilation, at: Location, value: float, channel: ChannelRecord) -> None:
    """Require a trip inside the channel's range, and not far outside the calibrated one."""
    quantity, trip = channel.quantity, f"the trip {show(value, channel.quantity)}"
    if not channel.low < value < channel.high:
        span = f"{show(channel.low, quantity)} to {show(channel.high, quantity)}"
        c.fault(at, f"{trip} is not inside the channel's range, {span}: it would never be seen")
    elif (beyond := _beyond(c, channel, value)) > EXTRAPOLATED:
        low, high = c.calibrated[channel.name]
        span, most = f"{show(low, quantity)} to {show(high, quantity)}", show(EXTRAPOLATED * (high - low), quantity)
        off = f"{trip} is not inside the calibration {channel.calibration.id}, {span}, nor within {most} of it"
        c.fault(at, f"{off}: calibrate with points nearer to the trip, or move the trip nearer to them")
    elif beyond > 0:
        known = show(channel.calibration.uncertainty(value) + _extrapolation(c, channel, value), quantity)
        c.extrapolated.append(f"{show(value, quantity)} of {channel.name} ({channel.calibration.id}; +-{known} there)")


def _beyond(c: Compilation, channel: ChannelRecord, value: float) -> float:
    """Distance of a value from the calibrated range, as a fraction of that range; 0 inside or without a calibration."""
    low, high = c.calibrated.get(channel.name, (value, value))
    return max(low - value, value - high, 0.0) / (high - low) if high > low else 0.0


def _extrapolation(c: Compilation, channel: ChannelRecord, value: float) -> float:
    """Additional uncertainty of a value outside the calibrated range [SI].

    A line that is off by at most U at both ends of its points is off by up to U (1 + 2 d) at a fraction d beyond them.
    """
    return 2.0 * _beyond(c, channel, value) * channel.calibration.offset_uncertainty


def _above_commands(c: Compilation, name: str, high: float, channel: ChannelRecord) -> None:
    """Require a trip above the command limit, by the channel's uncertainty and the regulator's overshoot."""
    if (output := c.outputs.get(watched_by(name))) is None:
        return
    margin = channel.calibration.uncertainty(high) + _extrapolation(c, channel, high)
    margin += c.bench.air.overshoot if output.quantity == "pressure" else 0.0
    if high <= output.high or high < output.high + margin * (1 - 1e-9):
        shown, least = show(high, channel.quantity), show(margin, channel.quantity)
        limit = f"the command limit {show(output.high, channel.quantity)} ({output.high_from})"
        text = f"the trip {shown} must lie at least {least} (uncertainty and overshoot) above {limit}"
        c.fault(("limits", name, "trip"), text)


def _below_commands(c: Compilation, name: str, low: float, channel: ChannelRecord) -> None:
    """Require a lower trip of a drive below the lowest command, by the channel's uncertainty."""
    output = c.outputs.get(watched_by(name))
    margin = channel.calibration.uncertainty(low) + _extrapolation(c, channel, low)
    if output is not None and output.rate and (low >= output.low or low > output.low - margin * (1 - 1e-9)):
        shown = f"the trip {show(low, output.quantity)} must lie at least {show(margin, output.quantity)} (uncertainty)"
        text = f"{shown} below the lowest command {show(output.low, output.quantity)} ({output.low_from})"
        c.fault(("limits", name, "trip_low"), text)


def _protects_the_muscle(c: Compilation, name: str, limit: LimitFile, high: float) -> None:
    for borne in c.borne(name):
        never = borne.limits.pressure.never_above
        if high >= never:
            shown = f"the trip {show(high, 'pressure')} does not lie below {borne.whose} never_above"
            place = borne.place("pressure", "never_above")
            c.fault(("limits", name, "trip"), f"{shown} {show(never, 'pressure')} ({place})")
    if limit.action != "vent":
        c.fault(("limits", name, "action"), 'the trip limit of the pressure must "vent"')


def _of_the_specimen(c: Compilation, watched: Collection[str]) -> Iterator[TripRecord]:
    """Contraction limit of each muscle, unless a limit of the bench that stops or vents covers it."""
    for name in c.channels:
        if without_number(name)[0] == "displacement" and name not in watched and c.length is not None:
            most, place = _most_contraction(c, name, c.length)
            yield TripRecord(name, None, most, 0.0, "vent", place)
    if "displacement" not in c.bench.channels and c.bench.free_end in {"weights", "actuator"} and not c.bench.muscles:
        c.fault(("channels",), "nothing measures the displacement, which the specimen's contraction limit needs")
    for name in c.bench.pressures:
        if name not in c.bench.channels:
            c.fault(("channels",), f'nothing measures the pressure that is commanded; add a channel "{name}"')


def _of_the_joint(c: Compilation) -> None:
    """Require a channel for the angle of a joint, with trip limits on both sides."""
    if "angle" not in c.bench.channels:
        c.fault(("channels",), 'nothing measures the angle of the joint; add a channel "angle"')
    limit = c.bench.limits.get("angle")
    if limit is None or limit.trip is None or limit.trip_low is None or limit.action not in ENDS:
        text = 'the angle of the joint needs limits to both sides that stop or vent; add "angle: {trip_low: ..., '
        c.fault(("limits", "angle"), text + 'trip: ..., action: vent}"')


def _supply(c: Compilation) -> Iterator[TripRecord]:
    """Trip that holds the bench while a measured supply is too low for the highest set-point."""
    supply, output = c.channels.get("supply"), c.highest
    if supply is None or output is None:
        return
    least = output.high + SUPPLY_MARGIN
    limit = c.bench.limits.get("supply")
    if limit is not None and limit.trip_low is not None:
        given = _bound(c, "supply", limit.trip_low, "trip_low") or 0.0
        if given < least:
            highest = f"the highest set-point, {show(output.high, 'pressure')} ({output.high_from})"
            text = f"must lie at least {show(SUPPLY_MARGIN, 'pressure')} above {highest}"
            c.fault(("limits", "supply", "trip_low"), text)
        return
    place: Location = ("channels", "supply")
    _inside(c, (*place, "range"), least, supply)
    yield TripRecord("supply", least, None, SUPPLY_DELAY, "hold", c.place(*place))


def _watch(c: Compilation, index: int, entry: WatchFile) -> TripRecord | None:
    at: Location = ("watch", index)
    kind, name = entry.kind, entry.channel
    if c.unknown((*at, kind), "channel", name, c.bench.channels) or name not in c.channels:
        return None
    channel = c.channels[name]
    quantity = channel.quantity
    delay, window = entry.for_ or 0.0, entry.within or 0.0
    low: float | None = None
    high: float | None = None
    if bound := BOUNDS.get(kind):
        rate_or_value = RATE_OF[quantity] if kind == "rate" else quantity
        high = _above_zero(c, getattr(entry, bound), rate_or_value, (*at, bound))
        if kind == "following" and name not in c.bench.set_points:
            commanded = ", ".join(c.outputs) or "nothing"
            c.fault((*at, kind), f'nothing commands "{name}"; what is commanded here: {commanded}')
        elif kind == "burst" and high >= channel.high - channel.low:
            c.fault((*at, bound), "is more than the channel can measure: it would never be seen")
    elif entry.below:
        low = c.si(entry.below, quantity, (*at, "below"))
        _inside(c, (*at, "below"), low, channel)
    if kind in {"stale", "frozen"} and delay <= 0:
        c.fault((*at, "for"), "a time above zero is expected: every channel is silent between two samples")
    return TripRecord(name, low, high, delay, entry.action, c.place(*at), kind.replace("_", "-"), window)


def _above_zero(c: Compilation, reading: Reading, quantity: str, at: Location) -> float:
    before = len(c.problems)
    value = c.si(reading, quantity, at)
    if value <= 0 and len(c.problems) == before:
        c.fault(at, "a value above zero is expected")
    return value


LATEST_VENT = 10.0
"""Longest time before the safe state begins to release the pressure [s]."""
SETUP_PRESSURE = 100e3
"""Highest pressure before the bench is proven, if the file does not set it [Pa]."""


def safe_state(c: Compilation) -> tuple[SafeAction, ...]:
    """The declared actions in order; each output must end where it is safe, and the vent must be confirmed."""
    if c.bench.hands.below > HANDS:
        below, most = show(c.bench.hands.below, "pressure"), show(HANDS, "pressure")
        c.fault(("hands", "below"), f"{below} is no vented muscle: hands may go in at {most} at most")
    actions: list[SafeAction | None] = []
    for index, file in enumerate(c.bench.safe_state):
        verb = file.verb
        at: Location = ("safe_state", index)
        if verb in {"set", "ramp_down", "drive_quick_stop"}:
            actions.append(_output(c, file, at))
        elif verb in {"open", "close"}:
            target = str(getattr(file, verb))
            known = not c.unknown((*at, verb), "valve", target, c.bench.valves)
            actions.append(SafeAction(verb, target, 0.0, file.within or 0.0) if known else None)
        elif verb == "hold":
            actions.append(SafeAction("hold", "", 0.0, file.hold or 0.0))
        else:
            actions.append(_confirm(c, file, at))
    if None not in actions:
        found = tuple(action for action in actions if action is not None)
        for pressure in c.bench.pressures:
            if pressure in c.bench.set_points:
                _vents(c, found, pressure)
        _ends_safe(c, found)
        if c.bench.steered:
            refuse_unsafe_order(c, found)
        elif c.bench.muscles:
            _in_order(c, found)
        return found
    return ()


def _output(c: Compilation, file: SafeActionFile, at: Location) -> SafeAction | None:
    verb, within = file.verb, file.within or 0.0
    target = str(getattr(file, verb))
    if c.unknown((*at, verb), "output that takes values", target, c.bench.set_points) or target not in c.outputs:
        return None
    output = c.outputs[target]
    if verb == "drive_quick_stop":
        if output.quantity == "pressure":
            c.fault((*at, verb), 'the pressure is not a drive; use "set", "ramp_down" or "open"')
        return SafeAction("stop", target, 0.0, within)
    value = output.safe if file.to is None else c.si(file.to, output.quantity, (*at, "to"))
    if not output.low <= value <= output.high:
        c.fault((*at, "to"), f"{show(value, output.quantity)} is outside the limits of the output")
    if verb == "set" or file.at is None:
        return SafeAction("set", target, value, within)
    quantity = RATE_OF[output.quantity]
    if (rate := c.si(file.at, quantity, (*at, "at"))) <= 0:
        c.fault((*at, "at"), "a rate above zero is expected")
        return None
    if output.rate and rate > output.rate:
        c.fault((*at, "at"), f"is faster than the drive, {show(output.rate, quantity)}")
    if (longest := max(output.high - value, value - output.low) / rate) > within * (1 + 1e-9):
        c.fault((*at, "within"), f"the ramp takes up to {longest:.3g} s, longer than its deadline")
    return SafeAction("ramp", target, value, within, rate)


def _confirm(c: Compilation, file: SafeActionFile, at: Location) -> SafeAction | None:
    target = str(file.confirm)
    if c.unknown((*at, "confirm"), "channel", target, c.bench.channels) or target not in c.channels or not file.below:
        return None
    channel = c.channels[target]
    below = c.si(file.below, channel.quantity, (*at, "below"))
    if channel.name in c.bench.pressures and below <= 0:
        c.fault((*at, "below"), "a pressure above zero is expected: a vent ends at that of the room")
    elif not channel.low < below < channel.high:
        c.fault((*at, "below"), f"{show(below, channel.quantity)} is not inside the channel's range")
    elif channel.name in c.bench.pressures and below > c.bench.hands.below:
        hands = f"{show(c.bench.hands.below, 'pressure')} ({c.place('hands', 'below')})"
        c.fault((*at, "below"), f"is above the pressure at which hands may go in, {hands}: it would confirm no vent")
    return SafeAction("confirm", target, below, file.within or 0.0)


def _vents(c: Compilation, actions: tuple[SafeAction, ...], name: str) -> None:
    """Require that the pressure `name` begins to fall soon, ends at its safe value, and is confirmed afterwards."""
    to_pressure = [n for n, a in enumerate(actions) if a.do in {"set", "ramp"} and a.target == name]
    dumps = {"dump_valve", f"dump_valve{without_number(name)[1]}"}
    first = [n for n, a in enumerate(actions) if n in to_pressure or (a.do == "open" and a.target in dumps)]
    output = c.outputs.get(name)
    if not to_pressure or (output is not None and actions[to_pressure[-1]].value > output.safe):
        safe = show(output.safe, "pressure") if output else "its safe value"
        c.fault(("safe_state",), f'does not vent: its last "set: {name}" or "ramp_down: {name}" must go to {safe}')
        return
    waits = sum(a.within for a in actions[: first[0]] if a.do in {"hold", "stop"})
    if waits > LATEST_VENT:
        c.fault(("safe_state",), f"waits {waits:g} s before it vents; at most {LATEST_VENT:g} s")
    looks = [n for n, a in enumerate(actions) if a.do == "confirm" and a.target == name]
    if not looks:
        c.fault(("safe_state",), f'does not look: "- {{confirm: {name}, below: ..., within: ...}}" is missing')
    elif looks[-1] < to_pressure[-1]:
        c.fault(("safe_state", looks[-1]), "looks before the vent; the confirmation comes last")


def _ends_safe(c: Compilation, actions: tuple[SafeAction, ...]) -> None:
    """Require that every drive is stopped or moved, every valve gets a position, and dump valves end open."""
    for name, output in c.outputs.items():
        if output.quantity == "pressure":
            continue
        first = next((n for n, a in enumerate(actions) if a.target == name and a.do in {"set", "ramp", "stop"}), None)
        if first is None:
            c.fault(("safe_state",), f'leaves "{name}" moving: add "drive_quick_stop: {name}" or "set: {name}"')
        elif waited := next((a for a in actions[:first] if a.do in WAITED_FOR), None):
            what = f"{waited.do} {waited.target}".strip()
            text = f'leaves "{name}" moving while "{what}" goes on, up to {waited.within:g} s: stop it before that'
            c.fault(("safe_state", first), f'{text}, "drive_quick_stop: {name}" or "set: {name}" first')
    for name in c.valves:
        ends = [action.do for action in actions if action.target == name and action.do in {"open", "close"}]
        if without_number(name)[0] == "dump_valve" and (not ends or ends[-1] != "open"):
            c.fault(("safe_state",), f'does not open the dump valve: "- {{open: {name}, within: ...}}" is missing')
        elif not ends and not c.valves[name].longest:
            c.fault(("safe_state",), f'says nothing of the valve "{name}": add "open: {name}" or "close: {name}"')


WAITED_FOR = ("ramp", "hold", "confirm")
"""Actions of the safe state that must end before the next one starts."""


def _in_order(c: Compilation, actions: tuple[SafeAction, ...]) -> None:
    """Require that several muscles vent as declared: all at once, or outputs and valves in the declared order."""
    if (declared := c.bench.vents) == "together":
        off = [n for n, a in enumerate(actions) if a.target in c.bench.pressures and a.do in {"set", "ramp"}]
        waits = [a for a in actions[min(off) : max(off)] if a.do in WAITED_FOR] if off else []
        for action in waits:
            what = f"{action.do} {action.target}".strip()
            text = f'"vents: together" and "{what}" between the muscles, which the next one waits for'
            c.fault(("safe_state",), f"{text}: one muscle alone turns what the others held; set all, then wait")
        return
    known = [*c.bench.outputs]
    unknown = [c.unknown(("vents", n), "output or valve", name, known) for n, name in enumerate(declared or ())]
    if any(unknown):
        return
    for name in c.bench.pressures:
        if name not in (declared or ()):
            c.fault(("vents",), f'"{name}" is missing: say when each muscle vents, or "together"')
    places = [next((n for n, a in enumerate(actions) if a.target == name), -1) for name in declared or ()]
    if places != sorted(places) or len(set(places)) < len(places):
        order = f"{', '.join(declared or ())} ({c.place('vents')})"
        c.fault(("safe_state",), f"is not in the order that is declared: {order}")


def interlocks(c: Compilation) -> dict[str, list[InterlockRecord]]:
    """The interlocks of each device."""
    found: dict[str, list[InterlockRecord]] = {name: [] for name in c.bench.devices}
    names: set[str] = set()
    for index, file in enumerate(c.bench.interlocks):
        at: Location = ("interlocks", index)
        if file.name in names:
            c.fault((*at, "name"), f'there are two interlocks "{file.name}"')
        names.add(file.name)
        if not c.unknown((*at, "input", "device"), "device", file.input.device, c.bench.devices):
            record = InterlockRecord(file.name, file.input.device, file.input.input, file.safe)
            found[file.input.device].append(record)
    return found


def setup_pressure(c: Compilation) -> float:
    """Highest pressure before the bench is proven [Pa], never above the command limit."""
    most = min((output.high for output in c.pressures), default=SETUP_PRESSURE)
    if c.bench.setup_pressure is None:
        return min(SETUP_PRESSURE, most)
    if c.bench.setup_pressure > most:
        c.fault(("setup_pressure",), f"is above the command limit, {show(most, 'pressure')}")
    return c.bench.setup_pressure


def proof(c: Compilation, most: float) -> ProofTest | None:
    """Proof of the vent path, within the set-up pressure `most` [Pa]; None if not declared."""
    if (file := c.bench.proof) is None:
        return None
    if not c.pressures:
        c.fault(("proof",), "nothing commands the pressure on this bench: there is nothing to prove")
    if file.pressure > most:
        c.fault(("proof", "pressure"), f"is above the set-up pressure, {show(most, 'pressure')}")
    return ProofTest(file.pressure, file.below, file.within, file.fill)
