"""The questions that `init` asks about a bench and its muscle, at most 20 of them, with what an answer looks like.

A derived answer (`default`) is a guess that a person has to confirm. What protects people and muscle is never derived:
such a question is `needed`, and an answer offered for it is only shown.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pmabench.base.quantities import show
from pmabench.bench.lab import derived, reading
from pmabench.bench.lab.derived import DAQS, NONE_YET

if TYPE_CHECKING:
    from pmabench.bench.lab.answers import Answers

MOST = 20
"""Questions that anybody is asked."""


def _nothing(_answers: Answers) -> str | None:
    return None


def _always(_answers: Answers) -> bool:
    return True


def _has_daq(answers: Answers) -> bool:
    return answers.text("daq") != NONE_YET


@dataclass(frozen=True)
class Question:
    """One question; `read` raises ValueError with what was expected."""

    key: str
    text: str
    explain: str
    read: Callable[[str, Answers], Any]
    default: Callable[[Answers], str | None] = _nothing
    """The derived answer; None where there is none."""
    choices: Callable[[Answers], Mapping[str, str]] = field(default=lambda _answers: {})
    """Answer -> words, for a numbered menu."""
    asked: Callable[[Answers], bool] = _always
    needed: bool = False
    """Only a person may answer it."""
    hint: Callable[[Answers], str] = field(default=lambda _answers: "")
    """What is known that may help; never taken as the answer."""


def _plain(read: Callable[[str], Any]) -> Callable[[str, Answers], Any]:
    return lambda value, _answers: read(value)


def _choice(choices: Callable[[Answers], Mapping[str, str]]) -> Callable[[str, Answers], str]:
    def read(value: str, answers: Answers) -> str:
        known = choices(answers)
        if value not in known:
            raise ValueError(f'"{value}" is none of {", ".join(known)}')
        return value

    return read


def _supply(value: str, answers: Answers) -> tuple[float, float | None]:
    pressure, relief = reading.supply(value)
    never = answers.value("never_above")
    if relief is not None and relief >= never:
        raise ValueError(f"the relief valve must open below the muscle's {show(never, 'pressure')}")
    return pressure, relief


def _contraction(value: str, _answers: Answers) -> float:
    ratio = reading.above_zero("ratio")(value)
    if ratio >= 0.6:
        raise ValueError("a share of the nominal length below 60 % is expected")
    return ratio


def _inputs(value: str, answers: Answers) -> dict[str, str]:
    found = reading.inputs(value)
    if answers.text("free_end") == "actuator" and "actuator" not in found:
        raise ValueError("actuator is missing: what the actuator is set to, looped into an input")
    return found


def _address(value: str, answers: Answers) -> str:
    reading.text(value)
    if answers.text("daq") == "modbus" and "," not in value:
        raise ValueError('address and register map are expected: "192.168.0.10:502, registers.yaml"')
    return value


def _daqs(_answers: Answers) -> dict[str, str]:
    return {**{key: daq.title for key, daq in DAQS.items()}, NONE_YET: "none yet: a simulated bench"}


def _free_ends(_answers: Answers) -> dict[str, str]:
    return {"weights": "weights hang on it", "actuator": "an actuator drives it"}


def _table() -> tuple[Question, ...]:
    length, pressure = reading.above_zero("length"), reading.above_zero("pressure")
    return (
        Question("make", "Make of the muscle", "The maker, or your lab.", _plain(reading.text)),
        Question("type", "Type", "As on its label, for instance DMSP-20-250N.", _plain(reading.text)),
        Question("serial", "Serial number", "What tells this muscle from others of its type.", _plain(reading.text),
                 default=lambda _answers: "unknown"),
        Question("nominal_length", "Nominal length", "Between the fittings, as ordered: 250 mm.", _plain(length),
                 default=derived.nominal_length),
        Question("inner_diameter", "Inner diameter", "Without pressure: 20 mm.", _plain(length),
                 default=derived.diameter),
        Question("never_above", "Highest pressure that the muscle may ever see",
                 "By the maker's data sheet, or what your own was tested with. It limits everything else.",
                 _plain(pressure), needed=True, hint=derived.pressure_hint),
        Question("contraction", "Highest contraction", "As share of the nominal length: 25 %.", _contraction,
                 default=derived.contraction),
        Question("mounted", "Length as mounted, and the load on it then", "250 mm, 6 kg", _plain(reading.mounted),
                 default=lambda answers: f"{answers.text('nominal_length')}, 0 kg"),
        Question("free_end", "What is at the free end", "What the muscle pulls.", _choice(_free_ends),
                 default=lambda _answers: "weights", choices=_free_ends),
        Question("stack", "Hanger and plates", "hanger 1 kg, plates 10 x 5 kg + 1 x 2 kg, carriage 2 kg, pulley. The"
                 " carriage is what moves with the stack; pulley: over one.", _plain(reading.stack),
                 default=derived.stack, asked=lambda answers: answers.text("free_end") == "weights"),
        Question("actuator", "Stroke, speed and force of the actuator", "60 mm, 100 mm/s, 2000 N",
                 _plain(reading.actuator), default=derived.actuator,
                 asked=lambda answers: answers.text("free_end") == "actuator"),
        Question("daq", "What measures and commands the bench", "One device for all; other benches are shipped: init"
                 " --like alicat, can, dataq, festo.", _choice(_daqs), default=lambda _answers: NONE_YET,
                 choices=_daqs),
        Question("address", "Its address", "IP address, device name or port; of a device with a register map also the"
                 " file: 192.168.0.10:502, registers.yaml.", _address, default=derived.address, asked=_has_daq),
        Question("inputs", "What is on each input", "pressure AIN0, displacement AIN1, force AIN2, command AIN3; with"
                 " an actuator also actuator AIN4. What both are set to is looped into inputs.", _inputs,
                 default=derived.inputs, asked=_has_daq),
        Question("sensors", "What each sensor gives over its range", "By their data sheets: pressure 0 V..10 V = 0"
                 " kPa..1000 kPa; displacement 0 V..10 V = 0 mm..100 mm; force 0 V..10 V = 0 N..2000 N.",
                 _plain(reading.sensors), default=derived.sensors, asked=_has_daq),
        Question("regulator", "Output of the pressure regulator and its range", "DAC0 0 V..5 V = 0 kPa..1000 kPa",
                 _plain(reading.regulator), default=derived.regulator, asked=_has_daq),
        Question("dump_valve", "Dump valve: output, and where it is while that is on", "FIO0 closed: open without"
                 " power, as it should be. FIO0 open: shut without power. none: there is none.",
                 _plain(reading.dump_valve), asked=_has_daq, needed=True),
        Question("supply", "Pressure of the supply, and where the relief valve opens", "700 kPa, relief 650 kPa; or"
                 " 700 kPa, relief none. The relief valve opens below the muscle's highest pressure.", _supply,
                 needed=True),
        Question("interlock", "Input of the emergency stop", "High while it is not pressed: FIO1, or none.",
                 _plain(reading.interlock), default=lambda _answers: "none", asked=_has_daq),
        Question("calibration", "Folder of calibration files", "One file for each sensor, as `pmabench calibrate`"
                 " writes them, or none yet: the data sheet's line is taken.", _plain(reading.text),
                 default=lambda _answers: "none yet", asked=_has_daq),
        Question("protocol", "What to measure", "Another protocol can be written at any time.",
                 _choice(derived.protocols), default=lambda answers: next(iter(derived.protocols(answers))),
                 choices=derived.protocols),
    )  # fmt: skip


QUESTIONS = {question.key: question for question in _table()}
"""Key -> question, in the order in which they are asked."""
