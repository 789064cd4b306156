"""Known quantities, their SI units and display units; no parsing of text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

PLAIN = 1e6
"""Size [display units] below which no power of ten is written."""


@dataclass(frozen=True)
class Quantity:
    """A physical quantity: its SI unit, and the unit of tables and plots with 1 display unit = `scale` SI."""

    name: str
    unit: str
    shown_in: str
    scale: float
    example: str = ""
    """Example as written in a file; empty if no file contains it."""

    def show(self, value: float, digits: int = 6) -> str:
        """`value` [SI] in the display unit, for instance `300 kPa`."""
        text = f"{value / self.scale:.{digits}g}"
        if "e+" in text and abs(float(text)) < PLAIN:
            text = f"{float(text):.0f}"
        return f"{text} {self.shown_in}".strip()


QUANTITIES: dict[str, Quantity] = {
    q.name: q
    for q in (
        Quantity("pressure", "Pa", "kPa", 1e3, "300 kPa"),
        Quantity("pressure rate", "Pa/s", "kPa/s", 1e3, "2 kPa/s"),
        Quantity("length", "m", "mm", 1e-3, "10 mm"),
        Quantity("speed", "m/s", "mm/s", 1e-3, "5 mm/s"),
        Quantity("acceleration", "m/s2", "m/s²", 1.0, "9.81 m/s2"),
        Quantity("force", "N", "N", 1.0, "58.86 N"),
        Quantity("mass", "kg", "kg", 1.0, "6 kg"),
        Quantity("time", "s", "s", 1.0, "2 s"),
        Quantity("frequency", "Hz", "Hz", 1.0, "500 Hz"),
        Quantity("ratio", "1", "%", 0.01, "25 %"),
        Quantity("stiffness", "N/m", "N/mm", 1e3, "7 N/mm"),
        Quantity("damping", "N.s/m", "N·s/mm", 1e3, "1.5 N.s/mm"),
        Quantity("gain", "Pa/m", "kPa/mm", 1e6, "20 kPa/mm"),
        Quantity("integral gain", "Pa/(m.s)", "kPa/(mm·s)", 1e6),
        Quantity("derivative gain", "Pa.s/m", "kPa·s/mm", 1e6),
        Quantity("work", "J", "J", 1.0),
        Quantity("voltage", "V", "V", 1.0, "10 V"),
        Quantity("current", "A", "mA", 1e-3, "4 mA"),
        Quantity("angle", "rad", "deg", 0.017453292519943295, "30 deg"),
        Quantity("angular speed", "rad/s", "deg/s", 0.017453292519943295, "20 deg/s"),
        Quantity("torque", "N.m", "N·m", 1.0, "5 N.m"),
        Quantity("torque rate", "N.m/s", "N·m/s", 1.0, "50 N.m/s"),
        Quantity("angular integral gain", "N.m/rad/s", "N·m/rad/s", 1.0, "20 N.m/rad/s"),
        Quantity("torsional stiffness", "N.m/rad", "N·m/rad", 1.0, "20 N.m/rad"),
        Quantity("torque per pressure", "N.m/Pa", "N·m/bar", 1e-5),
        Quantity("force per pressure", "N/Pa", "N/kPa", 1e-3, "1.08 N/kPa"),
        Quantity("force per pressure squared", "N/Pa2", "N/kPa²", 1e-6),
        Quantity("stiffness per pressure", "N/m/Pa", "N/mm/kPa", 1.0, "0.001 N/mm/kPa"),
        Quantity("stiffness per pressure squared", "N/m/Pa2", "N/mm/kPa²", 1e-3, "1e-5 N/mm/kPa2"),
        Quantity("damping per pressure", "N.s/m/Pa", "N·s/mm/kPa", 1.0, "0.0016 N.s/mm/kPa"),
        Quantity("damping per pressure squared", "N.s/m/Pa2", "N·s/mm/kPa²", 1e-3, "1e-6 N.s/mm/kPa2"),
        Quantity("force rate", "N/s", "N/s", 1.0, "2000 N/s"),
        Quantity("volume", "m3", "cm³", 1e-6, "60 cm3"),
        Quantity("impulse", "N.s", "N·s", 1.0, "420 N.s"),
        Quantity("volume per pressure", "m3/Pa", "cm³/bar", 1e-11, "2 cm3/bar"),
        Quantity("rate", "1/s", "1/s", 1.0, "0.5 Hz"),
        Quantity("mass flow", "kg/s", "g/s", 1e-3, "2 g/s"),
        Quantity("conductance", "kg/s/Pa", "g/s/bar", 1e-8, "10 g/s/bar"),
        Quantity("temperature", "K", "K", 1.0, "293 K"),
        Quantity("count", "1", "", 1.0),
    )
}

CHANNEL_QUANTITY = {
    "pressure": "pressure",
    "pressure_command": "pressure",
    "displacement": "length",
    "displacement_command": "length",
    "force": "force",
    "angle": "angle",
    "angle_command": "angle",
    "torque": "torque",
    "supply": "pressure",
    "flow": "mass flow",
    **dict.fromkeys(("acceleration_x", "acceleration_y", "acceleration_z"), "acceleration"),
    **dict.fromkeys(("turn_x", "turn_y"), "angular speed"),
}
"""Quantity of each channel name; a protocol may only use names of this table."""
MUSCLES = 6
"""Largest number of muscles on one bench."""
OF_A_MUSCLE = ("pressure", "pressure_command", "displacement", "displacement_command", "force")
"""Channels of each muscle on a bench with several: `pressure_1`, `pressure_2` ..."""
CHANNEL_QUANTITY |= {
    f"{name}_{number}": CHANNEL_QUANTITY[name] for name in OF_A_MUSCLE for number in range(1, MUSCLES + 1)
}


def without_number(name: str) -> tuple[str, str]:
    """A name and the number of its muscle: ("pressure", "_2") for `pressure_2`, ("pressure", "") for `pressure`."""
    return (name[:-2], name[-2:]) if name[-2:-1] == "_" and name[-1].isdigit() else (name, "")


def highest_pressure(measured: Mapping[str, float]) -> float | None:
    """Highest pressure of any muscle among measured values by channel [Pa]; None if none is measured."""
    return max((value for name, value in measured.items() if without_number(name)[0] == "pressure"), default=None)


def show(value: float, quantity: str, digits: int = 6) -> str:
    """`value` [SI] of the named quantity in its display unit."""
    return QUANTITIES[quantity].show(value, digits)


def in_words(seconds: float) -> str:
    """A duration in words: `3.2 s`, `12 min 05 s`, `3 h 20 min`, `2 days 3 h`, `31 years 251 days`."""
    if not seconds < 1e15:
        return "more than a million years"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    years, days = divmod(days, 365)
    if years:
        return f"{_counted(years, 'year')} {_counted(days, 'day')}"
    if days:
        return f"{_counted(days, 'day')} {hours} h" if hours else _counted(days, "day")
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{seconds:.1f} s"


def _counted(number: int, name: str) -> str:
    return f"{number} {name}{'' if number == 1 else 's'}"
