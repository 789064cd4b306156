"""From bytes to lines, and from a line to numbers; knows no port and no thread. Standard library only."""

from __future__ import annotations

import math

from pmabench.bench.interface import ChannelRecord
from pmabench_drivers.serial_ascii.options import Options
from pmabench_drivers.serial_ascii.pattern import LONGEST_LINE, inputs_of, number, readable


class Wrong(Exception):
    """A line that must never be taken for a measurement: another unit, a fault of the indicator."""


class Unreadable(Exception):
    """A line that is not what the pattern says: cut off, disturbed, something else."""


class Splitter:
    """Cuts a stream of bytes into lines; what comes before the first terminator is not a whole line and is dropped."""

    def __init__(self, terminator: bytes, *, whole: bool = False) -> None:
        self._terminator, self._whole = terminator, whole
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The whole lines that end in `data`; one that is too long is dropped up to its end."""
        *lines, self._rest = (self._rest + data).split(self._terminator)
        found = []
        for line in lines:
            if self._whole and len(line) <= LONGEST_LINE:
                found.append(line)
            self._whole = True
        if len(self._rest) > LONGEST_LINE + len(self._terminator):
            self._rest, self._whole = self._rest[-len(self._terminator) :], False
        return found


class LineReader:
    """Reads one line for the channels of a device."""

    def __init__(self, options: Options, channels: tuple[ChannelRecord, ...]) -> None:
        self._options, self._channels = options, channels
        raw = channels[0].raw_unit if channels else ""
        self._unit = options.unit or raw
        groups = options.pattern.groupindex
        self._checks_unit, self._has_sign, self._has_status = "unit" in groups, "sign" in groups, "status" in groups
        self._names = [channel.input for channel in channels] or inputs_of(options.pattern)

    def values(self, line: bytes) -> list[float]:
        """The raw value of each channel; over range reads as no number, or as a channel's highest count.

        Raises `Wrong` or `Unreadable`.
        """
        options = self._options
        if len(line) > LONGEST_LINE:
            raise Unreadable("a line longer than any that is expected")
        try:
            text = line.decode("ascii")
        except UnicodeDecodeError:
            raise Unreadable(f'"{readable(line)}"') from None
        bare = text.strip()
        if bare in options.errors:
            raise Wrong(f'says "{readable(line)}": {options.errors[bare]}')
        found = options.pattern.fullmatch(text)
        if found is None:
            if bare and any(mark in bare for mark in options.over_range):
                return self._over_range()
            raise Unreadable(f'"{readable(line)}"')
        if self._checks_unit:
            unit = (found["unit"] or "").strip()
            if unit != self._unit:
                raise Wrong(f'gives "{unit}" and the bench expects "{self._unit}": set the indicator back')
        if self._has_status and options.good_status:
            status = (found["status"] or "").strip()
            if status not in options.good_status:
                raise Wrong(f'says status "{status}"; good ones are {", ".join(options.good_status)}')
        try:
            sign = (found["sign"] or "") if self._has_sign else ""
            return [number(found[name] or "", sign) for name in self._names]
        except ValueError:
            if any(mark in bare for mark in options.over_range):
                return self._over_range()
            raise Unreadable(f'"{readable(line)}"') from None

    def _over_range(self) -> list[float]:
        return [
            float(round(channel.scale.to_raw(channel.high))) if channel.raw_type == "int32" else math.nan
            for channel in self._channels
        ] or [math.nan]
