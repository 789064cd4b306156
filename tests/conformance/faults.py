"""The table of mutants: one fault each, that the suite must find in any driver that can have it."""

from dataclasses import dataclass

from pmabench.bench import interface

MUTANTS = {}
EXAMPLE = "example"
"""`needs` of a fault that is put into the example driver's own bytes."""


@dataclass(frozen=True)
class Mutant:
    """A row of the table: a class that is put in front of a driver's class."""

    mixin: type
    needs: str
    """What a driver must have for it to be a fault: a capability, nothing, or `EXAMPLE`."""
    found_by: str
    """The check that must fail."""
    says: str
    """What its sentence must hold, for the example driver."""
    least: int
    """How many channels, outputs or valves it takes."""


def fault(needs, found_by, says="", least=1):
    """Put a class into the table."""

    def enter(mixin):
        MUTANTS[mixin.__name__] = Mutant(mixin, needs, found_by, says, least)
        return mixin

    return enter


def applies(name, driver, record, example):
    """Whether a fault is one for this driver, as this device of a bench."""
    mutant = MUTANTS[name]
    if mutant.needs == EXAMPLE:
        return example
    if mutant.needs == "Watchdog" and not record.watchdog:
        return False
    if mutant.found_by == "held" and not issubclass(driver, interface.Supervised):
        return False
    outputs = dict.fromkeys(("SetPoint", "Follower", "Motion"), record.outputs)
    outputs["Rescue"] = (*record.outputs, *record.valves)
    things = {**outputs, "Stream": record.channels, "Switch": record.valves, "Inputs": record.interlocks}
    if len(things.get(mutant.needs, " ")) < mutant.least:
        return False
    return not mutant.needs or issubclass(driver, getattr(interface, mutant.needs))
