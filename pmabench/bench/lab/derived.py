"""Devices that `init` offers (driver, names of inputs, raw units), and answers that follow from others.

Answers that follow from others: from the type's data sheet, from the size of the muscle, from the device.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pmabench.base.quantities import show
from pmabench.bench.lab.reading import GRAVITY
from pmabench.model.published_muscles import MuscleType, braid_surface, find_type, length_on_label
from pmabench.model.real.muscle import Surface

if TYPE_CHECKING:
    from pmabench.bench.lab.answers import Answers


@dataclass(frozen=True)
class Daq:
    """One device for all channels and outputs of a bench."""

    driver: str
    title: str
    address: str
    """An example of its address, or the usual one."""
    inputs: str
    """Usual inputs, as they are typed."""
    fifth: str
    """The next input, for what an actuator is set to."""
    raw: str
    """Unit of its readings."""
    full: float
    """Highest reading; the lowest is 0."""
    output: str
    """Output of the regulator."""
    second: str
    """Output of an actuator."""
    out_full: float
    """Highest value of an output, in `raw`."""
    resolution: str
    valve: str
    interlock: str
    watchdog: str = ""


_INPUTS = "pressure {}, displacement {}, force {}, command {}"
DAQS = {
    "labjack": Daq(
        "labjack", "LabJack T7, T8 or T4, over the network", "192.168.0.20",
        _INPUTS.format("AIN0", "AIN1", "AIN2", "AIN3"), "AIN4", "V", 10.0, "DAC0", "DAC1", 5.0, "0.00122 V",
        "FIO0", "FIO1", "2 s",
    ),
    "ni": Daq(
        "ni-daqmx", "NI multifunction device, by NI-DAQmx", "Dev1",
        _INPUTS.format("ai0", "ai1", "ai2", "ai3"), "ai4", "V", 10.0, "ao0", "ao1", 10.0, "0.000306 V",
        "port1/line0", "port0/line0",
    ),
    "modbus": Daq(
        "modbus", "device with a register map, by Modbus", "192.168.0.10:502, registers.yaml",
        _INPUTS.format("pressure", "displacement", "force", "set_point"), "position_set", "count", 10000.0, "pressure",
        "displacement", 10000.0, "1 count", "dump_valve", "e_stop", "500 ms",
    ),
    "board": Daq(
        "serial-line-daq", "board that sends lines of text over a serial port", "/dev/ttyACM0",
        _INPUTS.format("a0", "a1", "a2", "a3"), "a4", "count", 4092.0, "o0", "o1", 4095.0, "1 count", "v0",
        "d0", "500 ms",
    ),
}  # fmt: skip
"""Answer -> device."""
NONE_YET = "none"
"""The answer of a lab that has no device yet; its bench is simulated."""


CONTRACTION = "25 %"
"""Of muscles whose data sheet is not known here."""
PROTOCOLS = {
    "weights": {
        "contraction-relaxation": "force, stiffness, damping: steps of pressure under weights",
        "static-load": "force alone: the pressure at which each weight lifts off",
    },
    "actuator": {
        "isobaric-ramp": "force over contraction at fixed pressures, with its hysteresis",
        "sinusoidal-displacement": "stiffness and damping: sines of displacement at fixed pressure",
        "isometric-pressurisation": "force over pressure at fixed lengths",
    },
}
"""Free end -> protocol -> what it gives."""


def muscle_type(answers: Answers) -> MuscleType | None:
    """The library's type of the muscle."""
    return find_type(answers.text("make"), answers.text("type"))


def surface(answers: Answers) -> Surface:
    """Force over contraction and pressure: of the type, else of a braid of its diameter."""
    found = muscle_type(answers)
    if found is not None and found.surface is not None:
        return found.surface
    return braid_surface(answers.value("inner_diameter"))


def nominal_length(answers: Answers) -> str | None:
    """From the label."""
    length = length_on_label(answers.text("type"))
    return show(length, "length") if length else None


def diameter(answers: Answers) -> str | None:
    """From the type."""
    found = muscle_type(answers)
    return show(found.diameter, "length") if found else None


def pressure_hint(answers: Answers) -> str:
    """The data sheet's value, to be compared with the own one."""
    found = muscle_type(answers)
    return f"{found.name}: {show(found.highest_pressure, 'pressure')} by the data sheet" if found else ""


def contraction(answers: Answers) -> str:
    """From the type, else what most muscles bear."""
    found = muscle_type(answers)
    return show(found.contraction, "ratio") if found else CONTRACTION


def highest_force(answers: Answers) -> float:
    """Force at the highest pressure without contraction [N]."""
    return float(surface(answers).force(0.0, answers.value("never_above")))  # type: ignore[arg-type]


def round_up(value: float, digits: int = 2) -> float:
    """The next number of so many digits that is not smaller."""
    unit = 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    return float(f"{math.ceil(value / unit - 1e-9) * unit:.6g}")


def stack(answers: Answers) -> str:
    """Ten plates that together weigh half of the muscle's highest force."""
    plate = round_up(0.05 * highest_force(answers) / GRAVITY, 1)
    return f"hanger {show(plate / 5, 'mass')}, plates 10 x {show(plate, 'mass')}"


def actuator(answers: Answers) -> str:
    """As far as the muscle goes, and twice its force."""
    stroke = answers.value("contraction") * answers.value("nominal_length")
    force = round_up(2 * highest_force(answers))
    return f"{show(round_up(stroke), 'length')}, 100 mm/s, {show(force, 'force')}"


def address(answers: Answers) -> str | None:
    """The usual one; a register map is the lab's own."""
    return None if answers.text("daq") == "modbus" else DAQS[answers.text("daq")].address


def inputs(answers: Answers) -> str:
    """The first inputs of the device."""
    daq = DAQS[answers.text("daq")]
    return daq.inputs + (f", actuator {daq.fifth}" if answers.text("free_end") == "actuator" else "")


def sensors(answers: Answers) -> str:
    """Ranges somewhat wider than what the muscle does."""
    daq = DAQS[answers.text("daq")]
    raw = f"0 {daq.raw}..{daq.full:g} {daq.raw}"
    pressure = round_up(1.3 * answers.value("never_above"))
    length = round_up(1.4 * answers.value("contraction") * answers.value("nominal_length"))
    force = round_up(1.3 * highest_force(answers))
    return "; ".join((
        f"pressure {raw} = {show(-0.1 * pressure, 'pressure')}..{show(pressure, 'pressure')}",
        f"displacement {raw} = {show(-0.1 * length, 'length')}..{show(length, 'length')}",
        f"force {raw} = {show(-0.1 * force, 'force')}..{show(force, 'force')}",
    ))  # fmt: skip


def regulator(answers: Answers) -> str:
    """The first output over its whole range."""
    daq = DAQS[answers.text("daq")]
    top = round_up(1.3 * answers.value("never_above"))
    return f"{daq.output} 0 {daq.raw}..{daq.out_full:g} {daq.raw} = 0 kPa..{show(top, 'pressure')}"


def protocols(answers: Answers) -> dict[str, str]:
    """Those for this free end."""
    return PROTOCOLS[answers.text("free_end")]
