"""The operator at a terminal without a picture, at a bench in real time."""

import os

import pytest

from pmabench.base.errors import Interrupted
from pmabench.cli.operator import InLines


@pytest.fixture
def terminal():
    """What a person types into and what the operator reads from."""
    read, write = os.pipe()
    yield read, write
    os.close(read)
    os.close(write)


def asked(fd, blocks):
    """Ask; before each look at the keyboard a block of bench time passes, and `blocks` type then."""
    reported, passed = [], []

    def wait():
        passed.append(len(passed))
        blocks[min(len(passed), len(blocks)) - 1]()

    answer = InLines(reported.append, fd).ask("Put 6 kg on.", {"pressure": 5100.0}, wait)
    return answer, reported, len(passed)


def test_the_bench_is_watched_while_a_person_thinks_and_only_the_word_counts(terminal):
    read, write = terminal
    types = [
        lambda text=text: os.write(write, text) if text else None for text in (b"", b"", b"", b"done\n", b"CLEAR\n")
    ]
    answer, reported, passed = asked(read, types)
    assert (answer, passed) == ("clear", 5)
    assert "Put 6 kg on." in reported[0]
    assert "5.1 kPa" in reported[0]
    assert '"done" does not count' in reported[1]


def test_what_was_typed_before_the_question_is_no_answer(terminal):
    read, write = terminal
    os.write(write, b"clear\n")
    answer, _, passed = asked(read, [lambda: None, lambda: None, lambda: os.write(write, b"clear\n")])
    assert (answer, passed) == ("clear", 3)


def test_the_end_of_the_input_ends_the_run():
    read, write = os.pipe()
    os.close(write)
    with pytest.raises(Interrupted, match="end of input") as ended:
        asked(read, [lambda: None])
    os.close(read)
    assert ended.value.exit_code == 130
