"""Text lines: what is read, what is refused, and that reading any line is bounded."""

import math
import random
import re
import time

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pmabench_drivers.serial_ascii import LineReader, SerialIndicator, number, pattern_problem, read_options
from pmabench_drivers.shared.options import Reader
from pmabench_drivers.shared.serial_port import Splitter, Unreadable, Wrong

from pmabench.base.clock import RealClock
from tests.drivers.wires.rigs import cell, gauge


def reader(**changes):
    record, problems = cell("/dev/null", **changes), Reader()
    options = read_options(record, problems)
    assert problems.problems == []
    return LineReader(options, record.channels)


READ = {
    b"ST,+00058.86 N": 58.86,
    b"US,-00000.01 N": -0.01,
    b"ST,+00000.00 N": 0.0,
}


@pytest.mark.parametrize("line", READ)
def test_a_line_is_its_number(line):
    assert reader().values(line) == [READ[line]]


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"T,+00058.86 N",
        b"ST,+0058.86 N",
        b"ST,+00058.8",
        b"ST,+00058.86 N ST,+00058.86 N",
        b"ST,+00058,86 N",
        "ST,+0005٣.86 N".encode(),
        b"ST,+00058.86 \xb5",
        b"ST,+00058.86 N" * 30,
    ],
)
def test_a_line_that_is_not_the_pattern_is_no_number(line):
    with pytest.raises(Unreadable):
        reader().values(line)


def test_another_unit_is_no_number():
    with pytest.raises(Wrong, match='gives "kg" and the bench expects "N"'):
        reader().values(b"ST,+00006.00 kg")
    assert reader(unit="NEW").values(b"ST,+00058.86 NEW") == [58.86]


def test_a_status_that_is_not_good_is_no_number():
    with pytest.raises(Wrong, match='status "US"; good ones are ST'):
        reader(good_status=["ST"]).values(b"US,+00006.00 N")


@pytest.mark.parametrize("line", [b"OL", b"  OL  ", b"ST,OL", b"------"])
def test_over_range_is_no_number_and_no_error(line):
    [value] = reader().values(line)
    assert math.isnan(value)


def test_what_the_indicator_calls_a_fault_is_said():
    with pytest.raises(Wrong, match='"E1": load cell unplugged'):
        reader(errors={"E1": "load cell unplugged"}).values(b"E1")


def test_a_sign_may_stand_apart():
    spaced = reader(pattern=r"(?P<sign>[+-]) *(?P<value>\d+\.\d+)", good_status=[])
    assert spaced.values(b"-   12.50") == [-12.5]
    assert number("-  3.5") == -3.5
    for text in ("", "nan", "inf", "1e3", "0x1F", "1_000", "--3", "1.2.3", "+", "٣"):
        with pytest.raises(ValueError):
            number(text)


def by_hand(line):
    """An independent reading of "ST,+ddddd.dd N", column by column."""
    if len(line) != 14 or line[:3] not in {b"ST,", b"US,"} or line[12:] != b" N":
        return None
    sign, digits, cents = line[3:4], line[4:9], line[10:12]
    if sign not in {b"+", b"-"} or line[9:10] != b"." or not (digits + cents).isdigit():
        return None
    return (int(digits) + int(cents) / 100) * (-1 if sign == b"-" else 1)


GOOD = b"ST,+00058.86 N"


@settings(max_examples=500)
@given(st.one_of(
    st.binary(max_size=250),
    st.builds(lambda i, b: GOOD[:i] + b + GOOD[i + 1 :], st.integers(0, 13), st.binary(max_size=2)),
    st.builds(lambda i, j: GOOD[:i] + GOOD[j:], st.integers(0, 14), st.integers(0, 14)),
    st.text(alphabet="STU,+-0123456789. NkgOL", max_size=16).map(str.encode),
))  # fmt: skip
@example(GOOD)
@example(b"ST,+00058.86 N\n")
def test_any_line_is_read_as_by_hand_or_not_at_all(line):
    start = time.perf_counter()
    try:
        [value] = reader_once.values(line)
    except (Wrong, Unreadable):
        assert by_hand(line) is None
    else:
        wanted = by_hand(line)
        assert (math.isnan(value) and wanted is None) or value == pytest.approx(wanted, abs=1e-9)
    assert time.perf_counter() - start < 1.0


reader_once = reader()


@settings(max_examples=200)
@given(st.binary(max_size=2000), st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_lines_do_not_depend_on_how_bytes_arrive(data, sizes):
    whole, pieces = Splitter(b"\r\n"), Splitter(b"\r\n")
    wanted = whole.feed(data)
    found, position = [], 0
    while position < len(data):
        for size in sizes:
            found += pieces.feed(data[position : position + size])
            position += size
    assert [line for line in found if len(line) <= 120] == wanted
    assert all(len(line) <= 120 for line in found)


def test_what_comes_before_the_first_end_of_line_is_dropped():
    splitter = Splitter(b"\r")
    assert splitter.feed(b"8.86 N\rST,+0") == []
    assert splitter.feed(b"0058.86 N\r") == [b"ST,+00058.86 N"]


def test_a_line_without_end_costs_nothing_and_the_next_one_is_whole():
    splitter = Splitter(b"\r")
    splitter.feed(b"\r")
    for _ in range(1000):
        assert splitter.feed(b"9" * 50) == []
    assert len(splitter._rest) < 300
    assert splitter.feed(b"\rST,+00001.00 N\r") == [b"ST,+00001.00 N"]


# -- patterns -------------------------------------------------------------------------------------------------------

REFUSED = {
    r"(?P<value>(\d+)+)": "repeats a group",
    r"((?P<value>\d)*)*x": "repeats a group",
    r"(?P<value>\d+)\1": "cannot be used",
    r"(?=x)(?P<value>\d+)": "cannot be used",
    r"(?P<value>\d*\d*\d*\d*\d*)x": "too many repetitions",
    r".*.*.*(?P<value>.*).*x": "too many repetitions",
    r"\s*\d*\s*\d*\s*\d*(?P<value>\d*)\s*z": "too many repetitions",
    r"(?P<value>\d+": "no regular expression",
    r"\d+": "names no value",
    r"(?P<unit>\w+)": "names no value",
    r"(?P<sign>[+-])(?P<a>\d+) (?P<b>\d+)": "exactly one value",
    "(?P<value>" + "1" * 400 + ")": "longer than",
}


@pytest.mark.parametrize("pattern", REFUSED)
def test_patterns_that_are_refused(pattern):
    assert REFUSED[pattern] in pattern_problem(pattern)


USUAL = [
    r"(?P<status>ST|US),(?:GS|NT),(?P<value>[+-]\d{6}\.\d) {1,3}(?P<unit>[A-Za-z]{1,3})",
    r"^\s*(?P<value>[+-]?\d+\.\d+)\s*(?P<unit>[A-Za-z]+)$",
    r"[A-Z] (?P<value>[+-]\d+\.\d+) (?P<set_point>[+-]\d+\.\d+)(?: [A-Z]{3})?",
    r"!(?P<value>[+-]\d{5}\.\d{3})",
    r"G (?P<value>\d{5})",
    r"(?P<value>[ 0-9+.-]{8})",
]


@pytest.mark.parametrize("pattern", USUAL)
def test_patterns_of_usual_indicators_are_taken(pattern):
    assert pattern_problem(pattern) == ""


ATOMS = [r"\d", r"\w", ".", "[0-9]", "[A-F0-9]", "a", " ", r"\s", r"[^x]", r"\."]
TIMES = ["", "*", "+", "?", "{3}", "{1,4}", "*?", "{0,}"]


def test_whatever_pattern_is_taken_reads_hostile_lines_in_bounded_time():
    """Random patterns of overlapping classes; those that are taken are run on lines made to fail at their end."""
    chance, taken, slowest = random.Random(7), 0, 0.0
    lines = [char * 119 + "!" for char in "0a. "] + ["0a" * 59 + "!", "0 " * 59 + "!", "0" * 60 + "a" * 59 + "!"]
    for _ in range(600):
        body = "".join(chance.choice(ATOMS) + chance.choice(TIMES) for _ in range(chance.randint(1, 9)))
        pattern = f"(?P<value>{body})z"
        if pattern_problem(pattern):
            continue
        taken += 1
        compiled = re.compile(pattern)
        for line in lines:
            start = time.process_time()
            compiled.fullmatch(line)
            slowest = max(slowest, time.process_time() - start)
    assert taken > 100
    assert slowest < 1.0


@pytest.mark.parametrize(
    ("sent", "times", "since", "said"),
    [(200, 1, 0, "200"), (100, 2, 0, "200"), (100, 2, 8, "rate"), (100, 1, 0, ""), (120, 1, 0, ""), (50, 1, 0, "")],
)
def test_lines_that_come_more_often_than_the_bench_file_says_end_the_run(sent, times, since, said):
    """Lines of one piece are dated back by `rate`: at 200 lines a second behind an adapter of 16 ms by up to 6 ms too far.

    An indicator set to twice the rate, and one that sends each line twice, were recorded without a word.
    """
    device, piece, seconds, adapter = SerialIndicator(gauge("/dev/none"), RealClock()), b"", 16, 0.016
    arrives = adapter
    for line in range(seconds * sent):
        if line / sent > arrives:
            device._listen(piece, arrives)
            piece, arrives = b"", arrives + adapter * math.ceil((line / sent - arrives) / adapter)
        piece += b"+012.345mm\r\n" * (times if line / sent >= since else 1)
    failure = str(device._failure or "")
    assert (said in failure and "100 Hz" in failure) if said else not failure
