"""Finished trials as a table that fits the width, and a run as plain lines for pipes and logs; judges nothing."""

from __future__ import annotations

from collections.abc import Sequence

from rich.text import Text

from pmabench.display.state import Notice, RunState
from pmabench.display.verdicts import Number, TrialLine
from pmabench.display.wording import clean, clock, of_point, point_text, quantity, wrapped

FAINT, WARN, GOOD = "dim", "bold black on yellow", "green"
VALUE, OFF, PLACE = 7, 6, 7
"""Widths of a value, of its deviation from the reference, and of a coordinate of the operating point."""
WIDE = 108
"""Width from which doubts are on the line of their trial instead of below it."""
_HIDDEN = ("mass", "cycles", "setpoint", "bias", "mean", "amplitude")


def point_columns(lines: Sequence[TrialLine]) -> list[str]:
    """Coordinates of the operating point to be shown: all but the less important ones."""
    names = list(dict.fromkeys(name for line in lines for name in line.point))
    return [name for name in names if name not in _HIDDEN] or names[:1]


def number_text(number: Number) -> str:
    """The value in the unit of the heading, four digits; with a star if it depends on the specimen file."""
    if number.value is None:
        return "-"
    shown = number.value / quantity(number.quantity).scale
    text = f"{shown:#.4g}" if 1e-3 < abs(shown) < 1000 else f"{shown:.4g}"
    return text.rstrip(".") + ("*" if number.assumed else "")


def half_text(number: Number) -> str:
    """Half width of the scatter interval, in percent of the value; empty if unknown."""
    if number.half is None or not number.value:
        return ""
    share = 100 * number.half / abs(number.value)
    return f"±{share:.1f}%" if share < 9.95 else f"±{share:.0f}%" if share < 999 else "far"


def off_text(number: Number) -> str:
    """Relative deviation from the reference; empty without one."""
    off = number.off
    if off is None or number.assumed:
        return ""
    return f"{100 * off:+.1f}%" if abs(off) < 0.0995 else f"{100 * off:+.0f}%" if abs(off) < 9.5 else "far"


def _heading(lines: Sequence[TrialLine], names: Sequence[str]) -> str:
    text = "   trial"
    for name in names:
        symbol, q = of_point(name)
        text += f"{f'{symbol} {q.shown_in}'.strip()[:PLACE]:>{PLACE}}"
    numbers = max((line.numbers for line in lines), key=len)
    for number in numbers:
        label = f"{number.symbol} {quantity(number.quantity).shown_in}"
        text += " " + label.rjust(VALUE).ljust(VALUE + OFF)
    return text


def _row(line: TrialLine, names: Sequence[str]) -> Text:
    """One trial: verdict, number, point, each quantity with its interval or deviation."""
    text = Text().append(line.mark, GOOD if line.ok else WARN).append(f" {line.number:>5}", "bold")
    for name in names:
        value, scale = line.point.get(name), of_point(name)[1].scale
        text.append(f"{'-' if value is None else format(value / scale, '.4g'):>{PLACE}}")
    for number in line.numbers:
        share = half_text(number) or off_text(number)
        text.append(f" {number_text(number):>{VALUE}}").append(f"{share:>{OFF}}", FAINT)
    return text


def trial_table(lines: Sequence[TrialLine], width: int, room: int, spare: int = 0) -> list[Text]:
    """A heading and the last trials, newest at the end, at most `room` lines; empty without room.

    With `spare` extra lines, the legend for percent and star is below if it does not fit next to the heading.
    """
    if not lines or room < 2:
        return []
    names = point_columns(lines)
    parts: list[list[Text]] = []
    used = 1
    for line in reversed(lines):
        row, doubts = _row(line, names), "; ".join(clean(doubt) for doubt in line.doubts)
        part = [row]
        if doubts and width >= WIDE:
            row.append(f"  {doubts}")
        elif doubts:
            part += [Text("         ").append(text) for text in wrapped(doubts, width - 9)[:2]]
        if used + len(part) > room:
            break
        parts.append(part)
        used += len(part)
    if not parts:
        return []
    heading, legend = Text(_heading(lines, names), FAINT), Text(_legend(lines[-len(parts) :]), FAINT)
    below = []
    if heading.cell_len + legend.cell_len <= width:
        heading.append_text(legend)
    elif legend and spare and legend.cell_len <= width:
        below = [legend]
    return [heading, *(row for part in reversed(parts) for row in part), *below]


def _legend(lines: Sequence[TrialLine]) -> str:
    """Legend for percent and star in these lines."""
    against = against_text(lines)
    text = f"  % against {against}" if against else ""
    text += "; ± 95 %, by scatter" if any(half_text(n) for line in lines for n in line.numbers) else ""
    starred = any(n.assumed for line in lines for n in line.numbers)
    return text + ("; * leans on the specimen file" if starred else "")


def against_text(lines: Sequence[TrialLine]) -> str:
    """Reference of the numbers in these lines, in words."""
    kinds = {n.reference_is for line in lines for n in line.numbers if n.reference_is}
    words = {"expected": "the specimen file", "repeats": "earlier repeats"}
    return " or ".join(words[kind] for kind in sorted(kinds))


def first_line(state: RunState) -> str:
    """Kind, specimen and id of the run."""
    simulated = "SIMULATED " if state.simulated else ""
    return clean(f"{simulated}{state.kind}, {state.specimen}: {state.files.manifest.get('id', '')}")


def plain_line(item: Notice | TrialLine, trials: int) -> str:
    """A notice or a finished trial as one line."""
    if isinstance(item, Notice):
        mark = {"info": "", "doubt": "! ", "fault": "!! "}[item.level]
        return f"{clock(item.t) + ' ' if item.t is not None else ''}{mark}{clean(item.text)}"
    numbers = ", ".join(_number(number) for number in item.numbers)
    known = "ok" if item.mark == "ok" else "nothing measured, as expected"
    verdict = known if item.ok else "DOUBT: " + "; ".join(clean(doubt) for doubt in item.doubts)
    point = point_text(item.point)
    which = "reference trial again" if item.again else f"trial {item.number} of {trials}"
    return f"{which} ({point}): {numbers}{'; ' if numbers else ''}{verdict}"


def _number(number: Number) -> str:
    unit = quantity(number.quantity).shown_in
    text = f"{number.symbol} {number_text(number)}{f' {unit}' if number.value is not None else ''}"
    text += f" {half_text(number)}" if number.half is not None else ""
    if number.reference is None or number.value is None:
        return text
    reference = Number(number.symbol, number.quantity, number.reference)
    return f"{text} ({number.reference_is} {number_text(reference)})"


def last_line(state: RunState) -> str:
    """How the run ended, or that it is still running."""
    doubtful = sum(not line.ok for line in state.lines)
    why = f": {clean(state.why)}" if state.why else ""
    trials = f"{state.done} of {state.trials} trials" + (f", {doubtful} in doubt" if doubtful else "")
    vent = f"; vent {clean(state.vent)}" if state.vent else ""
    return f"{clean(state.status)}{why}; {trials}; {state.rows:,} rows{vent}"
