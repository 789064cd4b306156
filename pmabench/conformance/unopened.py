"""Checks of a driver that is not open: what it imports, what it is, what it says about its options."""

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
from pmabench.bench.interface import Device, DeviceRecord
from pmabench.conformance.rig import OPENS_WITHIN, Rig
from pmabench.conformance.verdict import Failed, NotApplicable

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
    before = threading.active_count(), _descriptors()
    rig.build(rig.record)
    after = threading.active_count(), _descriptors()
    if after > before:
        raise Failed("building it starts a thread or opens a file or socket; do that in open()")
    can = [name for name in CAPABILITIES if issubclass(driver, getattr(interface, name))]
    return f"a Device with {', '.join(can) or 'no capability'}; building it opens nothing"


def _descriptors() -> int:
    """How many files are open; 0 where the system does not say."""
    try:
        return len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    except OSError:
        return 0


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
    if rig.record.channels:
        channels = (replace(rig.record.channels[0], input=NOWHERE), *rig.record.channels[1:])
        wrong.append(("a channel at an input that does not exist", replace(rig.record, channels=channels)))
    if rig.record.outputs:
        outputs = (replace(rig.record.outputs[0], output=NOWHERE), *rig.record.outputs[1:])
        wrong.append(("an output that does not exist", replace(rig.record, outputs=outputs)))
    if rig.record.valves:
        valves = (replace(rig.record.valves[0], output=NOWHERE), *rig.record.valves[1:])
        wrong.append(("a valve at an output that does not exist", replace(rig.record, valves=valves)))
    if rig.record.interlocks:
        locks = (replace(rig.record.interlocks[0], input=NOWHERE), *rig.record.interlocks[1:])
        wrong.append(("an interlock at an input that does not exist", replace(rig.record, interlocks=locks)))
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
