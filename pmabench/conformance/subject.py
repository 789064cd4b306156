"""Which device of which bench file a driver is tried as."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pmabench.base.errors import InvalidFile, UsageError
from pmabench.bench.compile import mount_alone
from pmabench.bench.interface import DeviceRecord, Truth
from pmabench.bench.registry import driver_class, drivers
from pmabench.bench.truth import read_truth, truth_of
from pmabench.files.shipped import shipped_folder


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
    """The one of them with most to try, or called `device`; raises UsageError where there is none."""
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
