"""From a line of text to numbers; knows no port and no thread. Standard library only."""

from __future__ import annotations

import math

from pmabench.bench.interface import ChannelRecord
from pmabench_drivers.serial_ascii.options import Options
from pmabench_drivers.serial_ascii.pattern import inputs_of, number
from pmabench_drivers.shared.lines import Unreadable, Wrong, readable, text_of


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
        options, text = self._options, text_of(line)
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
