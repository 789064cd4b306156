"""Checks of a driver that is not open: what it imports and says about its options; and of opening and closing it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from dataclasses import asdict, replace
from typing import Any

from pmabench.base.errors import DeviceError
from pmabench.bench import interface
from pmabench.bench.interface import EMULATED, Block, Device, DeviceRecord, Identity
from pmabench.conformance.relay import Relay
from pmabench.conformance.rig import COLLECTS_WITHIN, OPENS_WITHIN, Failed, NotApplicable, Rig, open_files

CAPABILITIES = (
    *("Stream", "SetPoint", "Follower", "Hands", "Switch", "Motion", "Inputs"),
    *("Watchdog", "Supervised", "Rescue"),
)
NOWHERE = "no-such-option-of-any-driver"
LOADS = """
import json, sys
from importlib import import_module
from pmabench.base.clock import RealClock
from pmabench.bench.interface import device_from
data = json.loads(sys.stdin.read())
before = set(sys.modules)
record = device_from(data)
module, _, name = record.driver.partition(":")
driver = getattr(import_module(module), name)
for _ in getattr(driver, "check", lambda _record: ())(record):
    pass
driver(record, RealClock())
own = {"pmabench", "pmabench_drivers", module.partition(".")[0]}
loaded = {name.partition(".")[0] for name in set(sys.modules) - before} - own - set(sys.stdlib_module_names)
print(json.dumps(sorted(name for name in loaded if not name.startswith("__"))))
"""


def light(rig: Rig) -> str:
    """Importing, checking options and building loads the standard library, pmabench, its own package."""
    path = os.pathsep.join(part for part in sys.path if part)
    done = subprocess.run(
        [sys.executable, "-c", LOADS],
        input=json.dumps(asdict(rig.record)),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, "PYTHONPATH": path},
    )
    if done.returncode:
        raise Failed(f"it cannot be imported and built by itself: {done.stderr.strip().splitlines()[-1]}")
    loaded = json.loads(done.stdout)
    if loaded:
        raise Failed(f"it loads {', '.join(loaded)} before it is opened; import these inside open()")
    return "nothing but the standard library, pmabench and its own package is loaded before open()"


def interfaces(rig: Rig) -> str:
    """It is a Device and has what the bench file wants of it; building it opens nothing."""
    driver: Any = rig.driver()
    if not issubclass(driver, Device):
        raise Failed(f"{rig.record.driver} has no open() and close(): see pmabench/bench/interface.py")
    wanted = {
        "Stream": rig.record.channels,
        "SetPoint": rig.record.outputs,
        "Switch": rig.record.valves,
        "Inputs": rig.record.interlocks,
        "Watchdog": rig.record.watchdog,
    }
    for name, wants in wanted.items():
        if wants and not issubclass(driver, getattr(interface, name)):
            raise Failed(f"the bench wants a {name}, and the driver does not implement it")
    before = threading.active_count(), open_files()
    rig.build(rig.record)
    after = threading.active_count(), open_files()
    if after > before:
        raise Failed("building it starts a thread or opens a file or socket; do that in open()")
    can = [name for name in CAPABILITIES if issubclass(driver, getattr(interface, name))]
    return f"a Device with {', '.join(can) or 'no capability'}; building it opens nothing"


def options(rig: Rig) -> str:
    """`check` finds nothing wrong with the bench's own options, and names what cannot be."""
    check = getattr(rig.driver(), "check", None)
    if check is None:
        raise Failed("it has no class method check(device): a mistake in a bench file is found only at the rig")
    found = [f"{'.'.join(map(str, place))}: {text}" for place, text in check(rig.record)]
    if found:
        raise Failed(f"check() finds fault with the bench's own record: {found[0]}")
    wrong: list[tuple[str, DeviceRecord]] = [
        ("an option that does not exist", replace(rig.record, options={**rig.record.options, NOWHERE: 1}))
    ]
    for what, group, name in (
        ("a channel at an input", "channels", "input"),
        ("an output", "outputs", "output"),
        ("a valve at an output", "valves", "output"),
        ("an interlock at an input", "interlocks", "input"),
    ):
        if items := getattr(rig.record, group):
            changed: dict[str, Any] = {group: (replace(items[0], **{name: NOWHERE}), *items[1:])}
            wrong.append((f"{what} that does not exist", replace(rig.record, **changed)))
    for what, record in wrong:
        if not list(check(record)):
            raise Failed(f"check() takes {what} ({NOWHERE}); name it, with what there is")
    return f"good options are taken, {len(wrong)} kinds of mistake are named"


def declared(rig: Rig) -> str:
    """Every channel and output has a unit, a range and a finite scale."""
    for channel in rig.record.channels:
        if not channel.raw_unit or not channel.low < channel.high or not channel.scale.slope:
            raise Failed(f"the channel {channel.name} has no unit, no range or no scale")
    for output in rig.record.outputs:
        if not output.low <= output.safe <= output.high or not output.scale.slope or output.resolution < 0:
            raise Failed(f"the output {output.name} has no limits with its safe value between them, or no scale")
    count = len(rig.record.channels) + len(rig.record.outputs)
    if not count + len(rig.record.valves):
        raise NotApplicable("the bench names no channel and no output of it")
    return f"{count} channels and outputs have unit, range and scale"


def nobody(rig: Rig) -> str:
    """Where nobody answers, `open` says so in time, and `close` does no harm."""
    rig.need_wire()
    for relay in rig.relays:
        relay.close()
    device = rig.build(rig.record)
    answer = rig.call("open() where nobody is", device.open).judged(OPENS_WITHIN)
    if not isinstance(answer, DeviceError):
        raise Failed(f"open() at {rig.record.address}, where nobody is, gave {answer!r}; a DeviceError is expected")
    rig.call("close() after that", device.close).good(OPENS_WITHIN)
    return f"says: {answer}"


def life(rig: Rig) -> str:
    """It opens, says who answers, closes (twice), opens again; closed, its calls say so."""
    before = len(_commanded(rig))
    with rig.opened(armed=False) as device:
        if commanded := _commanded(rig)[before:]:
            raise Failed(f"open() commands something: {commanded[0]}; it connects and identifies, nothing else")
        if not rig.identity.simulated and any(_says_emulated(relay) for relay in rig.relays):
            raise Failed(f'the device says "{EMULATED.strip()}" over its wire, and open() gives simulated=False')
        rig.call("close()", device.close).good(COLLECTS_WITHIN)
        rig.call("close() again", device.close).good(COLLECTS_WITHIN)
        for what, act in rig.questions(device):
            answer = rig.call(f"{what} after close()", act).judged(COLLECTS_WITHIN)
            if not isinstance(answer, DeviceError) and not (isinstance(answer, Block) and not len(answer.time)):
                raise Failed(f"{what} after close() gave {answer!r}; a DeviceError is expected")
        again = rig.call("open() again", device.open).good(rig.opens_within)
        if not isinstance(again, Identity):
            raise Failed("a driver that was closed cannot be opened again")
    who = f"{again.maker} {again.model}".strip()
    return who if again.simulated else f"{who}; its wire does not show that it is emulated"


def _says_emulated(relay: Relay) -> bool:
    return EMULATED.encode() in b"".join(data for sent, data in relay.heard if sent)


def _commanded(rig: Rig) -> list[Any]:
    """What the emulated device was commanded so far."""
    return [entry for kind in ("set", "switch", "move", "halt") for entry in rig.logged(kind)]
