"""DBC files: layouts and values against cantools, another reader of the same text; and what cannot be used."""

import cantools
import hypothesis.strategies as st
import pytest
from hypothesis import given, settings
from pmabench_drivers.canbus.options import NoDatabase, read_dbc

LOAD_CELL = """\
VERSION "1"

NS_ :

BS_:

BU_: Cell Bench

BO_ 800 LoadCell: 8 Cell
 SG_ Force : 0|24@1- (0.001,0) [-8000|8000] "N" Bench
 SG_ Pressure : 39|16@0+ (0.5,-50) [0|0] "kPa" Bench
 SG_ Counter : 56|8@1+ (1,0) [0|255] "" Vector__XXX

BO_ 2566844926 Laser: 8 Cell
 SG_ Position m0 : 0|32@1- (1,0) [0|0] "um" Bench
 SG_ Which M : 32|8@1+ (1,0) [0|0] "" Bench
 SG_ Distance : 40|16@1+ (0.001,0) [0|0] "mm" Bench

BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX
 SG_ Orphan : 0|8@1+ (1,0) [0|0] "" Vector__XXX

BO_ 801 Floats: 8 Cell
 SG_ Small : 0|32@1- (1,0) [0|0] "bar" Bench

CM_ SG_ 800 Force "BO_ 9 No: 8 message";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 800 5;
SIG_VALTYPE_ 801 Small : 1;
"""


def test_messages_signals_types_and_cycle_times():
    found = read_dbc(LOAD_CELL)
    assert list(found) == ["LoadCell", "Laser", "Floats"]
    cell, laser = found["LoadCell"], found["Laser"]
    assert (cell.identifier, cell.extended, cell.length, cell.cycle) == (800, False, 8, 0.005)
    assert (laser.identifier, laser.extended, laser.cycle) == (0x18FEF1FE, True, 0.0)
    assert list(laser.signals) == ["Which", "Distance"]  # what is multiplexed is not known
    assert cell.signals["Force"].unit == "N"
    assert found["Floats"].signals["Small"].kind == "float"


def test_values_are_those_of_cantools():
    ours, theirs = read_dbc(LOAD_CELL), cantools.database.load_string(LOAD_CELL, "dbc")
    data = theirs.encode_message("LoadCell", {"Force": -1234.567, "Pressure": 321.5, "Counter": 7})
    values = {name: signal.value(data) for name, signal in ours["LoadCell"].signals.items()}
    assert values == pytest.approx({"Force": -1234.567, "Pressure": 321.5, "Counter": 7})
    data = theirs.encode_message("Floats", {"Small": -0.15625})
    assert ours["Floats"].signals["Small"].value(data) == -0.15625


@st.composite
def layouts(draw):
    """A signal somewhere in a frame of 8 bytes: start bit as the file counts it."""
    big, length = draw(st.booleans()), draw(st.integers(1, 64))
    first = draw(st.integers(0, 64 - length))
    start = 8 * (first // 8) + 7 - first % 8 if big else first
    return start, length, big, draw(st.booleans())


@settings(max_examples=300)
@given(layouts(), st.binary(min_size=8, max_size=8), st.sampled_from([(1, 0), (0.25, -40), (-0.5, 3)]))
def test_every_layout_is_read_and_written_as_cantools_does(layout, data, scaling):
    start, length, big, signed = layout
    factor, offset = scaling
    line = f" SG_ S : {start}|{length}@{0 if big else 1}{'-' if signed else '+'} ({factor},{offset})"
    text = f'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 100 M: 8 A\n{line} [0|0] "" A\n'
    signal = read_dbc(text)["M"].signals["S"]
    theirs = cantools.database.load_string(text, "dbc")
    expected = theirs.decode_message("M", data)["S"]
    assert signal.value(data) == pytest.approx(expected, rel=1e-12)
    raw = theirs.decode_message("M", data, scaling=False)["S"]
    ours = signal.put(bytes(8), raw * factor + offset) if length <= 50 else None  # a double tells no more
    if ours is not None:
        assert ours == theirs.encode_message("M", {"S": raw}, scaling=False, strict=False)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("BO_ 800 LoadCell: 8 Cell", "BO_ LoadCell", "line 9: no message can be read"),
        ("39|16@0+", "39|16@2+", "line 11: no signal can be read"),
        ("56|8@1+", "56|9@1+", "longer than its message"),
        ("(0.001,0) [-8000", "(0,0) [-8000", "a factor of 0"),
        ("BO_ 801 Floats", "BO_ 800 Floats", "there twice"),
        ("SG_ Small : 0|32", "SG_ Small : 0|16", "no floating-point number"),
        ("BO_ 801 Floats", "BO_ 80100000000000000 Floats", "too long"),
    ],
)
def test_a_file_that_cannot_be_used_says_where_and_why(old, new, reason):
    assert old in LOAD_CELL
    with pytest.raises(NoDatabase, match=reason):
        read_dbc(LOAD_CELL.replace(old, new))


def test_a_text_without_messages_is_refused():
    with pytest.raises(NoDatabase, match="has no message"):
        read_dbc("pressure,force\n1,2\n")


@settings(max_examples=300)
@given(
    st.text(max_size=200) | st.lists(st.sampled_from(LOAD_CELL.splitlines()), max_size=20).map("\n".join),
    st.binary(max_size=8),
)
def test_no_text_brings_it_down(text, data):
    try:
        messages = read_dbc(text)
    except NoDatabase:
        return
    for message in messages.values():
        for signal in message.signals.values():
            if len(data) == message.length:
                assert isinstance(signal.value(data), float | int)
