"""What commands do with their output: closed pipes, full disks, closed streams, quiet; as programs of their own."""

import contextlib
import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmabench.cli import common
from pmabench.cli.main import main

CHECK = ["check", "static-load", "--bench", "mock", "--specimen", "mas-20-250-paper0"]
LIST = ["list", "benches"]
"""Prints pages in a tenth of the time: nothing is imported for it."""
FULL = Path("/dev/full")


def start(*args, **streams):
    code = "import sys; from pmabench.cli.main import main; sys.exit(main())"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams}
    return subprocess.Popen([sys.executable, "-c", code, *args], stdin=subprocess.DEVNULL, **pipes)


@pytest.mark.parametrize("args", [[*CHECK, "--plan"], [*LIST, "--json"], ["--help"]])
def test_a_closed_pipe_ends_quietly(args):
    reading, writing = os.pipe()
    os.close(reading)
    with start(*args, stdout=writing) as program:
        os.close(writing)
        error = program.communicate()[1]
    assert error == b""
    assert program.returncode in ({0, 1} if args == ["--help"] else {0})


@pytest.mark.skipif(not FULL.exists(), reason="not run: there is no /dev/full")
@pytest.mark.parametrize("args", [LIST, [*LIST, "--json"], ["--help"], ["schema", "bench"]])
def test_a_full_disk_behind_stdout_is_a_sentence_and_exit_7(args):
    with FULL.open("wb") as full, start(*args, stdout=full) as program:
        error = program.communicate()[1].decode()
    assert error == "the output could not be written: No space left on device; give it a place that takes it\n"
    assert program.returncode == 7


@pytest.mark.skipif(not FULL.exists(), reason="not run: there is no /dev/full")
def test_the_exit_code_of_the_work_outlasts_that_of_the_output():
    with FULL.open("wb") as full, start("check", "absent", *CHECK[2:], "--json", stdout=full) as program:
        error = program.communicate()[1]
    assert error.startswith(b"the output could not be written")
    assert program.returncode == 3


def test_a_pipe_that_breaks_inside_the_work_is_never_taken_for_the_output(monkeypatch):
    def breaks(*_args, **_kwargs):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    monkeypatch.setattr("pmabench.cli.check.prepare", breaks)
    result = CliRunner().invoke(main, CHECK)
    assert result.exit_code == 7
    assert "Broken pipe" in result.stderr


@pytest.mark.parametrize("number", [1, 2])
def test_a_closed_stream_is_no_failure(number):
    with start(*LIST, preexec_fn=lambda: os.close(number)) as program:
        program.communicate()
    assert program.returncode == 0


def test_signs_that_the_terminal_lacks_are_spelled():
    latin = {**os.environ, "PYTHONIOENCODING": "latin-1:strict"}
    with start(*CHECK, "--set", "name=∞", env=latin) as program:
        output = program.communicate()[0]
    assert program.returncode == 0
    assert rb"\u221e" in output


UNREAD = """
import sys
from pathlib import Path
from pmabench.cli import common, outcome
from pmabench.engine.run import Outcome
from pmabench.guard.safe import Vent

common.UNREAD = 0.5
over = Outcome("tripped", "x" * 200, 5, Vent("confirmed", ()), Path("runs/one"), 1.0, 10, (), {})
ui = common.Ui(json=sys.argv[1] == "json", quiet=sys.argv[1] == "quiet")
common.prepare_streams()
outcome.show_outcome(ui, over)
sys.exit(over.exit_code)
"""


@pytest.mark.parametrize("how", ["people", "json", "quiet"])
def test_a_run_that_is_over_ends_also_where_nobody_reads_how(how):
    """The pipe is full, as a terminal is that somebody has stopped."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, b"x" * 4096)
    os.set_blocking(writing, True)
    program = subprocess.Popen([sys.executable, "-c", UNREAD, how], stdout=writing, stderr=writing)
    try:
        assert program.wait(20.0) == 5
    finally:
        program.kill()
        program.wait()
        os.close(reading)
        os.close(writing)


def test_a_terminal_with_ascii_only_keeps_columns_under_their_heads():
    """A half width takes the blank behind its sign; what has no likeness is spelled as in source code."""
    code = (
        "from pmabench.cli.common import prepare_streams; prepare_streams(); print('   K [N·s/mm]\\n113.0 ± 1.9 Ж▁█')"
    )
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout == "   K [N*s/mm]\n113.0 +-1.9 \\u0416_#\n"


def test_the_line_of_what_takes_long_is_taken_away_once(monkeypatch):
    """A second time would wipe the last line of the result from the terminal."""
    ui = common.Ui(begun=True)
    written = []
    monkeypatch.setattr(common, "rewrite", lambda: written.append("wiped"))
    ui.result({}, lambda: written.append("result"))
    ui.end()
    assert written == ["wiped", "result"]
