"""Devices that measure and command a bench, as `init` offers them: driver, names of its inputs, raw units."""

from __future__ import annotations

from dataclasses import dataclass


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
