"""Lines, checksums and times: bits that flip, bytes of no meaning, clocks that wrap, numbers that are missing."""

import itertools
import random
import time
from pathlib import Path

import pytest
from pmabench_drivers.serial_line_daq import NoLine, Sample, Timeline, decode, encode, index_of, read_sample

from tests.reliability.cases import cases

WRAP = 1 << 32


def test_the_checksum_is_the_one_of_the_catalogue():
    """CRC-16/IBM-3740 of 123456789 is 0x29B1: the catalogue of parametrised CRC algorithms."""
    assert encode("123456789") == b"123456789*29B1\n"


def test_a_line_is_read_as_it_was_written():
    line = encode("S", 4294967295, 12, 5, -2147483648, 0, 8184)
    fields = decode(line[:-1])
    assert read_sample(fields, 3) == Sample(4294967295, 12, 5, (-2147483648, 0, 8184))


def test_no_flipped_bit_and_no_lost_or_doubled_byte_is_taken_for_a_line():
    line = encode("S", 41, 820015, 1, 512, 77, 1023)[:-1]
    damaged = [bytes([*line[:i], line[i] ^ 1 << bit, *line[i + 1 :]]) for i in range(len(line)) for bit in range(8)]
    damaged += [line[:i] + line[i + 1 :] for i in range(len(line))]
    damaged += [line[:i] + line[i : i + 1] + line[i:] for i in range(len(line)) if line[i] != line[i - 1]]
    for other in damaged:
        with pytest.raises(NoLine):
            decode(other)


@pytest.mark.parametrize("fields", [
    ("S", 1, 2, 3), ("S", 1, 2, 3, 4, 5), ("S", -1, 2, 3, 4), ("S", 1, WRAP, 3, 4), ("S", 1, 2, 256, 4),
    ("S", 1, 2, 3, 1 << 31), ("S", 1, 2, 3, "4.0"), ("S", 1, 2, 3, ""), ("S", "", 2, 3, 4), ("S", 1, 2, 3, "12345678901"),
])  # fmt: skip
def test_what_is_no_sample_of_one_count_is_refused_although_its_checksum_is_right(fields):
    with pytest.raises(NoLine):
        read_sample(decode(encode(*fields)[:-1]), 1)


def test_hostile_bytes_are_refused_in_bounded_time():
    chance = random.Random(5)
    began, taken = time.process_time(), 0
    for _ in range(cases(300) * 10):
        line = bytearray(encode("S", chance.randrange(WRAP), chance.randrange(WRAP), 1, 2, 3)[:-1])
        for _ in range(chance.randrange(1, 6)):
            line[chance.randrange(len(line))] = chance.randrange(256)
        if chance.random() < 0.1:
            line *= chance.randrange(2, 500)
        try:
            decode(bytes(line))
            taken += 1
        except NoLine:
            pass
    assert taken <= cases(300) * 10 * 2**-10  # 2**-16 would be chance, some changes change nothing
    assert time.process_time() - began < cases(300) * 0.02


def test_the_examples_of_the_page_are_lines_of_the_protocol():
    page = (Path(__file__).parents[3] / "docs" / "devices" / "serial-line-daq.md").read_text()
    examples = [line[3:].encode() for line in page.splitlines() if line[:3] in {"-> ", "<- "}]
    assert [encode(*decode(line)) for line in examples] == [line + b"\n" for line in examples]
    assert len(examples) == 5


def test_names_of_pins():
    assert [index_of(name, "a") for name in ("a0", "a5", "a6", "d0", "a", "a00", "x")] == [
        0,
        5,
        None,
        None,
        None,
        None,
        None,
    ]


def line_of(period, numbers, clock=lambda number: 0.0, start=0):
    """What a timeline says to samples with these numbers, taken by an exact clock plus `clock(number)` [us]."""
    timeline, times = Timeline(period), []
    for number in numbers:
        micros = start + number * period + round(clock(number))
        times.append(timeline.place(Sample(number % WRAP, micros % WRAP, 0, ()), 100.0 + number * period * 1e-6))
    return timeline, times


def test_time_is_the_boards_and_goes_on_when_its_clock_and_its_number_wrap():
    start = WRAP - 50_000
    _, times = line_of(2000, range(WRAP - 20, WRAP + 80), start=start)
    assert [b - a for a, b in itertools.pairwise(times)] == [2000] * 99


def test_what_is_lost_is_counted_and_stays_a_gap_at_its_place():
    kept = [n for n in range(1000) if n not in {10, 500, 501, 502}]
    timeline, times = line_of(5000, kept)
    assert timeline.lost == 4
    steps = {kept[i + 1]: times[i + 1] - times[i] for i in range(len(kept) - 1)}
    assert {n: step for n, step in steps.items() if step != 5000} == {11: 10000, 503: 20000}


def test_late_samples_are_believed_and_doubled_ones_are_not_taken_twice():
    timeline, times = line_of(5000, [0, 1, 1, 2, 3], clock=lambda n: 3000 if n == 2 else 0)
    assert times == [times[0], times[0] + 5000, None, times[0] + 13000, times[0] + 15000]
    assert timeline.lost == timeline.misfits == 0


@pytest.mark.parametrize("wrong", [(3, 500_000), (0, 0), (WRAP - 1, 10_000), (1_000_000, 10_000), (2, 0), (3, 9_900)])
def test_a_sample_whose_number_and_clock_do_not_fit_is_not_believed(wrong):
    timeline = Timeline(5000)
    timeline.place(Sample(1, 5_000, 0, ()), 1.0)
    assert timeline.place(Sample(*wrong, 0, ()), 1.01) is None
    assert timeline.misfits == 1
    assert timeline.place(Sample(2, 10_000, 0, ()), 1.01) is not None
    assert timeline.misfits == timeline.lost == 0
