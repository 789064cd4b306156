"""How a text file seems to be laid out: encoding, delimiter, decimal sign, header; looks at its first lines."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from pmabench.base.errors import invalid
from pmabench.store.formats.fields import MINUS
from pmabench.store.formats.text import MARKS, TextLayout
from pmabench.store.formats.times import Stamps, step_in
from pmabench.store.importers.guess.clock import clock_and_date, interval_in, looks_like_time, written

TABLE = 0.5
"""Least share of the lines below the first row of numbers that are such rows, too."""
LOOKED_AT = 400
"""Lines from the beginning."""
FURTHER = 4000
"""Lines further down, evenly spread, that are looked at for signs of thousands and for texts that mean no value."""
COMMENTS = ("#", "%", "//", ";", "!")
NO_VALUE = {
    *("nan", "na", "n/a", "null", "none", "-", "--", "", "inf", "-inf", "*", "#n/a", "err", "error", "overflow"),
    *("1.#inf", "-1.#inf", "1.#ind", "-1.#ind", "1.#qnan", "-1.#qnan", "+inf", "infinity", "-infinity", "-nan"),
    *("nan(ind)", "-nan(ind)", "ol", "ovld", "over", "overload", "over range", "overrange", "open", "?", "invalid"),
    *("missing", "---", "----", "-.-", "--.-", "--.--", "#div/0!", "#value!", "#num!", "#ref!", "no data", "bad"),
}
MOST_MISSING = 12
FAULTS = 0.05
"""Share of texts that are neither numbers nor known for "no value", up to which a column holds numbers, and faults."""
_QUOTED = re.compile(r'"\s*[+-]?[\d.,]+(?:[eE][+-]?\d{1,3})?\s*"')
_POINT = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d{1,3})?\s*")
_COMMA = re.compile(r"\s*[+-]?(?:\d+,?\d*|,\d+)(?:[eEdD][+-]?\d{1,3})?\s*")


_GROUPED = {
    "point": re.compile(r"\s*[+-]?\d{1,3}(?:([,'\u2019 \u00a0\u202f])\d{3})(?:\1\d{3})*(?:\.\d*)?\s*"),
    "comma": re.compile(r"\s*[+-]?\d{1,3}(?:([.'\u2019 \u00a0\u202f])\d{3})(?:\1\d{3})*(?:,\d*)?\s*"),
}
"""Numbers with groups of three digits, by the decimal sign."""
_SIGNS = {",": "comma", ".": "point", "'": "apostrophe", "\u2019": "apostrophe"}
ENCODINGS = {
    "shift_jis": ("時間", "圧力", "変位", "荷重", "張力"),
    "euc_jp": ("時間", "圧力", "変位", "荷重", "張力"),
    "gb18030": ("时间", "压力", "位移", "拉力", "载荷"),
    "big5": ("時間", "壓力", "位移", "拉力"),
    "euc_kr": ("시간", "압력", "변위", "하중"),
}
"""Encodings that cannot be told by their bytes, each with words of its language that a header of a test holds."""
STATISTICS = {"mean", "average", "avg", "max", "min", "rms", "std", "value", "raw", "float", "double", "mittelwert"}
"""What stands below the names where a program says how it made its numbers."""


@dataclass
class TextGuess:
    """A layout with the names of its columns, and why."""

    layout: TextLayout
    names: list[str]
    """In order; as the file gives them, or `column 1` and so on."""
    named: bool
    """The file gives the names."""
    texts: list[str]
    """Names of columns that hold words."""
    units: dict[str, str] = field(default_factory=dict)
    """From a line of units below the names."""
    reasons: list[str] = field(default_factory=list)
    stamps: Stamps | None = None
    """The column whose texts are times, or that counts the steps of the header."""
    open_order: bool = False
    """Day and month of its dates may be the other way round."""
    tests: int = 0
    """How often the line of names was found; 0 where it is not repeated."""
    interval: float = 0.0
    """Distance of the samples that the header gives [s]; 0 where it gives none."""
    either: str = ""
    """A number whose comma may be the decimal sign or group digits, as all others; empty where one shows which."""


def guess_layout(path: str, content: bytes) -> TextGuess:
    """The layout that makes most cells of the first lines numbers; raises InvalidFile where none does."""
    text, encoding, why = _decoded(path, content.rstrip(b"\0") or content)
    text = text.replace(MINUS, "-").replace("\r\n", "\n").replace("\r", "\n")
    lines = text.split("\n")[:LOOKED_AT]
    if len(lines) == LOOKED_AT or not text.endswith("\n"):
        lines = lines[: LOOKED_AT - 1]
    quoted = sum(_QUOTED.search(line) is not None for line in lines) > TABLE * sum(map(bool, lines))
    above = next((k + 2 for k in range(min(len(lines), 60)) if step_in(lines[k : k + 2])), 0)
    delimiter, decimal, rows, thousands = _cells(path, lines, above, quoted=quoted)
    width = rows[-1][1]
    first = next(number for number, count in rows if count == width)
    comment = _comment(lines, first)
    reasons = [why, _told(delimiter, decimal, width, len(rows))]
    if quoted:
        reasons.append("numbers stand in quotation marks")
    further = text.split("\n")[LOOKED_AT:-1]
    further = further[:: 1 + len(further) // FURTHER]
    thousands = thousands or _thousands([split(line, delimiter, quoted=quoted) for line in further], decimal)
    if thousands:
        reasons.append(f"digits are grouped by {thousands}")

    def cut(line: str) -> list[str]:
        return split(line, delimiter, quoted=quoted)

    if delimiter == "comma" and decimal == "point" and not quoted:
        _two_commas(path, [cut(line) for line in lines[first:] if line.strip()], lines[:first], width)
    if above:
        names, units, skip = [*map(str.strip, cut(lines[above - 2]))], dict[str, str](), None
        names = [name or f"column {k + 1}" for k, name in enumerate((names + [""] * width)[:width])]
        reasons.append("the header gives Start and Increment: the first column counts samples")
    else:
        names, units, skip = _header(lines, first, cut, width, comment, reasons)
    blank = any(not line.strip() for line in lines[:-1])
    if blank:
        reasons.append("blank lines stand in it, and are skipped")
    texts, missing, other = _words(lines[first:], cut, decimal, width, grouped=bool(thousands))
    later = {row[k].strip() for row in map(cut, further) if len(row) == width for k in range(width) if k not in texts}
    missing = sorted({*missing, *(word for word in later if word.lower() in NO_VALUE)})[:MOST_MISSING]
    if missing:
        reasons.append(f"texts that stand for no value: {', '.join(repr(text) for text in missing)}")
    if other:
        told = ", ".join(f'"{names[k]}"' if names else f"column {k + 1}" for k in other)[:200]
        one, two = ("comma", "point") if decimal == "comma" else ("point", "comma")
        problem = (
            f"two decimal signs in one file: {told} have the {two}, the others the {one}; export it with one of them"
        )
        raise invalid(path, problem, first + 1, 1)
    called = names or [f"column {k + 1}" for k in range(width)]
    header_line = bool(names) and not units and skip is not None and not _twice(called)
    again = _again(text, lines, first, called) if names and not _twice(called) else 0
    called = _apart(called)
    if again:
        header_line = True
    layout = TextLayout.model_validate(
        {
            "delimiter": delimiter,
            "quoted": quoted,
            "decimal": decimal,
            "thousands": thousands or None,
            "encoding": encoding,
            "header": "first line" if header_line else "none",
            "names": [] if header_line else called,
            "skip_lines": (skip or 0) if header_line and not again else _before(lines, first, comment),
            "blank_lines": "skip" if blank or again else "refuse",
            "comment": comment,
            "missing": missing,
        }
    )
    if again:
        more = {
            "repeated_header": "new test",
            "skip_lines": again - 1,
            "lines_below_header": sum(bool(line.strip()) for line in lines[again:first]),
        }
        layout = layout.model_copy(update=more)
    guess = TextGuess(layout, called, bool(names), [called[k] for k in texts], units, reasons)
    guess.interval = interval_in(lines[:first])
    if decimal == "comma" and not thousands:
        guess.either = _may_be_thousands([cut(lines[row]) for row, _ in rows])
    guess.tests = f"\n{text}".count(f"\n{lines[again - 1]}\n") if again else 0
    _stamps(guess, [row for row in map(cut, lines[first:]) if len(row) == width])
    if above and guess.stamps is None:
        guess.stamps = Stamps(called[0], "header step")
    return guess


def _stamps(guess: TextGuess, rows: Sequence[Sequence[str]]) -> None:
    """Which of the columns of words are times, and how they are written."""
    kinds = {name: found for name in guess.texts if (found := written([row[guess.names.index(name)] for row in rows]))}
    time, date = clock_and_date(kinds)
    if not time:
        return
    dated = kinds[date or time]
    guess.open_order = dated.kind != "clock" and not dated.order
    guess.stamps = Stamps(time, kinds[time].kind, date=date, order=dated.order or "day first")
    told = f'"{time}" is written as {kinds[time].kind}' + (f', its date is in "{date}"' if date else "")
    guess.reasons.append(told)
    guess.texts = [name for name in guess.texts if name not in (time, date)]


def _again(text: str, lines: Sequence[str], first: int, names: Sequence[str]) -> int:
    """The line of names, from 1, where it is repeated below the first row; else 0."""
    found = next((k for k in range(first - 1, -1, -1) if all(name in lines[k] for name in names)), -1)
    if found < 0 or not lines[found].strip():
        return 0
    start = sum(len(line) + 1 for line in lines[:first])
    return found + 1 if f"\n{lines[found]}\n" in text[start - 1 :] else 0


def _two_commas(path: str, rows: Sequence[Sequence[str]], above: Sequence[str], width: int) -> None:
    """Raises InvalidFile where the comma seems to part columns and decimals at once."""
    if any("." in text for row in rows for text in row):
        return
    heads = [len(line.split(",")) for line in above if re.search(r"[^\W\d_]", line)]
    widths = {len(row) for row in rows}
    names = heads[-1] if heads else 0
    if names == width and len(widths) == 1:
        return
    zeros = any(re.fullmatch(r"\s*0\d+\s*", text) for row in rows for text in row)
    if (names > 1 and width == 2 * names) or zeros or (names > 1 and max(widths) > names):
        told = (
            f"rows have {width} fields between commas"
            + (f" under {names} names" if names else "")
            + ", none with a decimal point: the comma seems to part columns and decimals at once, which nothing can "
            "tell apart; export it with semicolons or tabs, or with decimal points"
        )
        raise invalid(path, told, len(above) + 1, 1)


def _decoded(path: str, content: bytes) -> tuple[str, str, str]:
    """Text, its encoding, and why that one; raises InvalidFile where its bytes leave it open."""
    part = content[:2_000_000]
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        try:
            return part.decode("utf-16", "ignore"), "utf-16", "utf-16, by its first two bytes"
        except UnicodeError as error:
            raise invalid(path, "begins like utf-16 and is not") from error
    for encoding, at in (("utf-16-le", 1), ("utf-16-be", 0)):
        if content[:400] and all(byte == 0 for byte in content[at:400:2]) and 0 not in content[1 - at : 400 : 2]:
            return part.decode(encoding, "ignore"), encoding, f"{encoding}, for every second byte is zero"
    if b"\0" in content:
        raise invalid(path, "is binary, and neither LabVIEW (.lvm), TDMS nor MATLAB (.mat): export it as text")
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return _by_words(path, content, part)
    return part.decode("utf-8-sig", "ignore"), "utf-8", "text in utf-8"


def _by_words(path: str, content: bytes, part: bytes) -> tuple[str, str, str]:
    """An encoding that is not utf-8: by words of a language, else one of the West."""
    for encoding, words in ENCODINGS.items():
        with suppress(UnicodeDecodeError):
            text = part.decode(encoding, "strict" if part == content else "ignore")
            found = next((word for word in words if word in text), "")
            if found:
                return text, encoding, f'{encoding}, for so it holds the word "{found}"'
    if not re.search(rb"[\x80-\x9f]", content):
        return part.decode("latin-1"), "latin-1", "latin-1, for it holds bytes that are not utf-8"
    odd = {byte for byte in content if 0x80 <= byte <= 0x9F}
    if odd <= {0x80, 0x82, 0x85, 0x91, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x99}:
        return part.decode("cp1252"), "cp1252", "cp1252, for it holds signs of that and is not utf-8"
    raise invalid(
        path,
        f"is not text in utf-8, and its bytes ({', '.join(f'{byte:02x}' for byte in sorted(odd)[:4])} hex) leave open "
        "in which encoding it is: save it as utf-8, or write a map with its encoding",
    )


def split(line: str, delimiter: str, *, quoted: bool = False) -> list[str]:
    """Fields of a line as the importer takes them."""
    if quoted:
        with suppress(csv.Error):
            return next(csv.reader([line], delimiter=MARKS[delimiter]), [])
        return []
    return line.split() if delimiter == "blank" else line.split(MARKS[delimiter])


def _cells(path: str, lines: Sequence[str], above: int, *, quoted: bool) -> tuple[str, str, list[tuple[int, int]], str]:
    """Delimiter, decimal sign, (line from 0, fields) of all rows of numbers, and the sign of thousands.

    The pair with most numbers wins. A field that is a date or a clock may stand in a row. `above`: lines before the
    first row that are none.
    """
    best: tuple[tuple[int, bool, bool], str, str, list[tuple[int, int]], str] | None = None
    even = [mark for mark in ("tab", "semicolon", "bar") if _in_each(lines[above:], MARKS[mark])]
    for delimiter in ("tab", "semicolon", "comma", "bar", *(() if quoted else ("blank",))):
        cut = [split(line, delimiter, quoted=quoted) for line in lines]
        for decimal, number in (("point", _POINT), ("comma", _COMMA)):
            if delimiter == decimal and not quoted:
                continue
            thousands = _thousands(cut, decimal)
            rows: list[tuple[int, int]] = []
            numbers = 0
            for index, fields in enumerate(cut):
                if index < above or len(fields) < 2:
                    continue
                good = sum(_is_number(text, number, decimal, thousands) for text in fields)
                times = sum(map(looks_like_time, fields)) if good < len(fields) else 0
                if good >= 1 and good + times >= 2 and 2 * (good + times) >= len(fields):
                    rows.append((index, len(fields)))
                    numbers += good
            if not rows:
                continue
            width = Counter(count for _, count in rows).most_common(1)[0][0]
            alike = [row for row in rows if row[1] == width]
            score = (numbers * len(alike) // len(rows), delimiter in even, decimal == "point")
            if best is None or score > best[0]:
                best = (score, delimiter, decimal, alike, thousands)
    if best is None:
        raise invalid(path, "holds no rows of at least two numbers in its first lines: nothing can be guessed")
    first, count = best[3][0][0], len(best[3])
    below = sum(bool(line.strip()) for line in lines[first:])
    if count < TABLE * below:
        told = f"{count} of {below} lines from line {first + 1} on are rows of {best[3][0][1]} fields with numbers"
        raise invalid(path, f"is no table of numbers ({told}): nothing can be guessed")
    return best[1], best[2], best[3], best[4]


def _in_each(lines: Sequence[str], mark: str) -> bool:
    """Whether a sign stands equally often in nearly all lines: it parts columns, rather than digits."""
    counts = Counter(line.count(mark) for line in lines if line.strip())
    usual, many = counts.most_common(1)[0] if counts else (0, 0)
    return usual > 0 and many > 0.9 * sum(counts.values())


def _is_number(text: str, plain: re.Pattern[str], decimal: str, thousands: str) -> bool:
    return plain.fullmatch(text) is not None or (bool(thousands) and _GROUPED[decimal].fullmatch(text) is not None)


def _thousands(rows: Sequence[Sequence[str]], decimal: str) -> str:
    """The sign between groups of three digits, where a field shows it beyond doubt; else an empty text."""
    point = "." if decimal == "point" else ","
    for row in rows:
        for text in row:
            match = _GROUPED[decimal].fullmatch(text)
            if match is not None and (point in text or text.count(match[1]) > 1 or match[1] in "'\u2019"):
                return _SIGNS.get(match[1], "blank")
    return ""


def _may_be_thousands(rows: Sequence[Sequence[str]]) -> str:
    """A number of a file in which every comma stands before three digits and none after a zero; else an empty text."""
    with_comma = [text.strip() for row in rows for text in row if "," in text]
    either = with_comma and all(re.fullmatch(r"[+-]?[1-9]\d{0,2},\d{3}", text) for text in with_comma)
    return with_comma[0] if either else ""


def _told(delimiter: str, decimal: str, width: int, rows: int) -> str:
    return f"{width} columns parted by {delimiter}, decimal {decimal}: so {rows} of the first lines are rows of numbers"


def _comment(lines: Sequence[str], first: int) -> str | None:
    for mark in COMMENTS:
        if any(line.lstrip().startswith(mark) for line in lines[:first]):
            return mark
    return None


def _header(
    lines: Sequence[str],
    first: int,
    cut: Callable[[str], list[str]],
    width: int,
    comment: str | None,
    reasons: list[str],
) -> tuple[list[str], dict[str, str], int | None]:
    """Names, units by name from a second line, and lines before the header (None: it is a comment)."""
    from pmabench.store.importers.units import spelled

    above = [(k, lines[k]) for k in range(first) if lines[k].strip()]
    candidates: list[tuple[int, list[str], bool]] = []
    for k, line in above[-5:]:
        commented = comment is not None and line.lstrip().startswith(comment)
        told = line.lstrip()[len(comment or "") :] if commented else line
        fields = [text.strip().strip('"').strip() for text in cut(told)]
        if len(fields) == width and any(re.search(r"[^\W\d_]", text) for text in fields):
            candidates.append((k, fields, commented))
    left = [each for each in candidates if not {text.lower() for text in each[1] if text} <= STATISTICS]
    of_units = [each for each in left if sum(bool(spelled(text)) for text in each[1]) * 2 > width]
    named = [each for each in left if each not in of_units] or of_units
    if not named:
        reasons.append("no line of names: the columns are told apart by what they hold")
        return [], {}, None
    k, fields, commented = named[-1]
    if of_units and named is not of_units:
        reasons.append(f"names in line {k + 1}, their units in line {of_units[-1][0] + 1}")
        called = fields if not _twice(fields) else _apart(fields)
        return called, {name: spelled(text) for name, text in zip(called, of_units[-1][1], strict=True)}, None
    if commented:
        reasons.append(f"names in line {k + 1}, which is a comment")
        return fields, {}, None
    reasons.append(f"names in line {k + 1}")
    if k < candidates[-1][0]:  # what is below the names is no row
        return fields, {}, None
    before = k if comment is None else sum(1 for j in range(k) if not lines[j].lstrip().startswith(comment))
    return fields, {}, (k if before else 0)


def _before(lines: Sequence[str], first: int, comment: str | None) -> int:
    """Lines to skip where the map gives the names: all before the first row, without comments and blank ones."""
    strange = [k for k in range(first) if lines[k].strip() and not (comment and lines[k].lstrip().startswith(comment))]
    return strange[-1] + 1 if strange else 0


def _words(
    lines: Sequence[str], cut: Callable[[str], list[str]], decimal: str, width: int, *, grouped: bool
) -> tuple[list[int], list[str], list[int]]:
    """Columns of words, texts that stand for no value in the others, and which of the words are numbers otherwise."""
    number, otherwise = (_COMMA, _POINT) if decimal == "comma" else (_POINT, _COMMA)
    cells = [row for row in map(cut, lines) if len(row) == width]
    texts: list[int] = []
    missing: set[str] = set()
    other: list[int] = []
    for column in range(width):
        strange = [
            row[column].strip()
            for row in cells
            if not _is_number(row[column], number, decimal, "any" if grouped else "")
        ]
        if not strange:
            continue
        known = sum(text.lower() in NO_VALUE for text in strange)
        if len(strange) > len(cells) / 2 or len(strange) - known > max(1.0, FAULTS * len(cells)):
            texts.append(column)
            if all(otherwise.fullmatch(text) for text in strange):
                other.append(column)
        else:
            missing |= {text for text in strange if text.lower() in NO_VALUE}
    return texts, sorted(missing)[:MOST_MISSING], other


def _twice(names: Sequence[str]) -> bool:
    return len(set(names)) < len(names) or any(not name for name in names)


def _apart(names: Sequence[str]) -> list[str]:
    """Names that differ, none of them empty."""
    seen: Counter[str] = Counter()
    told = []
    for k, name in enumerate(names):
        text = name[:100] or f"column {k + 1}"
        seen[text] += 1
        told.append(text if seen[text] == 1 else f"{text} ({seen[text]})")
    return told
