"""Frames and lines, byte by byte, as CiA 301 and the slcan adapters' makers print them; rows of one SYNC."""

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings
from pmabench_drivers.canbus import frames as f
from pmabench_drivers.canbus.frames import Answer, Frame, NoAnswer, State, state_of
from pmabench_drivers.canbus.link import Rows, line_of, read_line


def test_questions_byte_by_byte():
    assert f.upload(0x1018, 1) == bytes.fromhex("40 18 10 01 00 00 00 00")
    assert f.download(0x1017, 0, b"\xe8\x03") == bytes.fromhex("2B 17 10 00 E8 03 00 00")
    assert f.download(0x6060, 0, b"\x08") == bytes.fromhex("2F 60 60 00 08 00 00 00")
    assert f.download(0x607A, 0, b"\x01\x02\x03\x04") == bytes.fromhex("23 7A 60 00 01 02 03 04")
    assert f.next_segment(1) == bytes.fromhex("70 00 00 00 00 00 00 00")


@pytest.mark.parametrize(
    ("text", "written", "answer"),
    [
        ("43 18 10 01 47 00 00 00", False, Answer(b"\x47\0\0\0")),
        ("4B 41 60 00 37 02 00 00", False, Answer(b"\x37\x02")),
        ("4F 61 60 00 08 00 00 00", False, Answer(b"\x08")),
        ("60 17 10 00 00 00 00 00", True, Answer()),
        ("41 08 10 00 13 00 00 00", False, Answer(segmented=True)),
        ("80 17 10 00 30 00 09 06", True, Answer(abort=0x06090030)),
    ],
)
def test_answers_byte_by_byte(text, written, answer):
    data = bytes.fromhex(text)
    index, sub = int.from_bytes(data[1:3], "little"), data[3]
    assert f.read_answer(data, index, sub, written=written) == answer
    with pytest.raises(NoAnswer):
        f.read_answer(data, index, sub + 1, written=written)


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (0x0000, State.NOT_READY),
        (0x0250, State.DISABLED),
        (0x0231, State.READY),
        (0x0233, State.ON),
        (0x1637, State.ENABLED),
        (0x0217, State.STOPPED),
        (0x021F, State.REACTING),
        (0x0218, State.FAULT),
    ],
)
def test_states_of_statuswords(word, state):
    assert state_of(word) is state


def test_every_statusword_has_one_state_or_none():
    for word in range(1 << 7):
        matching = [s for s in State if state_of(word) is s]
        assert len(matching) <= 1


def test_lines_of_frames():
    assert line_of(Frame(0x185, bytes.fromhex("1122"))) == b"t18521122\r"
    assert read_line(b"t18521122") == Frame(0x185, b"\x11\x22")
    assert line_of(Frame(0x18FEEEFE, b"\x01", extended=True)) == b"T18FEEEFE101\r"
    assert read_line(b"T18FEEEFE101") == Frame(0x18FEEEFE, b"\x01", extended=True)
    assert read_line(b"t1852112212AB") == Frame(0x185, b"\x11\x22")  # with a time
    for wrong in (b"", b"z", b"t", b"t1859", b"t18521", b"t185211223", b"tFFF0", b"t18X0", b"r1850", b"t185\xff0"):
        assert read_line(wrong) is None, wrong


@settings(max_examples=300)
@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_lines_come_back(identifier, data):
    assert read_line(line_of(Frame(identifier, data))[:-1]) == Frame(identifier, data)


@settings(max_examples=300)
@given(st.binary(max_size=30), st.integers(0, 0xFFFF), st.integers(0, 255), st.booleans())
def test_no_bytes_bring_the_decoders_down(data, index, sub, written):
    read_line(data)
    for read in (lambda: f.read_answer(data, index, sub, written=written), lambda: f.read_segment(data, sub & 1)):
        try:
            read()
        except NoAnswer:
            continue


class Done(list):
    def __call__(self, time, host):
        self.append((time, host))


def test_a_row_is_whole_when_everything_has_answered_to_its_sync():
    done = Done()
    rows = Rows({1, 2}, done, 200)
    rows.begin(1000)
    rows.arrived(1, 1100)
    rows.arrived(1, 1150)
    assert not rows.may_sync()
    rows.arrived(2, 1200)
    assert done == [(1050, 1100)]  # sampled between the SYNC and the first answer
    assert rows.may_sync()


def test_a_late_answer_belongs_to_no_later_sync():
    done = Done()
    rows = Rows({1}, done, 200)
    rows.begin(1000)
    assert [rows.may_sync() for _ in range(3)] == [False, False, True]  # given up: a gap
    rows.arrived(1, 1900)
    assert (done, rows.lost) == ([], 1)
    rows.begin(2000)
    rows.arrived(1, 2100)
    assert done == [(2050, 2100)]


def test_a_row_whose_moment_is_not_known_well_enough_is_a_gap():
    done = Done()
    rows = Rows({1, 2}, done, 200)
    rows.begin(1000)
    rows.arrived(1, 1201)
    rows.arrived(2, 1210)
    assert (done, rows.lost) == ([], 1)
    rows.begin(2000)
    rows.arrived(2, 2200)
    rows.arrived(1, 2900)  # only the first answer says when the SYNC was there at the latest
    assert (done, rows.lost) == ([(2100, 2200)], 1)
