"""The card of a bench: what is mounted on the rig, and what happens when something fails, as plain texts and rows.

`pmabench.report.writing` draws it. What happens at a failure follows from valves, watchdogs and watch list.
"""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pmabench.base.quantities import show, without_number
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import ChannelRecord, DeviceRecord, SafeAction, TripRecord
from pmabench.bench.safety import RATE_OF


def _has_stop(mounted: Mounted) -> bool | None:
    """Whether an emergency stop is wired to an input; None if contacts are, of which none has "stop" in its name."""
    names = [record.name for device in mounted.bench.devices for record in device.interlocks]
    return any("stop" in name for name in names) or (None if names else False)


def _by_hand(mounted: Mounted) -> str:
    return f"{'Press the emergency stop, shut' if _has_stop(mounted) else 'Shut'} off the air, vent by hand."


def _protection(mounted: Mounted) -> str:
    """What protects people at this bench, and what of that it lacks."""
    there = {
        "relief valve": mounted.bench_file.air.relief_valve != "none",
        "normally-open dump valve": mounted.bench_file.normally_open_dump,
        "emergency stop": _has_stop(mounted),
    }
    has, lacks = ([name for name, known in there.items() if known is way] for way in (True, False))  # None: not known
    text = f"People are protected by the {', the '.join([*has, 'shield'])}."
    return text + (f" This bench file names NO {' and NO '.join(lacks)}." if lacks else "")


def _unconfirmed(mounted: Mounted) -> str:
    """A sentence where somebody still has to look up what stands on the card."""
    if not (mounted.bench.realtime and mounted.unconfirmed):
        return ""
    return 'Values of this bench are still guesses. Put no air on it before they are looked up; see "pmabench check".'


def failure_story(mounted: Mounted) -> list[tuple[str, str]]:
    """Pairs of what may fail and what happens then, in words for people at the rig; pure."""
    if not mounted.bench.realtime:
        return [("Anything", "Nothing is pressurised: this bench is simulated in virtual time.")]
    return [
        ("The program", "The guard, a separate process, vents: at once after a crash, within 0.5 s after a freeze."),
        ("The computer", " ".join(_computer(mounted))),
        ("Electric power", " ".join(_power(mounted))),
        ("Compressed air", " ".join(_air(mounted))),
        ("Network or cable", " ".join(_link(mounted))),
        ("Pressure sensor", " ".join(_sensor(mounted))),
        ("An interlock", _interlock(mounted)),
    ]


def seconds(value: float) -> str:
    """A duration as text: `200 ms`, `5 s`."""
    return f"{value * 1e3:.3g} ms" if value < 1 else f"{value:.3g} s"


def _device_of(mounted: Mounted, output: str) -> DeviceRecord | None:
    for device in mounted.bench.devices:
        if output in {*(o.name for o in device.outputs), *(v.name for v in device.valves)}:
            return device
    return None


def _opens_unheard(mounted: Mounted, output: str) -> DeviceRecord | None:
    """Device whose watchdog opens the dump valve of an output when communication stops; None without one."""
    own = _device_of(mounted, f"dump_valve{without_number(output)[1]}")
    device = own or _device_of(mounted, "dump_valve")
    return device if device is not None and device.watchdog else None


def _computer(mounted: Mounted) -> Iterator[str]:
    names = [output.name for output in mounted.bench.pressures]
    if mounted.bench.aims:
        yield from _valves_unheard(mounted)
    elif not names:
        yield "Nothing commands the pressure on this bench."
    yield from dict.fromkeys(sentence for name in names for sentence in _unheard(mounted, name))
    drive = _device_of(mounted, "displacement") or _device_of(mounted, "angle")
    if drive is not None:
        yield "The drive's own watchdog ends its motion." if drive.watchdog else "THE DRIVE GOES ON."


def _valves_unheard(mounted: Mounted) -> Iterator[str]:
    """Sentences on muscles behind valves that open in pulses, when the computer fails."""
    by_hand = _by_hand(mounted)
    yield "Pulses of valves end by themselves."
    for name in ("supply_valve", "dump_valve"):
        device = _device_of(mounted, name) or _device_of(mounted, f"{name}_1")
        if device is not None and device.watchdog:
            shown = name.replace("_", " ")
            yield f"{device.name} hears nothing and lets go of the {shown} after {seconds(device.watchdog)}."
        else:
            yield f"THE {name.replace('_', ' ').upper()} STAYS AS IT IS: its device has no watchdog. {by_hand}"


def _unheard(mounted: Mounted, output: str) -> Iterator[str]:
    """Sentences on one muscle when its devices no longer receive anything from the computer."""
    pressure, opens, by_hand = _device_of(mounted, output), _opens_unheard(mounted, output), _by_hand(mounted)
    if pressure is not None and pressure.watchdog:
        also = ""
        if opens is not None:
            same = opens is pressure
            also = " and opens the dump valve" if same else f"; {opens.name} opens the dump valve"
            also += "" if same else f" after {seconds(opens.watchdog)}"
        yield f"{pressure.name} hears nothing and vents by itself after {seconds(pressure.watchdog)}{also}."
    elif opens is not None:
        yield f"{opens.name} hears nothing and opens the dump valve after {seconds(opens.watchdog)}: the muscle vents."
        yield "The regulator keeps its last set-point."
    elif pressure is not None:
        yield f"NOTHING VENTS: {pressure.name} has no watchdog, and the pressure stays at its last value. {by_hand}"


def _power(mounted: Mounted) -> Iterator[str]:
    outputs = [one for name, one in mounted.bench_file.set_points.items() if name in mounted.bench_file.pressures]
    if mounted.bench.aims:
        yield "Supply and fill valves shut, and the dumps open: every muscle vents."
    elif mounted.bench_file.normally_open_dump:
        yield "The dump valve opens and the muscle vents, whatever the regulator does."
    elif outputs and all(output.without_power == "vents" for output in outputs):
        yield "The regulator vents by itself."
    elif outputs:
        yield f"THE REGULATOR MAY HOLD THE PRESSURE: nothing opens without power. {_by_hand(mounted)}"
    yield from _load(mounted)
    if _device_of(mounted, "displacement") is not None:
        yield "The drive no longer holds the free end."
    if _device_of(mounted, "angle") is not None:
        yield "The drive no longer holds the joint."


def _load(mounted: Mounted) -> Iterator[str]:
    if (weights := mounted.bench_file.weights) is not None:
        caught = f"the catch at {show(weights.catch_height, 'length')}" if weights.catch_height else "NOTHING"
        yield f"The load comes down; {caught} stops it."


def _air(mounted: Mounted) -> Iterator[str]:
    sinks = "" if mounted.bench_file.weights is None else "; the load sinks"
    yield f"The pressure falls as far as the muscle leaks{sinks}."
    supply = [trip for trip in mounted.bench.trips if trip.channel == "supply" and trip.low is not None]
    names = mounted.bench_file.pressures
    following = [trip for trip in mounted.bench.trips if trip.kind == "following" and trip.channel in names]
    for trip in supply[:1]:
        yield f"Supply below {show(trip.low or 0.0, 'pressure')} for {seconds(trip.delay)}: {trip.action}."
    yield from (f"{noticed(trip)}: {trip.action}." for trip in following[: 0 if supply else 1])
    if not supply and not following:
        yield "NOTHING REPORTS IT: look at the gauge."
    yield "Air that comes back brings the pressure back: vent first."


def _link(mounted: Mounted) -> Iterator[str]:
    yield "A device that does not answer for 0.2 s ends the run; every other one is vented."
    for device in mounted.bench.devices:
        if device.guarded and device.watchdog:
            moves = not device.valves and all(output.quantity in {"length", "angle"} for output in device.outputs)
            does = "stops its motion" if device.outputs and moves else "vents"
            yield f"{device.name} itself {does} after {seconds(device.watchdog)}."
        elif device.outputs:
            yield f"{device.name} keeps its last value: NO WATCHDOG."


def _sensor(mounted: Mounted) -> Iterator[str]:
    of_pressures = [t for t in mounted.bench.trips if without_number(t.channel)[0] == "pressure"]
    watched = [t for t in of_pressures if t.kind in {"stale", "frozen", "off-range"}]
    low = [t for t in of_pressures if t.kind == "range" and t.low is not None]
    seen = [f"{noticed(trip)}: {trip.action}" for trip in watched]
    seen += [f"reads below {show(trip.low or 0.0, 'pressure')}: {trip.action}" for trip in low]
    if not seen:
        yield "A DEAD SENSOR IS NOT NOTICED."
    else:
        text = "; ".join(seen)
        yield f"{text[0].upper()}{text[1:]}."


def _interlock(mounted: Mounted) -> str:
    if not any(device.interlocks for device in mounted.bench.devices):
        return "THE PROGRAM DOES NOT SEE IT: no emergency stop, door or drive is wired to an input."
    return "Vent; the bench stays tripped until somebody has looked and reset it."


def noticed(trip: TripRecord, quantity: str = "pressure") -> str:
    """What a trip of the watch list detects, in words."""
    rate = RATE_OF.get(quantity, quantity)
    high = trip.high or 0.0
    lasting = f" for {seconds(trip.delay)}" if trip.delay else ""
    return {
        "stale": f"no sample{lasting}",
        "frozen": f"exactly the same{lasting}",
        "off-range": f"at the end of its range{lasting}",
        "rate": f"faster than {show(high, rate)}{lasting}",
        "following": f"more than {show(high, quantity)} from the command{lasting}",
        "burst": f"falls {show(high, quantity)} within {seconds(trip.window)}{lasting}",
        "slack": f"below {show(trip.low or 0.0, quantity)}{lasting}",
    }[trip.kind]


Rows = list[list[str]]


@dataclass(frozen=True)
class Card:
    """Contents of the card, as texts in display units."""

    name: str
    file: str
    date: str
    hashes: Rows
    """File, SHA-256."""
    simulated: bool
    facts: Rows
    """Property, value."""
    unconfirmed: str
    """A warning if values are not confirmed, else empty."""
    first: str
    """What to do first in an emergency."""
    emergency: str
    """The command that vents from any terminal."""
    protection: str
    """Protection of people."""
    limits: Rows
    """Quantity, command range, its source, trip range, action with delay, its source."""
    vent: Rows
    """Action of the safe state, deadline."""
    proof: str
    stop: str
    failures: Rows
    """Failure, consequence."""
    watch: Rows
    """Channel, what is noticed, action."""
    interlocks: Rows
    """Name, device and input, safe level."""
    channels: Rows
    """Channel, device and input, range, calibration, its date, valid until, uncertainty."""
    outputs: Rows
    """Output, device and output, what it does, watchdog."""
    lacks: list[str]


def make_card(mounted: Mounted, date: str) -> Card:
    """The card of a mounted bench, made on `date` (ISO)."""
    bench, file = mounted.bench, mounted.bench_file
    hashes = [[name, hashlib.sha256(text.encode()).hexdigest()] for name, text in sorted(mounted.documents.items())]
    if bench.proof is not None:
        full, empty, most = (
            show(P, "pressure") for P in (bench.proof.pressure, bench.proof.below, bench.setup_pressure)
        )
        within = seconds(bench.proof.within)
        proof = f"Before each use: filled to {full}, vented, below {empty} within {within}. Until then at most {most}."
    else:
        proof = "The vent path is not proven before use."
    stop = f"A controlled stop first takes the pressure down at {show(bench.stop_rate, 'pressure rate')}."
    return Card(
        name=bench.name,
        file=Path(bench.path).name,
        date=date,
        hashes=hashes,
        simulated=not bench.realtime,
        facts=list(_facts(mounted)),
        unconfirmed=_unconfirmed(mounted),
        first="Press the emergency stop, then shut off the air."
        if _has_stop(mounted)
        else "Shut off the air; press the emergency stop if the rig has one.",
        protection=_protection(mounted),
        emergency=f"pmabench vent {shlex.quote(bench.name)}",
        limits=list(_limits(mounted)),
        vent=[list(_action(action, mounted)) for action in bench.safe_state],
        proof=proof,
        stop=stop if bench.stop_rate else "",
        failures=[list(pair) for pair in failure_story(mounted)],
        watch=list(_watch(mounted)),
        interlocks=[
            [record.name, f"{record.device} · {record.input}", f"safe: {record.safe}"]
            for device in bench.devices
            for record in device.interlocks
        ],
        channels=[_channel(channel, file.channels[channel.name].at) for channel in bench.channels],
        outputs=list(_outputs(mounted)),
        lacks=list(mounted.lacks),
    )


def _facts(mounted: Mounted) -> Iterator[list[str]]:
    specimen, file = mounted.specimen_file, mounted.bench_file
    if specimen.make:
        mounted_as = show(specimen.mounted.length, "length")
        yield ["Specimen", f"{specimen.make} {specimen.type}, {specimen.serial}, mounted length {mounted_as}"]
        yield ["Never above", f"{show(specimen.limits.pressure.never_above, 'pressure')} ({specimen.limits.source})"]
    else:
        yield ["Specimen", "any: its own limits come on top of these"]
    free_end = "driven by an actuator" if file.free_end == "actuator" else str(file.free_end)
    if file.weights is not None and file.weights.catch_height is not None:
        free_end += f", catch height {show(file.weights.catch_height, 'length')}"
    yield ["Free end", free_end]
    relief = file.air.relief_valve
    air = f"supply {show(file.air.supply, 'pressure')}"
    air += ", NO relief valve" if relief == "none" else f", relief valve at {show(relief, 'pressure')}"
    yield ["Air", air + (", dump valve normally open" if file.normally_open_dump else ", NO normally-open dump valve")]
    hands = f"only below {show(file.hands.below, 'pressure')}, measured"
    if file.hands.at_pressure:
        hands += f"; HAZARD: protocols may ask for hands at up to {show(file.hands.at_pressure, 'pressure')}"
    yield ["Hands", hands]
    tried = [f"{device.name}: {device.verified}" for device in mounted.bench.devices if mounted.bench.realtime]
    if tried:
        yield ["Drivers verified", "; ".join(tried)]
    if file.reviewed is not None:
        yield ["Reviewed", f"{file.reviewed.by}, {file.reviewed.date}"]
    elif mounted.unconfirmed:
        yield ["Reviewed", "by nobody"]


def _limits(mounted: Mounted) -> Iterator[list[str]]:
    """One row for each quantity that is commanded or watched."""
    bench = mounted.bench
    trips = [trip for trip in bench.trips if trip.kind == "range"]
    commanded = bench.commanded
    for name in [*commanded, *dict.fromkeys(t.channel for t in trips if t.channel not in commanded)]:
        own = [trip for trip in trips if trip.channel == name]
        output = commanded.get(name)
        command, by = "", ""
        if output is not None:
            command = f"{show(output.low, output.quantity)} to {show(output.high, output.quantity)}"
            by = Path(output.high_from).name
        for number, trip in enumerate(own or [None]):
            first = number == 0
            trip_cells = ["", "", ""] if trip is None else _trip(trip, mounted)
            yield [name if first else "", command if first else "", by if first else "", *trip_cells]
    for key, limit in mounted.bench_file.limits.items():
        if key == "contraction" and limit.trip is not None and not mounted.specimen_file.make:
            after = f" after {seconds(limit.delay)}" if limit.delay else ""
            source = Path(mounted.bench.path).name
            yield ["contraction", "", "", f"above {limit.trip[0]:g} {limit.trip[1]}", limit.action + after, source]


def _quantities(mounted: Mounted) -> dict[str, str]:
    """Quantity of each channel and commanded value."""
    found = {name: record.quantity for name, record in mounted.bench.commanded.items()}
    return found | {channel.name: channel.quantity for channel in mounted.bench.channels}


def _trip(trip: TripRecord, mounted: Mounted) -> list[str]:
    quantity = _quantities(mounted)[trip.channel]
    bounds = [f"below {show(trip.low, quantity)}"] if trip.low is not None else []
    bounds += [f"above {show(trip.high, quantity)}"] if trip.high is not None else []
    after = f" after {seconds(trip.delay)}" if trip.delay else ""
    return [", ".join(bounds), trip.action + after, Path(trip.source).name]


def _action(action: SafeAction, mounted: Mounted) -> tuple[str, str]:
    quantity = _quantities(mounted).get(action.target, "pressure")
    rate = RATE_OF.get(quantity, "pressure rate")
    target = action.target.replace("_", " ")
    text = {
        "set": f"{target} to {show(action.value, quantity)}",
        "ramp": f"{target} down to {show(action.value, quantity)} at {show(action.rate, rate)}",
        "stop": f"drive of {target} stops where it is",
        "hold": "wait",
        "open": f"{target} opens",
        "close": f"{target} closes",
        "confirm": f"look: {target} is below {show(action.value, quantity)}",
    }[action.do]
    return text, seconds(action.within)


def _watch(mounted: Mounted) -> Iterator[list[str]]:
    quantities = _quantities(mounted)
    if mounted.bench.together:
        found = "set-point and pressure, pulses and pressure, pressures and attitude disagree; no acceleration changes"
        yield ["all muscles", found, "vent"]
    for trip in mounted.bench.trips:
        if trip.kind != "range":
            yield [trip.channel, noticed(trip, quantities[trip.channel]), trip.action]


def _channel(channel: ChannelRecord, at: str) -> list[str]:
    record = channel.calibration
    low, high = show(channel.low, channel.quantity), show(channel.high, channel.quantity)
    uncertainty = ""
    if record.id:
        uncertainty = f"± {show(record.offset_uncertainty, channel.quantity)}"
        uncertainty += f" ± {100 * record.gain_uncertainty:g} %" if record.gain_uncertainty else ""
    return [
        channel.name.replace("_", " ") + (f" ({at})" if at else ""),
        f"{channel.device} · {channel.input}",
        f"{channel.raw_unit}, {low} to {high}",
        record.id or "none",
        record.date,
        record.valid_until or ("no end" if record.id else ""),
        uncertainty,
    ]


def _outputs(mounted: Mounted) -> Iterator[list[str]]:
    for device in mounted.bench.devices:
        watchdog = seconds(device.watchdog) if device.watchdog else "none"
        for output in device.outputs:
            unit = mounted.bench_file.set_points[output.name].scale[0][0][1]
            span = abs(output.scale.to_raw(output.high) - output.scale.to_raw(output.low))
            ends = [float(output.scale.to_raw(value)) for value in (output.low, output.high)]
            ends = [0.0 if abs(end) < 1e-9 * span else end for end in ends]
            raw = f"{ends[0]:.6g} to {ends[1]:.6g} {unit}"
            limits = f"{show(output.low, output.quantity)} to {show(output.high, output.quantity)}"
            yield [output.name, f"{device.name} · {output.output}", f"{limits} = {raw}", watchdog]
        for valve in device.valves:
            without = "open" if valve.energised == "closed" else "closed"
            states = f"{valve.energised} while energised, {without} without power"
            yield [valve.name.replace("_", " "), f"{device.name} · {valve.output}", states, watchdog]
