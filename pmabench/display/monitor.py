"""A bench that is looked at: per channel raw value, value, noise, rate, age and limits; there is no run behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rich.text import Text

from pmabench.display.channel import Channel
from pmabench.display.view import BAD, FAINT, STRONG, WARN, channel_text, fill, limit_bar
from pmabench.display.wording import clean, quantity, value_text

FIXED = 71
"""Columns of a line without its bar."""
OLD = 1.0
"""Age from which on a value is marked [s]."""


@dataclass
class Row:
    """One channel as it is now."""

    channel: Channel
    raw: float | None = None
    raw_unit: str = ""
    noise: float | None = None
    """Rms about a straight line over the last block [SI]."""
    rate: float = 0.0
    tare: float = 0.0
    """What the key z took off what is shown [SI]."""


@dataclass
class Page:
    """What is shown around the channels."""

    title: str
    simulated: bool = False
    rows: Mapping[str, Row] = field(default_factory=dict)
    settings: str = ""
    keys: str = ""
    notices: Sequence[str] = ()


def monitor_screen(page: Page, width: int, height: int) -> list[Text]:
    """The picture: `height` lines, none wider than `width` columns."""
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
    """In display units; what is nothing but rounding is 0."""
    if row.noise is None:
        return "-"
    return f"{row.noise / quantity(row.channel.quantity).scale:.2g}" if row.noise > 1e-9 * row.channel.span else "0"


def monitor_line(page: Page, t: float) -> str:
    """The same as one plain line: time, then each channel with its value and noise."""
    parts = []
    for row in page.rows.values():
        q = quantity(row.channel.quantity)
        value = value_text(row.channel.value, row.channel.quantity, row.channel.span)
        noise = "" if row.noise is None else f" (noise {_noise(row)})"
        mark = ("", " !", " !!")[row.channel.alarm]
        parts.append(f"{clean(row.channel.name)} {value} {q.shown_in}{noise}{mark}")
    return f"{t:8.1f} s  " + "  ".join(parts)
