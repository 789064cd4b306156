"""The picture: as recorded, at every size, harmless whatever the run says."""

import os
import pty
import re
import socket
import termios
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmabench.display.channel import Channel
from pmabench.display.child import Link
from pmabench.display.console import LINKED, Console, rendered
from pmabench.display.lines import last_line, plain_line
from pmabench.display.state import RunState
from pmabench.display.view import Extra, Question, curve, screen
from tests.display.recorded import Recorded

PICTURES = Path(__file__).parent / "pictures"
HOSTILE = "[/dev/ttyUSB0] [/] [bold] \x1b[2J\x1b]0;gone\x07 \r\n\t\u202e\u0000 " + "x" * 5000
ESCAPES = re.compile(r"\x1b(?!\[[0-9;]*m)|[\x00-\x08\x0b-\x1a\x1c-\x1f\x7f-\x9f]")
"""Anything but text and colours."""


def poll(run, age=0.1):
    """The state at a time at which the newest sample has this age [s]."""
    state = RunState(run.folder)
    now = (run.folder / "streams" / "daq.arrows").stat().st_mtime + age
    while state.poll(now):
        pass
    return state


@pytest.fixture
def running(tmp_path):
    """In the third trial; the second was far off."""
    run = Recorded(tmp_path, [(58.86, 3e5), (107.91, 3e5), (107.91, 4e5)], name="20261121-2237_TEST")
    run.load()
    run.trial(0)
    run.trial(1, factor=1.3)
    run.begin(2)
    run.contract(2, until=3.0)
    return run


def test_what_is_seen_holds_what_is_shown_without_being_recorded(running):
    """As in a warm-up, and before a hand is let in."""
    running.end(2)
    state = RunState(running.folder)
    now = (running.folder / "streams" / "daq.arrows").stat().st_mtime + 5.0
    state.live({"pressure": 512e3, "displacement": -3e-3}, now)
    while state.poll(now):
        pass
    pressure = next(line.plain for line in screen(state, 120, 40) if line.plain.startswith("  pressure"))
    state.files.bench["realtime"] = True
    assert pressure.split()[1] == "512.0"
    assert pressure.split("…")[1].split()[0] == "512.0"
    assert "nothing is recorded now" in next(
        line.plain for line in screen(state, 120, 40) if line.plain.startswith("samples")
    )


def test_when_the_program_of_the_run_dies_the_next_command_is_there_to_be_copied(running):
    """Whole, however narrow the terminal; the words before it are wrapped."""
    master, slave = pty.openpty()
    termios.tcsetwinsize(master, (24, 40))
    one, other = socket.socketpair()
    other.close()
    with one, os.fdopen(slave, "w", encoding="utf-8") as stream:
        Console(running.folder, stream, Link(one), color=False).run()
        shown = b""
        while not shown.endswith(str(running.folder).encode() + b"\r\n"):
            shown += os.read(master, 4096)
    os.close(master)
    *words, command = shown.decode().rpartition("\x1b[?1049l")[2].split("\r\n")[:-1]
    assert command == f"  pmabench continue {running.folder}"
    assert words[-1] == "Look at the bench, then:"


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
def test_the_picture_of_a_running_trial(running, size):
    """As it was looked at and found good; delete the file to make it anew."""
    width, height = size
    lines = [line.plain.rstrip() for line in screen(poll(running), width, height, Extra(footer="q quits"))]
    path = PICTURES / f"running-{width}x{height}.txt"
    if not path.exists():
        path.write_text("\n".join(lines) + "\n", "utf-8")
        pytest.fail(f"{path.name} was made anew: look at it, and keep it where it is good")
    assert lines == path.read_text("utf-8").splitlines()


@settings(max_examples=60)
@given(width=st.integers(1, 220), height=st.integers(1, 70), asked=st.booleans())
def test_every_size_is_filled_and_never_exceeded(picture_state, width, height, asked):
    extra = Extra(Question(HOSTILE, ("clear",), HOSTILE, HOSTILE) if asked else None, footer="keys", typing=None)
    lines = screen(picture_state, width, height, extra)
    assert len(lines) == max(3, height)
    assert all(line.cell_len <= max(20, width) for line in lines)


@pytest.fixture(scope="module")
def picture_state(tmp_path_factory):
    run = Recorded(tmp_path_factory.mktemp("runs"), [(58.86, 3e5), (107.91, 3e5)])
    run.trial(0)
    run.trial(1, factor=1.3)
    return poll(run)


def test_hostile_text_stays_text(tmp_path):
    run = Recorded(tmp_path, [(58.86, 3e5)] * 2, specimen={"type": HOSTILE, "serial": HOSTILE}, kind=HOSTILE)
    run.begin(0)
    run.contract(0)
    run.writer.event("limit-reached", run.t, phase=HOSTILE, trial=0, reason=HOSTILE)
    run.writer.event("command", run.t, output=HOSTILE, type=HOSTILE, value=1.0, phase=HOSTILE, trial=0)
    run.writer.event(HOSTILE, run.t, **{HOSTILE: HOSTILE})
    run.end(0)
    run.writer.event("prompt", run.t, text=HOSTILE, phase="x", demands="vented")
    state = poll(run)
    assert state.prompt == HOSTILE
    reported = rendered(screen(state, 100, 40), 100, color=True)
    assert len(reported) == 40
    assert not [line for line in reported if ESCAPES.search(line)]
    assert any("[/dev/ttyUSB0] [/] [bold]" in line for line in reported)
    for item in state.fresh:
        assert not ESCAPES.search(plain_line(item, 2))
        assert "\x1b" not in plain_line(item, 2)
    assert "\n" not in last_line(state)


def test_without_colour_nothing_is_lost_but_colour(running):
    lines = screen(poll(running), 100, 30)
    plain, coloured = rendered(lines, 100, color=False), rendered(lines, 100, color=True)
    assert re.search(r"\x1b\[[0-9;]*3[0-7]", "".join(coloured))
    assert not re.search(r"\x1b\[(?:[0-9;]*;)?(?:3[0-7]|4[0-7]|9[0-7]|10[0-7])(?:;[0-9]+)*m", "".join(plain))
    strip = re.compile(r"\x1b\[[0-9;]*m")
    assert [strip.sub("", line) for line in plain] == [strip.sub("", line) for line in coloured]


def test_a_mark_colours_itself_only(running):
    """An `ok` is green, the numbers beside it are not; an alarm marks sign and value, not the line."""
    state = poll(running)
    state.channels["pressure"].value = 700e3
    reported = rendered(screen(state, 100, 30), 100, color=True)
    (row,) = [line for line in reported if "ok" in line and "31.59" in line]
    assert row.index("\x1b[0m") < row.index("31.59")
    (pressure,) = [line for line in reported if "pressure    " in line]
    assert "\x1b[1;37;41m!!\x1b[0mpressure" in pressure


def test_only_the_sixteen_colours_are_used(running):
    reported = "".join(rendered(screen(poll(running), 100, 30), 100, color=True))
    assert not re.search(r"\x1b\[[0-9;]*(?:38|48);", reported)


def test_a_terminal_without_unicode_gets_ascii(running):
    for line in rendered(screen(poll(running), 100, 30), 100, color=True, ascii_only=True):
        assert line.isascii(), line


def test_an_old_sample_is_marked_while_a_trial_is_recorded(running):
    def pressure(age):
        return next(line.plain for line in screen(poll(running, age), 80, 24) if line.plain.startswith("  pressure"))

    assert pressure(0.1).rstrip().endswith("  0.1 s")
    assert pressure(4.0).rstrip().endswith("! 4.0 s")


def test_curves_that_stand_still_say_why(running):
    """As in a warm-up, which is not recorded while the values of the channels go on."""

    def counts(age):
        state = poll(running, age)
        state.files.bench["realtime"] = True
        return next(line.plain for line in screen(state, 120, 40) if line.plain.startswith("samples"))

    assert "none recorded for 7 s" in counts(7.0)
    assert "none recorded" not in counts(0.5)


@pytest.mark.parametrize(
    ("value", "alarm", "sign"),
    [
        (0.0, 0, "  "),
        (580e3, 0, "  "),
        (586e3, 1, "! "),
        (650e3, 2, "!!"),
        (-26e3, 0, "  "),
        (-28e3, 1, "! "),
        (-30e3, 2, "!!"),
    ],
)
def test_signs_near_and_beyond_a_trip(tmp_path, value, alarm, sign):
    channel = Channel(
        "pressure", "pressure", -1e5, 1e6, trip_low=-30e3, trip_high=650e3, command_high=600e3, value=value
    )
    assert channel.alarm == alarm
    state = poll(Recorded(tmp_path, [(58.86, 3e5)]))
    state.channels["pressure"] = channel
    line = next(line for line in screen(state, 80, 24) if "pressure  " in line.plain)
    assert line.plain[:2] == sign


def test_beyond_what_may_be_commanded_is_near():
    channel = Channel("pressure", "pressure", 0, 1e6, trip_high=900e3, command_high=600e3, value=604e3)
    assert channel.alarm == 1


def test_a_question_shows_the_pressure_of_now_or_that_it_is_not_known(running):
    running.end(2)
    running.writer.event("prompt", running.t, text="Put 11 kg on.", phase="load", demands="vented")
    state = poll(running, age=5.0)
    assert any("not known at this moment" in line.plain for line in screen(state, 80, 24))
    now = (running.folder / "streams" / "daq.arrows").stat().st_mtime + 5.0
    state.live({"pressure": 1230.0}, now)
    state.poll(now + 0.5)
    assert any("measured pressure 1.2 kPa" in line.plain for line in screen(state, 80, 24))


DOTS = [(0, 0, 0x01), (1, 0, 0x02), (2, 0, 0x04), (0, 1, 0x08), (1, 1, 0x10), (2, 1, 0x20), (3, 0, 0x40), (3, 1, 0x80)]
"""Row, column and bit of each dot (Unicode, Braille Patterns)."""


def dots(lines):
    """Columns and rows of all dots, from the top left."""
    return [
        (2 * x + column, 4 * y + row)
        for y, line in enumerate(lines)
        for x, character in enumerate(line)
        for row, column, bit in DOTS
        if character != " " and (ord(character) - 0x2800) & bit
    ]


@pytest.mark.parametrize("slope", [1, -1])
def test_a_straight_line_is_drawn_from_corner_to_corner(slope):
    t = np.linspace(0.0, 1.0, 400)
    found = dots(curve(t, 0.5 + slope * (t - 0.5), (0.0, 1.0), (0.0, 1.0), (10, 5)))
    assert {column for column, _ in found} == set(range(20))
    for column, row in found:
        exact = 19 * (0.5 - slope * (column / 19 - 0.5))
        assert abs(row - exact) <= 1.5


def test_a_curve_leaves_out_what_is_no_number_and_what_was_not_recorded():
    t = np.linspace(0.0, 1.0, 100)
    y = np.where((t > 0.4) & (t < 0.6), np.nan, 0.0)
    assert curve(t, y, (0.0, 1.0), (0.0, 1.0), (10, 1)) == ["⣀⣀⣀⣀  ⣀⣀⣀⣀"]
    assert curve(t[:0], y[:0], (0.0, 1.0), (0.0, 1.0), (3, 2)) == ["   ", "   "]


def test_the_keys_are_reported_in_full_on_80_columns():
    assert len(LINKED) <= 80
