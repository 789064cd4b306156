"""Files as loggers write them, guessed and imported: the numbers that were recorded, or a refusal that gives the reason."""

import re
from datetime import datetime, timedelta

import numpy as np
import pytest

from pmabench.base.errors import InvalidFile
from pmabench.store.importers.guess.write import map_text
from pmabench.store.importers.map_file import spelled
from pmabench.store.importers.prepare import prepare_all
from tests.importing import guess_files, read_map

ROWS = 500
T = np.arange(ROWS) * 0.02
P = 150 * (1 - np.cos(2 * np.pi * T / 5))
"""[kPa]"""
F = 2.1 * P + 20
"""[N]"""
BEGIN = datetime(2024, 3, 5, 10, 0, 0)


def stamp(t):
    return BEGIN + timedelta(seconds=float(t))


def rows(form, marks=None):
    """One line for each sample; `marks`: what takes the place of decimal points."""
    lines = [form(t, p, f) for t, p, f in zip(T, P, F, strict=True)]
    return "".join(f"{line.replace('.', marks) if marks else line}\n" for line in lines)


def plain(t, p, f):
    return f"{t:.2f},{p:.3f},{f:.3f}"


def imported(tmp_path, content, *, unresolved=False):
    """All tests of a file by the map that is guessed for it."""
    path = tmp_path / "held_8mm.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    (tmp_path / "map.yaml").write_text(map_text(guess_files([path])))
    return prepare_all(path, read_map(tmp_path / "map.yaml", unresolved=unresolved))


HEAD = "t (s),P (kPa),F (N)\n"
LINES = rows(plain).splitlines(keepends=True)
RIGHT = {
    "the header on every page": "".join(HEAD + "".join(LINES[k : k + 50]) for k in range(0, ROWS, 50)),
    "minus of typesetting": HEAD + rows(lambda t, p, f: f"{t:.2f},{p:.3f},{f - 1e3:.3f}").replace("-", "\u2212"),
    "exponents of Fortran": HEAD + rows(lambda t, p, f: f"{t:.2f},{p:.5E},{f:.6E}".replace("E", "D")),
    "iso": "Timestamp,Pressure (kPa),Force (N)\n"
    + rows(lambda t, p, f: f"{stamp(t).isoformat(timespec='milliseconds')}Z,{p:.3f},{f:.3f}"),
    "clock and decimal comma": "Zeit;Druck [kPa];Kraft [N]\n"
    + rows(lambda t, p, f: f"{stamp(t):%H:%M:%S.%f};{p:.4f};{f:.3f}", ","),
    "date and clock": "Date\tTime\tP [kPa]\tF [N]\n"
    + rows(lambda t, p, f: f"{stamp(t):%d.%m.%Y}\t{stamp(t):%H:%M:%S.%f}\t{p:.3f}\t{f:.3f}"),
    "serial days": "Time,Pressure_kPa,Force_N\n"
    + rows(lambda t, p, f: f"{(stamp(t) - datetime(1899, 12, 30)).total_seconds() / 86400:.10f},{p:.3f},{f:.3f}"),
    "epoch": "time,Pressure_kPa,Force_N\n"
    + rows(lambda t, p, f: f"{(stamp(t) - datetime(1970, 1, 1)).total_seconds() * 1e3:.0f},{p:.3f},{f:.3f}"),
    "index and rate": "Logger 7\nSample rate: 50 Hz\nSample,Pressure_kPa,Force_N\n"
    + rows(lambda t, p, f: f"{round(t / 0.02)},{p:.3f},{f:.3f}"),
    "hours": "Time (h),P (kPa),F (N)\n" + rows(lambda t, p, f: f"{t / 3600:.9f},{p:.3f},{f:.3f}"),
    "coarse clock and elapsed": "Time,Elapsed (ms),P (kPa),F (N)\n"
    + rows(lambda t, p, f: f"{stamp(t):%H:%M:%S},{1e3 * t:.0f},{p:.3f},{f:.3f}"),
    "quoted decimal comma": '"t (s)","P (kPa)","F (N)"\n'
    + rows(lambda t, p, f: f'"{t:.2f}"|"{p:.3f}"|"{f:.3f}"', ",").replace("|", ","),
    "quoted thousands": '"t (s)","P (kPa)","F (mN)"\n' + rows(lambda t, p, f: f'"{t:.2f}","{p:.3f}","{1e3 * f:,.1f}"'),
    "apostrophes": "t (s);P (kPa);F (mN)\n" + rows(lambda t, p, f: f"{t:.2f};{p:.3f};{1e3 * f:,.1f}".replace(",", "'")),
    "units and Mean below": "Time,Pressure,Force\ns,kPa,N\nMean,Mean,Mean\n" + rows(plain),
    "kgf/cm2": "Time (s),Pressure (kgf/cm2),Force (kgf)\n"
    + rows(lambda t, p, f: f"{t:.2f},{p / 98.0665:.6f},{f / 9.80665:.6f}"),
    "shift-jis": ("時間(s),圧力(kPa),荷重(N)\n" + rows(plain)).encode("shift_jis"),
    "chinese": ("时间(s),压力(kPa),拉力(N)\n" + rows(plain)).encode("gb18030"),
    "utf-16 without mark": (HEAD + rows(plain)).encode("utf-16-le"),
    "cp1252": ("t (s),P (kPa) – cell 2,F (N)\n" + rows(plain)).encode("cp1252"),
    "old Macintosh": (HEAD + rows(plain)).replace("\n", "\r"),
    "delimiter at the end": HEAD.replace(",", ";").replace("\n", ";\n")
    + rows(lambda t, p, f: f"{t:.2f};{p:.3f};{f:.3f};"),
    "blanks between date and clock": "date time P_kPa F_N\n"
    + rows(lambda t, p, f: f"{stamp(t):%Y-%m-%d %H:%M:%S.%f} {p:.3f} {f:.3f}"),
}


NAMELESS = {"blanks between date and clock"}
"""Names that do not belong to the columns one by one: their units are asked for."""


@pytest.mark.parametrize("name", RIGHT)
def test_what_was_recorded_is_what_is_read(tmp_path, name):
    (found,) = imported(tmp_path, RIGHT[name], unresolved=name in NAMELESS)
    channels = {channel.rule.role: channel.si for channel in found.checked}
    np.testing.assert_allclose(found.t - found.t[0], T, rtol=0, atol=1e-5)
    np.testing.assert_allclose(channels["pressure"], 1e3 * P, rtol=0, atol=1.0)
    force = F - 1e3 if "minus" in name else F
    np.testing.assert_allclose(channels["force"], force, rtol=0, atol=2e-3)
    assert not [f for f in found.findings if f.level != "note" and f.kind != "sign"]


def comma_comma(t, p, f):
    return f"{t:.2f}|{p:.2f}|{f:.2f}"


REFUSED = {
    "comma twice": ("t,P,F\n" + rows(comma_comma, ",").replace("|", ","), "separates? columns and decimals at once"),
    "comma twice, no names": (rows(comma_comma, ",").replace("|", ","), "separates? columns and decimals at once"),
    "decimals or thousands": (
        "t;P (kPa);F (N)\n" + rows(lambda t, p, f: f"{t + 1:.3f};{p + 100:.3f};{f + 100:.3f}", ","),
        "not answered: .*1,000",
    ),
    "unknown bytes": (
        ("t (s),P (kPa),F (N) \x81\x8d\n" + rows(plain)).encode("latin-1"),
        "leave open in which encoding",
    ),
    "seconds without fraction": (
        "Time,P (kPa),F (N)\n" + rows(lambda t, p, f: f"{stamp(t):%H:%M:%S},{p:.3f},{f:.3f}"),
        "written in steps of 1 s",
    ),
    "an index without a rate": (
        "Sample,P (kPa),F (N)\n" + rows(lambda t, p, f: f"{round(t / 0.02)},{p:.3f},{f:.3f}"),
        "counts the samples: how far apart",
    ),
    "no time at all": (
        "P (kPa),F (N)\n" + rows(lambda t, p, f: f"{p:.3f},{f:.3f}"),
        "no column is a time: were the samples taken at even distances",
    ),
    "newest row first": (HEAD + "".join(reversed(LINES)), "the newest row comes first"),
    "a word in a column of numbers": (HEAD + rows(plain).replace("2.00,", "two,", 1), '"two" is no number'),
    "a date either way round": (
        "When,P (kPa),F (N)\n" + rows(lambda t, p, f: f"{stamp(t):%d/%m/%Y %H:%M:%S.%f},{p:.3f},{f:.3f}"),
        "does day or month come first",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_may_be_two_things_is_refused_or_asked(tmp_path, name):
    content, reported = REFUSED[name]
    with pytest.raises(InvalidFile) as caught:
        imported(tmp_path, content)
    assert any(re.search(reported, problem.message) for problem in caught.value.problems), caught.value


def test_a_file_that_ends_within_a_row_is_read_to_its_last_whole_row(tmp_path):
    whole = HEAD + rows(plain)
    (found,) = imported(tmp_path, whole[:-9])
    assert len(found.t) == ROWS - 1
    (cut,) = [f for f in found.findings if f.kind == "cut-row"]
    assert (cut.level, cut.index) == ("doubt", ROWS - 2)
    assert "in line 501: 2 of 3 columns; it was left out" in cut.text
    (found,) = imported(tmp_path, whole[:-2])  # whole, or without its last digit: nobody knows
    assert len(found.t) == ROWS
    assert found.flags[-1] != 0
    assert found.flags[:-1].max() == 0


def test_a_footer_that_is_no_row_is_named_and_a_fault_in_the_last_row_is_refused(tmp_path):
    (found,) = imported(tmp_path, HEAD + rows(plain) + "end of record\n")
    assert len(found.t) == ROWS
    (doubt,) = [f for f in found.findings if f.kind == "cut-row"]
    assert doubt.level == "doubt"
    assert 'from line 502 ("end of record") on, are no rows' in doubt.text
    footer = "\nStatistics\nMaximum,600.1,1380.2\nMean,281.4,640.0\n"
    (found,) = imported(tmp_path, HEAD + rows(plain) + footer)
    assert len(found.t) == ROWS
    assert any("3 lines below the last row" in f.text and '"Statistics"' in f.text for f in found.findings)
    for blank_end in (",,\n" * 90, ",,\n" * 3 + footer):
        (found,) = imported(tmp_path, HEAD + rows(plain) + blank_end)
        assert len(found.t) == ROWS
    with pytest.raises(InvalidFile, match="the line is blank"):  # it is in the middle of the rows
        imported(tmp_path, HEAD + rows(plain) + footer + rows(plain))
    with pytest.raises(InvalidFile, match="1 columns, 3 are expected"):  # no footer is so long
        imported(tmp_path, HEAD + rows(plain) + "error\n" * 100)
    with pytest.raises(InvalidFile, match='"x1" is no number'):
        imported(tmp_path, HEAD + rows(plain) + "x1,2,3\n")


def test_titles_of_tests_that_are_padded_with_delimiters_are_no_rows(tmp_path):
    """As a spreadsheet writes them: the title has as many fields as a row."""
    table = "time;pressure;force\ns;kPa;N\n" + rows(lambda t, p, f: f"{t:.2f};{p:.3f};{f:.3f}").replace(".", ",")
    found = imported(tmp_path, "".join(f"Contraction = {x} mm;;\n{table}" for x in (0, 8)), unresolved=True)
    assert [len(each.t) for each in found] == [ROWS, ROWS]


def test_words_for_no_value_are_dropouts_and_zeros_at_the_end_are_said(tmp_path):
    lines = list(LINES)
    for row, text in ((40, "1.#INF"), (41, "-1.#IND"), (300, "OL")):
        lines[row] = f"{T[row]:.2f},{P[row]:.3f},{text}\n"
    (found,) = imported(tmp_path, HEAD + "".join(lines))
    assert np.flatnonzero(np.isnan(found.checked[1].si)).tolist() == [40, 41, 300]
    assert np.flatnonzero(found.flags).tolist() == [40, 41, 300]
    (found,) = imported(tmp_path, (HEAD + rows(plain)).encode() + bytes(700))
    assert len(found.t) == ROWS
    assert any("ends with 700 bytes of zero" in f.text and f.level == "doubt" for f in found.findings)
    with pytest.raises(InvalidFile, match="binary"):
        imported(tmp_path, (HEAD + rows(plain)).encode() + bytes(7) + b"1,2,3\n")


def test_what_comes_late_in_a_file_is_seen(tmp_path):
    lines = [f'{t:.2f},{p:.3f},"{f + 700:,.2f}"\n' for t, p, f in zip(T, P, F, strict=True)]
    early = [f'{t - 20:.2f},0.5,"1.00"\n' for t in 0.02 * np.arange(1000)]
    lines[450] = lines[450][: lines[450].index('"')] + "OL\n"
    (found,) = imported(tmp_path, HEAD + "".join([*early, *lines]))
    force = found.checked[1].si[1000:]
    assert np.flatnonzero(np.isnan(force)).tolist() == [450]
    np.testing.assert_allclose(np.delete(force, 450), np.delete(F + 700, 450), atol=6e-3)


def test_two_tests_under_repeated_headers_are_guessed_and_become_two(tmp_path):
    second = rows(lambda t, p, f: f"{t:.2f},{p:.3f},{1.5 * f:.3f}")
    content = f"Test 1\nt,P,F\ns,kPa,N\n{rows(plain)}\nTest 2\nt,P,F\ns,kPa,N\n{second}"
    one, two = imported(tmp_path, content)
    for found, factor in ((one, 1.0), (two, 1.5)):
        np.testing.assert_allclose(found.t, T, atol=1e-9)
        np.testing.assert_allclose(found.checked[1].si, factor * F, atol=2e-3)


def test_the_rows_of_one_oscilloscope_need_no_second_clock(tmp_path):
    content = "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-1.0e-02,2.00e-02\n" + rows(
        lambda t, p, f: f"{round(t / 0.02)},{p / 100:.5f},{f / 100:.5f},,"
    )
    path = tmp_path / "scope.csv"
    path.write_text(content)
    guess = guess_files([path])
    assert guess.role("time").written == "header step"
    np.testing.assert_allclose(guess.seconds, T - 0.01, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "unit"),
    [("kgf/cm²", "kgf/cm2"), ("kg/cm^2", "kgf/cm2"), ("Torr", "mmHg"), ("N/mm²", "N/mm2"), ("Std", "h"), ("psia", "")],
)
def test_units_as_people_write_them(text, unit):
    assert spelled(text) == unit


def test_a_line_of_units_is_read_in_every_file(tmp_path):
    """The second file of a call in psi was imported in the kPa of the first: 0.145 of each pressure."""
    units = "Time,Pressure,Force\ns,{},N\n"
    first, second = tmp_path / "a_8mm.csv", tmp_path / "b_8mm.csv"
    first.write_text(units.format("kPa") + rows(plain))
    second.write_text(units.format("psi") + rows(lambda t, p, f: plain(t, p / 6.894757, f)))
    text = map_text(guess_files([first, second]))
    (tmp_path / "map.yaml").write_text(text)
    rules = read_map(tmp_path / "map.yaml", unresolved=True)
    assert len(prepare_all(first, rules)) == 1
    with pytest.raises(InvalidFile, match='unit of "Pressure" is psi, the map says kPa'):
        prepare_all(second, rules)
    first.write_text(units.format("bar") + rows(plain))  # a wrong label: the way out that the refusal names
    right = 'unit: "bar"\n    line: {slope: 1 kPa/bar, offset: 0 kPa}'
    (tmp_path / "map.yaml").write_text(text.replace("unit: kPa", right))
    (test,) = prepare_all(first, read_map(tmp_path / "map.yaml", unresolved=True))
    assert test.checked[0].si == pytest.approx(1e3 * P, abs=1.0)
