"""What an ILD1420 sends: the printed conversion, bytes by hand, and that no hostile byte makes a false distance."""

import math
import random

import pytest
from pmabench_drivers.ild1420 import (
    SPANS,
    WRAP,
    CounterBroken,
    Decoder,
    Ild1420,
    Numbering,
    code_of,
    distance,
    encode,
    misset,
)

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from tests.drivers.ild1420.rigs import laser
from tests.reliability.cases import cases


def numbered(data, pieces=None):
    """(number, code) of what is believed; the stream in pieces of any size."""
    decoder, numbering, found, at = Decoder(), Numbering(10_000), [], 0
    while at < len(data):
        size = len(data) if pieces is None else pieces.randint(1, 20)
        for code, counter in decoder.feed(data[at : at + size]):
            number = numbering.place(counter)
            if number is not None:
                found.append((number, code))
        at += size
    return found, decoder, numbering


@pytest.mark.parametrize("span", SPANS)
def test_the_printed_conversion(span):
    """d = 1/100 (102/65520 x - 1) MR; 643 and 64877 are the ends of the range, 0 and 65520 those of the reserve."""
    assert distance(643, span) == pytest.approx(0.0, abs=2e-5 * span)
    assert distance(64877, span) == pytest.approx(span, abs=2e-5 * span)
    assert distance(0, span) == pytest.approx(-0.01 * span)
    assert distance(65520, span) == pytest.approx(1.01 * span)
    assert distance(32760, span) == pytest.approx(0.5 * span)
    assert code_of(0.5 * span, span) == 32760
    assert code_of(1.02 * span, span) == 262078
    assert code_of(-0.02 * span, span) == 262077


def test_bytes_by_hand():
    """32760 = 0b0111_111111_111000: low 00 111000, middle 01 111111, high 10 000111; counter 5 with marks 00 01 11."""
    data = bytes([0b00111000, 0b01111111, 0b10000111, 0b00000101, 0b01000000, 0b11000000])
    assert encode(32760, 5) == data
    assert Decoder().feed(data) == [(32760, 5)]
    assert Decoder().feed(encode(262076, WRAP - 1)) == [(262076, WRAP - 1)]


@pytest.mark.parametrize("code", [*range(262074, 262084), 65521, 70000, 262073])
def test_what_is_no_distance_is_no_number(code):
    assert math.isnan(distance(code, 100))
    assert bool(misset(code)) == (code not in {262076, 262077, 262078, 262080, 262081})


def test_what_is_set_wrong_is_said():
    assert misset(262075) == "sends more than its baud rate can carry"
    assert "laser switched off" in misset(262082)
    assert "master value" in misset(70000)
    assert misset(65520) == ""


def test_the_counter_may_begin_again():
    data = b"".join(encode(i % 60000, (WRAP - 50 + i) % WRAP) for i in range(100))
    found, _decoder, numbering = numbered(data)
    assert found == [(i, i + 1) for i in range(99)]
    assert numbering.lost == 0


def test_a_lost_measurement_is_missed_at_its_place():
    data = b"".join(encode(i, i) for i in range(100) if not 40 <= i < 47)
    found, _decoder, numbering = numbered(data)
    assert [code for _, code in found] == [*range(1, 40), *range(48, 100)]
    assert all(number == code - 1 for number, code in found)
    assert numbering.lost == 8  # seven never came; the first behind them may be put together from two


def test_each_measurement_twice_is_each_once():
    found, _, _ = numbered(b"".join(encode(i, i) * 2 for i in range(50)))
    assert [code for _, code in found] == list(range(1, 50))


def test_a_counter_that_is_set_back_is_an_error():
    numbering = Numbering(10_000)
    for counter in (100, 101, 102):
        numbering.place(counter)
    assert numbering.place(0) is None
    with pytest.raises(CounterBroken):
        numbering.place(1)


def test_a_disturbed_counter_makes_no_gap_in_what_follows():
    numbering = Numbering(10_000)
    placed = [numbering.place(counter) for counter in (10, 11, 12, 13 + 256, 14, 15, 16)]
    assert placed == [None, 0, 1, None, None, 4, 5]


@pytest.mark.parametrize("case", range(cases(300)))
def test_lost_bytes_never_make_a_false_distance(case):
    """Bytes are lost anywhere: what is believed has its own distance and its own number; soon after, all is well."""
    chance = random.Random(case)
    codes = [chance.randint(0, 65520) for _ in range(400)]
    stream = [byte for i, code in enumerate(codes) for byte in encode(code, i)]
    for _ in range(chance.randint(1, 12)):
        at = chance.randrange(600, len(stream) - 600)
        del stream[at : at + chance.randint(1, 40)]
    found, _decoder, numbering = numbered(bytes(stream), chance)
    assert all(codes[number + 1] == code for number, code in found)
    assert len({number for number, _ in found}) == len(found)
    assert found[-1][0] == 398
    assert len(found) + numbering.lost == 399
    assert numbering.lost > 0
    assert numbering.lost <= 12 * (40 // 6 + 6)


@pytest.mark.parametrize("case", range(cases(300)))
def test_bytes_too_many_never_make_a_false_distance(case):
    """One to three bytes of any value are put in anywhere, some measurements apart from the next ones."""
    chance = random.Random(1000 + case)
    codes = [chance.randint(0, 65520) for _ in range(300)]
    stream = [byte for i, code in enumerate(codes) for byte in encode(code, i)]
    for block in range(280, 10, -chance.randint(6, 40)):
        at = 6 * block + chance.randrange(6)
        stream[at:at] = chance.randbytes(chance.randint(1, 3))
    found, _decoder, numbering = numbered(bytes(stream), chance)
    assert all(codes[number + 1] == code for number, code in found)
    assert found[-1][0] == 298
    assert len(found) + numbering.lost == 299


def test_hostile_bytes_are_read_in_bounded_work_and_memory():
    chance = random.Random(7)
    for _ in range(cases(300)):
        decoder, numbering = Decoder(), Numbering(1000)
        for code, counter in decoder.feed(chance.randbytes(2000)):
            assert 0 <= code < WRAP
            numbering.place(counter)
        assert len(decoder._bits) < 6


WRONG = {
    "no range": ({"range": None}, ("options", "range"), "is not known here"),
    "a range it is not made in": ({"range": "40 mm"}, ("options", "range"), "is not known here"),
    "a rate without unit": ({"rate": 1000}, ("options", "rate"), "with its unit"),
    "a rate that it has not": ({"rate": "8 kHz"}, ("options", "rate"), "outside 100 to 4000 Hz"),
    "a rate that the line cannot carry": ({"baud": 115200, "rate": "2 kHz"}, ("options", "rate"), "need 120000 baud"),
    "a baud rate that it has not": ({"baud": 921601}, ("options", "baud"), "not possible here"),
    "an unknown key": ({"rnge": "100 mm"}, ("options", "rnge"), 'did you mean "range"'),
    "another input": ({"input": "distnce"}, ("channels", "displacement", "input"), 'did you mean "distance"'),
    "another unit": ({"unit": "V"}, ("channels", "displacement"), "gives mm"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_option_is_named_at_its_place(what):
    changes, place, message = WRONG[what]
    record = laser("/dev/ttyUSB0", **changes)
    found = list(Ild1420.check(record))
    assert any(at == place and message in text for at, text in found), found
    with pytest.raises(DeviceError, match="^laser: "):
        Ild1420(record, RealClock())


def test_good_options_have_no_problem():
    assert list(Ild1420.check(laser("/dev/ttyUSB0"))) == []
    assert [place for place, _ in Ild1420.check(laser(""))] == [("address",)]
