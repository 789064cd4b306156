"""Every mutant as a class: `tests.conformance.mutants:X__labjack` is the driver `labjack` with the fault `X`.

The faults are the rows of `MUTANTS`; `X__example` is the driver of docs/driver-example with one of them. What a fault
needs and which check finds it is in its row; `NOT_SEEN` has those that cannot be seen from outside.
"""

from dataclasses import replace
from functools import cache
from importlib import import_module

from pmabench.bench.driver_options import driver_class, drivers
from pmabench.conformance import subject
from tests.conformance import EXAMPLE_FOLDER, mutants_commands, mutants_example, mutants_manners, mutants_samples
from tests.conformance.faults import EXAMPLE, MUTANTS, applies

EXAMPLE_DRIVER = "pmabench_driver_example:ExampleController"
TABLES = (mutants_samples, mutants_commands, mutants_manners, mutants_example)
OF_TIMES = (
    *("ValuesOneSampleLate", "ValuesThreeSamplesLate", "ValuesRepeatedInTurn", "ValuesOfTheBlocksEnd"),
    *("ValuesSmoothed", "ValuesReversedInTheBlock"),
)
NOT_SEEN = {
    **{(name, "ild1420"): "some 2 ms at 500 Hz: less than a time can be compared" for name in OF_TIMES},
    ("ValuesSwapped", "festo-cmmt"): "place and target in one unit, equal in every state; the suite prints not checked",
    ("ReadBackFromMemory", "ni-daqmx"): "the device cannot be asked; the suite prints not checked",
    ("ReadBackFromMemory", "can"): "nothing else changes the emulated target; the suite prints not checked",
    ("ReadBackFromMemory", "festo-cmmt"): "nothing else changes the emulated target; the suite prints not checked",
    **{
        ("ReadBackKeptToTheNextCommand", name): "nothing else changes the emulated target; the suite prints not checked"
        for name in ("ni-daqmx", "can", "festo-cmmt")
    },
    ("WritesTwice", "festo-cmmt"): "the driver does not send the same target again",
    **{
        (name, "can"): "the emulator cannot change the input; the suite prints not checked"
        for name in ("LevelFixed", "LevelFromMemory", "LevelOld", "LevelOfTheLastFeed")
    },
    ("LevelOfTheLastFeed", "ni-daqmx"): "the bench has no watchdog that is fed",
    ("ValuesAreSi", "serial-ascii"): "its indicator gives N, which is SI",
    ("HeldFromMemory", "ni-daqmx"): "the serial number of the emulator stays, and a restart is refused",
}
"""Faults that cannot be seen from outside, and why."""


@cache
def tried(driver):
    """The device that a driver is tried as; to find it, every shipped bench that names the driver is compiled."""
    if driver == EXAMPLE:
        return subject(EXAMPLE_DRIVER, EXAMPLE_FOLDER / "bench.yaml")
    return subject(driver)


def _class(target):
    module, _, name = target.partition(":")
    return getattr(import_module(module), name)


def cases(names):
    """Every fault of each of the drivers: (fault, driver)."""
    for driver in names:
        record = tried(driver).record
        found = _class(record.driver)
        for name in MUTANTS:
            if applies(name, found, record, driver == EXAMPLE) and (name, driver) not in NOT_SEEN:
                yield name, driver


def mutated(name, driver):
    """The device, with a driver that has the fault."""
    right = tried(driver)
    target = f"tests.conformance.mutants:{name}__{driver.replace('-', '_')}"
    return replace(right, record=replace(right.record, driver=target))


def shipped():
    """The installed drivers that have an emulator."""
    return sorted(name for name, target in drivers().items() if getattr(_class(target), "emulator", ""))


def __getattr__(name):
    """`FAULT__DRIVER`, as a class."""
    kind, found, driver = name.partition("__")
    if not found or kind not in MUTANTS:
        raise AttributeError(name)
    base = _class(EXAMPLE_DRIVER if driver == EXAMPLE else driver_class(driver.replace("_", "-")))
    return type(name, (MUTANTS[kind].mixin, base), {"__module__": __name__})
