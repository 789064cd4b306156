"""Looks at one file that was never seen: its format, its layout, and what each of its columns seems to be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pmabench.base.errors import invalid
from pmabench.base.imported import Imported
from pmabench.store.formats import text
from pmabench.store.formats.mat import alike, is_clock, matrix_of
from pmabench.store.formats.record import format_of
from pmabench.store.formats.text import TextLayout
from pmabench.store.importers.guess.columns import Guess, Proposal, choose, unit_in
from pmabench.store.importers.guess.layout import TextGuess, guess_layout
from pmabench.store.importers.map_file import PLACE, spelled
from pmabench.store.importers.table import Table, content_of, read_table
from pmabench.store.records import Array

LOOKED_AT = 20_000_000
"""Bytes of a text file that are looked at."""
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86_400.0}
"""In one unit of a time."""


def look(path: Path, kinds: Mapping[str, Imported]) -> Guess:
    """One file by itself: its format, and what each of its columns seems to be."""
    content = content_of(path, LOOKED_AT)
    form = format_of(content)
    if form is text.FORMAT:
        if len(content) == LOOKED_AT:
            content = content[: content.rfind(b"\n") + 1] or content
        return _look_at_text(path, guess_layout(str(path), content), kinds)
    layout = form.layout.model_validate({"format": form.name})
    table = read_table(path, layout, None)
    owner = form.together(table.columns)
    tests, zeros = alike(table.columns, owner)
    groups: dict[tuple[str, int], list[str]] = {}
    for name, values in table.columns.items():
        groups.setdefault((owner[name], len(values)), []).append(name)
    if not groups:
        raise invalid(path, "holds no columns of numbers")
    good = [key for key in groups if key[0] not in zeros and (len(tests) < 2 or key[0] in tests)]
    group = max(good or groups, key=lambda key: (len(groups[key]) * key[1], key))
    others = [name for key, names in groups.items() if key != group for name in names]
    reasons = [f"{form.title}, by its first bytes; {len(groups[group])} columns of {group[1]} samples each"]
    if zeros:
        reasons.append(f"nothing moves in {', '.join(zeros)[:200]}: records of the zeros, left out")
    if len(tests) > 1:
        reasons.append(f"{len(tests)} matrices with a clock each: each is a test; {group[0]} is shown")
        others = [name for name in others if matrix_of(name) not in tests]
    if others:
        reasons.append(f"columns of other lengths, groups or clocks are left out: {', '.join(others)[:200]}")
    columns = [_proposal(name, table, groups[group]) for name in groups[group]]
    if any(column.bare for column in columns):
        reasons.append("columns of a matrix have no names: they are distinguished by what they hold")
    choose(columns)
    guess = Guess([path], layout, columns, [], [*others, *table.left_out], kinds, reasons={"file": reasons})
    if len(tests) > 1:
        _several(guess, tests, group[0], table.columns)
    if guess.role("time") is None:
        guess.doubts.append('nothing in the file gives the time: say "period" if the samples are evenly apart')
    return guess


def _proposal(name: str, table: Table, names: Sequence[str]) -> Proposal:
    """A column of a file with units; those of a matrix of several columns have no names of their own."""
    matrix, said = matrix_of(name), spelled(table.units.get(name, ""))
    column = Proposal(name, table.columns[name], unit=said or unit_in(name))
    column.bare = bool(matrix) and sum(other.startswith(f"{matrix}(:,") for other in names) > 1
    column.reasons += [f"the file says its unit, {column.unit}"] if said else []
    return column


def _several(guess: Guess, tests: list[str], shown: str, columns: Mapping[str, Array]) -> None:
    """Matrices that are a test each, of which one is shown."""
    guess.tests = tests
    for column in guess.columns:
        column.name = column.name.replace(shown, PLACE, 1)
    own = _usual_step(columns, shown)
    steps = [_usual_step(columns, test) / own for test in tests] if own else []
    guess.slower = (min(steps, default=1.0), max(steps, default=1.0))


def _usual_step(columns: Mapping[str, Array], matrix: str) -> float:
    """The median step of the clock of a matrix."""
    clock = next((v for name, v in columns.items() if matrix_of(name) == matrix and is_clock(v)), None)
    return 0.0 if clock is None else float(np.median(np.diff(clock)))


def _look_at_text(path: Path, guessed: TextGuess, kinds: Mapping[str, Imported]) -> Guess:
    numbers = [name for name in guessed.names if name not in guessed.texts]
    stamps = guessed.stamps
    if guessed.tests and _goes_on(path, guessed, numbers):
        guessed.tests, guessed.layout = 0, guessed.layout.model_copy(update={"repeated_header": "page"})
        guessed.reasons.append("the line of names is repeated, and the time goes on below it: pages of one test")
    elif guessed.tests:
        guessed.reasons.append("the line of names is repeated: another test begins there, which makes a run too")
    asked = [name for name in guessed.names if name in numbers]
    table = read_table(path, guessed.layout, asked, (), guessed.texts, stamps, LOOKED_AT)
    if table.starts:
        table = table.tests()[0]
    columns = [
        Proposal(name, table.columns[name], unit=guessed.units.get(name) or unit_in(name), bare=not guessed.named)
        for name in numbers
        if stamps is None or name != stamps.date
    ]
    for column in columns:
        if stamps is not None and column.name == stamps.column:
            column.unit, column.written, column.bare = "s", stamps.written, False
            column.order = "??" if guessed.open_order else stamps.order if stamps.order != "year first" else ""
    choose(columns)
    words = [Proposal(name, np.empty(0), reasons=["holds words, not numbers"]) for name in guessed.texts]
    if stamps is not None and stamps.date:
        order = "??" if guessed.open_order else stamps.order if stamps.order != "year first" else ""
        words.append(Proposal(stamps.date, np.empty(0), role="date", order=order, reasons=["the day of the clock"]))
    falls = next((c.name for c in columns if c.unit in SECONDS and is_clock(-c.values) and c.written == "number"), "")
    if falls and all(column.role != "time" for column in columns):
        backward = f'"{falls}" falls from row to row: the newest row comes first; reverse the order of the rows'
        raise invalid(path, backward)
    every = {column.name: column for column in [*columns, *words]}
    reasons = {"file": guessed.reasons}
    guess = Guess([path], guessed.layout, [every[name] for name in guessed.names], [], [], kinds, reasons=reasons)
    time = guess.role("time")
    if time is not None and time.written == "index":
        time.period = guessed.interval
    guess.period, guess.either = guessed.interval, guessed.either
    guess.tests = [str(number) for number in range(1, guessed.tests + 1)]
    if not guessed.named:
        _call_by_role(guess)
    return guess


def _goes_on(path: Path, guessed: TextGuess, numbers: Sequence[str]) -> bool:
    """Whether a column that rises throughout rises over each repeated line of names by a usual step, too."""
    layout = guessed.layout.model_copy(update={"repeated_header": "page"})
    starts = read_table(path, guessed.layout, numbers, (), guessed.texts, guessed.stamps, LOOKED_AT).starts
    table = read_table(path, layout, numbers, (), guessed.texts, guessed.stamps, LOOKED_AT)
    over = np.array(starts, dtype=int) - 1
    return len(over) > 0 and any(
        is_clock(values) and float(np.diff(values)[over].max()) < 2.0 * float(np.median(np.diff(values)))
        for values in table.columns.values()
    )


def _call_by_role(guess: Guess) -> None:
    """Columns without names are called by what they are."""
    for column in guess.columns:
        if column.role != "ignore":
            column.name = column.role
    if isinstance(guess.layout, TextLayout):
        guess.layout = guess.layout.model_copy(update={"names": [column.name for column in guess.columns]})
