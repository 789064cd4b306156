"""Guesses the layout of a text file: encoding, delimiter, decimal sign, header, form of its time.

Examines the first lines; times are recognised by their texts, or from sampling data in the header.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from pmabench.base.errors import invalid
from pmabench.store.formats.record import distinct
from pmabench.store.formats.text import MARKS, MINUS, NUMBER, Stamps, TextLayout, seconds_of, step_in
from pmabench.store.importers.map_file import spelled

ENOUGH = 0.99
"""Least share of texts in a column of times that look like times."""
_SLASHED = re.compile(r"\s*(\d{1,2})[-/.](\d{1,2})[-/.](?:\d{4}|\d{2})\b")
_LOOKS = re.compile(
    r"\d{1,3}:\d{2}|\d{4}[-/.]\d{1,2}[-/.]\d|\d{1,2}[-/. ](?:\d{1,2}|[A-Za-z]{3,9})[-/. ]\d{2,4}|\d{8}[T_ ]\d{4}"
)
_NUMBER = r"[:=,;\s\[(]*([0-9]+(?:[.,][0-9]+)?(?:[eE][+-]?[0-9]+)?)"
_RATE = re.compile(
    r"(?:sampl\w*|scan|acquisition|logging|abtast\w*)[ _]?(?:rate|frequency|freq|ing)?\b[^0-9\n]{0,24}?" + _NUMBER
    + r"\s*(k?)(?:hz|s/s|sps|/s|samples?/s)", re.IGNORECASE)  # fmt: skip
_INTERVAL = re.compile(
    r"(?:(?:sampl\w*|scan|time)[ _]?(?:interval|period|step|time)|delta[ _]?t|\bdt)\b[^0-9\n]{0,24}?" + _NUMBER
    + r"\s*(ms|us|µs|s)\b", re.IGNORECASE)  # fmt: skip


def looks_like_time(text: str) -> bool:
    """Whether a text may be a date or a clock."""
    return _LOOKS.search(text) is not None


def written(texts: Sequence[str]) -> tuple[str, str] | None:
    """The form of the times in a column of texts: `clock`, `date` or `date and time`, and the order of day and month.

    None if they are not times; the order is empty where the file does not show it.
    """
    some = [text.strip() for text in texts if text.strip()]
    if some and sum(map(looks_like_time, some)) >= ENOUGH * len(some):
        order = _order(some)
        for kind in ("clock", "date", "date and time"):
            with suppress(ValueError):
                seconds_of(some, kind, order or "day first")
                return kind, order
    return None


def _order(texts: Sequence[str]) -> str:
    """Order of day and month if a number above 12 or a point shows it; `year first` without such dates; else empty."""
    pairs = [(int(m[1]), int(m[2])) for text in texts if (m := _SLASHED.match(text))]
    if not pairs:
        return "year first"
    if any("." in text.split()[0] for text in texts[:1]) or any(one > 12 for one, _ in pairs):
        return "day first"
    return "month first" if any(other > 12 for _, other in pairs) else ""


def interval_in(lines: Sequence[str]) -> float:
    """Sampling period [s] from a rate or an interval in the header; 0 where it gives none, or several."""
    found: set[float] = set()
    for line in lines:
        if match := _RATE.search(line):
            rate = float(match[1].replace(",", ".")) * (1e3 if match[2] else 1.0)
            found |= {1.0 / rate} if rate > 0 else set()
        elif match := _INTERVAL.search(line):
            found.add(float(match[1].replace(",", ".")) * {"s": 1.0, "ms": 1e-3}.get(match[2].lower(), 1e-6))
    return found.pop() if len(found) == 1 else 0.0


TABLE = 0.5
"""Least share of lines below the first row of numbers that must be rows of numbers too."""
LOOKED_AT = 400
"""Number of lines that are examined at the beginning."""
EMPTY, TAIL = " \t,;|", 4000
"""Characters of a blank line, and number of characters at the end of the file that are searched for blank lines."""
FURTHER = 4000
"""Number of further lines, evenly spread, searched for thousands separators and texts that mean no value."""
COMMENTS = ("#", "%", "//", ";", "!")
NO_VALUE = {
    *("nan", "na", "n/a", "null", "none", "-", "--", "", "inf", "-inf", "*", "#n/a", "err", "error", "overflow"),
    *("1.#inf", "-1.#inf", "1.#ind", "-1.#ind", "1.#qnan", "-1.#qnan", "+inf", "infinity", "-infinity", "-nan"),
    *("nan(ind)", "-nan(ind)", "ol", "ovld", "over", "overload", "over range", "overrange", "open", "?", "invalid"),
    *("missing", "---", "----", "-.-", "--.-", "--.--", "#div/0!", "#value!", "#num!", "#ref!", "no data", "bad"),
}
MOST_MISSING = 12
MOST_BELOW = 20
"""Largest number of lines between names and first row that a map can state."""
FAULTS = 0.05
"""Largest share of faults in a column of numbers: texts that are neither numbers nor known for "no value"."""
FEWEST = 3
"""Fewest numbers among the first rows of a column of numbers; others may be blank where rates are mixed."""
_QUOTED = re.compile(r'"\s*[+-]?[\d.,]+(?:[eE][+-]?\d{1,3})?\s*"')
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
"""Encodings that bytes alone do not identify -> typical words of a header in that language."""
STATISTICS = {"mean", "average", "avg", "max", "min", "rms", "std", "value", "raw", "float", "double", "mittelwert"}
"""Words in a line below the names that states how the numbers were obtained."""


@dataclass
class TextGuess:
    """A guessed layout with the names of its columns, and reasons."""

    layout: TextLayout
    names: list[str]
    """In order; as the file gives them, or `column 1` and so on."""
    named: bool
    """Whether the file gives the names."""
    texts: list[str]
    """Names of columns of words."""
    units: dict[str, str] = field(default_factory=dict)
    """Name -> unit, as written in a line of units below the names."""
    reasons: list[str] = field(default_factory=list)
    stamps: Stamps | None = None
    """The time: a column of texts, or one that counts steps given in the header; None if not found."""
    open_order: bool = False
    """Whether the order of day and month in its dates is unknown."""
    tests: int = 0
    """Number of times that the line of names occurs; 0 where it is not repeated."""
    interval: float = 0.0
    """Sampling period from the header [s]; 0 where it gives none."""
    either: str = ""
    """Example of a number if all commas may be decimal or thousands signs; empty where the file shows which."""


@dataclass(frozen=True)
class _Body:
    """The first lines of a text, and the form of its rows of numbers."""

    path: str
    lines: list[str]
    further: list[str]
    """Some lines further down."""
    above: int
    """Number of lines above the first row if an oscilloscope's header shows it; else 0."""
    quoted: bool
    delimiter: str
    decimal: str
    thousands: str
    rows: list[tuple[int, int]]
    """Line from 0, and number of fields, of each row."""

    @property
    def width(self) -> int:
        """Number of fields of a row."""
        return self.rows[-1][1]

    @property
    def first(self) -> int:
        """Line of the first row, from 0."""
        return next(number for number, count in self.rows if count == self.width)

    def cut(self, line: str) -> list[str]:
        """Fields of a line."""
        return split(line, self.delimiter, quoted=self.quoted)

    def below(self) -> list[list[str]]:
        """Fields of all lines from the first row on that have `width` fields."""
        return [row for row in map(self.cut, self.lines[self.first :]) if len(row) == self.width]


def guess_layout(path: str, content: bytes) -> TextGuess:
    """The layout with which most cells of the first lines are numbers; raises InvalidFile where there is none."""
    text, encoding, why = _decoded(path, content.rstrip(b"\0") or content)
    text = text.replace(MINUS, "-").replace("\r\n", "\n").replace("\r", "\n")
    body = _body(path, text)
    lines, first = body.lines, body.first
    comment = _comment(lines, first)
    shown = f"{body.width} columns parted by {body.delimiter}, decimal {body.decimal}"
    reasons = [why, f"{shown}: so {len(body.rows)} of the first lines are rows of numbers"]
    reasons += ["numbers are in quotation marks"] if body.quoted else []
    reasons += [f"digits are grouped by {body.thousands}"] if body.thousands else []
    names, units, skip = _header(body, comment, reasons)
    blank = any(not line.strip(EMPTY) for line in (*lines[:-1], *text[-TAIL:].split("\n")[1:-1]))
    reasons += ["it has blank lines, which are skipped"] if blank else []
    texts, missing = _words(body, names, reasons)
    called = names or [f"column {k + 1}" for k in range(body.width)]
    again = _again(text, lines, first, called) if names and not _twice(called) else 0
    under = sum(bool(line.strip()) for line in lines[again:first]) if again else 0
    again = again if under <= MOST_BELOW else 0
    header_line = bool(again) or (bool(names) and not units and skip is not None and not _twice(called))
    called = _apart(called)
    layout = TextLayout.model_validate(
        {
            "delimiter": body.delimiter,
            "quoted": body.quoted,
            "decimal": body.decimal,
            "thousands": body.thousands or None,
            "encoding": encoding,
            "header": "first line" if header_line else "none",
            "names": [] if header_line else called,
            "skip_lines": again - 1 if again else (skip or 0) if header_line else _before(lines, first, comment),
            "lines_below_header": under if again else 0,
            "repeated_header": "new test" if again else "refuse",
            "blank_lines": "skip" if blank or again else "refuse",
            "comment": comment,
            "missing": missing,
        }
    )
    guess = TextGuess(layout, called, bool(names), [called[k] for k in texts], units, reasons)
    guess.interval = interval_in(lines[:first])
    if body.decimal == "comma" and not body.thousands:
        guess.either = _may_be_thousands([body.cut(lines[row]) for row, _ in body.rows])
    guess.tests = f"\n{text}".count(f"\n{lines[again - 1]}\n") if again else 0
    _stamps(guess, body.below())
    if body.above and guess.stamps is None:
        guess.stamps = Stamps(called[0], "header step")
    return guess


def _body(path: str, text: str) -> _Body:
    """The rows of a text; InvalidFile where it has none, or uses the comma both as delimiter and decimal sign."""
    lines = text.split("\n")[:LOOKED_AT]
    if len(lines) == LOOKED_AT or not text.endswith("\n"):
        lines = lines[: LOOKED_AT - 1]
    quoted = sum(_QUOTED.search(line) is not None for line in lines) > TABLE * sum(map(bool, lines))
    above = next((k + 2 for k in range(min(len(lines), 60)) if step_in(lines[k : k + 2])), 0)
    _, delimiter, decimal, rows, thousands = _cells(path, lines, above, quoted=quoted)
    further = text.split("\n")[LOOKED_AT:-1]
    further = further[:: 1 + len(further) // FURTHER]
    thousands = thousands or _thousands([split(line, delimiter, quoted=quoted) for line in further], decimal)
    body = _Body(path, lines, further, above, quoted, delimiter, decimal, thousands, rows)
    if delimiter == "comma" and decimal == "point" and not quoted:
        fields = [body.cut(line) for line in lines[body.first :] if line.strip()]
        _two_commas(path, fields, lines[: body.first], body.width)
    return body


def _stamps(guess: TextGuess, rows: Sequence[Sequence[str]]) -> None:
    """Find columns of texts that are times, and their form."""
    found = {name: form for name in guess.texts if (form := written([row[guess.names.index(name)] for row in rows]))}
    first = {kind: name for name, (kind, _) in reversed(found.items())}
    time = first.get("date and time") or first.get("clock", "")
    if not time:
        return
    kind = found[time][0]
    date = first.get("date", "") if kind == "clock" else ""
    dated, order = found[date or time]
    guess.open_order = dated != "clock" and not order
    guess.stamps = Stamps(time, kind, date=date, order=order or "day first")
    guess.reasons.append(f'"{time}" is written as {kind}' + (f', its date is in "{date}"' if date else ""))
    guess.texts = [name for name in guess.texts if name not in (time, date)]


def _again(text: str, lines: Sequence[str], first: int, names: Sequence[str]) -> int:
    """Line number, from 1, of the line of names if it is repeated below the first row; else 0."""
    found = next((k for k in range(first - 1, -1, -1) if all(name in lines[k] for name in names)), -1)
    if found < 0 or not lines[found].strip():
        return 0
    start = sum(len(line) + 1 for line in lines[:first])
    return found + 1 if f"\n{lines[found]}\n" in text[start - 1 :] else 0


def _two_commas(path: str, rows: Sequence[Sequence[str]], above: Sequence[str], width: int) -> None:
    """Raise InvalidFile where the comma seems to be both delimiter and decimal sign."""
    if any("." in text for row in rows for text in row):
        return
    heads = [len(line.split(",")) for line in above if re.search(r"[^\W\d_]", line)]
    widths = {len(row) for row in rows}
    names = heads[-1] if heads else 0
    if names == width and len(widths) == 1:
        return
    zeros = any(re.fullmatch(r"\s*0\d+\s*", text) for row in rows for text in row)
    if zeros or (names > 1 and (width == 2 * names or max(widths) > names)):
        under = f" under {names} names" if names else ""
        text = f"rows have {width} fields between commas{under}, none with a decimal point: the comma seems to "
        text += "separate columns and decimals at once, which cannot be distinguished; export it with semicolons or "
        raise invalid(path, f"{text}tabs, or with decimal points", len(above) + 1, 1)


def _decoded(path: str, content: bytes) -> tuple[str, str, str]:
    """The text, its encoding, and the reason; raises InvalidFile where the encoding cannot be determined."""
    part = content[:2_000_000]
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return part.decode("utf-16", "ignore"), "utf-16", "utf-16, by its first two bytes"
    for encoding, at in (("utf-16-le", 1), ("utf-16-be", 0)):
        if content[:400] and all(byte == 0 for byte in content[at:400:2]) and 0 not in content[1 - at : 400 : 2]:
            return part.decode(encoding, "ignore"), encoding, f"{encoding}, for every second byte is zero"
    if content.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):  # a zip, and what Excel wrote before 2007
        raise invalid(path, "is an Excel workbook, or another archive: save the sheet as CSV (UTF-8), and import that")
    if b"\0" in content:
        raise invalid(path, "is binary, and neither LabVIEW (.lvm), TDMS nor MATLAB (.mat): export it as text")
    with suppress(UnicodeDecodeError):
        content.decode("utf-8")
        return part.decode("utf-8-sig", "ignore"), "utf-8", "text in utf-8"
    return _by_words(path, content, part)


def _by_words(path: str, content: bytes, part: bytes) -> tuple[str, str, str]:
    """As `_decoded`, for other encodings than utf-8: by words of a language, else latin-1 or cp1252."""
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
    text = f"is not text in utf-8, and its bytes ({', '.join(f'{byte:02x}' for byte in sorted(odd)[:4])} hex) leave "
    raise invalid(path, f"{text}open in which encoding it is: save it as utf-8, or write a map with its encoding")


def split(line: str, delimiter: str, *, quoted: bool = False) -> list[str]:
    """Fields of a line as the importer splits it."""
    if quoted:
        with suppress(csv.Error):
            return next(csv.reader([line], delimiter=MARKS[delimiter]), [])
        return []
    return line.split() if delimiter == "blank" else line.split(MARKS[delimiter])


_Cells = tuple[tuple[int, bool, bool], str, str, list[tuple[int, int]], str]
"""Score, delimiter, decimal sign, (line from 0, number of fields) of all rows of numbers, and thousands separator."""


def _cells(path: str, lines: Sequence[str], above: int, *, quoted: bool) -> _Cells:
    """The delimiter and decimal sign with most numbers. `above`: number of lines that are known not to be rows."""
    best = max(_ways(lines, above, quoted=quoted), key=lambda way: way[0], default=None)
    cells = (text.strip() for line in lines for text in re.split(r"[\t;|]", line))
    grouped = next((text for text in cells if re.fullmatch(r"\d{1,3}(?:[ \u00a0\u202f]\d{3})+", text)), "")
    hint = f'. "{grouped}" seems to have its digits in groups: export the numbers without them' if grouped else ""
    if best is None:
        raise invalid(path, f"holds no rows of at least two numbers in its first lines: nothing can be guessed{hint}")
    (first, width), count = best[3][0], len(best[3])
    below = sum(bool(line.strip()) for line in lines[first:])
    if count < TABLE * below:
        sentence = f"{count} of {below} lines from line {first + 1} on are rows of {width} fields with numbers"
        raise invalid(path, f"is no table of numbers ({sentence}): nothing can be guessed{hint}")
    return best


def _ways(lines: Sequence[str], above: int, *, quoted: bool) -> Iterator[_Cells]:
    """Every delimiter and decimal sign with which some lines are rows of numbers; rows may have dates and clocks."""
    even = [mark for mark in ("tab", "semicolon", "bar") if _in_each(lines[above:], MARKS[mark])]
    for delimiter in ("tab", "semicolon", "comma", "bar", *(() if quoted else ("blank",))):
        cut = [split(line, delimiter, quoted=quoted) for line in lines]
        for decimal, number in (("point", NUMBER), ("comma", _COMMA)):
            thousands = _thousands(cut, decimal)
            rows: list[tuple[int, int]] = []
            numbers = 0
            for index, fields in enumerate(cut):
                good = sum(_is_number(text, number, decimal, thousands) for text in fields) if index >= above else 0
                times = sum(map(looks_like_time, fields)) if 0 < good < len(fields) else 0
                if good and good + times >= max(2, len(fields) / 2):
                    rows.append((index, len(fields)))
                    numbers += good
            if rows and (delimiter != decimal or quoted):
                width = Counter(count for _, count in rows).most_common(1)[0][0]
                alike = [row for row in rows if row[1] == width]
                score = (numbers * len(alike) // len(rows), delimiter in even, decimal == "point")
                yield score, delimiter, decimal, alike, thousands


def _in_each(lines: Sequence[str], mark: str) -> bool:
    """Whether a character occurs equally often in nearly all lines, as a delimiter does."""
    counts = Counter(line.count(mark) for line in lines if line.strip())
    usual, many = counts.most_common(1)[0] if counts else (0, 0)
    return usual > 0 and many > 0.9 * sum(counts.values())


def _is_number(text: str, plain: re.Pattern[str], decimal: str, thousands: str) -> bool:
    return plain.fullmatch(text) is not None or (bool(thousands) and _GROUPED[decimal].fullmatch(text) is not None)


def _thousands(rows: Sequence[Sequence[str]], decimal: str) -> str:
    """The thousands separator if a field shows it beyond doubt; else empty."""
    point = "." if decimal == "point" else ","
    for row in rows:
        for text in row:
            match = _GROUPED[decimal].fullmatch(text)
            if match is not None and (point in text or text.count(match[1]) > 1 or match[1] in "'\u2019"):
                return _SIGNS.get(match[1], "blank")
    return ""


def _may_be_thousands(rows: Sequence[Sequence[str]]) -> str:
    """Example of a number if every comma could be a thousands separator; else empty."""
    with_comma = [text.strip() for row in rows for text in row if "," in text]
    either = all(re.fullmatch(r"[+-]?[1-9]\d{0,2},\d{3}", text) for text in with_comma)
    return with_comma[0] if with_comma and either else ""


def _comment(lines: Sequence[str], first: int) -> str | None:
    return next((mark for mark in COMMENTS if any(line.lstrip().startswith(mark) for line in lines[:first])), None)


def _header(body: _Body, comment: str | None, reasons: list[str]) -> tuple[list[str], dict[str, str], int | None]:
    """Names, units by name from a second line, and number of lines to skip before the header.

    The last is None if the header line cannot be used as it is, for instance as a comment.
    """
    lines, width = body.lines, body.width
    if body.above:  # an oscilloscope's
        names = [*map(str.strip, body.cut(lines[body.above - 2])), *[""] * width][:width]
        reasons.append("the header gives Start and Increment: the first column counts samples")
        return [name or f"column {k + 1}" for k, name in enumerate(names)], {}, None
    candidates: list[tuple[int, list[str], bool]] = []
    for k in [k for k in range(body.first) if lines[k].strip()][-5:]:
        commented = comment is not None and lines[k].lstrip().startswith(comment)
        found = lines[k].lstrip()[len(comment or "") :] if commented else lines[k]
        fields = [text.strip().strip('"').strip() for text in body.cut(found)]
        if len(fields) == width and any(re.search(r"[^\W\d_]", text) for text in fields):
            candidates.append((k, fields, commented))
    left = [each for each in candidates if not {text.lower() for text in each[1] if text} <= STATISTICS]
    of_units = [each for each in left if sum(bool(spelled(text)) for text in each[1]) * 2 > width]
    named = [each for each in left if each not in of_units] or of_units
    if not named:
        reasons.append("no line of names")
        return [], {}, None
    k, fields, commented = named[-1]
    below = f", their units in line {of_units[-1][0] + 1}" if of_units and named is not of_units else ""
    reasons.append(f"names in line {k + 1}{below or (', which is a comment' if commented else '')}")
    if below:
        called = fields if not _twice(fields) else _apart(fields)
        return called, dict(zip(called, of_units[-1][1], strict=True)), None
    if commented or k < candidates[-1][0]:  # a further line is below the names
        return fields, {}, None
    before = k if comment is None else sum(1 for j in range(k) if not lines[j].lstrip().startswith(comment))
    return fields, {}, (k if before else 0)


def _before(lines: Sequence[str], first: int, comment: str | None) -> int:
    """Number of lines to skip if the map gives the names: up to the last one that is neither comment nor blank."""
    strange = [k for k in range(first) if lines[k].strip() and not (comment and lines[k].lstrip().startswith(comment))]
    return strange[-1] + 1 if strange else 0


def _words(body: _Body, names: Sequence[str], reasons: list[str]) -> tuple[list[int], list[str]]:
    """Columns of words, and texts that mean no value in the others.

    Raises InvalidFile where the words are numbers with the other decimal sign.
    """
    number, otherwise = (_COMMA, NUMBER) if body.decimal == "comma" else (NUMBER, _COMMA)
    cells, texts, missing, other = body.below(), list[int](), set[str](), dict[int, str]()
    for column in range(body.width):
        every = (row[column] for row in cells)
        strange = [text.strip() for text in every if not _is_number(text, number, body.decimal, body.thousands)]
        known = {text for text in strange if text.lower() in NO_VALUE}
        faults = sum(text not in known for text in strange)
        numbers = len(cells) - len(strange)
        if numbers < min(FEWEST, len(cells) / 2) or faults > max(1.0, FAULTS * numbers):
            texts.append(column)
            if all(otherwise.fullmatch(text) for text in strange):
                other[column] = strange[0] if all(map(_GROUPED[body.decimal].fullmatch, strange)) else ""
        else:
            missing |= known
    if other:
        named = ", ".join(f'"{names[k]}"' if names else f"column {k + 1}" for k in other)[:200]
        two = "point" if body.decimal == "comma" else "comma"
        groups = next(iter(other.values())) if all(other.values()) else ""
        text = "two decimal signs in one file" + (f', or digits in groups ("{groups}")' if groups else "")
        text += f": {named} have the {two}, the others the {body.decimal}; export it with one of them"
        raise invalid(body.path, text + (", without groups" if groups else ""), body.first + 1, 1)
    wide = [row for row in map(body.cut, body.further) if len(row) == body.width]
    later = {row[k].strip() for row in wide for k in range(body.width) if k not in texts}
    found = sorted({*sorted(missing)[:MOST_MISSING], *(word for word in later if word.lower() in NO_VALUE)})
    if found := found[:MOST_MISSING]:
        reasons.append(f"texts that mean no value: {', '.join(repr(text) for text in found)}")
    return texts, found


def _twice(names: Sequence[str]) -> bool:
    return len(set(names)) < len(names) or any(not name for name in names)


def _apart(names: Sequence[str]) -> list[str]:
    """Names made unique and not empty."""
    return distinct([name[:100] or f"column {k + 1}" for k, name in enumerate(names)])
