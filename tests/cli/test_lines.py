"""The operator who answers line by line: words, readings with their unit as typed, the end of the input."""

import os

import pytest

from pmabench.base.errors import Interrupted
from pmabench.cli.outcome import AtLines


class Input:
    """Standard input from a pipe, into which somebody types when the question is there."""

    def __init__(self, text):
        self.text = text
        self.read, self.write = os.pipe()

    def fileno(self):
        return self.read

    def type(self, _question):
        os.write(self.write, self.text.encode())
        os.close(self.write)


@pytest.mark.parametrize("realtime", [True, False])
def test_only_the_word_counts_and_readings_keep_their_case(monkeypatch, capsys, realtime):
    there = Input("yes\nCLEAR\n 58.86 N \n")
    monkeypatch.setattr("sys.stdin", there)
    monkeypatch.setattr("pmabench.cli.outcome.say", there.type)
    lines = AtLines(realtime=realtime)
    assert lines.ask("Put 6 kg on.", {"pressure": 1500.0}, lambda: None) == "clear"
    assert lines.line("reading ", lambda: None) == "58.86 N"
    shown = capsys.readouterr().err
    assert shown.count("Measured pressure: 1.5 kPa") == 2
    with pytest.raises(Interrupted) as ended:
        lines.line("more ", lambda: None)
    assert ended.value.exit_code == 130


def test_time_passes_while_nobody_types(monkeypatch, capsys):
    read, write = os.pipe()
    monkeypatch.setattr("sys.stdin", type("Open", (), {"fileno": lambda self: read})())
    waits = []

    def wait():
        waits.append(1)
        if len(waits) == 3:
            os.write(write, b"clear\n")

    assert AtLines(realtime=True).ask("text", {}, wait) == "clear"
    assert len(waits) == 3
    assert "not measured" in capsys.readouterr().err
    os.close(read)
    os.close(write)
