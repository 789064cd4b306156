"""The screen of a run as lines of exactly the given width and number; uses the state, no terminal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from pmabench.base.quantities import without_number
from pmabench.display.channel import BAD, FAINT, GOOD, STRONG, WARN, Channel, Setting, channel_text, fill, limit_bar
from pmabench.display.lines import trial_table
from pmabench.display.state import RunState
from pmabench.display.wording import clean, clock, point_text, quantity, value_text, wrapped
from pmabench.store.records import Array

LEVELS = {"info": "", "doubt": WARN, "fault": BAD}
SIGNS = {"info": " ", "doubt": "!", "fault": "!!"}
CURVES = (("pressure", "P", "cyan"), ("displacement", "x", "green"), ("force", "F", "magenta"))
"""Channels that are drawn, with their symbols and colours."""
OF_SEVERAL = (
    *((f"pressure_{number}", f"P{number}", "cyan") for number in (1, 2, 3)), ("angle", "θ", "green"),
    ("torque", "τ", "magenta"), ("acceleration_x", "a_x", "green"), ("acceleration_y", "a_y", "magenta"),
)  # fmt: skip
"""The same if none of the above exist."""
LEAST_RANGE = {"pressure": 2e3, "length": 0.2e-3, "force": 2.0, "angle": 2e-3, "torque": 0.1, "acceleration": 0.2}
"""Smallest range [SI] of a curve's axis."""
NARROWEST = 60
"""Width from which curves are drawn."""
FIXED = 58
"""Columns of a channel's line without its bar."""
CLOSING = 12
"""Lines of trials that remain on the terminal at the end."""
TALLEST = 16
"""Largest height of the curves in lines."""
WANTED = (("pause", "will pause"), ("repeat", "will repeat this trial"))
"""Keys of the operator that take effect at the end of the trial, in words."""
FRESH = 3.0
"""Age up to which a pressure is shown with a question to the operator [s]."""
SILENT = 2.0
"""Time without a recorded sample after which a message is shown [s]."""
OLD = 1.0
"""Age from which the newest sample is marked during recording [s]."""


@dataclass(frozen=True)
class Question:
    """A question of the run to the operator."""

    text: str
    words: tuple[str, ...] = ()
    """Accepted answers; empty: it is answered elsewhere."""
    typed: str = ""
    refused: str = ""


@dataclass(frozen=True)
class Extra:
    """Parts that the console adds to the screen."""

    question: Question | None = None
    footer: str = ""
    typing: str | None = None
    """A note that is being typed."""


def screen(state: RunState, width: int, height: int, extra: Extra | None = None) -> list[Text]:
    """The screen: `height` lines of at most `width` columns."""
    if not state.files.there:
        return fill([Text(clean(state.files.problem or f"waiting for {state.files.folder}"))], width, height)
    width, height = max(20, width), max(3, height)
    extra = extra or Extra()
    footer = _footer(extra)
    room = height - (1 if footer else 0)
    asked = _question(state, extra, width)
    lines = [*_head(state, width), *asked, *_channels(state, width), _settings(state), _counts(state)]
    left = room - len(lines)
    if left >= 3:
        lines += _lower(state, width, left, curves=not asked or left > 16)
    lines = fill(lines, width, room)
    return [*lines, *fill([footer], width, 1)] if footer else lines


def _row(left: Text, right: Text, width: int) -> Text:
    """One line with left-aligned and right-aligned parts; the left part is cut if there is too little room."""
    room = max(0, width - right.cell_len - 1)
    left.truncate(room, overflow="ellipsis")
    return Text.assemble(left, " " * max(1, width - left.cell_len - right.cell_len), right)


def _head(state: RunState, width: int) -> list[Text]:
    status = state.status
    style = {"running": STRONG, "finished": GOOD, "waiting": ""}.get(status, BAD)
    vent = f", vent {state.vent}" if state.vent else ""
    first = Text()
    if state.simulated:
        first.append(" SIMULATED ", WARN).append(" ")
    first.append(clean(state.kind) or "run", STRONG).append(f"  {clean(state.specimen)}")
    badge = Text(f" {clean(status)}{vent} ", style if style != STRONG else "bold reverse")
    lines = [_row(first, badge, width), Text(clean(state.files.manifest.get("id", "")), FAINT)]
    if state.why and status not in ("running", "waiting"):
        lines.append(Text(clean(state.why), BAD if status != "finished" else ""))
    trial = state.trial
    if trial is not None:
        which = "reference trial again" if trial.again else f"trial {trial.index + 1} of {state.trials}"
        where = Text().append(which, STRONG)
        where.append(f"  {point_text(trial.point)}" + (f", repeat {trial.repeat + 1}" if trial.repeat else ""))
    elif not state.trials and status == "running":
        where = Text("no trials; any prompt comes at the terminal of the run", STRONG)
    else:
        where = Text().append(_done(state), STRONG)
        where.append("  not in a trial: nothing is recorded" if status == "running" else "")
    lines += [_row(where, _doing(state), width), _time(state, width)]
    return lines


def _doing(state: RunState) -> Text:
    """Phase of the trial, or that the run is paused, held or about to pause."""
    if state.status != "running":
        return Text()
    if state.paused:
        return Text(" PAUSED: p goes on ", WARN)
    if state.held:
        return Text(f" HELD by {clean(', '.join(sorted(state.held)))} ", WARN)
    wanted = [words for key, words in WANTED if key in state.wanted]
    return Text.assemble((f" {', '.join(wanted)} ", WARN) if wanted else "", " ", (clean(state.phase), STRONG))


def _done(state: RunState) -> str:
    doubtful = sum(not line.ok for line in state.lines)
    earlier = f" ({len(state.before)} before this run)" if state.before else ""
    progress = f"{state.done} of {state.trials} trials done{earlier}"
    return f"{progress}, {doubtful} in doubt" if doubtful else progress


def _time(state: RunState, width: int) -> Text:
    """Elapsed time, remaining time, and a progress bar."""
    t = state.t
    line = Text(f"{clock(t)} elapsed")
    if state.progress is None or not state.progress.length or state.status != "running":
        return line
    done, left = state.progress.done(t), state.progress.left(t)
    if left is not None:
        line.append(f", by the plan {clock(left)} left{', paused' if state.paused else ''}")
    room = max(5, min(40, width - line.cell_len - 8))
    full = round(room * done)
    line.append("  ").append("━" * full, "bold").append("─" * (room - full), FAINT).append(f" {100 * done:3.0f} %")
    return line


def _channels(state: RunState, width: int) -> list[Text]:
    """One line per channel: value, range seen, bar between the limits, age."""
    bar = width - FIXED
    head = f"  {'':<16}{'now':>9}      {'seen':>15}"
    lines = [_row(Text(head, FAINT), Text("age" if bar > 0 else "", FAINT), width)]
    lines += [_channel(state, channel, bar, width) for channel in state.channels.values()]
    return lines


def _channel(state: RunState, channel: Channel, bar: int, width: int) -> Text:
    line = channel_text(channel, channel.value, 16)
    seen = "…".join(value_text(v, channel.quantity, channel.span) for v in (channel.least, channel.most))
    line.append(f"{seen if channel.least is not None else '':>15}", FAINT)
    if bar >= 8:
        line.append(" ").append_text(limit_bar(channel, bar))
    old = channel.age is not None and channel.age > OLD and state.trial is not None and state.status == "running"
    age = "" if channel.age is None or state.status != "running" else _age(channel.age)
    return _row(line, Text(("! " if old else "") + age, BAD if old else FAINT), width)


def _age(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 10 else clock(seconds) if seconds < 86400 else "old"


def _settings(state: RunState) -> Text:
    line = Text().append("commanded ", FAINT)
    if not state.settings:
        return line.append("nothing yet")
    return line.append("   ".join(_setting(setting) for setting in state.settings.values()))


def _setting(setting: Setting) -> str:
    q, data = quantity(setting.quantity), setting.data
    setting_text = f"{clean(setting.output)} {q.show(setting.value, 4)}"
    if setting.how == "ramp" and isinstance(data.get("rate"), int | float):
        return f"{setting_text} at {data['rate'] / q.scale:.4g} {q.shown_in}/s"
    if setting.how == "sine" and isinstance(data.get("amplitude"), int | float):
        return f"{setting_text} ± {q.show(float(data['amplitude']), 4)}, {data.get('frequency', 0):.4g} Hz"
    return setting_text


def _counts(state: RunState) -> Text:
    rate = max((stream.rate for stream in state.files.streams.values()), default=0.0)
    line = Text().append("samples   ", FAINT).append(f"{state.rows:,}" + (f" at {rate:g} Hz" if rate else ""))
    silent = state.t - state.samples.newest
    if state.rows and state.status == "running" and silent > SILENT:
        text = f"none recorded for {silent:.0f} s: the curves end there" if state.trial else "nothing is recorded now"
        line.append(f"   {text}", STRONG if state.trial else FAINT)
    for name, count in state.counts.items():
        said, style = ("muscle slack", "") if name == "slack" else (name, WARN if count else "")
        line.append("   ").append(f"{said} {count:,}", style)
    for stream in state.files.streams.values():
        if stream.fault and state.status != "running":
            line.append("   ").append(f"{clean(stream.name)}: {clean(stream.fault)}", WARN)
    return line


def _lower(state: RunState, width: int, room: int, *, curves: bool) -> list[Text]:
    """Curves, trials and log share the remaining lines: the log gets the fewest, the curves the most."""
    drawn = curves and width >= NARROWEST and state.rows > 0
    notices = min(len(state.notices), 2 if room < 14 else max(3, room // 6))
    gap = 1 if notices else 0
    trials = 0
    if state.lines:
        trials = max(4, (room - notices - gap) * 2 // 5) if drawn else room
        trials = min(trials, len(state.lines) * 3 + 1)
    high = min(room - notices - gap - trials, TALLEST)
    lines: list[Text] = []
    if drawn and high >= 3:
        lines += _curves(state, width, high)
    if trials:
        most = room - notices - gap - len(lines)
        table = trial_table(state.lines, width, most)
        spare = room - len(lines) - len(table) - gap - 2 * len(state.notices)
        lines += trial_table(state.lines, width, most, spare) if spare > 0 else table
    if notices:
        most = room - len(lines) - gap
        last = [part for n in list(state.notices)[-most:] for part in _notice(n.t, n.text, n.level, width)]
        lines += [Text(), *last[-most:]]
    return lines


def _notice(t: float | None, text: str, level: str, width: int) -> list[Text]:
    """A sentence of the log, in as many lines as it needs."""
    begin = Text.assemble((f"{clock(t) if t is not None else '':>7} ", FAINT), (SIGNS[level].ljust(2), LEVELS[level]))
    parts = wrapped(clean(text), width - begin.cell_len - 1)
    return [Text.assemble(begin, " ", parts[0]), *(Text(" " * (begin.cell_len + 1) + part) for part in parts[1:])]


def _curves(state: RunState, width: int, height: int) -> list[Text]:
    """Pressure, displacement and force next to each other: title with range, curve, and time axis."""
    known = CURVES if any(name in state.channels for name, *_ in CURVES) else OF_SEVERAL
    shown = [(state.channels[name], symbol, colour) for name, symbol, colour in known if name in state.channels]
    if not shown:
        return []
    axis_line = height >= 7
    each = (width - 2 * (len(shown) - 1)) // len(shown)
    span = state.span()
    columns = []
    for channel, symbol, colour in shown:
        t, y = state.samples.trace(channel.name)
        low, high = _range(channel, y[(t >= span[0]) & (t <= span[1])])
        ends = _ends(channel, low, high)
        title = f"{clean(channel.name)} {ends}"
        title = title if len(title) <= each else f"{symbol} {ends}"
        body = curve(t, y, span, (low, high), (each, height - 1 - axis_line))
        part = [Text(title[:each].ljust(each), FAINT), *(Text(line, colour) for line in body)]
        if axis_line:
            begin, end = f"{clock(span[0])}" if span[0] > 0 else f"-{span[1] - span[0]:.0f} s", clock(span[1])
            part.append(Text(begin + "─" * max(0, each - len(begin) - len(end)) + end, FAINT))
        columns.append(part)
    return [Text("  ").join(parts) for parts in zip(*columns, strict=True)]


def _range(channel: Channel, y: Array) -> tuple[float, float]:
    good = y[np.isfinite(y)]
    least = LEAST_RANGE.get(channel.quantity, 0.0)
    if not len(good):
        return 0.0, least or 1.0
    low, high = float(good.min()), float(good.max())
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), 0.5 * least, 1e-12)
    return middle - half, middle + half


def _ends(channel: Channel, low: float, high: float) -> str:
    span = max(abs(low), abs(high))
    ends = [value_text(v, channel.quantity, span) for v in (low, high)]
    return f"{ends[0]}…{ends[1]} {quantity(channel.quantity).shown_in}"


def _question(state: RunState, extra: Extra, width: int) -> list[Text]:
    """The question to the operator, with the present pressure."""
    question = extra.question or (Question(state.prompt) if state.prompt and state.status == "running" else None)
    if question is None:
        return []
    lines = [Text(f" {part}".ljust(width), WARN) for part in wrapped(clean(question.text), width - 2)[:3]]
    pressures = [channel for name, channel in state.channels.items() if without_number(name)[0] == "pressure"]
    fresh = [one.value for one in pressures if one.value is not None and (one.age or 0.0) < FRESH]
    line = Text(" measured pressure ")
    if fresh and len(fresh) == len(pressures):
        line.append(f"{value_text(max(fresh), 'pressure', 1e5)} kPa", STRONG)
    else:
        line.append("not known at this moment", BAD)
    if question.words:
        words = " or ".join(f'"{word}"' for word in question.words)
        answer = Text(f" type {words} and Enter: ").append(f"{clean(question.typed)}▏", STRONG)
        if question.refused:
            answer.append(f'  "{clean(question.refused)}" does not count', BAD)
        return [*lines, line, answer]
    return [*lines, line.append("   answered at the terminal of the run", FAINT)]


def _footer(extra: Extra) -> Text | None:
    if extra.typing is not None:
        return Text.assemble(("note: ", STRONG), f"{clean(extra.typing)}▏", ("  Enter keeps it, Esc drops it", FAINT))
    return Text(extra.footer, FAINT) if extra.footer else None


def closing(state: RunState, width: int) -> list[Text]:
    """The last trials, which remain on the terminal when the screen is closed."""
    return fill(table := trial_table(state.lines, width, CLOSING, spare=1), width, len(table))


_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.int64)


def curve(
    t: Array, y: Array, span: tuple[float, float], range_: tuple[float, float], size: tuple[int, int]
) -> list[str]:
    """Lines of braille text, from the top, of y over t (both of shape (n,)) in the ranges `span` and `range_`.

    `size` is columns and rows of characters. Neighbouring dots are joined; values that are not finite are left out,
    and values outside the range are drawn at its edge.
    """
    columns, rows = max(1, size[0]), max(1, size[1])
    grid = np.zeros((rows * 4, columns * 2), dtype=bool)
    good = np.isfinite(y) & np.isfinite(t) & (t >= span[0]) & (t <= span[1])
    if good.any() and span[1] > span[0] and range_[1] > range_[0]:
        x = ((t[good] - span[0]) / (span[1] - span[0]) * (columns * 2 - 1) + 0.5).astype(np.int64)
        up = np.clip((y[good] - range_[0]) / (range_[1] - range_[0]), 0.0, 1.0)
        row = ((1.0 - up) * (rows * 4 - 1) + 0.5).astype(np.int64)
        _draw(grid, x, row)
    cells = grid.reshape(rows, 4, columns, 2).transpose(0, 2, 1, 3)
    codes = 0x2800 + (cells * _DOTS).sum(axis=(2, 3))
    return ["".join(chr(code) if code > 0x2800 else " " for code in line) for line in codes.tolist()]


def _draw(grid: NDArray[np.bool_], x: NDArray[np.int64], row: NDArray[np.int64]) -> None:
    """Draw lowest to highest dot of each column, joined to the column before."""
    order = np.argsort(x, kind="stable")
    x, row = x[order], row[order]
    starts = np.flatnonzero(np.diff(x, prepend=-1))
    tops, bottoms = np.minimum.reduceat(row, starts), np.maximum.reduceat(row, starts)
    last = np.concatenate((starts[1:], [len(x)])) - 1
    before: tuple[int, int] | None = None
    for column, top, bottom, end in zip(x[starts], tops, bottoms, row[last], strict=True):
        if before is not None and column - before[0] <= 2:
            top, bottom = min(top, before[1]), max(bottom, before[1])
        grid[top : bottom + 1, column] = True
        before = int(column), int(end)
