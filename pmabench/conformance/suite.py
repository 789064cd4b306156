"""The table of checks, and the runs of them on a device of a bench file: one line each with its verdict and why."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from pmabench.base.errors import DeviceError, InvalidFile, UsageError
from pmabench.bench.compile import mount_alone
from pmabench.bench.interface import DeviceRecord, Truth
from pmabench.bench.registry import driver_class, drivers
from pmabench.bench.truth import read_truth, truth_of
from pmabench.conformance import broken_wire, commands, following, samples, unopened
from pmabench.conformance import rig as r
from pmabench.conformance.broken_wire import Battle
from pmabench.conformance.rig import Result, Rig
from pmabench.files.shipped import shipped_folder

CHECKS: dict[str, Callable[[Rig], str]] = {
    "interface": unopened.interfaces,
    "imports": unopened.light,
    "declares": unopened.declared,
    "options": unopened.options,
    "nobody there": unopened.nobody,
    "life": unopened.life,
    "samples": samples.samples,
    "values": samples.values,
    "set-points": commands.set_points,
    "valves": commands.valves,
    "inputs": commands.inputs,
    "from outside": commands.from_outside,
    "ramps": following.ramps,
    "halt": following.halts,
    "watchdog": following.watchdog,
    "held": following.held,
    "safe state": commands.safe_state,
    "second way": commands.second_way,
    "silence": broken_wire.silent,
    "late answers": broken_wire.late_answers,
    "line cut": broken_wire.hang_up,
    "exchanges": broken_wire.exchanges,
    "nothing left": broken_wire.nothing_left,
}
"""Name -> check; what it promises is the first line of its docstring."""
HOSTILE = "hostile answers"
ATTEMPTS = 3
"""A check in which a call is late is tried so often."""


@dataclass(frozen=True)
class Subject:
    """A device as a bench file names it."""

    record: DeviceRecord
    realtime: bool
    """Whether its bench runs in real time."""
    bench: str
    """The bench file's name."""
    wiring: Truth | None = None
    """What its rig's truth file says of wiring and scales; None: the bench file alone says it, and proves nothing."""


def subjects(driver: str, bench: Path | None = None) -> list[Subject]:
    """Every device of a driver (its name, or `module:Class`) in a bench file, or in all shipped ones.

    Raises InvalidFile where no bench file with one can be used, UsageError where the driver is not known.
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
            compiled = mount_alone(path).bench
        except InvalidFile as error:
            unusable.append(error)
            continue
        real = truth_of(path)
        wiring = None if real is None else read_truth(real)
        found += [Subject(r, compiled.realtime, path.name, wiring) for r in compiled.devices if r.driver == target]
    if unusable and not found:
        raise unusable[0]
    return found


def subject(driver: str, bench: Path | None = None, device: str | None = None) -> Subject:
    """The device with most to try, or the one called `device`; raises UsageError where there is none."""
    found = [one for one in subjects(driver, bench) if device in {None, one.record.name}]
    if found:
        return max(found, key=lambda one: _size(one.record))
    named = f' called "{device}"' if device else ""
    raise UsageError(
        f"no device{named} of the driver {driver} in {bench or 'the shipped benches'}; give a bench file with one, as "
        "docs/drivers.md says"
    )


def _size(record: DeviceRecord) -> tuple[int, int]:
    """Kinds of things, and things, that a device has."""
    groups = (record.channels, record.outputs, record.valves, record.interlocks)
    return sum(map(bool, groups)) + bool(record.watchdog), sum(map(len, groups))


def run(subject: Subject, *, hostile: int = 300, seed: int = 1, only: Collection[str] = ()) -> Iterator[Result]:
    """Every check of one device, or `only` some, each with a new emulator.

    `hostile` is how many pieces are damaged.
    """

    def battle(rig: Rig) -> str:
        """Damaged answers end in a sentence or a number, in time; no write is repeated."""
        rig.need_wire()
        return Battle(rig, hostile, seed).fight()

    checks = {**CHECKS, **({HOSTILE: battle} if hostile else {})}
    for name in only or checks:
        check = checks[name]
        promise = (check.__doc__ or "").strip().splitlines()[0]
        yield Result(name, promise, *_verdict(subject, check))


def _verdict(subject: Subject, check: Callable[[Rig], str], attempts: int = ATTEMPTS) -> tuple[str, str]:
    with tempfile.TemporaryDirectory(prefix="pmabench-conformance-") as folder:
        rig = Rig(subject.record, Path(folder), realtime=subject.realtime, wiring=subject.wiring)
        try:
            return r.PASSED, check(rig)
        except r.NotApplicable as reason:
            return r.NOT_APPLICABLE, str(reason)
        except r.NotChecked as reason:
            return r.NOT_CHECKED, str(reason)
        except r.Late as failure:
            if attempts == 1:
                return r.FAILED, f"{failure}, and so it was {ATTEMPTS} times"
        except r.Failed as failure:
            return r.FAILED, str(failure)
        except DeviceError as error:
            if attempts == 1:
                return r.NOT_CHECKED, f"the simulation that it is compared with does not answer: {error}"
        finally:
            rig.close()
    return _verdict(subject, check, attempts - 1)
