"""The safe state of a bench file, its proof, its controlled stop and its interlocks; refused where it does not vent."""

from __future__ import annotations

from collections.abc import Mapping

from pmabench.base.quantities import show
from pmabench.bench.compilation import Compilation
from pmabench.bench.files import SafeActionFile
from pmabench.bench.interface import ChannelRecord, InterlockRecord, OutputRecord, ProofTest, SafeAction, ValveRecord
from pmabench.bench.trips import RATE_OF
from pmabench.files.document import Location

LATEST_VENT = 10.0
"""Longest time before the safe state begins to take the pressure off [s]."""
SETUP_PRESSURE = 100e3
"""Highest pressure before the bench is proven, where the file does not say [Pa]."""


def safe_state(
    c: Compilation,
    channels: Mapping[str, ChannelRecord],
    outputs: Mapping[str, OutputRecord],
    valves: Mapping[str, ValveRecord],
) -> tuple[SafeAction, ...]:
    """The declared actions in order; each output must end where it is safe, and the vent must be confirmed."""
    actions: list[SafeAction | None] = []
    for index, file in enumerate(c.bench.safe_state):
        verb = file.verb
        at: Location = ("safe_state", index)
        if verb in {"set", "ramp_down", "drive_quick_stop"}:
            actions.append(_output(c, file, at, outputs))
        elif verb in {"open", "close"}:
            target = str(getattr(file, verb))
            known = not c.unknown((*at, verb), "valve", target, c.bench.valves)
            actions.append(SafeAction(verb, target, 0.0, file.within or 0.0) if known else None)
        elif verb == "hold":
            actions.append(SafeAction("hold", "", 0.0, file.hold or 0.0))
        else:
            actions.append(_confirm(c, file, at, channels))
    if None not in actions:
        found = tuple(action for action in actions if action is not None)
        _vents(c, found, outputs)
        _ends_safe(c, found, outputs, valves)
        return found
    return ()


def _output(
    c: Compilation, file: SafeActionFile, at: Location, outputs: Mapping[str, OutputRecord]
) -> SafeAction | None:
    verb, within = file.verb, file.within or 0.0
    target = str(getattr(file, verb))
    if c.unknown((*at, verb), "output that takes values", target, c.bench.set_points) or target not in outputs:
        return None
    output = outputs[target]
    if verb == "drive_quick_stop":
        if target == "pressure":
            c.fault((*at, verb), 'the pressure is not a drive; use "set", "ramp_down" or "open"')
        return SafeAction("stop", target, 0.0, within)
    value = output.safe if file.to is None else c.si(file.to, output.quantity, (*at, "to"))
    if not output.low <= value <= output.high:
        c.fault((*at, "to"), f"{show(value, output.quantity)} is outside the limits of the output")
    if verb == "set" or file.at is None:
        return SafeAction("set", target, value, within)
    quantity = RATE_OF[output.quantity]
    rate = c.si(file.at, quantity, (*at, "at"))
    if rate <= 0:
        c.fault((*at, "at"), "a rate above zero is expected")
        return None
    if output.rate and rate > output.rate:
        c.fault((*at, "at"), f"is faster than the drive, {show(output.rate, quantity)}")
    longest = max(output.high - value, value - output.low) / rate
    if longest > within * (1 + 1e-9):
        c.fault((*at, "within"), f"the ramp takes up to {longest:.3g} s, longer than its deadline")
    return SafeAction("ramp", target, value, within, rate)


def _confirm(
    c: Compilation, file: SafeActionFile, at: Location, channels: Mapping[str, ChannelRecord]
) -> SafeAction | None:
    target = str(file.confirm)
    if c.unknown((*at, "confirm"), "channel", target, c.bench.channels) or target not in channels or not file.below:
        return None
    channel = channels[target]
    below = c.si(file.below, channel.quantity, (*at, "below"))
    if target == "pressure" and below <= 0:
        c.fault((*at, "below"), "a pressure above zero is expected: a vent ends at that of the room")
    elif not channel.low < below < channel.high:
        c.fault((*at, "below"), f"{show(below, channel.quantity)} is not inside the channel's range")
    elif target == "pressure" and below > c.bench.hands.below:
        hands = f"{show(c.bench.hands.below, 'pressure')} ({c.place('hands', 'below')})"
        c.fault((*at, "below"), f"is above the pressure at which hands may go in, {hands}: it would confirm no vent")
    return SafeAction("confirm", target, below, file.within or 0.0)


def _vents(c: Compilation, actions: tuple[SafeAction, ...], outputs: Mapping[str, OutputRecord]) -> None:
    """Pressure begins to fall soon, ends at its safe value, and is looked at after that."""
    if "pressure" not in c.bench.set_points:
        return
    to_pressure = [n for n, a in enumerate(actions) if a.do in {"set", "ramp"} and a.target == "pressure"]
    first = [n for n, a in enumerate(actions) if n in to_pressure or (a.do == "open" and a.target == "dump_valve")]
    output = outputs.get("pressure")
    if not to_pressure or (output is not None and actions[to_pressure[-1]].value > output.safe):
        safe = show(output.safe, "pressure") if output else "its safe value"
        c.fault(("safe_state",), f'does not vent: its last "set: pressure" or "ramp_down: pressure" must go to {safe}')
        return
    waits = sum(a.within for a in actions[: first[0]] if a.do in {"hold", "stop"})
    if waits > LATEST_VENT:
        c.fault(("safe_state",), f"waits {waits:g} s before it vents; at most {LATEST_VENT:g} s")
    looks = [n for n, a in enumerate(actions) if a.do == "confirm" and a.target == "pressure"]
    if not looks:
        c.fault(("safe_state",), 'does not look: "- {confirm: pressure, below: ..., within: ...}" is missing')
    elif looks[-1] < to_pressure[-1]:
        c.fault(("safe_state", looks[-1]), "looks before the vent; the confirmation comes last")


def _ends_safe(
    c: Compilation,
    actions: tuple[SafeAction, ...],
    outputs: Mapping[str, OutputRecord],
    valves: Mapping[str, ValveRecord],
) -> None:
    """Every drive is stopped or brought to a place, every valve gets a position, and the dump valve ends open."""
    moved = {action.target for action in actions if action.do in {"set", "ramp", "stop"}}
    for name in outputs:
        if name != "pressure" and name not in moved:
            c.fault(("safe_state",), f'leaves "{name}" moving: add "drive_quick_stop: {name}" or "set: {name}"')
    for name in valves:
        ends = [action.do for action in actions if action.target == name and action.do in {"open", "close"}]
        if name == "dump_valve" and (not ends or ends[-1] != "open"):
            c.fault(("safe_state",), 'does not open the dump valve: "- {open: dump_valve, within: ...}" is missing')
        elif not ends:
            c.fault(("safe_state",), f'says nothing of the valve "{name}": add "open: {name}" or "close: {name}"')


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


def setup_pressure(c: Compilation, outputs: Mapping[str, OutputRecord]) -> float:
    """Highest pressure before the bench is proven [Pa], never above the command limit."""
    output = outputs.get("pressure")
    most = output.high if output is not None else SETUP_PRESSURE
    if c.bench.setup_pressure is None:
        return min(SETUP_PRESSURE, most)
    if c.bench.setup_pressure > most:
        c.fault(("setup_pressure",), f"is above the command limit, {show(most, 'pressure')}")
    return c.bench.setup_pressure


def proof(c: Compilation, most: float) -> ProofTest | None:
    """The proof of the vent path, within the set-up pressure `most` [Pa]."""
    file = c.bench.proof
    if file is None:
        return None
    if "pressure" not in c.bench.set_points:
        c.fault(("proof",), "nothing commands the pressure on this bench: there is nothing to prove")
    if file.pressure > most:
        c.fault(("proof", "pressure"), f"is above the set-up pressure, {show(most, 'pressure')}")
    return ProofTest(file.pressure, file.below, file.within, file.fill)


def stop_rate(c: Compilation) -> float:
    """Rate of a controlled stop [Pa/s]; 0: the safe state at once."""
    return c.bench.stop.ramp if c.bench.stop is not None else 0.0
