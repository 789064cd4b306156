"""Counts to volts: the formula at its knee and its ends, and constants that cannot be."""

import struct

import pytest
from pmabench_drivers.labjack.registers import f32, from_f32, from_u32, line_of, u32
from pmabench_drivers.labjack.stream import COUNT, Gain, gains

NOMINAL = [
    value for k in range(8) for value in (3.1580578e-4 / 10 ** (k % 4), -3.1580580e-4 / 10 ** (k % 4), 33523.0, 0.0)
]
NOMINAL += [13200.0, 0.0, 13200.0, 0.0, -92.6, 467.6, 1e-5, 2e-4, 0.0]


def test_nominal_constants_give_the_range_that_the_maker_states():
    """+-10 V has its centre at 33523 counts; count 0 is the nominal offset, -10.58695652 V."""
    gain = gains(NOMINAL)[0]
    assert gain.volts(33523) == 0.0
    assert gain.volts(0) == pytest.approx(-10.58695652, abs=2e-4)
    assert gain.volts(33523 + 31665) == pytest.approx(10.0, abs=2e-4)
    assert gains(NOMINAL)[3].volts(33523 + 31665) == pytest.approx(0.01, abs=2e-7)


def test_each_side_of_the_centre_has_its_own_slope():
    gain = Gain(2e-4, -4e-4, 1000.5)
    assert gain.volts(1001) == pytest.approx(0.5 * 2e-4)
    assert gain.volts(1000) == pytest.approx(-0.5 * 4e-4)
    table = gain.table()
    assert len(table) == 65536
    assert [table[n] for n in (0, 1000, 1001, 65535)] == [gain.volts(n) for n in (0, 1000, 1001, 65535)]


@pytest.mark.parametrize("at", [0, 1, 2, 13])
@pytest.mark.parametrize("value", [0.0, float("nan"), float("inf"), 1.0, -1e9])
def test_constants_of_no_t7_are_refused(at, value):
    constants = list(NOMINAL)
    constants[at] = value
    with pytest.raises(ValueError, match="that no T7 has"):
        gains(constants)


def test_all_constants_are_needed():
    assert len(NOMINAL) == COUNT
    with pytest.raises(ValueError, match="40 calibration constants"):
        gains(NOMINAL[:40])


def test_words_have_the_high_one_first():
    assert u32(0x00112233, 1) == [0x0011, 0x2233, 0, 1]
    assert from_u32([0x8899, 0xAABB]) == [0x8899AABB]
    assert f32(-9999.0) == list(struct.unpack(">HH", struct.pack(">f", -9999.0)))
    assert from_f32([0x40E0, 0]) == [7.0]


def test_lines_have_two_names():
    assert [line_of(name) for name in ("FIO7", "EIO0", "CIO3", "MIO2", "DIO22")] == [7, 8, 19, 22, 22]
    assert [line_of(name) for name in ("FIO8", "MIO3", "DIO23", "fio0", "AIN0", "")] == [None] * 6
