"""The list of columns as controllers send it, and data lines read by it: a damaged line is never a number."""

import random

import pytest
from pmabench_drivers.alicat import from_bits, trouble
from pmabench_drivers.alicat.layout import read_layout
from pmabench_drivers.shared.serial_port import Unreadable, Wrong

from tests.drivers.alicat.rigs import listing
from tests.reliability.cases import cases

UNIT_ID = ("700", "Unit ID", "string", "1", "")
GAUGE = ("006", "Gauge Press", "s decimal", "7/2", "010 02 PSIG")
SET_POINT = ("038", "Gauge Press Setpt", "s decimal", "7/2", "010 02 PSIG")
STATUS = [
    ("701", "*Error", "string", "3", "ADC"),
    *(("702", "*Status", "string", "3", c) for c in ("POV", "HLD", "EXH")),
]


def test_columns_stand_where_the_list_says():
    """A barometer in front and an unsigned set-point, as firmware 6v21 has it, change places and widths."""
    absolute = ("002", "Abs Press", "s decimal", "7/2", "010 02 PSIA")
    set_point = ("038", "Gauge Press Setpt", "decimal", "6/1", "010 02 PSIG")
    layout = read_layout(listing(UNIT_ID, absolute, set_point, GAUGE, *STATUS), "A")
    assert layout.read(b"A +014.62 0025.0 +024.98") == (24.98, 25.0, frozenset())
    assert layout.read(b"A +014.62 0025.0 -000.02 HLD POV") == (-0.02, 25.0, frozenset({"HLD", "POV"}))
    assert layout.decimals == 1
    assert [layout.columns[i].unit_code for i in (layout.pressure, layout.set_point)] == [10, 10]


def test_a_pressure_difference_to_the_open_air_counts_as_gauge_pressure():
    rows = ("007", "Diff Press", *GAUGE[2:]), ("039", "Diff Press Setpt", *SET_POINT[2:])
    assert read_layout(listing(UNIT_ID, *rows), "A").read(b"A +001.00 +002.00")[:2] == (1.0, 2.0)


@pytest.mark.parametrize(
    ("rows", "why"),
    {
        "absolute": (
            [UNIT_ID, ("002", "P", *GAUGE[2:]), ("034", "Abs Setpt", *GAUGE[2:])],
            "controls absolute pressure",
        ),
        "a meter": ([UNIT_ID, GAUGE], "no set-point of a pressure"),
        "a flow controller": ([UNIT_ID, GAUGE, ("037", "Mass Flow Setpt", *GAUGE[2:])], "no set-point of a pressure"),
        "another pressure": ([UNIT_ID, ("007", "Diff", *GAUGE[2:]), SET_POINT], "does not contain the pressure of"),
        "no unit ID": ([GAUGE, SET_POINT], "does not begin with its unit ID"),
        "no number": ([UNIT_ID, (*GAUGE[:2], "string", *GAUGE[3:]), SET_POINT], "no decimal numbers"),
        "no width": ([UNIT_ID, (*GAUGE[:3], "x", GAUGE[4]), SET_POINT], "cannot be read"),
        "no statistic": ([UNIT_ID, ("abc", *GAUGE[1:]), SET_POINT], "cannot be read"),
        "too long": ([UNIT_ID, GAUGE, SET_POINT, *(STATUS * 20)], "more than"),
    }.values(),
)
def test_what_cannot_be_driven_is_said(rows, why):
    with pytest.raises(Wrong, match=why):
        read_layout(listing(*rows), "A")


def test_a_list_that_lost_a_row_is_not_believed():
    lines = listing(UNIT_ID, GAUGE, SET_POINT, *STATUS)
    for lost in range(len(lines) - 1):
        with pytest.raises((Wrong, Unreadable)):
            read_layout(lines[:lost] + lines[lost + 1 :], "A")
    with pytest.raises(Wrong, match="firmware 6v21"):
        read_layout([b"A  D00 NAME______ TYPE______ MinVal MaxVal UNITS"], "A")
    with pytest.raises(Wrong, match="firmware 6v21"):
        read_layout([], "A")


def test_a_damaged_line_is_never_another_number():
    """Characters lost, doubled, put in or turned into something else than a digit, lines cut or run together."""
    layout, chance, whole = read_layout(listing(UNIT_ID, GAUGE, SET_POINT, *STATUS), "A"), random.Random(3), 0
    for _ in range(20 * cases(300)):
        pressure, set_point = round(chance.uniform(-99, 999), 2), round(chance.uniform(0, 999), 2)
        line = bytearray(f"A {pressure:+07.2f} {set_point:+07.2f}{chance.choice(['', ' HLD', ' ADC POV'])}".encode())
        place, kind = chance.randrange(len(line)), chance.randrange(5)
        if kind == 0:
            del line[place]
        elif kind == 1:
            line[place:place] = bytes([chance.randrange(256)])
        elif kind == 2:
            line[place] = chance.choice([*range(48), *range(58, 256)])
        elif kind == 3:
            del line[place:]
        else:
            line[place:place] = line
        try:
            found = layout.read(bytes(line))
        except (Unreadable, Wrong):
            continue
        whole += 1
        assert found[:2] == (pressure, set_point) or (abs(found[0]), abs(found[1])) == (abs(pressure), abs(set_point))
    assert whole > 0  # a space, a status or a sign may be damaged and the digits still stand


def test_a_refusal_and_another_unit_are_distinguished():
    layout = read_layout(listing(UNIT_ID, GAUGE, SET_POINT, *STATUS), "A")
    for refusal in (b"?", b"A ?"):
        with pytest.raises(Wrong, match="refuses"):
            layout.read(refusal)
    for other in (b"B +000.00 +000.00", b"@ +000.00 +000.00", b"A +000.00", b"", b"A +000.00 +000.00 XYZ", b"A" * 500):
        with pytest.raises(Unreadable):
            layout.read(other)


def test_status_bits_are_those_of_the_manual():
    """Bits 6, 8, 9, 10, 11 and 13 of the status flags; those of flow and temperature say nothing here."""
    assert from_bits(1 << 6 | 1 << 10) == {"POV", "EXH"}
    assert from_bits(1 << 8 | 1 << 9 | 1 << 11) == {"HLD", "ADC", "OPL"}
    assert from_bits(1 << 13) == {"aborted"}
    assert from_bits(0b1000010111111 & ~(1 << 6)) == frozenset()


@pytest.mark.parametrize(
    ("status", "exhausting", "said"),
    [
        ((), False, ""),
        (("LCK", "POV"), False, ""),
        (("EXH",), True, ""),
        (("EXH",), False, "exhaust is held open"),
        (("HLD",), False, "traps the pressure"),
        (("ADC", "EXH"), True, "cannot be read"),
        (("OPL",), False, "own pressure limit"),
        (("VTM",), False, "not known here"),
    ],
)
def test_what_a_status_means(status, exhausting, said):
    found = trouble(frozenset(status), exhausting=exhausting)
    assert said in found
    assert bool(said) == bool(found)
