"""Files whose text is laid out in odd ways, cut, or written twice (finding 13)."""

from __future__ import annotations

import numpy as np

from tests.store.foreign.case import HEADER, NAME, SLOPE, Case, Measured, clean, commas, fixed, lines, plain, text

ROWS_SAID = r"row|line|column|number|header|text"


def _file(name: str, content: bytes, words: str, seed: int, *, damaged: bool = False, must: bool = False) -> Case:
    return Case(name, "layouts", {NAME: content}, words, (clean(seed),), damaged=damaged, must=must)


def _two_tests() -> Case:
    """The second begins with the header again, and its clock at 0."""
    one, two = clean(100), clean(101)
    file = plain(one.t, one.P, one.F) + plain(two.t, two.P, two.F)
    return Case(
        "two tests in one file",
        "layouts",
        {NAME: file},
        r"two|header|repeat|second|again|which contraction was",
        (one, two),
    )


def _minus() -> Case:
    """Around zero the numbers have a true minus sign, as word processors and some locales write it."""
    whole = clean(102)
    test = Measured(whole.t, whole.P - 5.0, whole.F - 5.0 * SLOPE)
    P, F = ([value.replace("-", "\u2212") for value in fixed(values)] for values in (test.P, test.F))
    file = text([HEADER], lines([fixed(test.t), P, F]))
    return Case("true minus signs", "layouts", {NAME: file}, r"minus|number|\u2212", (test,))


def _whole_thousands() -> Case:
    """Whole newtons with a comma between thousands look like decimal commas: 1,380 is no 1.38."""
    whole = clean(103)
    test = Measured(whole.t, whole.P, np.rint(whole.F))
    rows = lines([fixed(test.t), fixed(test.P), [f"{value:,.0f}" for value in test.F]], ";")
    file = text(["time (s);pressure (kPa);force (N)"], rows)
    words = r"thousand|comma|decimal|number|leap|jump|count"
    return Case("whole newtons with thousands commas", "layouts", {NAME: file}, words, (test,))


def cases() -> list[Case]:
    """What people, spreadsheets and power cuts make of a table."""
    test = clean(110)
    t, P, F = fixed(test.t), fixed(test.P), fixed(test.F)
    plain_rows = lines([t, P, F])
    mean = f"Mean,{test.t.mean():.2f},{test.P.mean():.2f},{test.F.mean():.2f}"
    thousands = [f'{a},{b},"{c:,.2f}"' for a, b, c in zip(t, P, test.F, strict=True)]
    german = [f"{c:,.2f}".replace(",", " ").replace(".", ",").replace(" ", ".") for c in test.F]
    exponents = [f"{value:.6E}".replace("E", "D") for value in test.F]
    overload = ["OL" if 1180 <= n < 1200 else value for n, value in enumerate(F)]
    infinite = ["1.#INF" if n % 500 == 250 else value for n, value in enumerate(F)]
    logged = plain_rows.copy()
    logged[1000:1000] = ["[INFO] valve 2 open"]
    logged[2001:2001] = ["[WARN] supply 6.8 bar"]
    remarked = plain_rows.copy()
    remarked[1500] += ",operator touched the hose"
    paged = [row for n in range(0, len(plain_rows), 500) for row in (HEADER, *plain_rows[n : n + 500])][1:]
    whole = text([HEADER], plain_rows)
    return [
        _file("quoted thousands", text([HEADER], thousands), r"thousand|quot|number|1,", 110),
        _file(
            "German thousands",
            text(["Zeit (s);Druck (kPa);Kraft (N)"], lines([commas(test.t), commas(test.P), german], ";")),
            r"thousand|number|decimal|1\.",
            110,
        ),
        _file(
            "a line of means after the units",
            text(
                ["quantity,time,pressure,force", "unit,s,kPa,N", mean],
                [f"{n}," + row for n, row in enumerate(plain_rows)],
            ),
            ROWS_SAID + "|mean",
            110,
        ),
        _file(
            "a summary at the end",
            text(
                [HEADER],
                [
                    *plain_rows,
                    "Max," + ",".join((f"{test.P.max():.2f}", f"{test.F.max():.2f}")),
                    f"Min,{test.P.min():.2f},{test.F.min():.2f}",
                ],
            ),
            r"max|last|line 300|not a number|row",
            110,
        ),
        _file(
            "Shift-JIS",
            "\n".join(["時間(s),圧力(kPa),力(N)", *plain_rows, ""]).encode("shift_jis"),
            r"shift|encod|utf|japan|bytes|name",
            110,
        ),
        _file(
            "cut in mid row",
            whole[: -len(plain_rows[-1]) + 3],
            r"cut|last|incomplete|row|end",
            110,
            damaged=True,
            must=True,
        ),
        _file(
            "cut in mid number",
            whole[: whole.rindex(b",", 0, len(whole) // 2) + 3],
            r"cut|last|incomplete|row|end",
            110,
            damaged=True,
        ),
        _two_tests(),
        _file("zero bytes at the end", whole + b"\0" * 4096, r"nul|zero|byte|cut|end|\\0|\\x00", 110),
        _file("UTF-16", "\ufeff".encode("utf-16-le") + whole.decode().encode("utf-16-le"), r"utf|encod", 110),
        _file("UTF-8 mark and CRLF", b"\xef\xbb\xbf" + text([HEADER], plain_rows, "\r\n"), r"utf|encod|mark", 110),
        _file("CR only", text([HEADER], plain_rows, "\r"), r"line", 110),
        _file("a delimiter after each row", text([HEADER + ","], [row + "," for row in plain_rows]), ROWS_SAID, 110),
        _file(
            "OL for overload",
            text([HEADER], lines([t, P, overload])),
            r"\bOL\b|missing|overrange|gap|not a number",
            110,
            damaged=True,
        ),
        _file(
            "1.#INF",
            text([HEADER], lines([t, P, infinite])),
            r"inf|missing|gap|not a number|overrange",
            110,
            damaged=True,
        ),
        _minus(),
        _whole_thousands(),
        _file(
            "apostrophes between thousands",
            text([HEADER], lines([t, P, [f"{c:,.2f}".replace(",", "'") for c in test.F]])),
            r"number|thousand|'",
            110,
        ),
        _file(
            "time with a comma, numbers with a point",
            text([HEADER.replace(",", ";")], lines([commas(test.t), P, F], ";")),
            r"decimal|comma|number|mixed",
            110,
        ),
        _file(
            "fields left empty",
            text([HEADER], lines([t, P, ["" if n % 100 == 50 else value for n, value in enumerate(F)]])),
            r"empty|missing|gap|no value|dropout|number",
            110,
            damaged=True,
        ),
        _file(
            "errors of a spreadsheet",
            text([HEADER], lines([t, P, ["#DIV/0!" if n % 700 == 350 else value for n, value in enumerate(F)]])),
            r"#div|missing|no value|dropout|number",
            110,
            damaged=True,
        ),
        _file(
            "everything in quotation marks",
            text(
                ['"time (s)","pressure (kPa)","force (N)"'], lines([[f'"{v}"' for v in column] for column in (t, P, F)])
            ),
            ROWS_SAID + "|quot",
            110,
        ),
        _file("exponents with D", text([HEADER], lines([t, P, exponents])), r"number|\dD|exponent", 110),
        _file("remarks between rows", text([HEADER], logged), r"\[info\]|line 100|1002|row|number", 110),
        _file("a remark at the end of a row", text([HEADER], remarked), r"1502|column|field|remark|operator", 110),
        _file(
            "units after each number",
            text(
                ["time,pressure,force"], lines([[f"{v} s" for v in t], [f"{v} kPa" for v in P], [f"{v} N" for v in F]])
            ),
            r"number|unit|\bs\b",
            110,
        ),
        _file("the header on every page", text([HEADER], paged), r"header|repeat|line 50|no number", 110),
        _file("newest row first", text([HEADER], plain_rows[::-1]), r"back|revers|order|time.?jump|fall", 110),
        _file(
            "names in one line, units in the next",
            text(
                ["Zeit;Druck;Kraft", "s;bar;N"], lines([commas(test.t), commas(test.P / 100, 4), commas(test.F)], ";")
            ),
            ROWS_SAID,
            110,
        ),
    ]
