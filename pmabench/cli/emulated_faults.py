"""What goes wrong while a bench is emulated: from a file or from typed lines, at its time; knows no device."""

from __future__ import annotations

import heapq
import re
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from time import monotonic
from typing import Any

from pmabench.base.errors import InvalidFile, Problem, did_you_mean

OPTION = re.compile(r"\s+(count|for|after)\s+(.*?)(?=\s+(?:count|for|after)\s|$)")
USE = '"load 6 kg", "fault DEVICE delay 300 ms count 5", "fault DEVICE clear" or "plant burst for 2 s"'


@dataclass(frozen=True)
class Happening:
    """What the emulator shall do, and when [s from now]."""

    after: float
    wanted: Mapping[str, Any]

    @property
    def text(self) -> str:
        """In words."""
        wanted = self.wanted
        if "load" in wanted:
            return f"the free end carries {wanted['load']['force']:g} N"
        if "plant" in wanted:
            return f"plant: {wanted['plant']}{' is over' if wanted.get('over') else ''}"
        value = "" if wanted.get("value") is None else f" {wanted['value']:g}"
        times = f", {wanted['count']} times" if wanted.get("count", -1) > 0 else ""
        return f"{wanted['device']}: {wanted['fault']}{value}{times}"


class Schedule:
    """Does what is due, each thing at its time, on its own thread."""

    def __init__(self, act: Callable[[Mapping[str, Any]], object], report: Callable[[str], None]) -> None:
        self._act, self._report = act, report
        self._due: list[tuple[float, int, Happening]] = []
        self._number, self._changed = count(), threading.Condition()
        threading.Thread(target=self._run, name="what happens", daemon=True).start()

    def add(self, happenings: list[Happening]) -> None:
        """Let them happen, counted from now."""
        with self._changed:
            now = monotonic()
            for item in happenings:
                heapq.heappush(self._due, (now + item.after, next(self._number), item))
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._due or self._due[0][0] > monotonic():
                    self._changed.wait(self._due[0][0] - monotonic() if self._due else None)
                item = heapq.heappop(self._due)[2]
            try:
                self._act(item.wanted)
            except ValueError as error:
                self._report(f"{item.text}: {error}")
            else:
                self._report(item.text)


class Faults:
    """Turns what people write into requests to the emulator `served`."""

    def __init__(self, served: Any, gravity: float, carriage: float) -> None:
        self._served, self._gravity, self._carriage = served, gravity, carriage

    def of_file(self, path: Path) -> list[Happening]:
        """Everything in a file; `InvalidFile` with every problem."""
        from pmabench.bench.files.plant import FaultsFile
        from pmabench.files.document import read_document, validate

        document = read_document(path)
        found: list[Happening] = []
        problems: list[Problem] = []
        for index, event in enumerate(validate(FaultsFile, document).faults):
            key = "plant"
            try:
                if event.load is not None:
                    found.append(Happening(event.after, self.load(*event.load)))
                elif event.plant is not None:
                    found += self.plant(event.plant, event.after, event.lasts)
                else:
                    device, fault = str(event.device), str(event.fault)
                    key = "fault" if device in self._served.devices else "device"
                    self._served.kind(device, fault)
                    key = "value" if event.value is not None else "fault"
                    found += self.device(device, fault, event.value, event.count, event.after, event.lasts)
            except ValueError as error:
                problems.append(document.problem(("faults", index, key), str(error)))
        if problems:
            raise InvalidFile(problems)
        return found

    def of_line(self, line: str) -> list[Happening]:
        """A typed line; ValueError for one that means nothing."""
        from pmabench.files.quantity import parse_mass_or_force, parse_quantity

        given = {key: value.strip() for key, value in OPTION.findall(line)}
        word, _, rest = OPTION.sub("", line).strip().partition(" ")
        after = parse_quantity(given["after"], "time") if "after" in given else 0.0
        lasts = parse_quantity(given["for"], "time") if "for" in given else None
        if after < 0 or (lasts is not None and lasts <= 0):
            raise ValueError("a time after now is expected")
        number = given.get("count")
        if number is not None and not (number.isdecimal() and 0 < int(number) <= 1_000_000):
            raise ValueError(f'"count" takes a whole number from 1, not "{number}"')
        if word == "load":
            return [Happening(after, self.load(*parse_mass_or_force(rest)))]
        if word == "plant":
            return self.plant(rest.strip(), after, lasts)
        if word == "fault":
            device, _, rest = rest.strip().partition(" ")
            fault, _, value = rest.strip().partition(" ")
            return self.device(device, fault, value.strip() or None, number and int(number), after, lasts)
        raise ValueError(f'"{word}" is not known here; type for instance {USE}')

    def load(self, kind: str, number: float) -> dict[str, Any]:
        """A mass [kg] or a force [N] on the free end, with the carriage."""
        if not number >= 0:
            raise ValueError(f"{number:g} is less than nothing")
        force, mass = (number * self._gravity, number) if kind == "mass" else (number, number / self._gravity)
        return {"load": {"force": force, "mass": mass + self._carriage}}

    def plant(self, fault: str, after: float, lasts: float | None) -> list[Happening]:
        """A fault of the plant, and its end."""
        known = self._served.plant_faults
        name, _, over = fault.partition(" ")
        if name not in known or over not in {"", "over"}:
            raise ValueError(f'no fault of the plant "{fault}"{did_you_mean(name, known)}')
        found = [Happening(after, {"plant": name, "over": bool(over)})]
        return found + ([] if lasts is None else [Happening(after + lasts, {"plant": name, "over": True})])

    def device(
        self, device: str, fault: str, value: Any, number: Any, after: float, lasts: float | None
    ) -> list[Happening]:
        """A fault of a device, and its end."""
        wanted = {"device": device, "fault": fault, "value": _value(self._served.kind(device, fault), fault, value)}
        found = [Happening(after, {**wanted, "count": number or -1})]
        end = Happening(after + (lasts or 0.0), {"device": device, "fault": "clear"})
        return found if lasts is None else [*found, end]


def _value(kind: Any, fault: str, value: Any) -> float | None:
    """How much, in SI where it has a unit."""
    from pmabench.files.quantity import parse_quantity

    if value is None:
        return None
    if not kind.takes:
        raise ValueError(f'"{fault}" takes no value')
    if kind.takes in {"time", "ratio"}:
        number = parse_quantity(value, kind.takes)
        if kind.takes == "time" and number < 0:
            raise ValueError(f'"{value}": a time is not below zero')
        return number
    pattern = r"\d{1,9}" if kind.takes == "number" else r"\d{1,9}(\.\d+)?"
    if isinstance(value, bool) or not re.fullmatch(pattern, str(value)):
        raise ValueError(f'"{fault}" takes a {"whole " if kind.takes == "number" else ""}number, not "{value}"')
    return float(value)
