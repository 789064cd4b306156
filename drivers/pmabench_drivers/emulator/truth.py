"""Actual wiring and scales of each emulated device; independent of the bench file under test, if possible.

A truth file (`pmabench.bench.truth`) states them from data sheets, so that a wrong slope, sign or calibration in the
bench file shows. Without one they are derived from the bench's own records: then no scale is proven.

For testing a self-test, the rig may differ from its description in a slope, a sign or swapped plugs. Written
`KIND:NAME=VALUE`, for instance `scale:force=0.5`, `sign:displacement`, `swap:pressure=force`. A name is a measured
quantity, `output.pressure` for a commanded one, a valve, an emergency stop, or `DEVICE.TERMINAL`. Values are SI.
Without a name or value the usual one is used.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.bench.interface import DeviceRecord, Plug, Scale, Truth, Wired

PLACES = ("server", "stream_port")
"""Options with addresses for listening; they come from the bench file, as the address does."""
KINDS = {
    "scale": "the reading (or what is done) is so many times the right one; 2",
    "range": "the sensor has so many times its range, which begins where it did; 2",
    "sign": "the sign is reversed; a valve or contact works the other way round",
    "offset": "the reading (or what is done) is so much too high; 12 mm, 60 kPa, 120 N, 0.2 rad",
    "swap": "two plugs are exchanged, or one is in another terminal",
}
OFFSETS = {"length": 0.012, "pressure": 60e3, "force": 120.0, "angle": 0.2}
"""Usual offset [SI]: slightly more than 10 mm, or 5 % of a usual range."""
COMMANDS = ("pressure_command", "displacement_command")


def wired(devices: Iterable[DeviceRecord], truth: Truth | None) -> list[Wired]:
    """The devices of a bench as described by `truth`; without it, by the bench.

    With a truth, only names, addresses and watchdog times are taken from the bench's records.
    """
    if truth is None:
        return [_derived(device) for device in devices]
    found = []
    for device in devices:
        if device.name not in truth.devices:
            hint = did_you_mean(device.name, truth.devices)
            raise UsageError(f'{truth.path}: says nothing of the device "{device.name}" of the bench{hint}')
        item = truth.devices[device.name]
        options = {**item.record.options, **{name: device.options[name] for name in PLACES if name in device.options}}
        here = replace(item.record, address=device.address, options=options, watchdog=device.watchdog)
        found.append(replace(item, record=here))
    return found


def _derived(device: DeviceRecord) -> Wired:
    """Wiring from the bench's own record, which proves nothing about it."""
    inputs = {
        item.input: Plug(item.scale, unit=item.raw_unit, low=float(item.scale.to_si(0.0))) for item in device.channels
    }
    outputs = {item.output: Plug(item.scale, unit=item.quantity) for item in device.outputs}
    return Wired(device, inputs, outputs)


def moved(item: Wired, *, inputs: Mapping[str, str] | None = None, outputs: Mapping[str, str] | None = None) -> Wired:
    """The same device with plugs in other terminals: maps from old to new terminals."""
    inputs, outputs = inputs or {}, outputs or {}
    record, plugs, driven = item.record, _plugged(item.inputs, inputs), _plugged(item.outputs, outputs)
    channels = [(c, inputs[c.input]) if c.input in inputs else (c, "") for c in record.channels]
    moving = [(o, outputs[o.output]) if o.output in outputs else (o, "") for o in record.outputs]
    return Wired(
        replace(
            record,
            channels=tuple(replace(c, input=at, scale=plugs[at].scale) if at else c for c, at in channels),
            outputs=tuple(replace(o, output=at, scale=driven[at].scale) if at else o for o, at in moving),
            valves=tuple(replace(v, output=outputs.get(v.output, v.output)) for v in record.valves),
        ),
        plugs,
        driven,
    )


def _plugged(plugs: Mapping[str, Plug], ways: Mapping[str, str]) -> dict[str, Plug]:
    """Plugs in other terminals: the sensor moves, the resolution is that of the new terminal."""
    return {
        (now := ways.get(was, was)): replace(plug, digits=plugs.get(now, plug).digits) for was, plug in plugs.items()
    }


@dataclass(frozen=True)
class Errors:
    """Errors of one device: scales from the correct value to the value that it shows, or that it sets [SI]."""

    shown: Mapping[str, Scale] = field(default_factory=dict)
    done: Mapping[str, Scale] = field(default_factory=dict)


@dataclass(frozen=True)
class _End:
    """One end of a wire: index of the device, `input`, `output`, `valve`, `contact` or nothing, and its terminal."""

    device: int
    kind: str
    terminal: str
    what: str = ""
    quantity: str = ""


def apply(rig: Sequence[Wired], wanted: Iterable[str]) -> tuple[list[Wired], list[Errors], list[str]]:
    """The rig with all requested errors, the errors of each device, and a sentence for each."""
    found, errors, said = list(rig), [Errors() for _ in rig], []
    for text in wanted:
        kind, _, rest = text.partition(":")
        name, _, value = rest.partition("=")
        if kind not in KINDS:
            raise UsageError(f'nothing can be wrong in the way "{kind}"{did_you_mean(kind, KINDS)}: {", ".join(KINDS)}')
        if kind == "swap":
            said.append(_swap(found, name, value))
            continue
        end = _end(found, name or _usual(found))
        if kind == "sign" and end.kind in {"valve", "contact"}:
            said.append(_inverted(found, end))
        elif end.kind not in {"input", "output"}:
            raise UsageError(f'"{text}": {kind} is for what is measured or commanded in numbers')
        else:
            said.append(_bend(found, errors, end, kind, value))
    return found, errors, said


def _end(rig: Sequence[Wired], name: str) -> _End:
    ends = list(_ends(rig))
    for end in ends:
        output = end.kind in {"output", "valve"}
        named = {f"output.{end.what}"} if output else {end.what}
        if end.kind == "valve":
            named.add(end.what)
        if name in named or name == f"{rig[end.device].record.name}.{end.terminal}":
            return end
    known = [f"output.{end.what}" if end.kind == "output" else end.what for end in ends]
    raise UsageError(f'nothing is called "{name}" on this rig{did_you_mean(name, known)}; known: {", ".join(known)}')


def _ends(rig: Sequence[Wired]) -> Iterable[_End]:
    for number, item in enumerate(rig):
        record = item.record
        for channel in record.channels:
            yield _End(number, "input", channel.input, channel.name, channel.quantity)
        for output in record.outputs:
            yield _End(number, "output", output.output, output.name, output.quantity)
        yield from (_End(number, "valve", valve.output, valve.name) for valve in record.valves)
        yield from (_End(number, "contact", lock.input, lock.name) for lock in record.interlocks)


def _usual(rig: Sequence[Wired]) -> str:
    if not (measured := [channel.name for item in rig for channel in item.record.channels]):
        raise UsageError("this rig measures nothing; say what is wrong, as scale:output.pressure=0.5")
    return "force" if "force" in measured else measured[0]


# -- scales -------------------------------------------------------------------------------------------------------


def _bend(rig: Sequence[Wired], errors: list[Errors], end: _End, kind: str, value: str) -> str:
    error, said = _error(rig, end, kind, value)
    if end.kind == "input":
        _shows(errors, end.device, end.what, error)
        return f"{end.what}: {said}"
    held = errors[end.device]
    errors[end.device] = replace(held, done={**held.done, end.what: _after(held.done.get(end.what), error)})
    back = Scale(1.0 / error.slope, -error.offset / error.slope)
    for number in range(len(errors)):  # the command is looped back before the error
        _shows(errors, number, f"{end.what}_command", back)
    if end.what == "displacement":  # a drive measures itself with the scale by which it moves
        _shows(errors, end.device, "displacement", back)
    return f"output.{end.what}: {said}"


def _shows(errors: list[Errors], number: int, what: str, error: Scale) -> None:
    held = errors[number]
    errors[number] = replace(held, shown={**held.shown, what: _after(held.shown.get(what), error)})


def _after(first: Scale | None, then: Scale) -> Scale:
    """Combination of two errors, the first applied first."""
    return then if first is None else Scale(first.slope * then.slope, first.offset * then.slope + then.offset)


def _error(rig: Sequence[Wired], end: _End, kind: str, value: str) -> tuple[Scale, str]:
    if kind == "sign":
        return Scale(-1.0), "has the reversed sign"
    try:
        number = float(value) if value else OFFSETS.get(end.quantity, 1.0) if kind == "offset" else 2.0
    except ValueError:
        raise UsageError(f'{kind}: a number is expected, not "{value}"') from None
    if not abs(number) < 1e9 or (kind != "offset" and not 1e-3 <= abs(number)):
        raise UsageError(f"{kind}: {number:g} is out of all range")
    if kind == "offset":
        return Scale(1.0, number), f"is {number:g} too high [SI]"
    if kind == "scale":
        return Scale(number), f"is {number:g} times the right one"
    item = rig[end.device]
    low = (item.inputs if end.kind == "input" else item.outputs)[end.terminal].low
    slope = 1.0 / number if end.kind == "input" else number
    return Scale(slope, low * (1.0 - slope)), f"has {number:g} times its range"


# -- plugs --------------------------------------------------------------------------------------------------------


def _inverted(rig: list[Wired], end: _End) -> str:
    item, other = rig[end.device], {"open": "closed", "closed": "open", "high": "low", "low": "high"}
    record = item.record
    valves = tuple(
        replace(v, energised=other[v.energised], safe=other[v.safe]) if v.name == end.what else v for v in record.valves
    )
    locks = tuple(replace(lock, safe=other[lock.safe]) if lock.name == end.what else lock for lock in record.interlocks)
    rig[end.device] = replace(item, record=replace(record, valves=valves, interlocks=locks))
    return f"{end.what}: works the other way round"


def _swap(rig: list[Wired], first: str, second: str) -> str:
    if not first:
        first, second = _usual_swap(rig)
    if not second:
        raise UsageError(f"swap:{first}: say with what, as swap:{first}=force, or into which terminal")
    one = _end(rig, first)
    try:
        other = _end(rig, second)
    except UsageError:
        device, _, terminal = second.partition(".")
        if device != rig[one.device].record.name or not terminal:
            raise
        other = _End(one.device, one.kind, terminal)
    if one.device != other.device or one.kind != other.kind or one.kind == "contact" or one.terminal == other.terminal:
        raise UsageError(f"swap:{first}={second}: only plugs of one device that fit into each other's terminals")
    item = rig[one.device]
    plugs = item.inputs if one.kind == "input" else item.outputs
    units = {plugs[end.terminal].unit for end in (one, other) if end.terminal in plugs}
    if len(units) > 1:
        raise UsageError(
            f"swap:{first}={second}: signals in {' and '.join(sorted(units))} do not fit into one terminal"
        )
    ways = {one.terminal: other.terminal, other.terminal: one.terminal}
    rig[one.device] = moved(item, inputs=ways) if one.kind == "input" else moved(item, outputs=ways)
    if other.what:
        return f"{first} and {second}: each is in the other's terminal"
    return f"{first}: is in {other.terminal}, not in {one.terminal}"


def _usual_swap(rig: Sequence[Wired]) -> tuple[str, str]:
    for item in rig:
        for one, other in combinations([c for c in item.record.channels if c.name not in COMMANDS], 2):
            if item.inputs[one.input].unit == item.inputs[other.input].unit:
                return one.name, other.name
    raise UsageError(
        "no two sensors of this rig fit into each other's terminals; say what is swapped, as "
        "swap:output.pressure=DEVICE.TERMINAL"
    )
