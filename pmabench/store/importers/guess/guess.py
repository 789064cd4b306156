"""Examines unknown files: their format, columns and sampling, and how they are divided into trials.

Names of files and folders may contain dates, numbers of tests and operating points.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np

from pmabench.base.errors import invalid
from pmabench.base.kind import Imported
from pmabench.store.formats.mat import is_clock, matrix_of
from pmabench.store.formats.record import format_of
from pmabench.store.formats.text import TextLayout
from pmabench.store.importers.guess.columns import SECONDS, Guess, Names, Proposal, choose, proposal
from pmabench.store.importers.guess.layout import TextGuess, guess_layout
from pmabench.store.importers.guess.signs import choose_kind, count, share
from pmabench.store.importers.map_file import OPEN, spelled
from pmabench.store.importers.map_rules import NUMBER, number_in
from pmabench.store.importers.table import content_of, read_all, read_table
from pmabench.store.records import Array

LOOKED_AT = 20_000_000
"""Number of bytes of a text file that are examined."""


def look(path: Path, kinds: Mapping[str, Imported]) -> Guess:
    """Guess for a single file: its format, and the probable role of each column."""
    content = content_of(path, LOOKED_AT)
    form = format_of(content)
    if form.layout is TextLayout:
        if len(content) == LOOKED_AT:
            content = content[: content.rfind(b"\n") + 1] or content
        return _look_at_text(path, guess_layout(str(path), content), kinds)
    layout = form.layout.model_validate({"format": form.name})
    found, units, left_out = read_all(path, layout)
    owner = form.together(found)
    groups: dict[tuple[str, int], list[str]] = {}
    for name, values in found.items():
        groups.setdefault((owner[name], len(values)), []).append(name)
    if not groups:
        raise invalid(path, "holds no columns of numbers")
    group = max(groups, key=lambda key: (len(groups[key]) * key[1], key))
    others = [name for key, names in groups.items() if key != group for name in names]
    reasons = [f"{form.title}, by its first bytes; {len(groups[group])} columns of {group[1]} samples each"]
    if others:
        reasons.append(f"columns of other lengths, groups or clocks are left out: {', '.join(others)[:200]}")
    if len({key[0] for key in groups if key[0] and key[0] == matrix_of(groups[key][0])}) > 1:
        how = 'the map then says "{test}" in place of its name, and tests: with the names'
        reasons.append(f"several matrices have a clock; if each is a test as {group[0]} is, {how}")
    columns = [_proposal(name, found[name], units[name], groups[group]) for name in groups[group]]
    if any(column.bare for column in columns):
        reasons.append("columns of a matrix have no names")
    choose(columns)
    guess = Guess([path], layout, columns, [*others, *left_out], kinds, reasons={"file": reasons})
    if guess.role("time") is None:
        guess.doubts.append('nothing in the file gives the time: say "period" if the samples are evenly apart')
    return guess


def _proposal(name: str, values: Array, said: str, names: Sequence[str]) -> Proposal:
    """A column of a file that gives units; columns of a matrix have no names."""
    matrix = matrix_of(name)
    bare = bool(matrix) and sum(other.startswith(f"{matrix}(:,") for other in names) > 1
    column = proposal(name, values, said, bare=bare)
    column.reasons += [f"the file says its unit, {column.unit}"] if spelled(said) else []
    return column


def _look_at_text(path: Path, guessed: TextGuess, kinds: Mapping[str, Imported]) -> Guess:
    numbers = [name for name in guessed.names if name not in guessed.texts]
    stamps = guessed.stamps
    if guessed.tests and _goes_on(path, guessed, numbers):
        guessed.tests, guessed.layout = 0, guessed.layout.model_copy(update={"repeated_header": "page"})
        guessed.reasons.append("the line of names is repeated, and the time goes on below it: pages of one test")
    elif guessed.tests:
        guessed.reasons.append("the line of names is repeated: another test begins there, which makes a run too")
    table = read_table(path, guessed.layout, numbers, (), guessed.texts, stamps, LOOKED_AT)
    if table.starts:
        table = table.tests()[0]
    columns = [
        proposal(name, table.columns[name], guessed.units.get(name, ""), bare=not guessed.named)
        for name in numbers
        if stamps is None or name != stamps.date
    ]
    words = [Proposal(name, np.empty(0), reasons=["holds words, not numbers"]) for name in guessed.texts]
    if stamps is not None:
        order = OPEN if guessed.open_order else stamps.order if stamps.order != "year first" else ""
        for column in columns:
            if column.name == stamps.column:
                column.unit, column.written, column.bare, column.order = "s", stamps.written, False, order
        if stamps.date:
            words.append(Proposal(stamps.date, np.empty(0), role="date", order=order, reasons=["the day of the clock"]))
    choose(columns)
    falls = next((c.name for c in columns if c.unit in SECONDS and is_clock(-c.values) and c.written == "number"), "")
    if falls and all(column.role != "time" for column in columns):
        text = "falls from row to row: the newest row comes first; reverse the order of the rows"
        raise invalid(path, f'"{falls}" {text}')
    every = {column.name: column for column in [*columns, *words]}
    guess = Guess([path], guessed.layout, [every[name] for name in guessed.names], [], kinds)
    guess.reasons["file"] = guessed.reasons
    if (time := guess.role("time")) is not None and time.written == "index":
        time.period = time.period or guessed.interval
    guess.period, guess.either = guessed.interval, guessed.either
    guess.tests = [str(number) for number in range(1, guessed.tests + 1)]
    if not guessed.named:
        _call_by_role(guess)
    return guess


def _goes_on(path: Path, guessed: TextGuess, numbers: Sequence[str]) -> bool:
    """Whether the clock continues across each repeated line of names: then these are pages of one test."""
    layout = guessed.layout.model_copy(update={"repeated_header": "page"})
    starts = read_table(path, guessed.layout, numbers, (), guessed.texts, guessed.stamps, LOOKED_AT).starts
    table = read_table(path, layout, numbers, (), guessed.texts, guessed.stamps, LOOKED_AT)
    over = np.array(starts, dtype=int) - 1
    return len(over) > 0 and any(
        is_clock(values) and float(np.diff(values)[over].max()) < 2.0 * float(np.median(np.diff(values)))
        for values in table.columns.values()
    )


def _call_by_role(guess: Guess) -> None:
    """Name unnamed columns by their roles."""
    for column in guess.columns:
        column.name = column.name if column.role == "ignore" else column.role
    guess.layout = guess.layout.model_copy(update={"names": [column.name for column in guess.columns]})


_PARTS = (
    (re.compile(r"\d{4}-\d{2}-\d{2}"), "date", ""),
    (re.compile(r"(?<=\{date\}[_T -])\d{6}(?!\d)"), "clock", ""),
    (re.compile(rf"(?<=rads[-_]){NUMBER}|(?<=rad-s[-_]){NUMBER}"), "frequency", "rad/s"),
    (re.compile(rf"{NUMBER}(?=[_-]?Hz)"), "frequency", "Hz"),
    (re.compile(rf"{NUMBER}(?=[ _]?kPa(?![A-Za-z]))"), "pressure", "kPa"),
    (re.compile(rf"{NUMBER}(?=[ _]?bar(?![A-Za-z]))"), "pressure", "bar"),
    (re.compile(rf"{NUMBER}(?=[ _]?psi(?![A-Za-z]))"), "pressure", "psi"),
    (re.compile(rf"{NUMBER}(?=[ _]?kg(?![A-Za-z]))"), "mass", "kg"),
    (re.compile(rf"{NUMBER}(?=[ _]?g(?![A-Za-z]))"), "mass", "g"),
    (re.compile(rf"{NUMBER}(?=[ _]?N(?![A-Za-z]))"), "load", "N"),
    (re.compile(rf"(?<=[A-Za-z_ -]){NUMBER}(?=[ _]?mm(?![A-Za-z]))"), "contraction", "mm"),
    (re.compile(r"(?<=[Tt]est)\d{1,6}|(?<=[Rr]un)\d{1,6}|(?<=[Tt]rial)\d{1,6}"), "test", ""),
)
WHERE_APART = {"g", "N", "mm"}
"""Units of numbers that are used only if they differ among names, because they may be a size or a sensor's range."""
CONTRACTED = re.compile(
    r"(kink(ed)?|contract(ion|ed)?|contr|held|hold|at|shortened|short|x|dx|eps)[-_ ]?$", re.IGNORECASE
)
"""Text before a length in a name that marks it as a contraction, not a diameter."""
OTHER_LENGTH = re.compile(
    r"([a-z]|(?<![a-z])(l|len(gth)?|lange|stretch(ed)?|elong(ation|ated)?|ext(ension|ended)?|d|dia(m|meter)?|gap)"
    r"[-_ ])$",
    re.IGNORECASE,
)
"""Text before a length that may be no contraction: a letter joined to it, or one of these words."""


def found_in(files: Sequence[Path], of: str, without: frozenset[str] = frozenset()) -> Names:
    """Information in the names of files or folders (`of`); numbers with a unit in `without` are ignored.

    A length that is not marked as a contraction and is the same in all names may be a diameter, and is ignored.
    """
    sizes: dict[str, set[str]] = {}
    units: dict[str, str] = {}
    why: dict[str, str] = {}
    comma = False
    forms: dict[str, None] = {}
    for path in files:
        form = re.sub(r"[{}*]", "?", path.stem if of == "file" else path.resolve().parent.name)
        for pattern, key, unit in _PARTS:
            found = [] if unit in without else list(pattern.finditer(form))
            found.sort(key=lambda match: _doubtful(form[: match.start()]) if unit == "mm" else 0)
            if not found or "{" + key + "}" in form or (unit and units.get(key, unit) != unit):
                continue
            match, before, after = found[0], form[: found[0].start()], form[found[0].end() :]
            if before.endswith("}") or after.startswith("{"):
                continue
            doubtful = _doubtful(before)
            if unit in WHERE_APART and (unit != "mm" or doubtful):
                sizes.setdefault(unit, set()).add(match[0])
            if reason := _asked(match[0], unit, doubtful):
                why.setdefault(key, f'"{form}" has {match[0]} {unit}: {reason}')
            comma |= "," in match[0]
            form = f"{before}{{{key}}}{after}"
            if unit:
                units[key] = unit
        forms[form] = None
    if same := {unit for unit, values in sizes.items() if len(values) == 1}:
        return found_in(files, of, without | same)
    keys = {key for form in forms for key in re.findall(r"\{(\w+)\}", form)}
    if "?" in "".join(forms) or (of == "folder" and keys <= {"test"}):
        keys = set()
    return Names(of, list(forms), units, comma, why, keys)


def _doubtful(before: str) -> int:
    """Doubt whether a length is a contraction, from the text before it: 0 marked as one, 1 unmarked, 2 other words."""
    return 0 if CONTRACTED.search(before) else 2 if OTHER_LENGTH.search(before) else 1


def _asked(number: str, unit: str, doubtful: int) -> str:
    """Question about the meaning of a number in a name; empty where it is certain."""
    if number.startswith("-"):
        return "is the minus its sign, as of a muscle that is stretched? If it only separates, write it into the form"
    if "p" in number:
        return f"is it {number_in(number):g} {unit}?"
    if unit == "mm" and doubtful == 2:
        return "is it the contraction? A length of the muscle, a diameter or a stretch is none: take it out of the form"
    return {"N": "is it the load?", "g": "is it the mass?"}.get(unit, "")


def frequency_of(path: Path, of: str, units: Mapping[str, str]) -> float | None:
    """Frequency in the name of a file or of its folder [Hz], None without one; `units`: those of the forms."""
    name = path.resolve().parent.name if of == "folder" else path.stem
    for pattern, key, unit in _PARTS:
        match = pattern.search(name) if key == "frequency" and units.get(key) == unit else None
        if match is not None:
            return number_in(match[0]) / (2 * pi if unit == "rad/s" else 1.0)
    return None


FILES = 20
"""Largest number of files that are examined; the columns are those of the first."""


@np.errstate(all="ignore")  # damaged files hold numbers of any size
def guess_files(files: Sequence[Path], kinds: Mapping[str, Imported]) -> Guess:
    """A guess from up to `FILES` files of one layout, for tests of one of the `kinds`.

    Raises InvalidFile where they cannot be read or are not alike.
    """
    if not files:
        raise invalid("files", "give at least one file")
    guess = look(files[0], kinds)
    for path in files[1:FILES]:
        _alike(guess, path)
    guess.files = list(files)
    _sampling(guess)
    choose_kind(guess)
    _names(guess)
    _frequency(guess)
    _lacking(guess)
    for role in ("time", "pressure"):
        if guess.role(role) is None:
            guess.doubts.append(f"no column was found that is a {role}: say which it is, for the map needs one")
    if guess.lacks == "force" and all(column.role != "ignore" for column in guess.columns):
        guess.doubts.append("no column is a force or a displacement: a pressure alone gives no result here")
    if guess.role("time") is None and guess.role("pressure") is not None and isinstance(guess.layout, TextLayout):
        text = "a table of points without time is no recording: report --overlay draws it next to your own, and model "
        guess.doubts.append(f"{text}fit fits a model to it")
    return guess


def _alike(guess: Guess, path: Path) -> None:
    """Compare another file, which must have the same layout; without a header it may have more columns, or fewer."""
    other = look(path, guess.kinds)
    there = {column.name: column for column in other.columns}
    for column in guess.columns:
        if column.name in there and len(values := there[column.name].good):
            column.middles.append(float(np.median(values)))
    same = type(other.layout) is type(guess.layout)
    if isinstance(guess.layout, TextLayout) and isinstance(other.layout, TextLayout):
        keys = ("delimiter", "quoted", "decimal", "encoding", "header", "skip_lines", "comment")
        same = all(getattr(guess.layout, key) == getattr(other.layout, key) for key in keys)
        blank = "skip" if "skip" in {guess.layout.blank_lines, other.layout.blank_lines} else "refuse"
        missing = sorted({*guess.layout.missing, *other.layout.missing})
        guess.layout = guess.layout.model_copy(update={"blank_lines": blank, "missing": missing})
        if same and guess.layout.header == "none":
            _further(guess, other)
            return
    names, others = {column.name for column in guess.columns}, {column.name for column in other.columns}
    if not same or names != others:
        text = f" ({', '.join(sorted(names ^ others)[:4])})" if names != others else ""
        raise invalid(path, f"is laid out otherwise than {guess.files[0]}{text}: guess them apart")


LACKED = "; some files lack it: add optional: true"


def _further(guess: Guess, other: Guess) -> None:
    """Take over the columns that another file without a header has at the end; ask about those of one file only."""
    common = min(len(guess.columns), len(other.columns))
    for place, column in enumerate(other.columns[common:], common + 1):
        if column.role != "ignore" and (first := guess.role(column.role)) is not None:
            question = f'"{first.name}" is the {column.role} too: what is column {place}? Write what it is, or ignore'
            column.name, column.role, column.question = f"column {place}", "ignore", question
        guess.columns.append(column)
    for column in guess.columns[common:]:
        if column.question and not column.question.endswith(LACKED):
            column.question += LACKED
    guess.layout = guess.layout.model_copy(update={"names": [column.name for column in guess.columns]})


def _sampling(guess: Guess) -> None:
    time = guess.role("time")
    if time is None:
        return
    unit = time.period or 1.0 if time.written == "index" else SECONDS.get(time.unit, 1.0)
    guess.seconds = time.values * unit
    steps = np.diff(guess.seconds)
    forward = steps[steps > 0]
    if not len(forward):
        return
    usual = float(np.median(forward))
    guess.rate = (0.7 / usual, 1.4 / usual)
    early, late = (float(step) for step in np.quantile(steps[steps >= 0], [0.05, 0.95]))
    even = late < 1.01 * usual and early > 0.99 * usual
    wide = float(np.quantile(forward, 0.995))
    guess.gap = max((1.5 if even else 4.0) * usual, 1.5 * wide if wide < 10 * usual else 0.0)
    how = "evenly" if even else f"unevenly, {early:.3g} to {late:.3g} s apart"
    found = [f"median {1 / usual:.4g} samples a second, {how}"]
    if (steps < 0).any():
        found.append(f"the time jumps back {int((steps < 0).sum())} times: it is flagged, not mended")
    if (steps > guess.gap).any():
        found.append(f"{int((steps > guess.gap).sum())} gaps, the longest {steps.max():.3g} s")
    guess.reasons["sampling"] = found


def _names(guess: Guess) -> None:
    """Use the dates, test numbers and points in the names of files or of their folders, whichever contain more."""
    best = max((found_in(guess.files, of) for of in ("file", "folder")), key=lambda names: len(names.keys))
    if best.keys and len(best.forms) <= 20:
        guess.names = best
        guess.reasons["name_tells"] = [f"the name of the {best.of} gives {', '.join(sorted(best.keys))}"]
    else:
        guess.names = replace(best, forms=())


def _frequency(guess: Guess) -> None:
    """Let the frequency of a sine be fitted in each file, if no name gives it or the name is wrong."""
    if not guess.frequency:
        return
    found = frequency_of(guess.files[0], guess.names.of, guess.names.units)
    slowest = 1.0 / float(guess.seconds[-1] - guess.seconds[0]) if guess.seconds is not None else 0.0
    if (found is None or abs(found - guess.frequency) > 0.1 * found + 2 * slowest) and count(guess, "sine") > 0:
        why = "no name gives its frequency"
        if found is not None:
            why = f"its name gives {found:.4g} Hz, and its command does not"
        guess.smallest_of = "pressure_command"
        guess.trials = {"by": "sine", "smallest": f"{share(guess, 'pressure_command'):.3g}"}
        guess.reasons["trials"].append(f"{why}: it is fitted to each file")


def _lacking(guess: Guess) -> None:
    """Ask which column is the pressure, or the force of an isometric test, if none was found."""
    needed = ("pressure", "force") if guess.test.held else ("pressure",)
    lacking = [role for role in needed if guess.role(role) is None]
    guess.lacks = lacking[0] if lacking else ""
    ignored = [column for column in guess.columns if column.role == "ignore"]
    spare = next((column for column in guess.columns if column.role in {"pressure_command", "supply"}), None)
    other = spare is not None or any(len(column.good) for column in ignored)
    if guess.lacks == "pressure" and guess.test.commanded is not None and not other:
        why = "no column gives it: that of the operating point, the same throughout each file"
        guess.columns.append(Proposal("@pressure", np.full(1, np.nan), "pressure", "kPa", [why]))
        guess.lacks, guess.constant = "", True
    if guess.lacks == "pressure" and spare is not None:
        text = f'no measured pressure was found: is "{spare.name[:40]}" it (pressure), or'
        spare.question = f"{text} {spare.role} as its name says? Then nothing can be fitted"
    elif guess.lacks and ignored and not any(column.question for column in ignored):
        ignored.sort(key=lambda column: len(column.values) == 0)
        names = ", ".join(f'"{column.name[:40]}"' for column in ignored[:8])
        for role, column in zip(lacking, ignored, strict=False):
            form = f"as {{is: {role}, unit: {'bar' if role == 'pressure' else 'N'}}}"
            text = f"which column is the {role}? No name says it; there is {names}"
            column.question = f"{text}: write what it is and its unit, {form}"
