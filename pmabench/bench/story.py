"""What happens at a mounted bench when something fails, in words: derived from its valves, watchdogs and watch list."""

from __future__ import annotations

from collections.abc import Iterator

from pmabench.base.quantities import show
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import DeviceRecord, TripRecord, ValveRecord

BY_HAND = "Press the emergency stop, shut off the air, vent by hand."


def failure_story(mounted: Mounted) -> list[tuple[str, str]]:
    """What may fail, and what happens then, for people at the rig; pure."""
    if not mounted.bench.realtime:
        return [("Anything", "Nothing is pressurised: this bench is simulated in virtual time.")]
    return [
        ("The program", "The guard, a process of its own, vents: at once after a crash, within 0.5 s after a freeze."),
        ("The computer", " ".join(_computer(mounted))),
        ("Electric power", " ".join(_power(mounted))),
        ("Compressed air", " ".join(_air(mounted))),
        ("Network or cable", " ".join(_link(mounted))),
        ("Pressure sensor", " ".join(_sensor(mounted))),
        ("An interlock", _interlock(mounted)),
    ]


def seconds(value: float) -> str:
    """A time as people say it: `200 ms`, `5 s`."""
    return f"{value * 1e3:.3g} ms" if value < 1 else f"{value:.3g} s"


def _device_of(mounted: Mounted, output: str) -> DeviceRecord | None:
    for device in mounted.bench.devices:
        if output in {*(o.name for o in device.outputs), *(v.name for v in device.valves)}:
            return device
    return None


def _dump(mounted: Mounted) -> ValveRecord | None:
    return next((valve for valve in mounted.bench.valves if valve.name == "dump_valve"), None)


def _opens_unheard(mounted: Mounted) -> DeviceRecord | None:
    """The device whose watchdog opens the dump valve, if there is one."""
    device = _device_of(mounted, "dump_valve")
    return device if device is not None and device.watchdog else None


def _computer(mounted: Mounted) -> Iterator[str]:
    pressure, opens = _device_of(mounted, "pressure"), _opens_unheard(mounted)
    if pressure is None:
        yield "Nothing commands the pressure on this bench."
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
        yield f"NOTHING VENTS: {pressure.name} has no watchdog, and the pressure stays at its last value. {BY_HAND}"
    drive = _device_of(mounted, "displacement")
    if drive is not None:
        yield "The drive's own watchdog ends its motion." if drive.watchdog else "THE DRIVE GOES ON."


def _power(mounted: Mounted) -> Iterator[str]:
    output = mounted.bench_file.set_points.get("pressure")
    if mounted.bench_file.normally_open_dump:
        yield "The dump valve opens and the muscle vents, whatever the regulator does."
    elif output is not None and output.without_power == "vents":
        yield "The regulator vents by itself."
    elif output is not None:
        yield f"THE REGULATOR MAY HOLD THE PRESSURE: nothing opens without power. {BY_HAND}"
    yield from _load(mounted)
    if _device_of(mounted, "displacement") is not None:
        yield "The drive no longer holds the free end."


def _load(mounted: Mounted) -> Iterator[str]:
    weights = mounted.bench_file.weights
    if weights is not None:
        caught = f"the catch at {show(weights.catch_height, 'length')}" if weights.catch_height else "NOTHING"
        yield f"The load comes down; {caught} stops it."


def _air(mounted: Mounted) -> Iterator[str]:
    yield "The pressure falls as far as the muscle leaks" + (
        "; the load sinks." if mounted.bench_file.weights is not None else "."
    )
    supply = [trip for trip in mounted.bench.trips if trip.channel == "supply" and trip.low is not None]
    following = [trip for trip in mounted.bench.trips if trip.kind == "following" and trip.channel == "pressure"]
    for trip in supply[:1]:
        least = show(trip.low or 0.0, "pressure")
        yield f"Supply below {least} for {seconds(trip.delay)}: {trip.action}."
    for trip in following[: 0 if supply else 1]:
        yield f"{_noticed(trip)}: {trip.action}."
    if not supply and not following:
        yield "NOBODY IS TOLD: look at the gauge."
    yield "Air that comes back brings the pressure back: vent first."


def _link(mounted: Mounted) -> Iterator[str]:
    yield "A device that does not answer for 0.2 s ends the run; every other one is vented."
    for device in mounted.bench.devices:
        if device.guarded and device.watchdog:
            moves = not device.valves and all(output.quantity == "length" for output in device.outputs)
            does = "stops its motion" if device.outputs and moves else "vents"
            yield f"{device.name} itself {does} after {seconds(device.watchdog)}."
        elif device.outputs:
            yield f"{device.name} keeps its last value: NO WATCHDOG."


def _sensor(mounted: Mounted) -> Iterator[str]:
    watched = [t for t in mounted.bench.trips if t.channel == "pressure" and t.kind in {"stale", "frozen", "off-range"}]
    low = [t for t in mounted.bench.trips if t.channel == "pressure" and t.kind == "range" and t.low is not None]
    noticed = [f"{_noticed(trip)}: {trip.action}" for trip in watched]
    noticed += [f"reads below {show(trip.low or 0.0, 'pressure')}: {trip.action}" for trip in low]
    if not noticed:
        yield "A DEAD SENSOR IS NOT NOTICED."
    else:
        text = "; ".join(noticed)
        yield f"{text[0].upper()}{text[1:]}."


def _interlock(mounted: Mounted) -> str:
    if not any(device.interlocks for device in mounted.bench.devices):
        return "THE PROGRAM DOES NOT SEE IT: no emergency stop, door or drive is wired to an input."
    return "Vent; the bench stays tripped until somebody has looked and reset it."


def noticed(trip: TripRecord, quantity: str) -> str:
    """What a trip of the watch list looks at, in words."""
    rate = {"pressure": "pressure rate", "length": "speed", "force": "force rate"}.get(quantity, quantity)
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


def _noticed(trip: TripRecord) -> str:
    return noticed(trip, "pressure")
