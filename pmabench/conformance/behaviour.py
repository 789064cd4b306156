"""Checks of an open device on a good wire: life, samples, set-points, valves, inputs, ramps, watchdog, safe state."""

from __future__ import annotations

import math
import threading
import time
from functools import partial
from typing import Any

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import (
    Block,
    ChannelRecord,
    Follower,
    Identity,
    Inputs,
    OutputRecord,
    Rescue,
    Segment,
    Switch,
    Watchdog,
)
from pmabench.conformance.rig import CALLS_WITHIN, COLLECTS_WITHIN, Rig
from pmabench.conformance.verdict import Failed, NotApplicable
from pmabench.guard.limits import to_device

RATE = 50.0
"""At which channels are sampled [Hz]."""
FIRST = 3.0
"""How long first samples are waited for [s]."""


def life(rig: Rig) -> str:
    """It opens, says who answers, closes (twice), opens again; closed, its calls say so."""
    with rig.opened() as device:
        rig.call("close()", device.close).good(COLLECTS_WITHIN)
        rig.call("close() again", device.close).good(COLLECTS_WITHIN)
        for what, act in _questions(rig, device):
            told = rig.call(f"{what} after close()", act).judged(COLLECTS_WITHIN)
            if not isinstance(told, DeviceError):
                raise Failed(f"{what} after close() gave {told!r}; a DeviceError is expected")
        again = rig.call("open() again", device.open).good(rig.opens_within)
        if not isinstance(again, Identity):
            raise Failed("a driver that was closed cannot be opened again")
    who = f"{again.maker} {again.model}".strip()
    return who if again.simulated else f"{who}; its wire cannot tell that it is emulated"


def _questions(rig: Rig, device: Any) -> list[tuple[str, Any]]:
    """What can be asked of the device without changing anything."""
    asked: list[tuple[str, Any]] = []
    asked += [("read_back()", partial(device.read_back, output.output)) for output in rig.record.outputs]
    asked += [("is_on()", partial(device.is_on, valve.output)) for valve in rig.record.valves]
    asked += [("level()", partial(device.level, lock.input)) for lock in rig.record.interlocks]
    return asked


def samples(rig: Rig) -> str:
    """Samples come by themselves: numbers of every channel, in range, on a clock that only goes forward."""
    if not rig.streams():
        raise NotApplicable("the bench names no channel of it")
    with rig.opened() as device:
        rate = rig.call("start()", device.start, RATE).good(COLLECTS_WITHIN)
        if not isinstance(rate, float | int) or not 0 < rate < math.inf:
            raise Failed(f"start({RATE:g}) gave {rate!r}; the rate that the device uses is expected [Hz]")
        times: list[int] = []
        values: dict[str, list[float]] = {channel.name: [] for channel in rig.record.channels}
        until = time.monotonic() + FIRST
        while len(times) < 10 and time.monotonic() < until:
            rig.pass_time(0.1)
            block = rig.call("collect()", device.collect).good(COLLECTS_WITHIN)
            take(rig, block, times, values)
        if len(times) < 10:
            raise Failed(f"only {len(times)} samples came within {FIRST:g} s")
        for channel in rig.record.channels:
            outside = [v for v in values[channel.name] if not channel.low <= channel.scale.to_si(v) <= channel.high]
            if outside:
                raise Failed(f"the emulated {channel.name} gives {outside[0]:g}, outside its range in the bench file")
        rig.call("stop()", device.stop).good(COLLECTS_WITHIN)
        rig.call("stop() again", device.stop).good(COLLECTS_WITHIN)
        rig.call("start() again", device.start, RATE).good(COLLECTS_WITHIN)
    return f"{len(times)} samples of {len(values)} channels at {rate:g} Hz"


def take(rig: Rig, block: Any, times: list[int], values: dict[str, list[float]]) -> None:
    """Add a block to what came before; raises Failed where it is none that pmabench could record."""
    if not isinstance(block, Block):
        raise Failed(f"collect() gave {type(block).__name__}; a Block is expected")
    count = len(block.time)
    for channel in rig.record.channels:
        column = block.columns.get(channel.name)
        if column is None or len(column) != count:
            raise Failed(f"collect() gave {count} times and not as many values of {channel.name}")
        values[channel.name] += [number(channel, value) for value in column]
    new = [int(t) for t in block.time]
    for earlier, later in zip([*times[-1:], *new], [*times[-1:], *new][1:], strict=False):
        if later <= earlier:
            raise Failed(f"the time of a sample, {later} ns, is not after that of the one before, {earlier} ns")
    times += new


def number(channel: ChannelRecord, value: Any) -> float:
    """A raw value as a number; NaN is none that is taken for good, and is marked as out of range above the driver."""
    try:
        told = float(value)
    except (TypeError, ValueError):
        raise Failed(f"{channel.name} gave {value!r}; a number is expected") from None
    if channel.raw_type == "int32" and not (told == math.floor(told) and abs(told) < 2**31):
        raise Failed(f"{channel.name} gave {told!r}; a count of at most 32 bits is expected")
    return told


def set_points(rig: Rig) -> str:
    """A value is commanded once, and read back as the device holds it."""
    if not rig.record.outputs:
        raise NotApplicable("the bench names no output of it")
    with rig.opened() as device:
        for output in rig.record.outputs:
            for share in (0.4, 0.2, 0.0):
                value = raw(output, output.safe + share * (output.high - output.safe))
                before = len(rig.logged("set"))
                rig.call(f"write({value:g})", device.write, output.output, value).good(CALLS_WITHIN)
                held = rig.call("read_back()", device.read_back, output.output).good(CALLS_WITHIN)
                if not near(output, held, value):
                    raise Failed(f"{output.name}: {value:g} was written and {held!r} is read back")
                times = times_sent(rig, output, value, before)
                if times > 1 or (rig.logged("set") and not times):
                    raise Failed(f"{output.name}: one write() sent the value {times} times; once is expected")
    return f"{len(rig.record.outputs)} outputs hold what was written, each command was sent once"


def times_sent(rig: Rig, output: OutputRecord, value: float, before: int) -> int:
    """How often the emulator was sent `value` since its log of set-points had `before` entries."""
    entries = [entry for entry in rig.logged("set")[before:] if entry.get("output") == output.name]
    return sum(abs(entry.get("raw", value) - value) <= max(output.resolution, 1e-4 * abs(value)) for entry in entries)


def raw(output: OutputRecord, si: float) -> float:
    """What the guard would send for a value [SI]."""
    return to_device(output, min(max(si, output.low), output.high))


def near(output: OutputRecord, held: Any, value: float) -> bool:
    """Whether what is read back is what was written, as the guard looks at it."""
    return isinstance(held, float | int) and abs(held - value) <= max(output.resolution, 1e-6 * abs(held), 1e-9)


def valves(rig: Rig) -> str:
    """A valve goes on and off, and the device tells which."""
    if not rig.record.valves:
        raise NotApplicable("the bench names no valve of it")
    with rig.opened() as device:
        for valve in rig.record.valves:
            for on in (True, False, True, False):
                rig.call(f"switch(on={on})", device.switch, valve.output, on=on).good(CALLS_WITHIN)
                told = rig.call("is_on()", device.is_on, valve.output).good(CALLS_WITHIN)
                if told is not on:
                    raise Failed(f"{valve.name} was switched {'on' if on else 'off'} and is_on() gives {told!r}")
    return f"{len(rig.record.valves)} valves"


def inputs(rig: Rig) -> str:
    """A digital input is high or low."""
    if not rig.record.interlocks:
        raise NotApplicable("the bench names no interlock of it")
    with rig.opened() as device:
        assert isinstance(device, Inputs)  # noqa: S101  (checked before)
        for lock in rig.record.interlocks:
            told = rig.call("level()", device.level, lock.input).good(CALLS_WITHIN)
            if not isinstance(told, bool):
                raise Failed(f"level() of {lock.name} gave {told!r}; True or False is expected")
            if told != (lock.safe == "high"):
                raise Failed(f"the emulated {lock.name} is open at rest; the bench says that {lock.safe} is safe")
    return f"{len(rig.record.interlocks)} inputs"


def ramps(rig: Rig) -> str:
    """A ramp is followed by the device itself, and the next write ends it."""
    if not rig.record.outputs or not issubclass(rig.driver(), Follower):
        raise NotApplicable("it follows no ramps")
    with rig.opened() as device:
        if rig.streams():
            rig.call("start()", device.start, RATE).good(COLLECTS_WITHIN)
        for output in rig.record.outputs:
            origin, target = raw(output, output.safe), raw(output, output.safe + 0.3 * (output.high - output.safe))
            rig.call("write()", device.write, output.output, origin).good(CALLS_WITHIN)
            rate = abs(target - origin) / 1.0
            segment = Segment("ramp", rig.bench_clock.now(), origin, target, rate=rate)
            rig.call("follow()", device.follow, output.output, segment).good(CALLS_WITHIN)
            held = _wait(rig, device, output, target, 4.0)
            if not near(output, held, target):
                raise Failed(f"{output.name}: 4 s after a ramp of 1 s to {target:g} the device holds {held!r}")
            rig.call("write()", device.write, output.output, origin).good(CALLS_WITHIN)
            rig.pass_time(0.3)
            held = rig.call("read_back()", device.read_back, output.output).good(CALLS_WITHIN)
            if not near(output, held, origin):
                raise Failed(f"{output.name}: {origin:g} was written and the device still follows: it holds {held!r}")
    return "a ramp of 1 s arrives, and a write ends it"


def _wait(rig: Rig, device: Any, output: OutputRecord, value: float, within: float) -> Any:
    """What is read back once it is `value`, or after `within` [s]; on its way a device may not know."""
    until = rig.bench_clock.now() + within
    while True:
        held = rig.call("read_back()", device.read_back, output.output).judged(CALLS_WITHIN)
        if near(output, held, value) or rig.bench_clock.now() > until:
            return held
        rig.pass_time(0.1)


def watchdog(rig: Rig) -> str:
    """Armed, it says the time that it holds; fed, it stays quiet; without that the device vents by itself."""
    if not rig.record.watchdog or not issubclass(rig.driver(), Watchdog):
        raise NotApplicable("the bench file gives it no watchdog")
    asked = rig.record.watchdog
    with rig.opened(armed=False) as device:
        told = rig.call("arm_watchdog()", device.arm_watchdog, asked).good(CALLS_WITHIN)
        if not isinstance(told, float | int) or not 0 < told <= asked * 1.01:
            raise Failed(f"arm_watchdog({asked:g}) gave {told!r}; the time that the device holds is expected")
        for output in rig.record.outputs:
            high = raw(output, output.safe + 0.3 * (output.high - output.safe))
            rig.call("write()", device.write, output.output, high).good(CALLS_WITHIN)
        for _ in range(round(1.5 * asked / 0.1)):
            rig.pass_time(0.1)
            rig.call("feed_watchdog()", device.feed_watchdog).good(CALLS_WITHIN)
        if rig.emulator is not None and rig.logged("watchdog"):
            raise Failed("the watchdog ran out although it was fed ten times a second")
        rig.pass_time(asked + 0.5)
        if rig.emulator is not None and not rig.logged("watchdog"):
            raise Failed(f"the emulated device did nothing {asked + 0.5:g} s after it was fed last")
    return f"holds {told:g} s; fed it is quiet, and silence of that length makes the device vent by itself"


def safe_state(rig: Rig) -> str:
    """The commands of a safe state are quick, may be repeated, and leave the outputs safe."""
    if not rig.record.outputs and not rig.record.valves:
        raise NotApplicable("it commands nothing")
    slowest = 0.0
    with rig.opened() as device:
        for output in rig.record.outputs:
            high = raw(output, output.safe + 0.3 * (output.high - output.safe))
            rig.call("write()", device.write, output.output, high).good(CALLS_WITHIN)
        for _ in range(3):
            for output in rig.record.outputs:
                done = rig.call("write(safe)", device.write, output.output, raw(output, output.safe))
                done.good(CALLS_WITHIN)
                slowest = max(slowest, done.seconds)
            for valve in rig.record.valves:
                assert isinstance(device, Switch)  # noqa: S101  (checked before)
                done = rig.call("switch(safe)", device.switch, valve.output, on=False)
                done.good(CALLS_WITHIN)
                slowest = max(slowest, done.seconds)
        for output in rig.record.outputs:
            held = rig.call("read_back()", device.read_back, output.output).good(CALLS_WITHIN)
            if not near(output, held, raw(output, output.safe)):
                raise Failed(f"{output.name} holds {held!r} after its safe value was written three times")
        for valve in rig.record.valves:
            if rig.call("is_on()", device.is_on, valve.output).good(CALLS_WITHIN):
                raise Failed(f"{valve.name} is on after it was switched off three times")
    return f"three times over; the slowest command took {1e3 * slowest:.0f} ms"


def second_way(rig: Rig) -> str:
    """`rescue` reaches the outputs while the usual call hangs."""
    if not rig.record.outputs or not issubclass(rig.driver(), Rescue):
        raise NotApplicable("it has no second way to its outputs")
    rig.need_wire()
    output = rig.record.outputs[0]
    with rig.opened() as device:
        high = raw(output, output.safe + 0.3 * (output.high - output.safe))
        rig.call("write()", device.write, output.output, high).good(CALLS_WITHIN)
        first = threading.Lock()
        first.acquire()
        hangs = threading.Thread(target=lambda: rig.call("a call that hangs", first.acquire), daemon=True)
        hangs.start()
        began = time.monotonic()
        device.rescue(output.output, raw(output, output.safe))
        took = time.monotonic() - began
        first.release()
        hangs.join(5.0)
        if took > CALLS_WITHIN + 0.3:
            raise Failed(f"rescue() took {took:.2f} s; at most {CALLS_WITHIN:g} s is allowed")
        held = _wait(rig, device, output, raw(output, output.safe), 0.5)
        if not near(output, held, raw(output, output.safe)):
            raise Failed(f"{output.name} holds {held!r} 0.5 s after rescue() sent its safe value")
    return f"took {1e3 * took:.0f} ms from another thread, while the device's own thread hung"
