"""The truth file of a rig: what is really wired to which terminal, with scales from the data sheets."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from pmabench.bench.files.specimen import Name, Reading, Text
from pmabench.files.document import Strict

Line = tuple[tuple[Reading, Reading], tuple[Reading, Reading]]
"""Two points of a straight line."""
Terminal = Annotated[str, Field(min_length=1, max_length=80)]
Source = Annotated[str, Field(min_length=1, max_length=400)]
"""Data sheet or page with the numbers."""


class SensorFile(Strict):
    """What is measured at one terminal: the sensor from signal to quantity, the device from digits to signal."""

    measures: Literal[
        "pressure", "displacement", "force", "supply", "angle", "pressure_command", "displacement_command"
    ]
    sensor: Line
    device: Line | None = None
    """Scale of the device, if it does not give the signal itself but for instance counts for volts."""
    source: Source


class ActuatorFile(Strict):
    """What a set-point moves: the actuator from its signal to the quantity, the device from digits to signal."""

    drives: Literal["pressure", "displacement"]
    actuator: Line
    device: Line | None = None
    step: Reading | None = None
    """Smallest step of the device."""
    range: tuple[Reading, Reading] | None = None
    """Ends of the travel of a drive."""
    source: Source


class ValveTruth(Strict):
    """A valve on a digital output."""

    valve: Literal["dump_valve"]
    energised: Literal["closed", "open"]
    """Position while energised."""
    source: Source


class ContactTruth(Strict):
    """A contact on a digital input."""

    contact: Name
    """A contact whose name has "stop" in it is the emergency stop."""
    released: Literal["high", "low"]
    """Level while it is not pressed."""
    source: Source


class DeviceTruth(Strict):
    """One device: which it is, how it is set up, and what is wired to it by terminal."""

    driver: str
    """Name of its driver."""
    options: dict[str, Any] = {}
    """Settings of the device, as options of its driver; its address is in the bench file."""
    inputs: dict[Terminal, SensorFile] = {}
    outputs: dict[Terminal, ActuatorFile] = {}
    valves: dict[Terminal, ValveTruth] = {}
    contacts: dict[Terminal, ContactTruth] = {}


class TruthFile(Strict):
    """What a rig really is, written from data sheets and not from the bench file that is to be proven."""

    schema_: Annotated[Literal["pmabench.truth/1"], Field(alias="schema")]
    name: Annotated[str, Field(min_length=1, max_length=80)]
    note: Text = ""
    devices: Annotated[dict[Name, DeviceTruth], Field(min_length=1)]
    """Devices by their names in the bench file."""
