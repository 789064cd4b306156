"""How a proposed map says when samples were taken: columns of time and dates, periods, several tests in a file."""

from __future__ import annotations

from pmabench.store.importers.guess import asked
from pmabench.store.importers.guess.asked import Asked
from pmabench.store.importers.guess.columns import UNLIKE_TIME, Proposal
from pmabench.store.importers.guess.record import Guess
from pmabench.store.importers.guess.spell import question, scalar
from pmabench.store.importers.questions import OPEN


def time_lines(column: Proposal, guess: Guess) -> list[str]:
    """A column of time with how it is written, and what is asked about it."""
    keys: dict[str, str] = {"is": "time"}
    asking = list(asked.two_clocks(guess.columns))
    for clock in asking:
        keys["is"] = clock.scalar
    unit = column.unit or "s"
    if column.written != "number":
        keys["written"] = column.written
    if not column.written:
        text = f'are the numbers of "{column.name}" serial days of a spreadsheet, or a time in {unit}?'
        asking.append(Asked("", f"{text} Write serial days, or number"))
        keys["written"] = asking[-1].scalar
    if column.written in {"number", "epoch", ""}:
        keys["unit"] = Asked(unit, "").scalar if column.question else unit
    if column.written == "index":
        keys["period"] = f"{column.period:.9g} s"
        if not column.period:
            text = f'"{column.name}" counts the samples: how far apart are they? For instance 2 ms'
            asking.append(Asked("", text))
            keys["period"] = asking[-1].scalar
    if column.order and column.written == "date and time":
        keys["order"], more = _order(column)
        asking += more
    sentence = ", ".join(f"{key}: {value}" for key, value in keys.items())
    return [*(f"  {question(each)}" for each in asking), f"  {scalar(column.name)}: {{{sentence}}}"]


def date_lines(column: Proposal) -> list[str]:
    """A column of dates next to one of clock times."""
    order, asking = _order(column) if column.order else ("", [])
    text = f", order: {order}" if order else ""
    return [*(f"  {question(each)}" for each in asking), f"  {scalar(column.name)}: {{is: date{text}}}"]


def _order(column: Proposal) -> tuple[str, list[Asked]]:
    if column.order != OPEN:
        return column.order, []
    text = f'does day or month come first in "{column.name}"? No date in it shows that: day first, or month first'
    return Asked("", text).scalar, [Asked("", text)]


def period_lines(guess: Guess) -> list[str]:
    """The distance of the samples where no column is a time, or what is asked about it."""
    if guess.role("time") is not None:
        return []
    if guess.period:
        return [f"  period: {guess.period:.9g} s"]
    doubts = [(each.name, doubt) for each in guess.columns for doubt in each.doubts if doubt.startswith(UNLIKE_TIME)]
    sentence = "".join(f' ("{name}" {doubt})' for name, doubt in doubts)
    text = f"no column is a time{sentence}: were the samples taken at even distances, and at which? For instance 2 ms."
    which = Asked("", f"{text} A table of points is no recording: report --overlay draws it")
    return [f"  {question(which)}", f"  period: {which.scalar}"]


def test_lines(guess: Guess) -> list[str]:
    """Several tests in each file, and at which contraction each was held."""
    lines = ["tests:"] if guess.tests else []
    for test in guess.tests:
        point = ""
        if guess.open_point("contraction"):
            which = Asked("", f'at which contraction was "{test}" held? For instance 8 mm')
            lines.append(question(which))
            point = f", point: {{contraction: {which.scalar}}}"
        lines.append(f"- {{name: {scalar(test)}{point}}}")
    return lines
