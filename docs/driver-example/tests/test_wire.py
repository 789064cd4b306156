"""The examples of device.md byte for byte: what the driver sends, and what the emulator answers."""

# ruff: noqa: S101, D103

import socket
from dataclasses import replace
from pathlib import Path

from pmabench_driver_example.wire import line, parse
from pmabench_drivers.emulator import Emulator

from pmabench.conformance import subject

BENCH = Path(__file__).resolve().parents[1] / "bench.yaml"
EXAMPLES = (
    (2, "S", b"02 S*D5\n", b"02 S 0.00*B3\n", "S 0.00"),
    (3, "S 100.00", b"03 S 100.00*15\n", b"03 S 100.00*15\n", "S 100.00"),
    (4, "V 2", b"04 V 2*2C\n", b"04 V 2 0*7C\n", "V 2 0"),
    (5, "D", b"05 D*C9\n", b"05 D 1*1A\n", "D 1"),
)
"""Number and text of a question, its bytes and those of its answer, and the text of that."""


def test_a_question_has_the_bytes_of_the_page_and_its_answer_is_understood():
    for number, text, question, answer, understood in EXAMPLES:
        assert line(number, text) == question
        assert parse(answer.rstrip(b"\n")) == (number, understood)


def test_the_emulator_answers_with_the_bytes_of_the_page():
    record = replace(subject("pmabench_driver_example:ExampleController", BENCH).record, address="127.0.0.1:0")
    emulator = Emulator([record])
    try:
        host, _, port = emulator.devices[record.name].address.rpartition(":")
        with socket.create_connection((host, int(port)), timeout=5) as connection, connection.makefile("rwb") as wire:
            for _, _, question, answer, _ in EXAMPLES:
                wire.write(question)
                wire.flush()
                assert wire.readline() == answer
    finally:
        emulator.close()
