"""Writes a guess as a map with reasons as comments; open questions are marked `??`, which `import` refuses."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from pmabench.base.text import printable
from pmabench.store.formats.text import TextLayout
from pmabench.store.importers.guess import asked
from pmabench.store.importers.guess.asked import Asked, quantity_of
from pmabench.store.importers.guess.columns import UNLIKE_TIME, Guess, Proposal
from pmabench.store.importers.map_file import NUMBERS, OPEN, QUANTITY

TRUTH = {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}
"""Texts that YAML may take for a truth value or null."""


Value: TypeAlias = str | Asked | Mapping[str, "Value"] | Sequence["Value"]
"""A value of the map, possibly with questions in it; a text is written as YAML without change."""
Entries: TypeAlias = dict[str, Value]


def comment(text: str) -> str:
    """A comment line."""
    return f"# {printable(text, 400)}"


def question(asked: Asked) -> str:
    """The comment with a question, above its value."""
    return comment(f"{OPEN} {asked.text}")


def entry(head: str, value: Value, indent: str = "  ") -> list[str]:
    """Lines of a map entry: comments with its questions, then `head` and value."""
    asking = [f"{indent}{question(each)}" for each in _asked(value) if each.text]
    return [*asking, f"{indent}{head}{_yaml(value)}"]


def block(head: str, entries: Entries, indent: str = "", why: Sequence[str] = ()) -> list[str]:
    """Lines of a map entry with its own entries below it, and reasons before these."""
    lines = [line for key, value in entries.items() for line in entry(f"{key}: ", value, f"{indent}  ")]
    return [f"{indent}{head}", *(f"{indent}  {comment(text)}" for text in why), *lines]


def _asked(value: Value) -> Iterator[Asked]:
    if isinstance(value, Asked):
        yield value
    elif not isinstance(value, str):
        for inner in value.values() if isinstance(value, Mapping) else value:
            yield from _asked(inner)


def _yaml(value: Value) -> str:
    if isinstance(value, Asked):
        return value.scalar
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {_yaml(inner)}' for key, inner in value.items())}}}"
    return value if isinstance(value, str) else f"[{', '.join(map(_yaml, value))}]"


def scalar(text: str) -> str:
    """A text as a YAML scalar, quoted where needed."""
    if re.fullmatch(r"[A-Za-z][A-Za-z0-9@ _./()-]*", text) and text.lower() not in TRUTH:
        return text.strip() if text == text.strip() else json.dumps(text)
    return json.dumps(text, ensure_ascii=not text.isprintable())


def _time(column: Proposal, guess: Guess) -> list[str]:
    """Lines of the map for a time column: its form, and questions about it."""
    clocks = list(asked.two_clocks(guess.columns))
    keys: Entries = {"is": clocks[-1] if clocks else "time"}
    unit = column.unit or "s"
    if not column.written:
        text = f'are the numbers of "{column.name}" serial days of a spreadsheet, or a time in {unit}?'
        keys["written"] = Asked("", f"{text} Write serial days, or number")
    elif column.written != "number":
        keys["written"] = column.written
    if column.written in {"number", "epoch", ""}:
        keys["unit"] = Asked(unit, "") if column.question else unit
    if column.written == "index":
        keys["period"] = _period(column)
    if column.order and column.written == "date and time":
        keys["order"] = _order(column)
    asking = [*([Asked("", column.question)] if column.question else []), *clocks[:-1]]
    return [*(f"  {question(each)}" for each in asking), *entry(f"{scalar(column.name)}: ", keys)]


def _period(column: Proposal) -> Value:
    """Sampling period for a column that counts samples, or a question about it."""
    period = f"{column.period:.9g} s"
    if column.factor:
        text = f'"{column.name}" has "{column.factor}" with its unit: how long is 1 of its numbers?'
        return Asked("", f"{text} As it is written {period}")
    if not column.period:
        return Asked("", f'"{column.name}" counts the samples: how far apart are they? For instance 2 ms')
    return period


def _order(column: Proposal) -> Value:
    if column.order != OPEN:
        return column.order
    text = f'does day or month come first in "{column.name}"? No date in it shows that: day first, or month first'
    return Asked("", text)


def _no_time(guess: Guess) -> Entries:
    """The sampling period if no column is a time, or a question about it."""
    if guess.role("time") is not None:
        return {}
    if guess.period:
        return {"period": f"{guess.period:.9g} s"}
    doubts = [(each.name, doubt) for each in guess.columns for doubt in each.doubts if doubt.startswith(UNLIKE_TIME)]
    sentence = "".join(f' ("{name}" {doubt})' for name, doubt in doubts)
    text = f"no column is a time{sentence}: were the samples taken at even distances, and at which? For instance 2 ms."
    return {"period": Asked("", f"{text} A table of points is no recording: report --overlay draws it")}


def _tests(guess: Guess) -> list[str]:
    """Lines for several tests in each file, with questions for their contractions."""
    text = 'at which contraction was "{}" held? For instance 8 mm'.format
    lines = ["tests:"] if guess.tests else []
    for test in guess.tests:
        asking: Entries = {"point": {"contraction": Asked("", text(test))}} if guess.open_point("contraction") else {}
        lines += entry("- ", {"name": scalar(test), **asking}, "")
    return lines


EDGE = {"pressure": ("bar", "10 bar"), "length": ("mm", "100 mm"), "force": ("N", "1000 N")}
"""Quantity -> unit of its scale, and an example of a sensor's range."""
LOOPS = (("mA", 4.0, 20.0, 22.0), ("mV", 4000.0, 20000.0, 21000.0), ("V", 0.0, 5.0, 5.1), ("V", 0.0, 10.0, 10.6))
"""Usual output ranges of sensors: unit, ends, and the largest reading that still fits the range."""
LEAST_STEP = "10 kPa"
"""Smallest step of a command whose scale is unknown."""
UNASKED = {
    "supply": "the supply enters no result",
    "flow": "a flow enters the volume of isometric-pressurisation alone, as a mass; docs/maps.md makes one of litres",
}
"""Role of a column that most tests do not need -> advice if the file does not give its scale."""


SHARE = r"%|percent|per cent|strain"
"""Words in the name of a length that is a relative length."""


@np.errstate(all="ignore")  # damaged files hold numbers of any size
def map_text(guess: Guess) -> str:
    """The map as YAML."""
    lines = [
        "# Proposed by pmabench import --guess, each choice with its reason. Look at all: a guess is no knowledge.",
        "# ?? is a question that no file answers: write the answer in its place. What follows it is taken with",
        "# `import --unresolved` until then, and no result is accepted.",
        *(comment(f"DOUBT: {text}") for text in guess.doubts),
        "schema: pmabench.map/1",
        f"name: {scalar('guessed from ' + guess.files[0].name)}",
        "source: unknown  # who recorded these files, when and where",
        *_kind(guess),
        "",
        *_file(guess),
        "",
        "columns:",
    ]
    for column in guess.columns:
        lines += _column(column, guess)
    if guess.role("time") is None:
        lines.append('  "@time": {is: time, unit: s}  # made from the period, for no column is a time')
    lines += [*_tests(guess), "", *_name_lines(guess)]
    gap = f"{guess.gap * 1e3:.3g} ms" if guess.gap < 1 else f"{guess.gap:.3g} s"
    low, high = (f"{rate:.4g}" for rate in guess.rate)
    lines.append(f"sampling: {{rate: [{low} Hz, {high} Hz], gap: {gap}}}{_why(guess, 'sampling')}")
    lines += _trials(guess)
    lines += _siblings(guess) + _analysis(guess)
    more = "  # make, nominal_length, inner_diameter; with the last one a force or pressure in a wrong unit is found"
    lines.append(f"specimen: {{type: unknown, serial: unknown}}{more}")
    return "\n".join(lines) + "\n"


def still_open(text: str) -> list[int]:
    """Numbers, from 1, of the lines of a map with open questions."""
    lines = enumerate(text.split("\n"), 1)
    return [number for number, line in lines if OPEN in line.split("  # ")[0] and not line.lstrip().startswith("#")]


def _why(guess: Guess, key: str) -> str:
    text = "; ".join(guess.reasons.get(key, []))
    return f"  {comment(text)}" if text else ""


def _kind(guess: Guess) -> list[str]:
    """The kind of test, or a question about it where no name says which column is the pressure."""
    if guess.lacks != "pressure" or not any(column.bare and column.question for column in guess.columns):
        return [f"kind: {guess.kind}{_why(guess, 'trials')}"]
    text = f"which kind of test is it ({', '.join(guess.kinds)}), and how is it cut, in trials: below?"
    return entry("kind: ", Asked("", f"columns without names: {text}"), "")


def _file(guess: Guess) -> list[str]:
    layout = guess.layout
    entries: Entries = {"format": layout.format}
    if isinstance(layout, TextLayout):
        entries = {"delimiter": layout.delimiter, "header": layout.header}
        if layout.names:
            entries["names"] = [scalar(name) for name in layout.names]
        keys = ("quoted", "decimal", "thousands", "encoding", "blank_lines", "skip_lines")
        for key in (*keys, "lines_below_header", "repeated_header"):
            value = getattr(layout, key)
            if key == "decimal" and guess.either:
                text = f'is "{guess.either}" a number with decimals, or are its digits grouped?'
                text += " For groups write decimal: point and thousands: comma; all numbers change by 1000"
                entries[key] = Asked(value, text)
            elif value != TextLayout.model_fields[key].default:
                entries[key] = str(value).lower()
        entries |= {key: json.dumps(value) for key in ("comment", "missing") if (value := getattr(layout, key))}
    return block("file:", entries | _no_time(guess), why=guess.reasons.get("file", []))


def _column(column: Proposal, guess: Guess) -> list[str]:
    head = [f"  {comment(text)}" for text in (*column.reasons, *(f"DOUBT: {text}" for text in column.doubts))]
    name, role = scalar(column.name), column.role
    asked_role: Value = Asked(role, column.question) if column.question else role
    known = QUANTITY.get(column.unit) == quantity_of(column) and not column.factor
    if role in UNASKED and not known:
        return [*head, f"  {comment(UNASKED[role])}", f"  {name}: ignore"]
    if role == "time":
        return [*head, *_time(column, guess)]
    if role in NUMBERS or role in ("point", "date"):
        value: Value = asked_role if role == "ignore" else {"is": asked_role, **_marks(column)}
        return [*head, *entry(f"{name}: ", value)]
    body, why = _measured(column, guess)
    return [*head, *(f"  {comment(text)}" for text in why), *block(f"{name}:", {"is": asked_role, **body}, "  ")]


def _marks(column: Proposal) -> Entries:
    """Entries of a column that is not measured: marks of phases, order of dates, or a coordinate and its unit."""
    if column.role == "date" and column.order:
        return {"order": _order(column)}
    if column.role == "point":
        unit = re.fullmatch(r".* \[([^\[\]]*)\]", column.name)
        return {**column.extra, **({"unit": unit[1]} if unit and unit[1] else {})}
    if column.role != "phase":
        return {}
    marks = np.unique(column.good)
    names = ("fill", "exhaust") if len(marks) == 2 else [f"phase {mark:g}" for mark in marks]
    called = {scalar(name): f"{mark:g}" for name, mark in zip(names, marks, strict=True)}
    return {"marks": called}


def _measured(column: Proposal, guess: Guess) -> tuple[Entries, list[str]]:
    """Entries of a measured or commanded column, and reasons."""
    body, why = _scale(column)
    if column.role == "displacement":
        contraction, reasons = _contraction(column, guess)
        if isinstance(body["unit"], Asked) and contraction:  # its zero has the same open unit
            zero = contraction["zero"]
            contraction["zero"] = Asked(zero, "") if isinstance(zero, str) else zero
        body |= {"contraction": contraction} if contraction else {}
        why = why + reasons
    zeros = int(np.count_nonzero(column.good == 0))
    if column.unit == "mA" and zeros:
        body["dropout"] = "0 mA"
        why.append(f"{zeros} samples read 0 mA, as a cut wire does")
    return body, why


def _line(slope: Value, offset: Value) -> Entries:
    return {"slope": slope, "offset": offset}


def _scale(column: Proposal) -> tuple[Entries, list[str]]:
    """Entries for unit, calibration and range of a column, and reasons."""
    quantity, unit = quantity_of(column), column.unit
    if quantity == "length" and unit in ("", "%") and re.search(SHARE, column.name, re.IGNORECASE):
        text = f'"{column.name}" is a share: of which length? The slope is what one unit of it is, as "2.5 mm/count"'
        return {"unit": "count", "line": _line(Asked("", text), "0 mm")}, []
    if (slope := asked.factor_of(column)) is not None:
        zero = f"0 {'N' if quantity == 'force' else unit}"
        zero = asked.air(unit) if quantity == "pressure" and asked.absolute(column) else zero
        return {"unit": unit, "line": _line(slope, zero)}, []
    if (unit_asked := asked.unit_of(column)) is not None:
        return {"unit": unit_asked}, []
    if QUANTITY.get(unit) == quantity:
        air: Value | None = asked.gauge_of(column) if quantity == "pressure" else None
        why = []
        if air is None and quantity == "pressure" and asked.absolute(column):
            air, why = asked.air(unit), ["absolute by its name: the normal pressure of air is taken off"]
        return {"unit": unit, **({"line": _line(f"1 {unit}/{unit}", air)} if air is not None else {})}, why
    if quantity == "force" and unit in asked.WEIGHT:
        line = _line(f"{asked.WEIGHT[unit]} N/{unit}", "0 N")
        return {"unit": unit, "line": line}, [f"a weight in {unit}, with 9.80665 m/s2"]
    return _from_reading(column, quantity)


def _from_reading(column: Proposal, quantity: str) -> tuple[Entries, list[str]]:
    """Entries for the calibration of a current, a voltage or counts, as far as usual sensor ranges give it."""
    unit, (edge, example) = column.unit or "count", EDGE[quantity]
    top = float(np.quantile(column.good, 0.999)) if len(column.good) else 0.0
    for known, begin, end, most in LOOPS:
        if unit == known and top <= most:
            why = f"{begin:g} to {end:g} {unit} is a usual range, {top:.4g} {unit} the highest here"
            text = f'which {quantity} is {end:g} {unit} of "{column.name}"? For instance {example}'
            points: Value = [[f"{begin:g} {unit}", f"0 {edge}"], [f"{end:g} {unit}", Asked("", text)]]
            return {"unit": unit, "points": points, **({"range": "[3.5 mA, 20.5 mA]"} if unit == "mA" else {})}, [why]
    ends = (float(column.good.min()), float(column.good.max())) if len(column.good) else (0.0, 0.0)
    text = f'"{column.name}" reads {ends[0]:.4g} to {ends[1]:.4g} {unit}: '
    which = Asked("", f"{text}which line makes a {quantity} of it? Slope in {edge}/{unit}, offset in {edge}")
    return {"unit": scalar(unit), "line": _line(which, Asked("", ""))}, []


def _contraction(column: Proposal, guess: Guess) -> tuple[Entries, list[str]]:
    """Entry `contraction` of a displacement (sign and zero), and reasons.

    A free muscle shortens with pressure; a driven one pulls less when shortened.
    """
    which = asked.unit_of(column)
    unit = (which.value if which else column.unit) or "count"
    pressure, force = guess.role("pressure"), guess.role("force")
    unsure = f'does "{column.name}" fall or rise while the muscle shortens? Strokes have the other sign otherwise'
    open_sign: Entries = {"reading": Asked("rises", unsure), "zero": f"0 {unit}"}
    if guess.test.held and column.apart and not asked.is_contraction(column):
        return {**open_sign, "zero": Asked(f"0 {unit}", "")}, []
    if guess.test.held:
        return {}, []
    known = [c.values for c in (column, pressure, force) if c is column or (c is not None and len(c.good))]
    good = np.logical_and.reduce([np.isfinite(values) & (values != 0) for values in known])
    x = column.values[good]
    P = pressure.values[good] if pressure is not None and len(pressure.good) else np.zeros(len(x))
    driven = force if guess.test.follows == "force" else None
    if pressure is None or len(x) < 20 or np.ptp(x) == 0 or (np.ptp(P) == 0 and driven is None):
        return open_sign, []
    if driven is not None:  # the length is driven
        table = np.column_stack([np.ones(len(P)), P - P.mean(), x - x.mean()])
        try:
            less = float(np.linalg.lstsq(table, driven.values[good], rcond=None)[0][2])
            less *= -1.0 if np.quantile(driven.good, 0.9) < 0 else 1.0  # the cell reads pulling as negative
        except np.linalg.LinAlgError:
            return open_sign, []
        rises, zero = less < 0, float(np.quantile(x, 0.01 if less < 0 else 0.99))
        why = f"at equal pressure the force falls where it {'rises' if rises else 'falls'}"
        if guess.test.commanded is not None:
            return _zero(column, unit, x, rises), [why]
        why += "; zero is its end there"
    else:
        together = float(np.corrcoef(P, x)[0, 1])
        if abs(together) < 0.5:
            return open_sign, []
        rises, zero = together > 0, float(np.median(x[np.quantile(P, 0.02) >= P]))
        why = f"it {'rises' if rises else 'falls'} with the pressure; zero is its reading at the lowest one here"
        if rises and QUANTITY.get(unit) == "length" and abs(zero) < 0.05 * np.ptp(x):
            return {}, []
    return {"reading": "rises" if rises else "falls", "zero": f"{zero:.5g} {unit}"}, [why]


def _zero(column: Proposal, unit: str, x: np.ndarray, rises: bool) -> Entries:
    """Entry `contraction` of a driven length, with a question for the zero unless the data show it.

    F_ce and x of every result refer to this zero. Contractions that begin at 0 begin at full length.
    """
    reading = "rises" if rises else "falls"
    if rises and abs(float(np.quantile(x, 0.01))) < 0.05 * np.ptp(x):
        return {"reading": reading, "zero": f"0 {unit}"}
    taken = f"0 {unit}" if rises and x.min() > 0 else f"{float(np.quantile(x, 0.01 if rises else 0.99)):.5g} {unit}"
    text = f'what does "{column.name}" read where the muscle has its full length? F_ce and x of all results begin there'
    return {"reading": reading, "zero": Asked(taken, text)}


def _name_lines(guess: Guess) -> list[str]:
    names = guess.names
    if not names.forms:
        return []
    forms = [json.dumps(form, ensure_ascii=not form.isprintable()) for form in names.forms]
    entries: Entries = {"of": names.of, "forms": forms}
    if names.comma:
        entries["decimal"] = "comma"
    if names.units:
        asking = {key: Asked(names.units[key], text) for key, text in names.asked.items() if key in names.units}
        entries["units"] = {**names.units, **asking}
    lacking = {key: [form for form in names.forms if f"{{{key}}}" not in form] for key in sorted(names.units)}
    if lacking := {key: without for key, without in lacking.items() if without}:
        without = next(iter(lacking.values()))[0]
        text = f'which {", ".join(lacking)} have the files whose name is "{without}"? Their name has none'
        texts = dict.fromkeys(lacking, "") | {next(iter(lacking)): text}
        entries["otherwise"] = {key: Asked(f"0 {names.units[key]}", texts[key]) for key in lacking}
    return [*block(f"name_tells:{_why(guess, 'name_tells')}", entries), ""]


def _trials(guess: Guess) -> list[str]:
    trials: Entries = dict(guess.trials)
    channel = guess.role(guess.smallest_of)
    if "smallest" in trials and channel is not None:
        known = QUANTITY.get(channel.unit) == "pressure" and not channel.factor
        trials["smallest"] = f"{float(guess.trials['smallest']):.3g} {channel.unit}" if known else LEAST_STEP
    point: Entries = {}
    if at := "" if guess.tests else asked.contraction_of(guess):
        point["contraction"] = at
    if guess.trials["by"] == "file" and guess.open_point("frequency"):
        text = "which frequency has the sine? It is read off its spectrum only"
        point["frequency"] = Asked(f"{guess.frequency:.3g} Hz", text)
    if guess.constant and not any("{pressure}" in form for form in guess.names.forms):
        text = "at which pressure was each file recorded? No column and no name says it. For instance 3 bar"
        point["pressure"] = Asked("", text)
    return entry("trials: ", {**trials, **({"point": point} if point else {})}, "")


def _siblings(guess: Guess) -> list[str]:
    """Entry `siblings` for repeats of an isometric test: different peaks show a different scale.

    A comment where columns without names leave open whether it is one.
    """
    if not any("{test}" in form for form in guess.names.forms) or len(guess.files) < 2:
        return []
    line = "siblings: {force: 30 %, pressure: 10 %}  # of files at one contraction: beyond it the scale is another one"
    if guess.test.held and guess.role("force") is not None:
        return [line]
    text = comment("if the muscle was held, with force and pressure among the columns without names:")
    return [text, f"# {line}"] if any(column.bare and column.question for column in guess.columns) else []


def _analysis(guess: Guess) -> list[str]:
    found = asked.threshold_of(guess)
    if found is None:
        return []
    above, others = found
    return entry("analysis: ", {"force_above": above, **({"also_at": others} if others else {})}, "")
