"""The operator who answers line by line, at a bench in real time."""

import os
from contextlib import suppress

import pytest

from pmabench.base.errors import Interrupted
from pmabench.cli.outcome import AtLines


class Input:
    """Standard input from a pipe."""

    def __init__(self):
        self.read, self.write = os.pipe()

    def fileno(self):
        return self.read


@pytest.fixture
def typed(monkeypatch):
    """Where a person types."""
    there = Input()
    monkeypatch.setattr("sys.stdin", there)
    yield there.write
    os.close(there.read)
    with suppress(OSError):
        os.close(there.write)


def asked(blocks):
    """Ask; before each look at the keyboard a block of bench time passes, and `blocks` type then."""
    passed = []

    def wait():
        passed.append(len(passed))
        blocks[min(len(passed), len(blocks)) - 1]()

    return AtLines(realtime=True).ask("Put 6 kg on.", {"pressure": 5100.0}, wait), len(passed)


def test_the_bench_is_watched_while_a_person_thinks_and_only_the_word_counts(typed, capsys):
    types = [
        lambda text=text: os.write(typed, text) if text else None for text in (b"", b"", b"", b"done\n", b"CLEAR\n")
    ]
    assert asked(types) == ("clear", 5)
    reported = capsys.readouterr().err
    assert "Put 6 kg on." in reported
    assert reported.count("5.1 kPa") == 2
    assert '"done" does not count' in reported


def test_what_was_typed_before_the_question_is_no_answer(typed):
    os.write(typed, b"clear\n")
    assert asked([lambda: None, lambda: None, lambda: os.write(typed, b"clear\n")]) == ("clear", 3)


def test_the_end_of_the_input_ends_the_run(typed):
    os.close(typed)
    with pytest.raises(Interrupted, match="end of input") as ended:
        asked([lambda: None])
    assert ended.value.exit_code == 130
