"""The table of checks, and their runs on a device of a bench file: one line each with verdict and reason.

Also the checks of a driver that is not open (what it imports, its options), of opening and of closing.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pmabench.base.errors import DeviceError, InvalidFile, UsageError
from pmabench.bench import interface
from pmabench.bench.compile import mount_alone
from pmabench.bench.driver_options import driver_class, drivers
from pmabench.bench.interface import EMULATED, Block, Device, DeviceRecord, Identity, Truth
from pmabench.bench.truth import read_truth, truth_of
from pmabench.conformance import broken_wire, commands, following, samples
from pmabench.conformance import rig as r
from pmabench.conformance.broken_wire import Battle
from pmabench.conformance.rig import COLLECTS_WITHIN, OPENS_WITHIN, Failed, Result, Rig, open_files
from pmabench.files.shipped import shipped_folder

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
    if loaded := json.loads(done.stdout):
        raise Failed(f"it loads {', '.join(loaded)} before it is opened; import these inside open()")
    return "nothing but the standard library, pmabench and its own package is loaded before open()"


def interfaces(rig: Rig) -> str:
    """It is a Device; building it opens nothing."""
    driver: Any = rig.driver()
    if not issubclass(driver, Device):
        raise Failed(f"{rig.record.driver} has no open() and close(): see pmabench/bench/interface.py")
    before = threading.active_count(), open_files()
    rig.build(rig.record)
    after = threading.active_count(), open_files()
    if after > before:
        raise Failed("building it starts a thread or opens a file or socket; do that in open()")
    can = [name for name in CAPABILITIES if issubclass(driver, getattr(interface, name))]
    return f"a Device with {', '.join(can) or 'no capability'}; building it opens nothing"


def options(rig: Rig) -> str:
    """`check` finds nothing wrong with the bench's own options, and names what cannot be."""
    if (check := getattr(rig.driver(), "check", None)) is None:
        raise Failed("it has no class method check(device): a mistake in a bench file is found only at the rig")
    if found := [f"{'.'.join(map(str, place))}: {text}" for place, text in check(rig.record)]:
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


def nobody(rig: Rig) -> str:
    """Without a device `open` raises DeviceError in time, and `close` does no harm."""
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
        heard = [b"".join(data for sent, data in relay.heard if sent) for relay in rig.relays]
        if not rig.identity.simulated and any(EMULATED.encode() in data for data in heard):
            raise Failed(f'the device says "{EMULATED.strip()}" over its wire, and open() gives simulated=False')
        rig.call("close()", device.close).good(COLLECTS_WITHIN)
        rig.call("close() again", device.close).good(COLLECTS_WITHIN)
        for what, act in rig.questions(device):
            answer = rig.call(f"{what} after close()", act).judged(COLLECTS_WITHIN)
            if not isinstance(answer, DeviceError) and not (isinstance(answer, Block) and not len(answer.time)):
                raise Failed(f"{what} after close() gave {answer!r}; a DeviceError is expected")
        again = rig.call("open() again", device.open).good(OPENS_WITHIN)
        if not isinstance(again, Identity):
            raise Failed("a driver that was closed cannot be opened again")
    who = f"{again.maker} {again.model}".strip()
    return who if again.simulated else f"{who}; its wire does not show that it is emulated"


def _commanded(rig: Rig) -> list[Any]:
    """Commands in the log of the emulated device."""
    return [entry for kind in ("set", "switch", "move", "halt") for entry in rig.logged(kind)]


Need = tuple[Callable[[Rig], Any], str]
"""Whether a device has what a check needs, and the text if it has not."""


def _can(capability: type, group: str = "name") -> Callable[[Rig], bool]:
    """Whether the driver has a capability, and the bench's record something that needs it."""
    return lambda rig: bool(getattr(rig.record, group)) and issubclass(rig.driver(), capability)


WIRE: Need = (lambda rig: rig.relays, "there is no emulator on a TCP or serial wire that could be damaged")
CHANNELS: Need = (Rig.streams, "the bench names no channel of it")
OUTPUTS: Need = (lambda rig: rig.record.outputs, "the bench names no output of it")
VALVES: Need = (lambda rig: rig.record.valves, "the bench names no valve of it")
INTERLOCKS: Need = (lambda rig: rig.record.interlocks, "the bench names no interlock of it")
COMMANDS: Need = (lambda rig: rig.record.outputs or rig.record.valves, "it commands nothing")
RAMPS: Need = (_can(interface.Follower, "outputs"), "it follows no ramps")
MOTION: Need = (_can(interface.Motion, "outputs"), "it stops no motion by itself")
WATCHDOG: Need = (_can(interface.Watchdog, "watchdog"), "the bench file gives it no watchdog")
SUPERVISED: Need = (
    _can(interface.Supervised),
    "it has no held(): that its device restarts is not seen while it is pressurised",
)
RESCUE: Need = (_can(interface.Rescue, "outputs"), "it has no second way to its outputs")
CHECKS: dict[str, tuple[Callable[[Rig], str], *tuple[Need, ...]]] = {
    "interface": (interfaces,),
    "imports": (light,),
    "options": (options,),
    "nobody there": (nobody, WIRE),
    "life": (life,),
    "samples": (samples.samples, CHANNELS),
    "values": (samples.values, CHANNELS),
    "set-points": (commands.set_points, OUTPUTS),
    "valves": (commands.valves, VALVES),
    "inputs": (commands.inputs, INTERLOCKS),
    "from outside": (commands.from_outside, COMMANDS),
    "ramps": (following.ramps, RAMPS),
    "halt": (following.halts, MOTION),
    "watchdog": (following.watchdog, WATCHDOG),
    "held": (following.held, SUPERVISED),
    "safe state": (commands.safe_state, COMMANDS),
    "second way": (commands.second_way, RESCUE),
    "silence": (broken_wire.silent, WIRE),
    "late answers": (broken_wire.late_answers, WIRE, OUTPUTS),
    "line cut": (broken_wire.hang_up, WIRE),
    "nothing left": (broken_wire.nothing_left, WIRE),
}
"""Name -> check and its needs; the promise is the first line of the check's docstring."""
HOSTILE = "hostile answers"
ATTEMPTS = 3
"""Number of attempts for a check in which a call is late."""


@dataclass(frozen=True)
class Subject:
    """A device of a bench file."""

    record: DeviceRecord
    bench: str
    """Name of the bench file."""
    wiring: Truth | None = None
    """Wiring and scales from its rig's truth file; None: taken from the bench file alone, which proves nothing."""


def subjects(driver: str, bench: Path | None = None) -> list[Subject]:
    """Every device of a driver (its name, or `module:Class`) in a bench file, or in all shipped ones.

    Raises InvalidFile if no bench file with one is valid, UsageError if the driver is unknown.
    """
    try:
        target = driver_class(driver)
    except ValueError as error:
        raise UsageError(f"{error}; or give module:Class") from error
    names = [target, *(name for name, known in drivers().items() if known == target)]
    shipped = sorted(shipped_folder("bench").glob("*.yaml")) if bench is None else []
    naming = [path for path in shipped if any(name in path.read_text("utf-8") for name in names)]
    found: list[Subject] = []
    unusable: list[InvalidFile] = []
    for path in naming if bench is None else [bench]:
        try:
            devices = mount_alone(path).bench.devices
        except InvalidFile as error:
            unusable.append(error)
            continue
        real = truth_of(path)
        wiring = None if real is None else read_truth(real)
        found += [Subject(r, path.name, wiring) for r in devices if r.driver == target]
    if unusable and not found:
        raise unusable[0]
    return found


def subject(driver: str, bench: Path | None = None, device: str | None = None) -> Subject:
    """The device with the most to check, or the one called `device`; raises UsageError if there is none."""
    if found := [one for one in subjects(driver, bench) if device in {None, one.record.name}]:
        return max(found, key=lambda one: _size(one.record))
    named = f' called "{device}"' if device else ""
    missing = f"no device{named} of the driver {driver} in {bench or 'the shipped benches'}"
    raise UsageError(f"{missing}; give a bench file with one, as docs/drivers.md says")


def _size(record: DeviceRecord) -> tuple[int, int]:
    """Number of kinds of channels, outputs and so on of a device, and their total number."""
    groups = (record.channels, record.outputs, record.valves, record.interlocks)
    return sum(map(bool, groups)) + bool(record.watchdog), sum(map(len, groups))


def run(subject: Subject, *, hostile: int = 300, seed: int = 1, only: Collection[str] = ()) -> Iterator[Result]:
    """Run every check on one device, or only those in `only`, each with a new emulator.

    `hostile` is the number of damaged pieces.
    """

    def battle(rig: Rig) -> str:
        """Damaged answers end in a sentence or a number, in time; no write is repeated."""
        return Battle(rig, hostile, seed).fight()

    checks = {**CHECKS, **({HOSTILE: (battle, WIRE)} if hostile else {})}
    for name in only or checks:
        check, *needs = checks[name]
        promise = (check.__doc__ or "").strip().splitlines()[0]
        yield Result(name, promise, *_verdict(subject, check, needs))


def _verdict(
    subject: Subject, check: Callable[[Rig], str], needs: Sequence[Need], attempts: int = ATTEMPTS
) -> tuple[str, str]:
    with tempfile.TemporaryDirectory(prefix="pmabench-conformance-") as folder:
        try:
            with closing(Rig(subject.record, Path(folder), subject.wiring)) as rig:
                missing = next((sentence for has, sentence in needs if not has(rig)), "")
                return (r.NOT_APPLICABLE, missing) if missing else (r.PASSED, check(rig))
        except r.NotChecked as reason:
            return r.NOT_CHECKED, str(reason)
        except r.Late as failure:
            if attempts == 1:
                return r.FAILED, f"{failure}, and so it was {ATTEMPTS} times"
        except r.Failed as failure:
            return r.FAILED, str(failure)
        except DeviceError as error:  # not of the driver, whose errors are results of its calls
            return r.FAILED, f"the emulator: {error}"
    return _verdict(subject, check, needs, attempts - 1)
