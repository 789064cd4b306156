"""Checks of commands on a good connection: what reaches the emulated device and its plant, and what calls return."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Any

from pmabench.base.errors import DeviceError
from pmabench.base.quantities import show
from pmabench.bench.interface import OutputRecord, ValveRecord
from pmabench.conformance.rig import CALLS_WITHIN, COLLECTS_WITHIN, Failed, Late, NotChecked, Rig
from pmabench.conformance.samples import RATE, Recording, record, tolerance
from pmabench.guard.limits import to_device

ARRIVES = 0.15
"""Time within which a command must reach the device, without any other call [s]."""
MOVES = 5.0
"""Longest travel time of an actuator [s]."""
EXACT = 2e-4
"""Tolerance of the plant's set-point, as a fraction of the output's range, in addition to its resolution."""
NOWHERE = "no-such-output"
FROM_MEMORY = "it answers from memory; ask the device at each call"
LONG_KNOWN = 5
"""How often an input is asked before it changes, every 0.1 s: a driver may keep answers for some tenths of a second."""


def raw(output: OutputRecord, si: float) -> float:
    """Device value that the guard would send for a value [SI]."""
    return to_device(output, min(max(si, output.low), output.high))


def at(output: OutputRecord, share: float) -> float:
    """Value at this fraction of the way from the safe to the highest value [device units]."""
    return raw(output, output.safe + share * (output.high - output.safe))


def near(output: OutputRecord, held: Any, value: float) -> bool:
    """Whether the value read back is the one written, within the guard's tolerance."""
    return isinstance(held, float | int) and abs(held - value) <= max(output.resolution, 1e-6 * abs(held), 1e-9)


def times_sent(rig: Rig, output: OutputRecord, value: float, before: int) -> int:
    """How often the emulator has received `value` since `before`, a length of `sent`."""
    wanted, most = float(output.scale.to_si(value)), close_enough(output)
    entries = [entry for entry in sent(rig)[before:] if entry.get("output", output.name) == output.name]
    return sum(abs(entry["si"] - wanted) <= most for entry in entries)


def sent(rig: Rig) -> list[dict[str, Any]]:
    """Log entries of the set-points and targets that the emulated device received."""
    return [entry for kind in ("set", "move") for entry in rig.logged(kind)]


# -- the plant's state ------------------------------------------------------------------------------------------------


def close_enough(output: OutputRecord) -> float:
    """Tolerance of the plant's set-point [SI]."""
    return EXACT * (output.high - output.low) + abs(output.scale.slope) * output.resolution


def commanded(rig: Rig, output: OutputRecord) -> float:
    """Set-point of the plant's regulator or actuator [SI]; raises NotChecked without one."""
    if (found := rig.plant.quantities().get(f"{output.name}_command")) is None:
        raise NotChecked(f"the emulated plant has no {output.name} that is commanded")
    return float(found)


def reaches(rig: Rig, output: OutputRecord, value: float, within: float = ARRIVES) -> bool:
    """Whether the plant's set-point becomes `value` [device units] in time; the driver is not called meanwhile."""
    wanted, most = float(output.scale.to_si(value)), close_enough(output)
    return _soon(rig, within, lambda: abs(commanded(rig, output) - wanted) <= most)


def _travel(rig: Rig, output: OutputRecord, value: float) -> None:
    """Wait for an actuator to arrive, feeding the watchdog, whose vent would stop it or move it there."""
    until = rig.bench_clock.now() + MOVES
    while not reaches(rig, output, value, 0.05) and rig.bench_clock.now() < until:
        rig.feed()


def _soon(rig: Rig, within: float, holds: Callable[[], bool]) -> bool:
    until = rig.bench_clock.now() + within
    while not holds():
        if rig.bench_clock.now() > until:
            return False
        rig.wait(0.01)
    return True


def dump_of(valves: Sequence[ValveRecord]) -> ValveRecord | None:
    """The dump valve among them; None if there is none."""
    named = [valve for valve in valves if "dump" in valve.name] or (list(valves) if len(valves) == 1 else [])
    return named[0] if named else None


def refuse_position(rig: Rig, valve: ValveRecord, *, on: bool, after: str, by_itself: bool = False) -> None:
    """Raise Failed if a valve's coil, or the dump valve itself, is not as commanded.

    `by_itself`: the device has switched the valve without a command.
    """
    if not by_itself and not _soon(rig, ARRIVES, lambda: rig.coil(valve) is on):
        raise Failed(f"{valve.name}: after {after} the device has it otherwise; is the valve inverted, or another one?")
    is_open = on != (valve.energised == "closed")
    if valve is dump_of(rig.record.valves) and rig.plant.dump_open() is not is_open:
        words = {True: "open", False: "closed"}
        expected = f"{words[is_open]} is expected"
        raise Failed(f"{valve.name}: after {after} it is {words[not is_open]} in the plant; {expected}")


def _refuse_nowhere(rig: Rig, *calls: str) -> None:
    """Raise Failed if a call accepts an output that does not exist."""
    for name in calls:
        given = [0.0] if name == "write" else []
        act = partial(getattr(rig.device, name), NOWHERE, *given, **({"on": False} if name == "switch" else {}))
        answer = rig.call(what := f"{name}({NOWHERE})", act).judged()
        if not isinstance(answer, DeviceError):
            raise Failed(f"{what} gave {answer!r}; a DeviceError is expected, with the names that there are")


# -- checks -----------------------------------------------------------------------------------------------------------


def set_points(rig: Rig) -> str:
    """A value is commanded once and at once, the plant gets it in SI, and it is read back as the device holds it."""
    with rig.opened(rate=RATE):
        for output in rig.record.outputs:
            moves = output.quantity == "length"
            for share in (0.4, 0.07, 0.0) if moves else (0.93, 0.37, 0.013, 0.0):
                _one_set_point(rig, output, at(output, share), moves=moves)
        _refuse_nowhere(rig, "write", "read_back")
    return f"{len(rig.record.outputs)} outputs: the plant gets each value [SI], once; it is read back, others stay"


def _one_set_point(rig: Rig, output: OutputRecord, value: float, *, moves: bool) -> None:
    device, before = rig.device, len(sent(rig))
    others = {o.name: commanded(rig, o) for o in rig.record.outputs if o is not output}
    coils = {valve.name: rig.coil(valve) for valve in rig.record.valves}
    si = show(float(output.scale.to_si(value)), output.quantity)
    rig.call(f"write({value:g})", device.write, output.output, value).nothing()
    if moves:
        began = rig.plant.quantities()[f"{output.name}_command"]
        _soon(rig, ARRIVES, lambda: abs(commanded(rig, output) - began) > close_enough(output))
        _travel(rig, output, value)
    if not reaches(rig, output, value):
        got = show(commanded(rig, output), output.quantity)
        why = "is it another unit, sign or output, or did nothing leave?"
        raise Failed(f"{output.name}: {si} ({value:g}) was written, and the plant has {got}; {why}")
    for other in rig.record.outputs:
        if other.name in others and abs(commanded(rig, other) - others[other.name]) > close_enough(other):
            raise Failed(f"writing {output.name} has changed {other.name}; are these outputs swapped?")
    if coils != {valve.name: rig.coil(valve) for valve in rig.record.valves}:
        raise Failed(f"writing {output.name} has switched a valve")
    held = rig.call("read_back()", device.read_back, output.output).good()
    if isinstance(held, bool) or not near(output, held, value):
        raise Failed(f"{output.name}: {value:g} was written and {held!r} is read back; the device holds {si}")
    times = times_sent(rig, output, value, before)
    if times > 1 or (sent(rig) and not times):
        raise Failed(f"{output.name}: one write() sent the value {times} times; once is expected")
    _shown(rig, output)


def _shown(rig: Rig, output: OutputRecord) -> None:
    """Raise Failed unless the channel for the command of this output, if there is one, shows it."""
    for channel in rig.record.channels if rig.streams() else ():
        if channel.name != f"{output.name}_command":
            continue
        rig.pass_time(0.15)
        rig.call("collect()", rig.device.collect).good(COLLECTS_WITHIN)
        found = record(rig, 0.2, Recording(rig.record.channels)).si(channel)
        real = commanded(rig, output)
        if not found:
            raise Late(f"no sample of {channel.name} came within 0.2 s")
        if abs(found[-1] - real) > tolerance(channel):
            seen = show(found[-1], channel.quantity)
            raise Failed(f"{channel.name} shows {seen}, and {show(real, channel.quantity)} is commanded in the plant")


def valves(rig: Rig) -> str:
    """A valve is energised or not in the plant as it was commanded, others stay, and the device reports which."""
    with rig.opened() as device:
        for valve in rig.record.valves:
            for on in (True, False, True, False):
                others = {v.name: rig.coil(v) for v in rig.record.valves if v is not valve}
                rig.call(f"switch(on={on})", device.switch, valve.output, on=on).nothing()
                refuse_position(rig, valve, on=on, after=f"switch(on={on})")
                if others != {v.name: rig.coil(v) for v in rig.record.valves if v is not valve}:
                    raise Failed(f"switching {valve.name} has switched another valve")
                if (shown := rig.call("is_on()", device.is_on, valve.output).good()) is not on:
                    raise Failed(f"{valve.name} was switched {'on' if on else 'off'} and is_on() gives {shown!r}")
        _refuse_nowhere(rig, "switch", "is_on")
    dump = dump_of(rig.record.valves)
    seen = f"; {dump.name} opens and closes in the plant" if dump else ""
    return f"{len(rig.record.valves)} valves energised as commanded{seen}"


def inputs(rig: Rig) -> str:
    """A digital input is high or low as the emulated contact is now, also after it changed."""
    fixed = [lock.name for lock in rig.record.interlocks if "stop" not in lock.name]
    with rig.opened():
        for pressed in (False, True, False):
            rig.plant.fail("e_stop_at", over=not pressed)
            rig.wait(0.1)  # unfed, as an answer may be kept from the last feed
            for _ in range(LONG_KNOWN):
                _levels(rig, fixed, pressed=pressed)
                rig.pass_time(0.1)
        _refuse_nowhere(rig, "level")
    if fixed:
        raise NotChecked(f"{', '.join(fixed)} at rest only: the emulator cannot change it")
    return f"{len(rig.record.interlocks)} inputs, at rest, with the emergency stop pressed, and released"


def _levels(rig: Rig, fixed: Collection[str], *, pressed: bool) -> None:
    for lock in rig.record.interlocks:
        level = rig.call("level()", rig.device.level, lock.input).good()
        if not isinstance(level, bool):
            raise Failed(f"level() of {lock.name} gave {level!r}; True or False is expected")
        safe = not pressed or lock.name in fixed
        if level != ((lock.safe == "high") == safe):
            real = f"the emulated contact is {'safe' if safe else 'unsafe'}, and {lock.safe} is safe"
            raise Failed(f"level() of {lock.name} gave {level}; {real}")


def from_outside(rig: Rig) -> str:
    """What changes without the driver is read back as it is, or refused: nothing is answered from memory."""
    unchecked = []
    why = getattr(rig.driver(), "cannot_read_back", "")
    for way in ("by hand", "after a restart"):
        for output in rig.record.outputs:
            with rig.opened() as device:
                rig.call("write()", device.write, output.output, at(output, 0.4)).good()
                reaches(rig, output, at(output, 0.4), MOVES if output.quantity == "length" else ARRIVES)
                rig.call("read_back()", device.read_back, output.output).judged()  # what was read may be kept, too
                if why or not _changes(rig, way, output.output, at(output, 0.2)):
                    unchecked.append(f"{output.name} {way} ({why or 'the emulator has no such change'})")
                    continue
                held = rig.call("read_back()", device.read_back, output.output).judged()
                if not isinstance(held, DeviceError) and not _is_held(rig, output, held):
                    real = show(commanded(rig, output), output.quantity)
                    raise Failed(
                        f"{output.name} was changed to {real} ({way}), and read_back() gives {held!r}: {FROM_MEMORY}"
                    )
        for valve in rig.record.valves:
            with rig.opened() as device:
                rig.call("switch(on=True)", device.switch, valve.output, on=True).good()
                rig.call("is_on()", device.is_on, valve.output).judged()
                if not _changes(rig, way, valve.output, 0.0):
                    unchecked.append(f"{valve.name} {way} (the emulator has no such change)")
                    continue
                shown = rig.call("is_on()", device.is_on, valve.output).judged()
                if not isinstance(shown, DeviceError) and shown is not bool(rig.coil(valve)):
                    raise Failed(f"{valve.name} was switched off ({way}), and is_on() gives {shown!r}: {FROM_MEMORY}")
    if unchecked:
        raise NotChecked(f"{', '.join(unchecked)}; the others are read back as they are")
    return "set-points and valves changed at the device itself, and by a restart, are read back as they are"


def _changes(rig: Rig, way: str, output: str, value: float) -> bool:
    """Change an output without the driver; whether that was possible."""
    done = True
    if way == "after a restart":
        rig.restart()
    else:
        done = rig.by_hand(output, value)
    rig.wait(0.1)
    return done


def _is_held(rig: Rig, output: OutputRecord, held: Any) -> bool:
    if isinstance(held, bool) or not isinstance(held, float | int):
        return False
    return abs(float(output.scale.to_si(held)) - commanded(rig, output)) <= close_enough(output)


# -- the safe state ---------------------------------------------------------------------------------------------------


def lift(rig: Rig, *, checked: bool = True) -> None:
    """Leave the safe state: valves energised, outputs up."""
    for valve in rig.record.valves:
        rig.call("switch(on=True)", rig.device.switch, valve.output, on=True).nothing()
    for output in rig.record.outputs:
        rig.call("write()", rig.device.write, output.output, at(output, 0.3)).nothing()
        if checked and output.quantity == "pressure" and not reaches(rig, output, at(output, 0.3)):
            raise Failed(f"{output.name} was written, and did not arrive in the plant: see the check of set-points")


def refuse_unsafe(rig: Rig, after: str, *, by_itself: bool = False) -> None:
    """Raise Failed if an output is not at its safe value in the plant, or a valve is energised.

    `by_itself`: the device has vented without a command; a drive then only stops.
    """
    for valve in rig.record.valves:
        refuse_position(rig, valve, on=False, after=after, by_itself=by_itself)
    for output in rig.record.outputs:
        safe = raw(output, output.safe)
        if output.quantity == "length":
            if by_itself:
                continue
            _travel(rig, output, safe)
        if not reaches(rig, output, safe):
            raise Failed(f"{output.name} is at {show(commanded(rig, output), output.quantity)} in the plant {after}")


def safe_state(rig: Rig) -> str:
    """The commands of a safe state are quick, may be repeated, and leave the plant safe."""
    slowest = 0.0
    with rig.opened() as device:
        lift(rig)
        acts = [("write(safe)", partial(device.write, o.output, raw(o, o.safe))) for o in rig.record.outputs]
        acts += [("switch(safe)", partial(device.switch, v.output, on=False)) for v in rig.record.valves]
        for what, act in 3 * acts:
            done = rig.call(what, act)
            done.nothing()
            slowest = max(slowest, done.seconds)
        refuse_unsafe(rig, "the commands of the safe state, sent three times")
    return f"three times over, safe in the plant; the slowest command took {1e3 * slowest:.0f} ms"


def _rescued(device: Any, name: str, value: float) -> float:
    """Command a value over the second connection; returns the duration [s]."""
    began = time.monotonic()
    try:
        given = device.rescue(name, value)
    except DeviceError as error:
        raise Late(f"rescue({name}) took {time.monotonic() - began:.2f} s and failed: {error}") from error
    if given is not None:
        raise Failed(f"rescue({name}) returned {given!r}; by the interface it returns None")
    return time.monotonic() - began


def second_way(rig: Rig) -> str:
    """`rescue` reaches every output and valve in the plant while the usual call hangs."""
    slowest = 0.0
    with rig.opened() as device:
        lift(rig)
        first = threading.Lock()
        first.acquire()
        threading.Thread(target=lambda: rig.call("a call that hangs", first.acquire), daemon=True).start()
        safe = [(o.output, raw(o, o.safe)) for o in rig.record.outputs] + [(v.output, 0.0) for v in rig.record.valves]
        try:
            tried = [(o.output, at(o, 0.2)) for o in rig.record.outputs if o.quantity == "pressure"]
            for name, value in (*tried, *safe):
                slowest = max(slowest, _rescued(device, name, value))
                for out in rig.record.outputs if (name, value) in tried else ():
                    if out.output == name and not reaches(rig, out, value):
                        got = show(commanded(rig, out), out.quantity)
                        raise Failed(f"{out.name}: after rescue() with {value:g} the plant has {got}")
        finally:
            first.release()
        if slowest > CALLS_WITHIN + 0.3:
            raise Failed(f"rescue() took {slowest:.2f} s; at most {CALLS_WITHIN:g} s is allowed")
        refuse_unsafe(rig, "rescue() with the safe values")
    return f"took {1e3 * slowest:.0f} ms from another thread, while the device's own thread hung; safe in the plant"
