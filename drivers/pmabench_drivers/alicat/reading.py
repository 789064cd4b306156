"""What a controller tells at a time, and what its status codes mean; knows no line. Standard library only."""

from __future__ import annotations

from dataclasses import dataclass

OVER, HELD, FAILED, EXHAUST, LIMIT, ABORTED = "POV", "HLD", "ADC", "EXH", "OPL", "aborted"
BITS = {6: OVER, 8: HELD, 9: FAILED, 10: EXHAUST, 11: LIMIT, 13: ABORTED}
"""Bits of the Modbus status flags that a pressure controller has."""
HARMLESS = frozenset({"LCK", "MOV", "OVR", "TMF", "TOV", "VOV"})
"""A locked display, and what is about flow and temperature."""
CODES = frozenset({*HARMLESS, OVER, HELD, FAILED, EXHAUST, LIMIT})
NO_VALUE = frozenset({FAILED, ABORTED})
"""With these the number is no measurement."""
MEANING = {
    FAILED: "its pressure sensor cannot be read (ADC)",
    ABORTED: "its measurement was aborted",
    LIMIT: "it is over its own pressure limit (OPL)",
    HELD: "its valves are held (HLD): it traps the pressure and follows no set-point",
    EXHAUST: "its exhaust is held open (EXH), and not by this program",
}


@dataclass(frozen=True)
class Reading:
    """One answer: pressure and set-point in the device's unit, its status, and when it was asked and answered.

    `asked` and `answered` are bench time [s].
    """

    pressure: float
    set_point: float
    status: frozenset[str]
    asked: float
    answered: float


def trouble(status: frozenset[str], *, exhausting: bool) -> str:
    """What in a status is wrong; empty where nothing is. `exhausting`: this program has opened the exhaust."""
    for code in (FAILED, ABORTED, LIMIT, HELD, EXHAUST):
        if code in status and not (code in {EXHAUST, HELD} and exhausting):
            return MEANING[code]
    unknown = sorted(status - CODES - {ABORTED})
    return f'it says "{unknown[0]}", which is not known here' if unknown else ""


def from_bits(flags: int) -> frozenset[str]:
    """The codes of Modbus status flags; bits about flow and temperature are left out."""
    return frozenset(code for bit, code in BITS.items() if flags >> bit & 1)
