"""A run as plain lines, one per event and trial, for pipes and logs; draws no picture."""

from __future__ import annotations

from pmabench.display.lines import number_text
from pmabench.display.state import Notice, RunState
from pmabench.display.verdicts import Number, TrialLine
from pmabench.display.wording import clean, clock, point_text, quantity


def first_line(state: RunState) -> str:
    """What run this is."""
    simulated = "SIMULATED " if state.simulated else ""
    return clean(f"{simulated}{state.kind}, {state.specimen}: {state.files.manifest.get('id', '')}")


def plain_line(item: Notice | TrialLine, trials: int) -> str:
    """A notice or a finished trial."""
    if isinstance(item, Notice):
        mark = {"info": "", "doubt": "! ", "fault": "!! "}[item.level]
        return f"{clock(item.t) + ' ' if item.t is not None else ''}{mark}{clean(item.text)}"
    numbers = ", ".join(_number(number) for number in item.numbers)
    verdict = "ok" if item.ok else "DOUBT: " + "; ".join(clean(doubt) for doubt in item.doubts)
    point = point_text(item.point)
    which = "reference trial again" if item.again else f"trial {item.number} of {trials}"
    return f"{which} ({point}): {numbers}{'; ' if numbers else ''}{verdict}"


def _number(number: Number) -> str:
    unit = quantity(number.quantity).shown_in
    text = f"{number.symbol} {number_text(number)}{f' {unit}' if number.value is not None else ''}"
    if number.reference is None or number.value is None:
        return text
    reference = Number(number.symbol, number.quantity, number.reference)
    return f"{text} ({number.reference_is} {number_text(reference)})"


def last_line(state: RunState) -> str:
    """How it ended, or that it has not."""
    doubtful = sum(not line.ok for line in state.lines)
    why = f": {clean(state.why)}" if state.why else ""
    trials = f"{state.done} of {state.trials} trials" + (f", {doubtful} in doubt" if doubtful else "")
    vent = f"; vent {clean(state.vent)}" if state.vent else ""
    return f"{clean(state.status)}{why}; {trials}; {state.rows:,} rows{vent}"
