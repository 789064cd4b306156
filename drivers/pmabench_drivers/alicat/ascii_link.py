"""An Alicat controller over its ASCII protocol: one request, one answer, and no late answer taken for a new one.

Answers are not numbered. After an answer that did not arrive in time the next line may be that late answer: no line is
used until the device has answered a request for its firmware, which looks like no other answer. Answers come in the
order of requests, so lines after that one are new. Set-points do not wait for this; what the device holds is read
afterwards. Hold-closed (HC) is never sent: it traps the pressure.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Any

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, NotSent
from pmabench.bench.interface import COMPUTER, Identity
from pmabench_drivers.alicat import HELD, OTHER_SET_POINT, OUTPUT, UNITS, Options, Reading
from pmabench_drivers.alicat.layout import Layout, read_layout
from pmabench_drivers.shared import serial_port as sp
from pmabench_drivers.shared.link import Still, Unanswered, always, opened, reason, turn, who

PUSH = 0.1
"""Time limit for passing a command to the port [s]."""
PIECE = 0.005
"""Longest single wait for bytes [s]."""
QUIET = 0.15
"""A list of lines ends when nothing arrives for this time [s]."""
FIRST = 0.4
"""Longest wait for an answer while the port is opened [s]."""
LISTED_EVERY, LONGEST_LIST = 2.0, 0.1
"""Interval for listing the columns again, if that takes at most `LONGEST_LIST` [s], as nothing is sampled meanwhile."""
MOST_LINES = 100
SOURCES = {"A": "its analogue input", "U": "its knob", "S": "the serial line"}
FIRMWARE = re.compile(rb"\S\s+(?:GP|\d+v\d+).*")
_ABOUT = re.compile(r"\S\s+M(?P<number>\d\d) (?P<text>.*)")
_LABELS = {4: "Model Number", 5: "Serial Number", 9: "Software Revision"}


class AsciiLink:
    """The line to one controller, used by any thread."""

    exhausting = False
    """There is no documented ASCII command for the exhaust: it vents by its set-point."""

    def __init__(self, device: str, address: str, options: Options, clock: Clock) -> None:
        self._device, self._address, self._options, self._clock = device, address, options, clock
        self._lock = threading.Lock()
        self._port: Any = None
        self._layout: Layout | None = None
        self._splitter = sp.Splitter(b"\r", whole=True)
        self._lines: list[bytes] = []
        self._clean = True
        """Whether no older answer can still arrive."""
        self._late_until = 0.0
        """Until then the answer to the request that clears the line may arrive late [s, monotonic]."""
        self._asked_since = False
        """Whether anything was requested since."""
        self._reports_source = self._reports_unit = False
        self._rows, self._list_takes = 0, math.inf
        """Rows of its list of columns, and how long listing takes [s]."""
        self._unit, self._unit_at = "", -math.inf
        """Unit of its set-points, and when it was last read [s, monotonic]."""
        self._vented = True
        """Whether only the venting set-point has been sent so far."""

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self, deadline: float) -> Identity:
        """Open the port, read identity and line layout."""
        self._open_port()
        with self._turn(deadline):
            about = self._about(deadline)
            self._layout = self._read_layout(deadline)
            self._reports_unit = self._unit_word(deadline, FIRST) is not None
            self._vented, self._unit_at = True, -math.inf
            self._reading("", deadline, FIRST)
        return who("Alicat", about.get(4) or "controller", about.get(5, ""), about.get(9, ""), clock=COMPUTER)

    def close(self) -> None:
        """Close the port; may be called again."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def compare(self, deadline: float) -> None:
        """Refuse a unit or set-point source other than the bench's."""
        with self._turn(deadline):
            self._refuse_other_unit(self._shape)
            self._refuse_other_source(deadline)

    @property
    def fastest(self) -> float:
        """Polling rate that the line allows [Hz]."""
        layout = self._layout
        return 0.8 * self._options.baud / 10 / (10 + (layout.length if layout else sp.LONGEST_LINE))

    # -- commands -------------------------------------------------------------------------------------------------

    def poll(self, deadline: float) -> Reading | None:
        """One reading; None if the line had to be cleared of older answers first."""
        with self._turn(deadline):
            if not self._clean:
                self._clear(deadline)
                return None
            return self._reading("", deadline)

    def command(self, value: float, deadline: float, tolerance: float, still: Still = always) -> Reading | None:
        """Send a set-point once; success depends on the value then held. Nothing is sent if `still()` is false."""
        text = self._written(value)
        if self._vented and self._reports_unit and still():
            self._refuse_changed_unit(deadline)
        with self._turn(deadline):
            if not still():
                return None
            self._vented = False
            within, why = tolerance + 10.0**-self._shape.decimals, OTHER_SET_POINT
            kind: type[DeviceError] = NotSent
            try:
                reading = self._reading(text, deadline)
                if not abs(reading.set_point - value) <= within:  # an answer to something before would look like this
                    reading = self._reading("", deadline)
            except Unanswered as lost:
                reading, why, kind = self._found(lost, value, deadline), lost.message, DeviceError
        if not abs(reading.set_point - value) <= within:
            raise kind(self._device, f"was commanded {value:g} and holds {reading.set_point:g}: {why}", OUTPUT)
        return reading

    def vent(self, value: float, deadline: float, tolerance: float, still: Still = always) -> Reading | None:
        """Send the venting set-point, then end any hold of the valves; both, even if the first one fails.

        If the device then holds another set-point, its source is set to the serial line, and the command repeated: the
        source may have been changed to the analogue input or the knob at the panel.
        """
        text, lost = self._written(value), None
        with self._turn(deadline):
            if not still():
                return None
            self._vented = True
            reading: Reading | None = None
            for command in (text, "C"):
                try:
                    reading = self._reading(command, deadline)
                except DeviceError as error:
                    reading, lost = None, error
            if reading is None and lost is not None:
                reading = self._found(lost, value, deadline)
            within = tolerance + 10.0**-self._shape.decimals
            if reading is not None and self._reports_source and not abs(reading.set_point - value) <= within:
                self._ask("LSS S", deadline)
                reading = self._reading(text, deadline)
        if reading is None or not abs(reading.set_point - value) <= within:
            held = "nothing" if reading is None else f"{reading.set_point:g}"
            raise DeviceError(self._device, f"was commanded {value:g} to vent and holds {held}", OUTPUT)
        if HELD in reading.status:
            raise DeviceError(self._device, "its valves stay held (HLD): it does not vent", OUTPUT)
        return reading

    def held(self, deadline: float) -> float:
        """Set-point that the device holds."""
        with self._turn(deadline, clean=True):
            return self._reading("", deadline).set_point

    def reported(self, deadline: float) -> dict[str, float | str]:
        """Unit and source of its set-point, as far as the firmware reports them."""
        found: dict[str, float | str] = {}
        if unit := self._unit_now(deadline):
            found["unit of the set-point"] = unit
        if self._reports_source:
            with self._turn(deadline, clean=True):
                words = self._ask("LSS", deadline).decode("ascii", "replace").upper().split()
            if len(words) != 2 or words[1] not in SOURCES:
                raise DeviceError(self._device, f'answers "{" ".join(words)[:40]}" to where its set-point comes from')
            found["source of the set-point"] = SOURCES[words[1]]
        return found

    def _unit_now(self, deadline: float) -> str:
        """Unit of its set-points; it may be changed at the panel at any time, and 0 is 0 in all units.

        Older firmware can only list its columns, which takes long: every 2 s, or never on a slow line; then "".
        """
        if not self._reports_unit and (self._list_takes > LONGEST_LIST or monotonic() - self._unit_at < LISTED_EVERY):
            return self._unit
        with self._turn(deadline, clean=True):
            if self._reports_unit:
                unit = self._unit_word(deadline)
                if unit is None:
                    raise DeviceError(self._device, "does not say the unit of its set-point, which it did before")
            else:
                column = self._read_layout(deadline).columns[self._shape.set_point]
                unit = f"{column.unit_code} {column.unit}"
            self._unit, self._unit_at = unit, monotonic()
        return unit

    def _refuse_changed_unit(self, deadline: float) -> None:
        """Raise DeviceError if the unit has changed; before pressure is commanded after venting."""
        unit = self._unit_now(deadline)
        if int(unit.split()[0]) not in self._codes():
            raise DeviceError(self._device, f"takes set-points in {unit} now, not in {self._options.unit}", OUTPUT)

    def _unit_word(self, deadline: float, patience: float = 0.0) -> str | None:
        """Code and name of the set-point's unit, from firmware 10v05; None from older firmware."""
        statistic = self._shape.columns[self._shape.set_point].statistic
        words = self._ask(f"DCU {statistic}", deadline, patience).decode("ascii", "replace").split()
        known = len(words) == 3 and words[0].upper() == self._options.letter and words[1].isdecimal()
        return " ".join(words[1:]) if known else None

    def _codes(self) -> set[int]:
        """Codes of a device for the bench's unit."""
        pascal = UNITS[self._options.unit][1]
        return {known for known, size in UNITS.values() if size == pascal}

    def _found(self, lost: DeviceError, value: float, deadline: float) -> Reading:
        """What the device holds after a command whose answer is lost or uncertain."""
        try:
            if not self._clean:
                self._clear(deadline)
            return self._reading("", deadline)
        except DeviceError as error:
            message = f"{lost.message}; whether it took {value:g} is not known ({error.message})"
            raise Unanswered(self._device, message, OUTPUT) from None

    def _written(self, value: float) -> str:
        return f"S{value:.{self._shape.decimals}f}"

    # -- opening --------------------------------------------------------------------------------------------------

    def _open_port(self) -> None:
        self._port = sp.open_port(self._device, self._address, baudrate=self._options.baud, timeout=PIECE)
        self._splitter, self._lines = sp.Splitter(b"\r", whole=True), []
        self._clean, self._late_until, self._rows = True, 0.0, 0

    def _about(self, deadline: float) -> dict[int, str]:
        """Its identification texts, by number."""
        if not (lines := self._listed("??M*", deadline, last=b" M09 ")):
            options = self._options
            right = f"is it switched on, at {options.baud} baud, with the unit ID {options.letter}, and set to ASCII?"
            raise DeviceError(self._device, f"nobody answers at {self._address}: {right}")
        found = {}
        for line in lines:
            row = _ABOUT.fullmatch(line.decode("ascii", "replace").replace("\b", "").strip())
            if row is not None:
                number = int(row["number"])
                found[number] = row["text"].strip().removeprefix(_LABELS.get(number, "")).strip()
        if not found and lines[0].strip()[:1].upper() not in {b"?", self._options.letter.encode()}:
            raise DeviceError(self._device, f'sends "{sp.readable(lines[0])}": another unit ID, or it sends by itself')
        return found

    def _read_layout(self, deadline: float) -> Layout:
        """Have it list its columns."""
        rows = self._rows
        asked = monotonic()
        try:
            lines = self._listed("??D*", deadline, last=f" D{rows:02d} ".encode() if rows else b"")
            layout = read_layout(lines, self._options.letter)
        except (sp.Wrong, sp.Unreadable) as error:
            raise DeviceError(self._device, str(error)) from None
        self._rows, self._list_takes = len(lines) - 1, monotonic() - asked - (0.0 if rows else QUIET)
        return layout

    def _refuse_other_unit(self, layout: Layout) -> None:
        for column in (layout.columns[layout.pressure], layout.columns[layout.set_point]):
            code, _pascal = UNITS[self._options.unit]
            if column.unit_code not in self._codes():
                given = f'gives "{column.name}" in {column.unit or "no unit"} (unit {column.unit_code})'
                wanted = f"the bench expects {self._options.unit} (unit {code}): set the device or the bench file"
                raise DeviceError(self._device, f"{given} and {wanted}")

    def _refuse_other_source(self, deadline: float) -> None:
        """Refuse another set-point source; not reported before firmware 10v05, where answers confirm set-points."""
        words = self._ask("LSS", deadline, FIRST).decode("ascii", "replace").upper().split()
        self._reports_source = len(words) == 2 and words[1] in SOURCES
        if self._reports_source and words[1] != "S":
            source = SOURCES[words[1]]
            message = f"takes its set-point from {source} and would ignore this program: set the source to serial"
            raise DeviceError(self._device, message, OUTPUT)

    # -- one request ----------------------------------------------------------------------------------------------

    @property
    def _shape(self) -> Layout:
        return opened(self._layout, self._device)

    @contextmanager
    def _turn(self, deadline: float, *, clean: bool = False) -> Iterator[None]:
        """Exclusive use of the line, `clean` of older answers; its errors are raised as DeviceError."""
        with turn(self._lock, deadline, self._device):
            try:
                if clean and not self._clean:
                    self._clear(deadline)
                yield
            except (OSError, TypeError, ValueError) as error:
                raise DeviceError(self._device, f"lost {self._address}: {reason(error)}") from None

    def _reading(self, command: str, deadline: float, patience: float = 0.0) -> Reading:
        """Send a command that is answered by a data line; returns the reading."""
        asked = self._clock.now()
        line = self._ask(command, deadline, patience)
        try:
            pressure, set_point, status = self._shape.read(line)
        except sp.Wrong as error:
            raise DeviceError(self._device, str(error)) from None
        except sp.Unreadable as error:
            raise Unanswered(self._device, f"answers {error}, which is not its data line") from None
        return Reading(pressure, set_point, status, asked, self._clock.now())

    def _ask(self, command: str, deadline: float, patience: float = 0.0) -> bytes:
        """Send one request and return its one-line answer; `Unanswered` if that is not certain."""
        patience = patience or self._options.timeout
        stray, limit = self._drain(), min(deadline, monotonic() + patience)
        certain = self._clean and not stray
        if limit <= monotonic():
            raise DeviceError(self._device, "no time was left to ask")
        self._clean, self._asked_since = False, True
        self._send(command)
        while not self._lines and monotonic() < limit:
            self._receive()
        lines, self._lines = self._lines, []
        if not lines:
            raise Unanswered(self._device, f"no answer from {self._address} within {patience:g} s")
        if not certain or len(lines) > 1:
            raise Unanswered(self._device, f'more than one answer at a time, from "{sp.readable(lines[0])}" on')
        self._clean = True
        return lines[0]

    def _clear(self, deadline: float) -> None:
        """Ask for the firmware and drop everything before its answer."""
        now = monotonic()
        limit, pending = min(deadline, now + self._options.timeout), now < self._late_until
        if limit <= now or (pending and self._asked_since):
            raise Unanswered(self._device, "is not asked again yet, so that a late answer is not taken for a new one")
        if not pending:
            self._drain()
            self._splitter = sp.Splitter(b"\r", whole=True)
            self._late_until, self._asked_since = now + self._options.slowest, False
            self._send("VE")
        while monotonic() < limit:
            self._receive()
            lines, self._lines = self._lines, []
            if any(FIRMWARE.fullmatch(line.strip()) for line in lines):
                self._clean, self._late_until = True, 0.0
                return
        raise Unanswered(self._device, f"no answer from {self._address} within {self._options.timeout:g} s")

    def _listed(self, command: str, deadline: float, last: bytes = b"") -> list[bytes]:
        """All lines that answer one request: up to the line with `last`, or to a pause."""
        self._drain()
        self._send(command)
        found: list[bytes] = []
        heard = monotonic() + FIRST - QUIET
        while monotonic() < min(deadline, heard + QUIET) and len(found) < MOST_LINES:
            if self._receive():
                heard = monotonic()
            found, self._lines = [*found, *(line for line in self._lines if line.strip())], []
            if last and found and last in found[-1]:
                break
        return found

    def _send(self, command: str) -> None:
        sp.hand_over(self._opened(), f"{self._options.letter}{command}\r".encode("ascii"), PUSH)

    def _receive(self) -> bool:
        """Receive bytes for a short time; returns whether any came."""
        data = sp.received(self._opened())
        self._lines += self._splitter.feed(data.replace(b"\n", b""))
        return bool(data)

    def _drain(self) -> bool:
        """Drop late and unexpected bytes; returns whether there was a complete line."""
        port = self._opened()
        if waiting := port.in_waiting:
            self._lines += self._splitter.feed(port.read(waiting).replace(b"\n", b""))
        lines, self._lines = self._lines, []
        return bool(lines)

    def _opened(self) -> Any:
        return opened(self._port, self._device)
