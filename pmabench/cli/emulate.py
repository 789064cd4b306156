"""`pmabench emulate`: the simulated muscle behind the wires of a bench, for practice and tests; knows no driver.

What goes wrong meanwhile comes from a file or from typed lines, each thing at its time.
"""

from __future__ import annotations

import heapq
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import InvalidFile, Problem, RecordError, UsageError, did_you_mean, reading
from pmabench.cli.common import Ui, common
from pmabench.cli.names import BENCH, FILE
from pmabench.files.shipped import find_file

if TYPE_CHECKING:
    from pmabench.bench.interface import OutputRecord

PRESETS = (
    "paper0",
    "paper0-air",
    "serres2009",
    "dmsp-40-305",
    *(f"contractor-{cm}" for cm in (15, 20, 25, 30, 40)),
    "arm-30",
    "real",
)
NOT_PROVEN = "scales not proven: wiring and scales are taken from the bench file itself, so its errors cancel out"


@click.command(name="emulate")
@click.argument("bench", type=BENCH)
@click.option("--plant", default="paper0", help=f"The muscle: {', '.join(PRESETS)}, or the path of a plant file.")
@click.option(
    "--preset", type=click.Choice(["bench", "ideal"]), default="bench", help="bench: lag, friction, noise; or ideal."
)
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the noise.")
@click.option("--log", type=FILE, help="Append every exchange as JSON lines.")
@click.option("--faults", type=FILE, help="File of lines as typed, each with the time when it happens.")
@click.option("--truth", help="What is really wired, and by which scales: a shipped rig's name, or a truth file.")
@click.option("--expose", is_flag=True, help="Serve also at addresses that other machines can reach.")
@click.option("--control", type=click.IntRange(0, 65535), default=0, help="Port for loads and faults; 0: a free one.")
@common
def command(ui: Ui, bench: str, plant: str, faults: Path | None, truth: str | None, **how: Any) -> None:
    """Serve the devices of BENCH whose drivers have an emulator on this machine, in real time, until Ctrl-C.

    Devices answer at the addresses of the bench file: TCP at its address (port 0 takes a free one, which is printed),
    serial ports as links to pseudo-terminals. What is typed here happens: "load 6 kg" (all that hangs on the free
    end), "fault DEVICE delay 300 ms count 5", "fault DEVICE clear", "plant burst for 2 s"; "after 5 s" behind a line
    lets it happen then.

    A shipped bench is emulated from its truth file, which says from data sheets what is wired and by which scales. For
    another bench without --truth that is taken from the bench file itself: then its scales are not proven.
    """
    from pmabench.base.system import ENGINE, real_time, registered
    from pmabench.bench.compile import mount_alone
    from pmabench.bench.truth import read_truth, truth_of

    real_time(ENGINE)  # a device does not wait for other programs
    path = find_file("bench", bench)
    mounted = mount_alone(path)
    real = truth_of(path) if truth is None else find_file("truth", truth)
    found = registered("pmabench.emulators")
    if not found:
        raise UsageError("no emulator is installed")
    served: Any = next(iter(found)).load()(
        mounted.bench.devices,
        truth=None if real is None else read_truth(real),
        plant=_muscle(plant, mounted.bench.outputs),
        **how,
    )
    try:
        _serve(ui, served, real, Faults(served, mounted.bench.gravity, mounted.bench.carriage), faults)
    except KeyboardInterrupt:
        pass
    finally:
        served.close()
    if served.log.problem:
        raise RecordError(served.log.problem)


def _serve(ui: Ui, served: Any, truth: Path | None, faults: Faults, file: Path | None) -> None:
    """Say what is served and by which wiring, then let what `file` and the keyboard ask happen, until SIGTERM."""
    planned = [] if file is None else faults.of_file(file)

    def end(number: int, _frame: object) -> None:
        signal.signal(number, signal.SIG_IGN)  # the next one would cut the end of the first
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, end)
    ui.result(
        {
            "schema": "pmabench.emulate/1",
            "devices": {name: device.address for name, device in served.devices.items()},
            "control": served.control.address,
            "truth": None if truth is None else str(truth),
        },
        lambda: click.echo("\n".join([*served.lines(), f"control: {served.control.address}"])),
    )
    ui.note(f"wiring and scales from {truth}" if truth is not None else NOT_PROVEN)
    ui.note('serving until Ctrl-C; "help" and Enter: what can be typed here')
    schedule = Schedule(served.act, ui.note)
    schedule.add(planned)
    threading.Thread(target=_typed, args=(ui, faults, schedule), daemon=True).start()
    threading.Event().wait()


def _muscle(name: str, outputs: Iterable[OutputRecord]) -> str | dict[str, Any]:
    """A preset by name, or what a plant file says."""
    from pmabench.bench.plant import read_plant

    if not name.endswith(".yaml"):
        if name not in PRESETS:
            raise UsageError(f'--plant: no plant "{name}"{did_you_mean(name, PRESETS)}; a plant file ends in .yaml')
        return name
    plant = read_plant(Path(name))
    if wrong := list(plant.beyond(outputs)):
        raise UsageError("\n".join(f"--plant: {sentence}" for sentence in wrong))
    return {**plant.numbers, "file": name}


def _typed(ui: Ui, happenings: Faults, schedule: Schedule) -> None:
    """Carry out the lines that are typed."""
    for line in sys.stdin:
        if not line.strip():
            continue
        try:
            schedule.add(happenings.of_line(line))
        except ValueError as error:
            ui.note(str(error))


OPTION = re.compile(r"\s+(count|for|after)\s+(.*?)(?=\s+(?:count|for|after)\s|$)")
USE = '"load 6 kg", "fault DEVICE delay 300 ms count 5", "fault DEVICE clear" or "plant burst for 2 s"'


@dataclass(frozen=True)
class Happening:
    """A request to the emulator, and when it is due [s from now]."""

    after: float
    wanted: Mapping[str, Any]

    @property
    def text(self) -> str:
        """The event in words."""
        wanted = self.wanted
        if "load" in wanted:
            return f"the free end carries {wanted['load']['force']:g} N"
        if "plant" in wanted:
            return f"plant: {wanted['plant']}{' is over' if wanted.get('over') else ''}"
        value = "" if wanted.get("value") is None else f" {wanted['value']:g}"
        times = f", {wanted['count']} times" if wanted.get("count", -1) > 0 else ""
        return f"{wanted['device']}: {wanted['fault']}{value}{times}"


class Schedule:
    """Carries out requests at their times, in a thread."""

    def __init__(self, act: Callable[[Mapping[str, Any]], object], report: Callable[[str], None]) -> None:
        self._act, self._report = act, report
        self._due: list[tuple[float, int, Happening]] = []
        self._number, self._changed = count(), threading.Condition()
        threading.Thread(target=self._run, name="what happens", daemon=True).start()

    def add(self, happenings: list[Happening]) -> None:
        """Schedule them, their times counted from now."""
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
        """The requests of a file of such lines, `#` for comments; raises InvalidFile with every problem."""
        found: list[Happening] = []
        problems: list[Problem] = []
        with reading(path):
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
        for number, line in enumerate(lines, 1):
            text = line.partition("#")[0].strip()
            try:
                found += self.of_line(text) if text else []
            except ValueError as error:
                problems.append(Problem(str(path), number, 1, str(error)))
        if problems:
            raise InvalidFile(problems)
        return found

    def of_line(self, line: str) -> list[Happening]:
        """The requests of a line; raises ValueError for one that cannot be understood."""
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
        if (word != "fault" and number is not None) or (word == "load" and lasts is not None):
            raise ValueError(
                '"count" belongs to the fault of a device; a load stays until another one comes, without "for"'
            )
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
        """Requests for a fault of the plant and for its end."""
        known = self._served.plant_faults
        name, _, over = fault.partition(" ")
        if name not in known or over not in {"", "over"}:
            raise ValueError(f'no fault of the plant "{fault}"{did_you_mean(name, known)}')
        found = [Happening(after, {"plant": name, "over": bool(over)})]
        return found + ([] if lasts is None else [Happening(after + lasts, {"plant": name, "over": True})])

    def device(
        self, device: str, fault: str, value: str | None, number: Any, after: float, lasts: float | None
    ) -> list[Happening]:
        """Requests for a fault of a device and for its end."""
        wanted = {"device": device, "fault": fault, "value": _value(self._served.kind(device, fault), fault, value)}
        found = [Happening(after, {**wanted, "count": number or -1})]
        end = {"device": device, "fault": "clear"}
        return found if lasts is None else [*found, Happening(after + lasts, end)]


def _value(kind: Any, fault: str, value: str | None) -> float | None:
    """The size of a fault, in SI where it has a unit."""
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
    if not re.fullmatch(pattern, value):
        raise ValueError(f'"{fault}" takes a {"whole " if kind.takes == "number" else ""}number, not "{value}"')
    return float(value)
