"""The guard's program from its start to its end, in the process of the test: what it says, keeps and takes away."""

import io
import json
import signal
import socket
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest

from pmabench.guard import process
from pmabench.guard.remote import exchange
from pmabench.guard.station import Station
from tests.guard.rig import BENCH, DEVICE, Rig
from tests.realtime import eventually

PATIENCE = 30.0
"""An answer may take so long where others want the cores first [s]; how soon it comes is asked elsewhere."""


class Said(io.StringIO):
    """Standard output that can be read after it was closed."""

    def close(self):
        self.text = self.getvalue()


@pytest.fixture
def program(monkeypatch):
    """Standard input and output of the program; its signal handlers are given back."""
    before = [(number, signal.getsignal(number)) for number in (signal.SIGTERM, signal.SIGINT)]
    said = Said()
    given = {
        "bench": json.loads(
            replace(BENCH, name="program", devices=(replace(DEVICE, address="127.0.0.1:9"),)).to_json()
        ),
        "start": time.monotonic(),
        "user": "ann",
    }
    streams = SimpleNamespace(stdin=io.StringIO(json.dumps(given) + "\n"), stdout=said)
    monkeypatch.setattr(process, "sys", streams)
    yield said
    for number, handler in before:
        signal.signal(number, handler)


def engine(problems, *requests):
    """What an engine does, in a thread of its own."""

    def act():
        try:
            here = eventually(lambda: Station("program").read("guard"))
            with socket.create_connection(("127.0.0.1", here["port"])) as link:
                for do, data in requests:
                    message = {"do": do, "at": time.monotonic(), **data}
                    problems.append(exchange(link, message, here["token"], PATIENCE)[0].get("error"))
        except Exception as error:
            problems.append(error)

    thread = threading.Thread(target=act)
    thread.start()
    return thread


def test_it_serves_an_engine_vents_when_it_is_gone_and_leaves_nothing_behind(program):
    problems = []
    thread = engine(problems, ("open", {}), ("arm", {"run": ""}), ("set", {"name": "pressure", "value": 3e5}))
    process.main()
    thread.join()
    assert problems == [None] * 3
    here = json.loads(program.text)
    assert (here["user"], Station("program").read("guard")) == ("ann", {})
    assert Station("program").read("state")["what"] == "tripped"
    assert Station("program").read("bench")["name"] == "program"
    assert Station("program").read("state")["devices"] == ["127.0.0.1:9 unit 1"]
    rig = Rig.made["dac"]
    assert [reported for reported in rig.values("write") if reported[1] == "p"][-1] == ("write", "p", 0.0)
    assert rig.reported[-1] == ("close",)
    assert rig.values("disarm_watchdog"), "the vent was confirmed"


def test_it_ends_cleanly_where_the_engine_says_so(program):
    problems = []
    thread = engine(
        problems, ("open", {}), ("arm", {"run": ""}), ("safe", {"tripped": False, "hurry": False, "why": "end"}),
        ("bye", {}),
    )  # fmt: skip
    process.main()
    thread.join()
    assert problems == [None] * 4
    assert Station("program").latched() == ""


def test_a_bench_that_is_taken_is_reported(program):
    Station("program").folder.mkdir(parents=True)
    other = Station("program")
    other.take()
    process.main()
    assert "in use by" in json.loads(program.getvalue())["busy"]
