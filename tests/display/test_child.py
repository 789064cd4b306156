"""The display as a child: it never holds the run up, its keys and answers arrive, the terminal is given back."""

import json
import os
import pty
import select
import signal
import socket
import subprocess
import sys
import termios
import time
from contextlib import suppress

import pytest

from pmabench.display.child import MOST, Display, Link
from pmabench.display.console import Terminate, tidy_signals
from tests.display.recorded import Recorded

PATIENCE = 60.0
"""Only a hang lasts longer [s]."""


def until(holds, within=PATIENCE):
    """Wait for a condition; its value."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        value = holds()
        if value:
            return value
        time.sleep(0.02)
    raise AssertionError("did not happen in time")


@pytest.fixture
def folder(tmp_path):
    run = Recorded(tmp_path / "runs", [(58.86, 3e5)])
    run.load()
    yield run.folder
    run.close()


@pytest.fixture
def ends():
    """Two ends of a link."""
    ours, theirs = socket.socketpair()
    yield ours, theirs
    ours.close()
    theirs.close()


@pytest.fixture
def display(folder):
    shown = Display()
    shown.start(folder)
    yield shown
    shown.close(within=0.5)


def busy(display, count=2000):
    """All that a run says, many times; what was taken, and how long it took [s]."""
    begun = time.monotonic()
    taken = 0
    for number in range(count):
        taken += display._link.send({"live": {f"{number} " + "x" * 200: 0.0}})
        display.live({"pressure": 1e5})
        display.ask("again?", ("yes",))
        display.poll()
    return taken, time.monotonic() - begun


def test_a_display_that_is_stopped_holds_up_nothing(display):
    os.kill(display._process.pid, signal.SIGSTOP)
    taken, seconds = busy(display)
    assert taken < 2000
    assert seconds < 10.0
    assert display.alive
    display.close(within=0.2)
    assert display._process.returncode == -signal.SIGKILL


def test_a_display_that_is_killed_holds_up_nothing_and_is_noticed(display):
    os.kill(display._process.pid, signal.SIGKILL)
    until(lambda: not display.alive)
    taken, seconds = busy(display)
    assert (taken, display.poll()) == (0, [])
    assert seconds < 10.0


def test_an_end_that_never_reads_gets_what_fits_and_the_question_comes_through_in_the_end(ends):
    ours, theirs = ends
    link = Link(ours)
    sent = [n for n in range(5000) if link.send({"log": n, "pad": "x" * 500})]
    assert 10 < len(sent) < 5000
    theirs.setblocking(False)
    other, got = Link(theirs), []
    while len(got) < len(sent):
        link.flush()
        got += other.receive()
    assert [message["log"] for message in got] == sent


def test_rubbish_on_the_link_is_left_out(ends):
    ours, theirs = ends
    link = Link(ours)
    theirs.sendall(b'{"key": "r"}\nnot json\n[1]\n"x"\n\xff\xfe\n{"key"' + b'\n{"key": "p"}\n' + b"[" * 30000 + b"\n")
    theirs.sendall(b"x" * (MOST // 2))
    got = []
    until(lambda: got.extend(link.receive()) or len(got) >= 2)
    assert got == [{"key": "r"}, {"key": "p"}]
    theirs.close()
    until(lambda: (link.receive(), link.closed)[1])
    assert not link.send({"log": "x"})


@pytest.mark.parametrize(
    ("answer", "counts"),
    [
        ({"id": 1, "text": "clear"}, True),
        ({"id": 1, "text": "Clear "}, False),
        ({"id": 1, "text": "yes"}, False),
        ({"id": 2, "text": "clear"}, False),
        ({"id": 1}, False),
        ("clear", False),
    ],
)
def test_only_the_word_for_the_question_counts(answer, counts, ends):
    ours, theirs = ends
    display = Display()
    display._link = Link(ours)
    assert display.ask("Hands out?") == 1
    child = Link(theirs)
    child.send({"answer": answer})
    assert display.poll() == ([{"answer": answer}] if counts else [])
    child.send({"answer": answer})
    assert display.poll() == []


def test_without_a_terminal_there_are_plain_lines(folder, ends):
    ours, theirs = ends
    command = [sys.executable, "-m", "pmabench.display.console", str(folder), "--link", str(theirs.fileno())]
    child = subprocess.Popen(command, pass_fds=[theirs.fileno()], stderr=subprocess.PIPE, text=True)
    theirs.close()
    link = Link(ours)
    link.send({"ask": {"id": 1, "text": "Put 6 kg on.", "words": ["clear"]}})
    reported = ""
    while "asked" not in reported:
        reported += child.stderr.readline()
    link.close()
    reported += child.stderr.read()
    assert child.wait(PATIENCE) == 0
    child.stderr.close()
    assert "SIMULATED contraction-relaxation" in reported
    assert "asked: Put 6 kg on. (no terminal here: it cannot be answered)" in reported


# -- at a terminal --------------------------------------------------------------------------------------------------------

IN_FRONT = (
    "import os, sys; fd = os.open(sys.argv[1], os.O_RDWR); [os.dup2(fd, k) for k in (0, 1, 2)];"
    "os.execv(sys.executable, [sys.executable, '-m', 'tests.display.operated', *sys.argv[2:]])"
)


class AtTerminal:
    """A program with a display in the foreground of a terminal of its own."""

    def __init__(self, folder, log, *more):
        self.log = log
        self.master, slave = pty.openpty()
        termios.tcsetwinsize(self.master, (24, 80))
        self.before = termios.tcgetattr(slave)
        self.slave = slave
        command = [sys.executable, "-c", IN_FRONT, os.ttyname(slave), str(folder), str(log), *more]
        self.process = subprocess.Popen(command, start_new_session=True)
        self.seen = b""

    def drawn(self, text):
        """Read what was drawn until a text is there."""

        def there():
            if select.select([self.master], [], [], 0.05)[0]:
                with suppress(OSError):
                    self.seen += os.read(self.master, 65536)
            return text.encode() in self.seen

        until(there)

    def press(self, keys):
        os.write(self.master, keys.encode())

    def reported(self):
        """Messages that came to the program."""
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        return [json.loads(line) for line in lines]

    def until_reported(self, message):
        def reported():
            if select.select([self.master], [], [], 0)[0]:
                with suppress(OSError):
                    self.seen += os.read(self.master, 65536)
            return message in self.reported()

        until(reported)

    def keyboard(self):
        """Whether the terminal reads lines with echo, as a shell wants it."""
        return termios.tcgetattr(self.slave)[:4] == self.before[:4]

    def close(self):
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        os.close(self.master)
        os.close(self.slave)


@pytest.fixture
def terminal(folder, tmp_path, request):
    shown = AtTerminal(folder, tmp_path / "log", *getattr(request, "param", ()))
    yield shown
    shown.close()


def test_answers_keys_and_notes_arrive_and_the_terminal_is_given_back(terminal):
    terminal.drawn("6 kg on [/dev/ttyUSB0] [/].")
    terminal.drawn("measured pressure")
    terminal.drawn("1.2 kPa")
    assert not terminal.keyboard()
    terminal.press("v\x1b[A\x7f")  # typed into the answer, not a key; an arrow is nothing; taken back
    terminal.press("cleat\n")
    terminal.drawn('"cleat" does not count')
    terminal.press("CLEAR\n")
    terminal.until_reported({"answer": {"id": 1, "text": "clear"}})
    terminal.press("r")
    terminal.until_reported({"key": "r"})
    terminal.press("nhiss at the [fitting]\n")
    terminal.until_reported({"note": "hiss at the [fitting]"})
    terminal.press("v")
    terminal.until_reported({"key": "v"})
    terminal.press("\x1a\x13")  # Ctrl-Z and Ctrl-S do nothing
    terminal.press("q")
    terminal.until_reported({"over": True})
    terminal.process.wait(PATIENCE)
    assert terminal.keyboard()
    assert not [m for m in terminal.reported() if m.get("key") not in (None, "r", "v", "q")]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGKILL])
def test_however_the_display_ends_the_terminal_is_given_back(terminal, number):
    terminal.drawn("measured pressure")
    assert not terminal.keyboard()
    os.kill(terminal.reported()[0]["pid"], number)
    terminal.until_reported({"over": True})
    terminal.process.wait(PATIENCE)
    terminal.drawn("\x1b[?1049l")
    assert terminal.keyboard()


def test_ctrl_c_is_not_the_displays(terminal):
    terminal.drawn("measured pressure")
    os.kill(terminal.reported()[0]["pid"], signal.SIGINT)
    terminal.press("clear\n")
    terminal.until_reported({"answer": {"id": 1, "text": "clear"}})


@pytest.mark.parametrize("terminal", [("die",)], indirect=True)
def test_when_the_run_dies_the_display_goes_and_gives_the_terminal_back(terminal):
    terminal.drawn("measured pressure")
    terminal.press("clear\nv")
    terminal.process.wait(PATIENCE)
    assert terminal.process.returncode == 9
    terminal.drawn("\x1b[?1049l")
    until(terminal.keyboard)


def test_a_terminal_that_changes_its_size_is_drawn_anew(terminal):
    terminal.drawn("measured pressure")
    termios.tcsetwinsize(terminal.master, (12, 40))
    terminal.seen = b""
    terminal.drawn("\x1b[2J")
    terminal.drawn("measured pressure")


def test_a_signal_is_not_lost_in_code_that_catches_every_exception():
    with pytest.raises(Terminate), tidy_signals(child=True), suppress(Exception):
        signal.raise_signal(signal.SIGHUP)
