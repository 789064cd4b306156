"""Scans of a DATAQ device as bytes: conversions of the protocol, divisors, and that no lost byte makes a false value."""

import random
import struct

import pytest
from pmabench_drivers.dataq import DIVIDEND, MODELS, Dataq, Lost, Scans, counts, divisors, packet, plausible, volts

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from tests.drivers.dataq.rigs import daq
from tests.reliability.cases import cases

HIGH = 0x7F00
"""D6 to D0 high in the high byte; D1 and D0 complemented in the low one."""


def test_words_as_volts():
    """16 bits with sign are the whole range; of a DI-1110 the upper 12 are."""
    sixteen, twelve = MODELS["DI-4108"], MODELS["DI-1110"]
    assert volts(sixteen, 10.0, 16384) == 5.0
    assert volts(sixteen, 0.2, -32768) == -0.2
    assert volts(twelve, 10.0, 0x4000) == 5.0
    assert volts(twelve, 10.0, 0x400F) == 5.0  # the low four bits are no data
    assert volts(twelve, 10.0, -32768) == -10.0
    for model in MODELS.values():
        assert volts(model, 10.0, counts(model, 10.0, 5.0)) == 5.0
        assert volts(model, 10.0, counts(model, 10.0, 99.0)) < 10.0
        assert volts(model, 10.0, counts(model, 10.0, -99.0)) == -10.0


@pytest.mark.parametrize("rate", [10.0, 50.0, 100.0, 500.0, 1000.0, 4000.0, 10000.0])
@pytest.mark.parametrize("name", ["DI-2108", "DI-4108"])
def test_the_rate_divides_the_clock_and_the_divisors_are_allowed(name, rate):
    srate, dec = divisors(MODELS[name], rate, DIVIDEND)
    assert 60e6 / (srate * dec) == rate
    assert 375 <= srate <= 65535
    assert 1 <= dec <= 512


def test_a_rate_that_does_not_divide_is_the_nearest_and_one_without_dec_has_a_lowest():
    srate, dec = divisors(MODELS["DI-2108"], 333.3, DIVIDEND)
    assert 60e6 / (srate * dec) == pytest.approx(333.3, rel=1e-4)
    assert divisors(MODELS["DI-1110"], 100.0, DIVIDEND) == (65535, 1)  # 915.5 Hz
    assert divisors(MODELS["DI-1110"], 1000.0, DIVIDEND) == (60000, 1)


def test_packets_fill_soon():
    assert packet(3000.0) == 1  # 32 bytes in 11 ms
    assert packet(100.0) == 0
    assert packet(1e6) == 7


def test_the_word_of_the_digital_inputs():
    assert plausible(HIGH)
    assert plausible(0x0003)  # both low
    assert plausible(0x7D02)  # D1 low
    assert not plausible(0x0000)
    assert not plausible(0xFF00)


def stream(values):
    return b"".join(struct.pack("<hhH", *row, HIGH) for row in values)


def read(data, chance=None):
    """Scans up to the first loss, in pieces of any size; whether there was one, and in which scan of the stream."""
    scans, found, at = Scans(2), [], 0
    while at < len(data):
        size = chance.randint(1, 25) if chance else len(data)
        try:
            found += scans.feed(data[at : at + size])
        except Lost:
            return found + scans.whole, True
        at += size
    return found, False


def test_whole_scans_in_pieces_of_any_size():
    chance = random.Random(1)
    values = [(chance.randint(-32768, 32767), i) for i in range(500)]
    assert read(stream(values), chance) == (values, False)


@pytest.mark.parametrize("case", range(cases(300)))
def test_lost_or_added_bytes_are_noticed_in_the_scan_where_they_are(case):
    """Signals at rest, as at a bench, and moving ones; not a single scan behind the place is taken for a measurement."""
    chance = random.Random(case)
    rest = chance.randint(-2000, 32000)
    moving = chance.random() < 0.5
    values = [(chance.randint(-32768, 32000) if moving else rest, chance.choice([0, rest])) for _ in range(60)]
    data = bytearray(stream(values))
    at = chance.randrange(6, len(data) - 60)
    if chance.random() < 0.5:
        number = chance.choice([n for n in range(1, 24) if n % 6])
        del data[at : at + number]
    else:
        number = chance.choice([n for n in range(1, 24) if n % 6])
        data[at:at] = chance.randbytes(number)
    found, lost = read(bytes(data), chance)
    assert lost
    assert found[: at // 6] == values[: at // 6]
    assert len(found) <= at // 6 + 1 + number // 6
    assert all(row in values for row in found[at // 6 + 1 + number // 6 :])


def test_an_input_that_is_switched_is_no_loss():
    """A push-button on D0, D4 and both, which bounces; each scan of them is a measurement, in pieces of any size."""
    chance = random.Random(3)
    words = [HIGH] * 20 + [0x7E01, HIGH, 0x7E01, HIGH] + [0x7E01] * 20 + [0x6E01] * 5 + [HIGH] * 20
    values = [(chance.choice([0, 9830, -5]), chance.randint(-32768, 32767)) for _ in words]
    data = b"".join(struct.pack("<hhH", *row, word) for row, word in zip(values, words, strict=True))
    for _ in range(50):
        assert read(data, chance) == (values, False)


@pytest.mark.parametrize("signal", [0x7E01, 0x6E01, 0x0003])
def test_a_shifted_scan_is_a_loss_also_where_a_signal_looks_like_the_digital_inputs(signal):
    """What stands in the place of the inputs for good is a value of `a0` or `a1` that they could have as well."""
    values = [(signal, signal)] * 30
    for number in (1, 2, 3, 4, 5, 7, 8, 10):
        data = bytearray(stream(values))
        del data[60 : 60 + number]
        found, lost = read(bytes(data), random.Random(number))
        assert lost
        assert found == values[:10]


def test_the_word_of_an_overrun_is_a_loss_and_no_scan():
    scans = Scans(7)  # of 16 bytes: the word alone fills none
    row = struct.pack("<7hH", *range(7), HIGH)
    assert scans.feed(row * 3) == [tuple(range(7))] * 3
    with pytest.raises(Lost):
        scans.feed(b"stop 01")
    for part in range(6):
        values = [(100, 200)] * 10
        found, lost = read(stream(values)[: 60 - part] + b"stop 01")
        assert lost
        assert set(found) == {(100, 200)}


def test_hostile_bytes_are_read_in_bounded_memory():
    chance = random.Random(5)
    for _ in range(cases(300)):
        scans = Scans(2)
        for _piece in range(20):
            try:
                scans.feed(chance.randbytes(100))
            except Lost:
                assert scans._rest == b"" or len(scans._rest) < 6 + 100
        assert len(scans._rest) <= 106


WRONG = {
    "no model": ({"model": None}, ("options", "model"), "is not known here"),
    "a DI-1100, whose scans have no mark": ({"model": "DI-1100"}, ("options", "model"), "is not known here"),
    "a range that the model has not": ({"ranges": {"a0": "5 V"}}, ("options", "ranges", "a0"), "is not known here"),
    "a range of no input": ({"ranges": {"b0": "10 V"}}, ("options", "ranges", "b0"), "unknown key"),
    "ranges that are none": ({"ranges": "10 V"}, ("options", "ranges"), "keys and values"),
    "an unknown filter": ({"filter": "median"}, ("options", "filter"), "is not known here"),
    "a filter where there is none": ({"model": "DI-1110", "filter": "average"}, ("options", "filter"), "nothing to"),
    "an unknown key": ({"modl": "DI-2108"}, ("options", "modl"), 'did you mean "model"'),
    "another input": ({"inputs": ("a8", "a3")}, ("channels", "pressure", "input"), 'no input "a8"'),
    "another unit": ({"unit": "count"}, ("channels", "pressure"), "gives V"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_option_is_named_at_its_place(what):
    changes, place, message = WRONG[what]
    record = daq("/dev/ttyACM0", **changes)
    found = list(Dataq.check(record))
    assert any(at == place and message in text for at, text in found), found
    with pytest.raises(DeviceError, match="^daq: "):
        Dataq(record, RealClock())


def test_good_options_have_no_problem():
    assert list(Dataq.check(daq("/dev/ttyACM0"))) == []
    assert list(Dataq.check(daq("/dev/ttyACM0", model="DI-4108", ranges={"a0": "0.5 V"}, filter="average"))) == []
    assert [place for place, _ in Dataq.check(daq(""))] == [("address",)]
