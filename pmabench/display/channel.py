"""Measured channels against their limits: plain values, lines of text, and the screen of a bench without a run.

That screen has for each channel raw value, value, noise, rate, age and limits. Colours are the sixteen of every
terminal; text that must be noticed also has a background colour and a mark.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

from rich.text import Text

from pmabench.display.wording import clean, quantity, value_text

WARN, BAD, GOOD, STRONG, FAINT = "bold black on yellow", "bold white on red", "black on green", "bold", "dim"


@dataclass
class Channel:
    """A measured channel and its limits [SI]."""

    name: str
    quantity: str
    low: float
    high: float
    """Ends of its range."""
    trip_low: float | None = None
    trip_high: float | None = None
    command_low: float | None = None
    command_high: float | None = None
    value: float | None = None
    least: float | None = None
    most: float | None = None
    """Lowest and highest value seen."""
    age: float | None = None
    """Age of the newest value [s]."""
    stream: str = ""

    def show(self, value: float, least: float, most: float) -> None:
        """Update with the newest value, and with the minimum and maximum of its block."""
        self.value = value
        if isfinite(least) and isfinite(most):
            self.least = least if self.least is None else min(least, self.least)
            self.most = most if self.most is None else max(most, self.most)

    @property
    def alarm(self) -> int:
        """0: far from a trip limit; 1: within a tenth of it, or beyond what may be commanded; 2: at or beyond it."""
        value = self.value
        if value is None or not isfinite(value):
            return 0
        low, high = self.trip_low, self.trip_high
        if (high is not None and value >= high) or (low is not None and value <= low):
            return 2
        rest = max(0.0, low) if low is not None else 0.0
        near = high is not None and high > rest and value > high - 0.1 * (high - rest)
        near |= low is not None and low < 0 and value < 0.9 * low
        near |= low is not None and high is not None and low > 0 and value < low + 0.1 * (high - low)
        slip = 0.005 * abs(self.command_high or 0.0)
        return 1 if near or (self.command_high is not None and value > self.command_high + slip) else 0

    @property
    def span(self) -> float:
        """Largest expected absolute value [SI], which determines the number of decimals."""
        return max((abs(v) for v in self.axis() if isfinite(v)), default=1.0)

    def axis(self) -> tuple[float, float]:
        """Ends of the bar [SI]: slightly beyond the trip limits, else limits of the command or of the range."""
        low = self.trip_low if self.trip_low is not None else min(0.0, self.command_low or 0.0)
        high = self.trip_high if self.trip_high is not None else self.command_high
        if high is None or not high > low:
            high = self.high if isfinite(self.high) and self.high > low else low + 1.0
        edge = 0.04 * (high - low)
        return low - edge, high + edge


@dataclass(frozen=True)
class Setting:
    """Last command to an output [SI]."""

    output: str
    quantity: str
    how: str
    value: float
    data: Mapping[str, Any]


def fill(lines: Sequence[Text], width: int, height: int) -> list[Text]:
    """The lines cut to width and height, padded with empty lines."""
    kept = list(lines[:height]) + [Text() for _ in range(height - len(lines))]
    for line in kept:
        line.no_wrap = True
        line.truncate(width, overflow="ellipsis")
    return kept


def channel_text(channel: Channel, value: float | None, wide: int) -> Text:
    """Start of a channel's line: alarm mark, name in `wide` columns, value with its unit."""
    alarm, name = channel.alarm, clean(channel.name).replace("_command", " set")
    style = ("", WARN, BAD)[alarm]
    line = Text().append((" ", "!", "!!")[alarm].ljust(2), style).append(f"{name[:wide]:<{wide}}")
    line.append(f"{value_text(value, channel.quantity, channel.span):>9}", style or STRONG)
    return line.append(f" {quantity(channel.quantity).shown_in:<5}")


def limit_bar(channel: Channel, width: int) -> Text:
    """A bar from zero to the value; `╎` marks limits of the command, `┃` trip limits."""
    low, high = channel.axis()

    def place(value: float) -> int:
        return min(width - 1, max(0, round((value - low) / (high - low) * (width - 1))))

    cells, styles = ["─"] * width, [FAINT] * width
    value = channel.value
    if value is not None and isfinite(value):
        ends = sorted((place(0.0), place(value)))
        for k in range(ends[0], ends[1] + 1):
            cells[k], styles[k] = "━", ("green", "yellow", "red")[channel.alarm]
        cells[place(value)] = "●"
    marks = [(channel.command_low, "╎", ""), (channel.command_high, "╎", "")]
    marks += [(channel.trip_low, "┃", "red"), (channel.trip_high, "┃", "red")]
    for at, mark, style in marks:
        if at is not None and isfinite(at) and low < at < high and cells[place(at)] != "●":
            cells[place(at)], styles[place(at)] = mark, style
    line = Text()
    for cell, style in zip(cells, styles, strict=True):
        line.append(cell, style)
    return line


FIXED = 71
"""Columns of a line without its bar."""
OLD = 1.0
"""Age from which a value is marked [s]."""


@dataclass
class Row:
    """Present values of one channel."""

    channel: Channel
    raw: float | None = None
    raw_unit: str = ""
    noise: float | None = None
    """Rms deviation from a straight line over the last block [SI]."""
    rate: float = 0.0
    tare: float = 0.0
    """Value subtracted for display by the key z [SI]."""


@dataclass
class Page:
    """Contents of the screen other than the channels."""

    title: str
    simulated: bool = False
    rows: Mapping[str, Row] = field(default_factory=dict)
    settings: str = ""
    keys: str = ""
    notices: Sequence[str] = ()


def monitor_screen(page: Page, width: int, height: int) -> list[Text]:
    """The screen: `height` lines of at most `width` columns."""
    head = Text()
    if page.simulated:
        head.append(" SIMULATED ", WARN).append(" ")
    head.append(clean(page.title), STRONG)
    heads = f"  {'':<14}{'value':>9}{'':<7}{'raw':>14}{'noise rms':>11}{'rate':>7}{'age':>6} "
    lines = [head, Text(heads, FAINT)]
    lines += [_line(row, width) for row in page.rows.values()]
    if page.settings:
        lines += [Text(), Text(page.settings)]
    lines += [Text(), *(Text(clean(notice)) for notice in page.notices)]
    footer = [Text(page.keys, FAINT)] if page.keys else []
    return fill(lines, width, height - len(footer)) + fill(footer, width, len(footer))


def _line(row: Row, width: int) -> Text:
    channel = row.channel
    line = channel_text(channel, None if channel.value is None else channel.value - row.tare, 14)
    line.style = ("", WARN, BAD)[channel.alarm]
    line.append("z" if row.tare else " ")
    raw = "no sample" if row.raw is None else f"{row.raw:.6g} {clean(row.raw_unit)}"
    noise = _noise(row)
    line.append(f"{raw[:14]:>14}{noise:>11}{row.rate:>4.3g} Hz", FAINT)
    old = channel.age is None or channel.age > OLD
    age = "-" if channel.age is None else f"{channel.age:.1f} s" if channel.age < 99 else "old"
    line.append(f"{age:>6}", BAD if old else FAINT)
    if width - FIXED >= 8:
        line.append(" ").append_text(limit_bar(channel, width - FIXED))
    return line


def _noise(row: Row) -> str:
    """Noise in display units; 0 if it is rounding only."""
    if row.noise is None:
        return "-"
    return f"{row.noise / quantity(row.channel.quantity).scale:.2g}" if row.noise > 1e-9 * row.channel.span else "0"


def monitor_line(page: Page, t: float) -> str:
    """The same on one plain line: time, then each channel with its value and noise."""
    parts = []
    for row in page.rows.values():
        q = quantity(row.channel.quantity)
        value = value_text(row.channel.value, row.channel.quantity, row.channel.span)
        noise = "" if row.noise is None else f" (noise {_noise(row)})"
        mark = ("", " !", " !!")[row.channel.alarm]
        parts.append(f"{clean(row.channel.name)} {value} {q.shown_in}{noise}{mark}")
    return f"{t:8.1f} s  " + "  ".join(parts)
