"""The questions that `init` asks about a bench and its muscle, at most 20 of them, and the answers of a lab.

An answer that is derived from others (from the type's data sheet, the size of the muscle, the device: `default`) is a
guess that a person has to confirm. What protects people and muscle is never derived: such a question is `needed`, and
an answer offered for it is only shown.

Also the file that keeps the answers, and the limits of a bench from the limits of the muscle, the relief valve, the
supply and the sensors; each is to be confirmed.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, UsageError, did_you_mean
from pmabench.base.quantities import show
from pmabench.bench.lab import reading
from pmabench.bench.lab.reading import GRAVITY, Scale
from pmabench.files.document import Document, read_document
from pmabench.model.published_muscles import MuscleType, braid_surface, find_type, length_on_label
from pmabench.model.real.muscle import Surface


@dataclass(frozen=True)
class Daq:
    """One device for all channels and outputs of a bench."""

    driver: str
    title: str
    address: str
    """Its usual address, or an example."""
    inputs: str
    """Usual inputs, in the form of an answer."""
    fifth: str
    """Next input, for the looped-back command of an actuator."""
    raw: str
    """Unit of its readings."""
    full: float
    """Highest reading; the lowest is 0."""
    output: str
    """Usual output for the regulator."""
    second: str
    """Usual output for an actuator."""
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
"""Answer of a lab that has no device yet; its bench is simulated."""


CONTRACTION = "25 %"
"""Highest contraction of muscles without a data sheet in the library."""
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
"""Free end -> protocol -> its result."""


def muscle_type(answers: Answers) -> MuscleType | None:
    """Type of the muscle in the library; None if unknown."""
    return find_type(answers.text("make"), answers.text("type"))


def surface(answers: Answers) -> Surface:
    """Force over contraction and pressure: of the type, else of a braid of its diameter."""
    found = muscle_type(answers)
    if found is not None and found.surface is not None:
        return found.surface
    return braid_surface(answers.value("inner_diameter"))


def nominal_length(answers: Answers) -> str | None:
    """Nominal length from the label; None if it has none."""
    length = length_on_label(answers.text("type"))
    return show(length, "length") if length else None


def diameter(answers: Answers) -> str | None:
    """Inner diameter of the type; None if unknown."""
    found = muscle_type(answers)
    return show(found.diameter, "length") if found else None


def pressure_hint(answers: Answers) -> str:
    """Highest pressure by the data sheet, to be compared with the answer; empty if unknown."""
    found = muscle_type(answers)
    return f"{found.name}: {show(found.highest_pressure, 'pressure')} by the data sheet" if found else ""


def contraction(answers: Answers) -> str:
    """Highest contraction of the type, else `CONTRACTION`."""
    found = muscle_type(answers)
    return show(found.contraction, "ratio") if found else CONTRACTION


def highest_force(answers: Answers) -> float:
    """Force at the highest pressure without contraction [N]."""
    return float(surface(answers).force(0.0, answers.value("never_above")))  # type: ignore[arg-type]


def round_up(value: float, digits: int = 2) -> float:
    """Round up to a number of `digits` significant digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    return float(f"{math.ceil(value / unit - 1e-9) * unit:.6g}")


def stack(answers: Answers) -> str:
    """A stack of ten plates with half of the muscle's highest force."""
    plate = round_up(0.05 * highest_force(answers) / GRAVITY, 1)
    return f"hanger {show(plate / 5, 'mass')}, plates 10 x {show(plate, 'mass')}"


def actuator(answers: Answers) -> str:
    """An actuator with the muscle's stroke and twice its force."""
    stroke = answers.value("contraction") * answers.value("nominal_length")
    force = round_up(2 * highest_force(answers))
    return f"{show(round_up(stroke), 'length')}, 100 mm/s, {show(force, 'force')}"


def address(answers: Answers) -> str | None:
    """Usual address of the device; None for a register map, which is the lab's own."""
    return None if answers.text("daq") == "modbus" else DAQS[answers.text("daq")].address


def inputs(answers: Answers) -> str:
    """The device's usual inputs."""
    daq = DAQS[answers.text("daq")]
    return daq.inputs + (f", actuator {daq.fifth}" if answers.text("free_end") == "actuator" else "")


def sensors(answers: Answers) -> str:
    """Ranges somewhat wider than the muscle's."""
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
    """The device's usual output over its whole range."""
    daq = DAQS[answers.text("daq")]
    top = round_up(1.3 * answers.value("never_above"))
    return f"{daq.output} 0 {daq.raw}..{daq.out_full:g} {daq.raw} = 0 kPa..{show(top, 'pressure')}"


def protocols(answers: Answers) -> dict[str, str]:
    """Protocols for this free end."""
    return PROTOCOLS[answers.text("free_end")]


MOST = 20
"""Largest number of questions."""


def _has_daq(answers: Answers) -> bool:
    return answers.text("daq") != NONE_YET


@dataclass(frozen=True)
class Question:
    """One question; `read` raises ValueError with what was expected."""

    key: str
    text: str
    explain: str
    read: Callable[[str, Answers], Any]
    default: Callable[[Answers], str | None] = field(default=lambda _answers: None)
    """Derived answer; None without one."""
    choices: Callable[[Answers], Mapping[str, str]] = field(default=lambda _answers: {})
    """Answer -> description, for a numbered menu."""
    asked: Callable[[Answers], bool] = field(default=lambda _answers: True)
    needed: bool = False
    """Whether only a person may answer it."""
    hint: Callable[[Answers], str] = field(default=lambda _answers: "")
    """Information that may help; never taken as the answer."""


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
    if (ratio := reading.above_zero("ratio")(value)) >= 0.6:
        raise ValueError("a share of the nominal length below 60 % is expected")
    return ratio


def _inputs(value: str, answers: Answers) -> dict[str, str]:
    found = reading.inputs(value)
    if answers.text("free_end") == "actuator" and "actuator" not in found:
        raise ValueError("actuator is missing: what the actuator is set to, looped into an input")
    if answers.text("free_end") != "actuator" and "actuator" in found:
        raise ValueError("actuator is an input too many: weights are at the free end")
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
        Question("nominal_length", "Nominal length", "Between the fittings, as ordered; for instance 250 mm.",
                 _plain(length), default=nominal_length),
        Question("inner_diameter", "Inner diameter", "Without pressure; for instance 20 mm.", _plain(length),
                 default=diameter),
        Question("never_above", "Highest pressure that the muscle may ever see",
                 "By the maker's data sheet, or what your own was tested with. It limits everything else.",
                 _plain(pressure), needed=True, hint=pressure_hint),
        Question("contraction", "Highest contraction", "As share of the nominal length: 25 %.", _contraction,
                 default=contraction),
        Question("mounted", "Length as mounted, and the load on it then", "250 mm, 6 kg", _plain(reading.mounted),
                 default=lambda answers: f"{answers.text('nominal_length')}, 0 kg"),
        Question("free_end", "What is at the free end", "What the muscle pulls.", _choice(_free_ends),
                 default=lambda _answers: "weights", choices=_free_ends),
        Question("stack", "Hanger and plates", "hanger 1 kg, plates 10 x 5 kg + 1 x 2 kg, carriage 2 kg, pulley. The"
                 " carriage moves with the stack; leave pulley out where the stack hangs directly.",
                 _plain(reading.stack), default=stack, asked=lambda answers: answers.text("free_end") == "weights"),
        Question("actuator", "Stroke, speed and force of the actuator", "60 mm, 100 mm/s, 2000 N",
                 _plain(reading.actuator), default=actuator,
                 asked=lambda answers: answers.text("free_end") == "actuator"),
        Question("daq", "What measures and commands the bench", "One device for all; other benches are shipped: init"
                 " --like alicat, can, dataq, festo.", _choice(_daqs), default=lambda _answers: NONE_YET,
                 choices=_daqs),
        Question("address", "Its address", "IP address, device name or port; of a device with a register map also the"
                 " file: 192.168.0.10:502, registers.yaml.", _address, default=address, asked=_has_daq),
        Question("inputs", "What is on each input", "pressure AIN0, displacement AIN1, force AIN2, command AIN3; with"
                 " an actuator also actuator AIN4. Loop each output back into a spare input, which records the command"
                 " with the measurement. An encoder needs a device that reads one: docs/devices.md.", _inputs,
                 default=inputs, asked=_has_daq),
        Question("sensors", "What each sensor gives over its range", "By their data sheets: pressure 0 V..10 V = 0"
                 " kPa..1000 kPa; displacement 0 V..10 V = 0 mm..100 mm; force 0 V..10 V = 0 N..2000 N.",
                 _plain(reading.sensors), default=sensors, asked=_has_daq),
        Question("regulator", "Output of the pressure regulator and its range", "DAC0 0 V..5 V = 0 kPa..1000 kPa",
                 _plain(reading.regulator), default=regulator, asked=_has_daq),
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
                 _choice(protocols), default=lambda answers: next(iter(protocols(answers))),
                 choices=protocols),
    )  # fmt: skip


QUESTIONS = {question.key: question for question in _table()}
"""Key -> question, in order."""


ASKED = "asked"
"""Key of the date on which the questions were asked."""


class Answers:
    """Answers to `QUESTIONS` by key, as typed; None for "not known yet". Returns parsed values, derived if missing."""

    def __init__(self, given: Mapping[str, str | None], asked: datetime.date) -> None:
        self.given = dict(given)
        self.asked = asked

    def said(self, key: str) -> bool:
        """Whether a person gave this answer."""
        return self.given.get(key) is not None

    def text(self, key: str) -> str:
        """The answer as typed, or the derived one; raises KeyError if there is neither."""
        found = self.given.get(key)
        found = QUESTIONS[key].default(self) if found is None else found
        if found is None:
            raise KeyError(key)
        return found

    def value(self, key: str) -> Any:
        """The parsed answer, given or derived; raises ValueError if it cannot be read."""
        return QUESTIONS[key].read(self.text(key), self)

    def questions(self) -> list[Question]:
        """Questions that apply to the answers so far, in their order."""
        return [question for question in QUESTIONS.values() if question.asked(self)]

    def missing(self) -> list[str]:
        """Keys of missing answers that only a person can give."""
        open_ones = [question for question in self.questions() if not self.said(question.key)]
        return [question.key for question in open_ones if question.needed or not self._derivable(question)]

    def _derivable(self, question: Question) -> bool:
        """Whether an answer can be derived once the others are given."""
        try:
            return question.default(self) is not None
        except KeyError:
            return True

    def text_of_file(self) -> str:
        """The answers as a file that `init --answers` takes."""
        head = "# Answers to the questions of `pmabench init`; `init DIR --answers FILE` writes the same files again."
        given = [f"{key}: {'null' if value is None else quoted(value)}" for key, value in self.given.items()]
        return "\n".join([head, f"{ASKED}: {self.asked.isoformat()}", *given]) + "\n"


def read_answers(path: Path) -> tuple[dict[str, str | None], datetime.date | None]:
    """Answers in a file, and the day on which they were given; `InvalidFile` with every unknown key."""
    document = read_document(path)
    known = [ASKED, *QUESTIONS]
    problems = [
        document.problem((key,), f'unknown key "{key}"{did_you_mean(key, known)}', key=True)
        for key in document.data
        if key not in known
    ]
    day = None
    try:
        day = datetime.date.fromisoformat(str(document.data[ASKED])) if ASKED in document.data else None
    except ValueError:
        problems.append(document.problem((ASKED,), "a day such as 2026-11-23 is expected"))
    if problems:
        raise InvalidFile(problems)
    given = {key: None if value is None else str(value) for key, value in document.data.items() if key != ASKED}
    check_answers(Answers(given, day or datetime.date.today()), document)
    return given, day


def check_answers(answers: Answers, document: Document | None = None) -> None:
    """Raise `InvalidFile` (or without a file `UsageError`) if given answers cannot be parsed."""
    problems = []
    for key, typed in answers.given.items():
        try:
            if typed is not None:
                QUESTIONS[key].read(typed, answers)
        except KeyError:
            continue  # reported as missing
        except ValueError as error:
            if document is None:
                raise UsageError(f"--answer {key}={typed}: {error}") from error
            problems.append(document.problem((key,), str(error)))
    if problems:
        raise InvalidFile(problems)


def quoted(value: str) -> str:
    """A text in double quotes, as YAML."""
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'


OVERSHOOT = 0.02
"""Overshoot of the regulator, as a fraction of the highest pressure."""
UNCERTAINTY = 0.005
"""Uncertainty of a sensor without calibration, as a fraction of its range."""
SUPPLY_MARGIN = 50e3
"""Supply pressure that a regulator needs above its set-point [Pa]."""


@dataclass(frozen=True)
class Limits:
    """Limits of a bench, in SI."""

    command: float
    trip: float
    overshoot: float
    specimen: float
    """Command limit of the muscle itself."""
    force: float
    contraction: float
    scales: dict[str, Scale]
    """Channel -> range of its sensor."""

    @property
    def setup(self) -> float:
        """Pressure of the proof of the vent path [Pa]."""
        return min(50e3, 0.2 * self.command)


def limits_of(answers: Answers) -> Limits:
    """Limits consistent with the answers: below the relief valve and `never_above`, the trip in between."""
    never = answers.value("never_above")
    pressure, relief = answers.value("supply")
    ceiling = min(never, relief if relief is not None else never)
    scales = scales_of(answers)
    overshoot = _down(OVERSHOOT * ceiling)
    margin = overshoot + UNCERTAINTY * scales["pressure"].span
    command = min(0.88 * ceiling, ceiling - 2.5 * margin, pressure - SUPPLY_MARGIN)
    if answers.text("daq") != NONE_YET:
        command = min(command, answers.value("regulator")[1].values[1])
    command = _down(command)
    trip = _down(min((command + ceiling) / 2, 0.98 * scales["pressure"].values[1]))
    return Limits(
        command, trip, overshoot, _down(0.95 * never), 0.95 * scales["force"].values[1], answers.value("contraction"),
        scales,
    )  # fmt: skip


def scales_of(answers: Answers) -> dict[str, Scale]:
    """Ranges of the sensors; of a simulated bench the proposed ones."""
    if answers.text("daq") != NONE_YET:
        found: dict[str, Scale] = answers.value("sensors")
        return found
    simulated = Answers({**answers.given, "daq": "labjack", "sensors": None}, answers.asked)
    return reading.sensors(simulated.text("sensors"))


def _down(pressure: float) -> float:
    """Round down to whole kPa."""
    return math.floor(pressure / 1e3 + 1e-9) * 1e3
