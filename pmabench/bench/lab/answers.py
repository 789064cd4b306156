"""The answers of a lab: what was said, what is derived where nothing was, and the file that keeps them.

And the limits of a bench from what the muscle bears, the relief valve, the supply and the sensors; each to be
confirmed.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, UsageError, did_you_mean
from pmabench.bench.lab.questions import NONE_YET, QUESTIONS, Question
from pmabench.bench.lab.reading import Scale, sensors
from pmabench.files.document import Document, read_document

ASKED = "asked"
"""Key of the day on which the questions were asked."""


class Answers:
    """Answers to `QUESTIONS` by key, as typed; None for "not known yet". Gives parsed values, derived where missing."""

    def __init__(self, given: Mapping[str, str | None], asked: datetime.date) -> None:
        self.given = dict(given)
        self.asked = asked

    def said(self, key: str) -> bool:
        """Whether a person gave this answer."""
        return self.given.get(key) is not None

    def text(self, key: str) -> str:
        """The answer as typed, or the derived one; KeyError where there is neither."""
        found = self.given.get(key)
        found = QUESTIONS[key].default(self) if found is None else found
        if found is None:
            raise KeyError(key)
        return found

    def value(self, key: str) -> Any:
        """The parsed answer, given or derived; ValueError where it cannot be read."""
        return QUESTIONS[key].read(self.text(key), self)

    def questions(self) -> list[Question]:
        """Those that belong to the answers so far, in their order."""
        return [question for question in QUESTIONS.values() if question.asked(self)]

    def missing(self) -> list[str]:
        """Keys of answers that only a person can give, and nobody has."""
        open_ones = [question for question in self.questions() if not self.said(question.key)]
        return [question.key for question in open_ones if question.needed or not self._derivable(question)]

    def _derivable(self, question: Question) -> bool:
        """Whether an answer can be derived, once the others are there."""
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
    """Raise what cannot be read of the given answers: `InvalidFile` at its place, or `UsageError` without a file."""
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
    """A text as YAML between double quotes."""
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'


OVERSHOOT = 0.02
"""Of the regulator, as a share of the highest pressure."""
UNCERTAINTY = 0.005
"""Of a sensor without calibration, as a share of its range."""
SUPPLY_MARGIN = 50e3
"""What a regulator needs above its set-point [Pa]."""


@dataclass(frozen=True)
class Limits:
    """All in SI."""

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
    """Limits that are consistent with the answers: below the relief valve and `never_above`, the trip in between."""
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
    """Ranges of the sensors; of a simulated bench those that would be proposed."""
    if answers.text("daq") != NONE_YET:
        found: dict[str, Scale] = answers.value("sensors")
        return found
    simulated = Answers({**answers.given, "daq": "labjack", "sensors": None}, answers.asked)
    return sensors(simulated.text("sensors"))


def _down(pressure: float) -> float:
    """The next whole kPa below."""
    return math.floor(pressure / 1e3 + 1e-9) * 1e3
