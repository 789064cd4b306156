"""Time in every form that programs write it: the seconds between rows are those of the recording, whatever the form."""

import re
from datetime import datetime, timedelta

import numpy as np
import pytest
from scipy.io import savemat

from pmabench.base.errors import InvalidFile
from pmabench.store.formats.text import clock_seconds, date_seconds, seconds_of
from pmabench.store.importers.guess.write import map_text
from pmabench.store.importers.prepare import prepare, prepare_all
from tests.importing import guess_files, read_map

HEAD = """schema: pmabench.map/1
name: made here
source: the project
kind: isometric
sampling: {rate: [1 Hz, 10 kHz], gap: 10 s}
trials: {by: file}
specimen: {type: X}
"""
CHANNELS = """  p: {is: pressure, unit: kPa}
  f: {is: force, unit: N}
"""
BEGIN = datetime(2024, 3, 1, 23, 59, 59, 500_000)
STEP = timedelta(milliseconds=20)
ROWS = 100
TRUE = np.arange(ROWS) * 0.02


def moments():
    return [BEGIN + k * STEP for k in range(ROWS)]


def read(tmp_path, rows, columns, file="delimiter: semicolon, header: first line", names="t;p;f"):
    """The times [s] of a file of rows `time;pressure;force`, and when it says that it began."""
    path = tmp_path / "old.csv"
    lines = [names, *(f"{t};{k};{2 * k}" for k, t in enumerate(rows))]
    path.write_text("\n".join(lines) + "\n")
    (tmp_path / "map.yaml").write_text(f"{HEAD}file: {{{file}}}\ncolumns:\n{columns}{CHANNELS}")
    found = prepare(path, read_map(tmp_path / "map.yaml"))
    return found.t, found.named.started


FORMS = {
    "iso": ("date and time", "", lambda m: m.isoformat(timespec="milliseconds")),
    "iso zone": ("date and time", "", lambda m: m.isoformat(timespec="milliseconds") + "+01:00"),
    "blank": ("date and time", "", lambda m: m.strftime("%Y/%m/%d %H:%M:%S.%f")),
    "german": ("date and time", ", order: day first", lambda m: m.strftime("%d.%m.%Y %H:%M:%S,%f")),
    "american": ("date and time", ", order: month first", lambda m: m.strftime("%m/%d/%Y %I:%M:%S.%f %p")),
    "named": ("date and time", "", lambda m: m.strftime("%d-Mar-%Y %H:%M:%S.%f").replace("02-Mar", "02-Mar")),
    "compact": ("date and time", "", lambda m: m.strftime("%Y%m%dT%H%M%S.%f")),
    "clock past midnight": ("clock", "", lambda m: m.strftime("%H:%M:%S.%f")),
    "clock of twelve hours": ("clock", "", lambda m: m.strftime("%I:%M:%S.%f %p")),
    "colon before ms": ("clock", "", lambda m: m.strftime("%H:%M:%S:%f")[:-3]),
    "epoch ms": ("epoch", ", unit: ms", lambda m: round((m - datetime(1970, 1, 1)).total_seconds() * 1e3)),
    "epoch us": ("epoch", ", unit: us", lambda m: round((m - datetime(1970, 1, 1)).total_seconds() * 1e6)),
    "serial days": ("serial days", "", lambda m: f"{(m - datetime(1899, 12, 30)).total_seconds() / 86400:.9f}"),
    "matlab": ("matlab days", "", lambda m: f"{719529 + (m - datetime(1970, 1, 1)).total_seconds() / 86400:.9f}"),
    "labview": ("labview", "", lambda m: f"{(m - datetime(1904, 1, 1)).total_seconds():.3f}"),
    "index": ("index", ", period: 20 ms", lambda m: round((m - BEGIN) / STEP)),
}  # fmt: skip
DATED = set(FORMS) - {"clock past midnight", "clock of twelve hours", "colon before ms", "index"}


@pytest.mark.parametrize("name", FORMS)
def test_each_form_gives_the_seconds_between_the_rows(tmp_path, name):
    written, more, text = FORMS[name]
    column = f"  t: {{is: time, written: {written}{more}}}\n"
    t, started = read(tmp_path, [text(m) for m in moments()], column)
    coarse = 1e-4 if "days" in written else 1e-6
    np.testing.assert_allclose(t - t[0], TRUE, rtol=0, atol=coarse)
    if name in DATED:
        zone = timedelta(hours=1) if "zone" in name else timedelta()
        assert abs(started.replace(tzinfo=None) + zone - BEGIN) < timedelta(milliseconds=1)
    else:
        assert started is None


def test_a_date_in_a_column_and_a_clock_in_the_next(tmp_path):
    rows = [m.strftime("%d/%m/%Y;%H:%M:%S.%f") for m in moments()]
    columns = "  d: {is: date, order: day first}\n  t: {is: time, written: clock}\n"
    t, started = read(tmp_path, rows, columns, names="d;t;p;f")
    np.testing.assert_allclose(t, TRUE, rtol=0, atol=1e-6)
    assert started.replace(tzinfo=None) == BEGIN


@pytest.mark.parametrize("text", ["X;CH1;CH2;Start;Increment\nSequence;Volt;Volt;-2.5e-03;2.0e-04"])
def test_an_oscilloscope_counts_samples_and_says_their_step_in_its_header(tmp_path, text):
    body = "\n".join(f"{k};{k};{2 * k};;" for k in range(ROWS))
    path = tmp_path / "scope.csv"
    path.write_text(f"{text}\n{body}\n")
    file = "file: {delimiter: semicolon, header: none, names: [t, p, f, a, b], skip_lines: 2}\n"
    columns = f"columns:\n  t: {{is: time, written: WRITTEN}}\n{CHANNELS}  a: ignore\n  b: ignore\n"
    (tmp_path / "map.yaml").write_text(HEAD + file + columns.replace("WRITTEN", "header step"))
    found = prepare(path, read_map(tmp_path / "map.yaml"))
    np.testing.assert_allclose(found.t, -2.5e-3 + 2e-4 * np.arange(ROWS), rtol=0, atol=1e-12)
    (tmp_path / "map.yaml").write_text(HEAD + file + columns.replace("WRITTEN", "number, unit: ms"))
    with pytest.raises(InvalidFile, match="Increment 0.0002 s: say"):
        prepare(path, read_map(tmp_path / "map.yaml"))
    path.write_text(body + "\n")
    (tmp_path / "map.yaml").write_text(
        HEAD + file.replace(", skip_lines: 2", "") + columns.replace("WRITTEN", "header step")
    )
    with pytest.raises(InvalidFile, match="no header that gives Start and Increment"):
        prepare(path, read_map(tmp_path / "map.yaml"))


def test_a_clock_that_falls_by_less_than_half_a_day_is_an_error_of_the_clock(tmp_path):
    late = [m - timedelta(hours=4) for m in moments()]
    rows = [(m - timedelta(hours=k // 50)).strftime("%H:%M:%S.%f") for k, m in enumerate(late)]
    t, _ = read(tmp_path, rows, "  t: {is: time, written: clock}\n")
    assert t[50] - t[49] == pytest.approx(0.02 - 3600)


@pytest.mark.parametrize(
    ("text", "reported"),
    [("10:20", "minutes and seconds"), ("25:61:00", "no time of the day"), ("13:00:00 PM", "no time of the day"),
     ("noon", "no clock"), ("10:20:30.", "no clock")],
)  # fmt: skip
def test_what_is_no_clock_is_refused_at_its_line(tmp_path, text, reported):
    rows = [m.strftime("%H:%M:%S.%f") for m in moments()]
    rows[7] = text
    with pytest.raises(InvalidFile, match=reported) as caught:
        read(tmp_path, rows, "  t: {is: time, written: clock}\n")
    assert caught.value.problems[0].line == 9


def test_dates_whose_order_is_open_are_refused():
    with pytest.raises(ValueError, match="day first"):
        date_seconds("01/03/2024", "year first")
    assert date_seconds("01/03/2024", "day first") - date_seconds("01/03/2024", "month first") == 58 * 86400
    assert date_seconds("1 March 2024", "year first") == date_seconds("20240301", "day first")
    with pytest.raises(ValueError, match="no day"):
        date_seconds("13/13/2024", "day first")
    with pytest.raises(ValueError, match="hours and minutes or minutes and seconds"):
        clock_seconds("10:20")
    assert clock_seconds("59:30.5") == 3570.5
    assert clock_seconds("12:00:00 am") == 0.0
    assert seconds_of(["1:02:03"], "clock", "").tolist() == [3723.0]


def test_rows_within_one_stamp_have_no_time(tmp_path):
    rows = [m.strftime("%H:%M:%S") for m in moments()]
    with pytest.raises(InvalidFile, match=r"97 of 100 time stamps equal the one before.*period"):
        read(tmp_path, rows, "  t: {is: time, written: clock}\n")


def test_a_map_that_says_two_things_of_time_is_refused(tmp_path):
    for column, reported in (
        ("  t: {is: time, written: index}\n", "period"),
        ("  t: {is: time, written: epoch}\n", "needs \"unit\""),
        ("  t: {is: time, unit: s}\n  d: {is: date}\n", "belongs to a time that is"),
    ):  # fmt: skip
        with pytest.raises(InvalidFile, match=reported):
            read(tmp_path, [0.0], column)


# -- several tests in one file, each with its own clock ------------------------------------------------------------


def test_a_repeated_header_begins_another_test_with_its_own_clock(tmp_path):
    first = "".join(f"{0.02 * k:.2f},{k},{2 * k}\n" for k in range(50))
    second = "".join(f"{5 + 0.01 * k:.2f},{k},{3 * k}\n" for k in range(60))
    path = tmp_path / "two.csv"
    path.write_text(f"t,p,f\ns,kPa,N\n{first}\nTest 2\nt,p,f\ns,kPa,N\n{second}")
    layout = "file: {delimiter: comma, header: first line, lines_below_header: 1, blank_lines: skip%s}\n"
    columns = f"columns:\n  t: {{is: time, unit: s}}\n{CHANNELS}"
    tests = "tests:\n- {name: slow, point: {contraction: 4 mm}}\n- {name: fast, point: {contraction: 8 mm}}\n"
    (tmp_path / "map.yaml").write_text(HEAD + layout % ", repeated_header: new test" + columns + tests)
    one, two = prepare_all(path, read_map(tmp_path / "map.yaml"))
    assert (one.name, two.name) == ("slow", "fast")
    np.testing.assert_allclose(one.t, 0.02 * np.arange(50))
    np.testing.assert_allclose(two.t, 5 + 0.01 * np.arange(60), atol=1e-9)
    assert two.checked[1].si.tolist() == [3.0 * k for k in range(60)]
    assert [each.named.point["contraction"] for each in (one, two)] == [0.004, 0.008]
    assert two.table.line(0) == 57
    assert not [f for each in (one, two) for f in each.findings if f.level == "fault"]
    (tmp_path / "map.yaml").write_text(HEAD + layout % "" + columns)
    with pytest.raises(InvalidFile, match="the header is repeated"):
        prepare_all(path, read_map(tmp_path / "map.yaml"))
    path.write_text(f"t,p,f\ns,kPa,N\n{first}t,p,f\ns,kPa,N\n{second}")
    with pytest.raises(InvalidFile, match="the header is repeated"):
        prepare_all(path, read_map(tmp_path / "map.yaml"))


def test_each_matrix_of_a_mat_file_is_a_test_with_its_own_clock(tmp_path):
    path, kilo = tmp_path / "ten.mat", np.arange(40.0)
    savemat(path, {f"M{k}": np.column_stack([kilo * 0.01 * k, kilo + k, 2 * kilo]) for k in range(1, 11)})
    columns = (
        'columns:\n  "{test}(:,1)": {is: time, unit: s}\n  "{test}(:,2)": {is: pressure, unit: kPa}\n'
        '  "{test}(:,3)": {is: force, unit: N}\n'
    )
    tests = "tests:\n" + "".join(f"- {{name: M{k}, point: {{pressure: {k} bar}}}}\n" for k in range(1, 11))
    (tmp_path / "map.yaml").write_text(f"{HEAD}file: {{format: mat}}\n{columns}{tests}")
    found = prepare_all(path, read_map(tmp_path / "map.yaml"))
    assert len(found) == 10
    for k, each in enumerate(found, 1):
        np.testing.assert_allclose(each.t, kilo * 0.01 * k)
        assert each.checked[0].si.tolist() == [1e3 * (p + k) for p in kilo]
        assert each.named.point == {"pressure": pytest.approx(1e5 * k)}


def test_the_clock_of_another_matrix_is_a_doubt(tmp_path):
    path, k = tmp_path / "two.mat", np.arange(40.0)
    savemat(path, {"A": np.column_stack([k * 0.01, k]), "B": np.column_stack([k * 0.02, k, 2 * k])})
    columns = 'columns:\n  "A(:,1)": {is: time, unit: s}\n  "B(:,2)": {is: pressure, unit: kPa}\n'
    (tmp_path / "map.yaml").write_text(f'{HEAD}file: {{format: mat}}\n{columns}  "B(:,3)": {{is: force, unit: N}}\n')
    (found,) = [f for f in prepare(path, read_map(tmp_path / "map.yaml")).findings if f.kind == "contradiction"]
    assert "of other matrices" in found.text


def test_a_guess_shows_one_matrix_and_how_further_tests_are_named(tmp_path):
    rng = np.random.default_rng(1)

    def matrix(step):
        t = np.arange(400) * step
        P = 150 * (1 - np.cos(2 * np.pi * t / t[-1]))
        return np.column_stack([t, P, 2 * P + 5])

    zero = np.column_stack([np.arange(300) * 0.01, 0.1 * rng.standard_normal((300, 2))])
    savemat(tmp_path / "log.mat", {"zero": zero, "slow": matrix(0.02), "fast": matrix(0.005)})
    text = map_text(guess_files([tmp_path / "log.mat"]))
    assert "if each is a test as slow is, the map then says" in text
    (tmp_path / "map.yaml").write_text(text)
    answers = [("columns.slow(:,2)", "{is: pressure, unit: kPa}"), ("columns.slow(:,3)", "{is: force, unit: N}")]
    answers += [("kind", "isometric"), ("trials.point", "{contraction: 0 mm}")]
    (slow,) = prepare_all(tmp_path / "log.mat", read_map(tmp_path / "map.yaml", answers, unresolved=True))
    assert slow.period == pytest.approx(0.02)
    tests = text.replace("slow(", "{test}(") + "tests: [{name: slow}, {name: fast}]\n"
    (tmp_path / "map.yaml").write_text(re.sub("sampling:.*", "sampling: {rate: [20 Hz, 500 Hz], gap: 1 s}", tests))
    answers = [(key.replace("slow(", "{test}("), value) for key, value in answers]
    slow, fast = prepare_all(tmp_path / "log.mat", read_map(tmp_path / "map.yaml", answers, unresolved=True))
    assert (slow.name, fast.name) == ("slow", "fast")
    assert (slow.period, fast.period) == (pytest.approx(0.02), pytest.approx(0.005))
    assert not [f for each in (slow, fast) for f in each.findings if f.kind in ("rate", "gap")]
