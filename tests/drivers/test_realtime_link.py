"""The mock's plant in a process of its own: its life, its link, and what a client makes of a link that fails."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import asdict, replace
from pathlib import Path
from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pmabench_drivers.mock.client import Link, MockClient, decode, encode, parse_address

from pmabench.base.clock import RealClock, VirtualClock
from pmabench.base.errors import DeviceError
from tests.drivers.rig import record
from tests.realtime import ended, eventually, opened, plant_server, read_log, with_service

COUNT = 65.535
LONGEST = 2.0
"""A call that is bounded by 0.2 s takes less than this [s] on any machine; one that is not takes for ever."""

realtime = pytest.mark.realtime


def failing(call):
    """The sentence of a call that must fail, within its bound."""
    begin = time.monotonic()
    with pytest.raises(DeviceError) as caught:
        call()
    assert time.monotonic() - begin < LONGEST
    return str(caught.value)


# -- framing -----------------------------------------------------------------------------------------------------


HEADS = st.dictionaries(st.text(max_size=3), st.integers(), max_size=2)


class Pieces:
    """A socket from which bytes come in these pieces."""

    def __init__(self, pieces):
        self.pieces = list(pieces)

    def recv(self, _most):
        return self.pieces.pop(0) if self.pieces else b""

    def sendall(self, _data):
        pass

    setsockopt = settimeout = lambda self, *_: None


def answered(pieces):
    with patch("socket.create_connection", return_value=Pieces(pieces)):
        return Link("plant", ("127.0.0.1", 1), 1.0).ask("held", time.monotonic() + 60.0)


@given(st.lists(st.tuples(HEADS, st.binary(max_size=20)), max_size=4), st.tuples(HEADS, st.binary()), st.data())
def test_an_answer_comes_out_as_it_went_in_however_it_is_cut_and_whatever_came_before(older, newest, data):
    kept = {k: v for k, v in newest[0].items() if k not in {"bytes", "n", "error"}}
    other = [({k: v for k, v in head.items() if k != "bytes"} | {"n": 0}, payload) for head, payload in older]
    stream = b"".join(encode(head, payload) for head, payload in [*other, (kept | {"n": 1}, newest[1])])
    pieces = []
    while stream:
        cut = data.draw(st.integers(1, len(stream)))
        pieces.append(stream[:cut])
        stream = stream[cut:]
    head, payload = answered(pieces)
    assert ({k: v for k, v in head.items() if k != "bytes"}, payload) == (kept | {"n": 1}, newest[1])


@pytest.mark.parametrize("line", [b"\n", b"[1]\n", b"nonsense\n", b'{"bytes": -1}\n', b'{"bytes": "9"}\n', b"\xff\n"])
def test_what_is_no_message_is_refused(line):
    with pytest.raises(ValueError):
        answered([line])
    with pytest.raises(ValueError):
        decode(line)


@pytest.mark.parametrize("address", ["", "47807", "127.0.0.1:", "127.0.0.1:x", "192.168.0.5:47807", "127.0.0.1:0"])
def test_only_a_port_of_this_machine_is_an_address(address):
    assert "127.0.0.1:PORT is expected" in failing(lambda: parse_address("plant", address))


def test_an_answer_to_an_older_question_is_passed_over():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        link = Link("plant", listener.getsockname(), 5.0)
        other, _ = listener.accept()
        old, new = encode({"n": 0, "value": "old"}, b"1234"), encode({"n": 1, "value": "new"})
        other.sendall(old + new[:5])
        threading.Timer(0.05, other.sendall, [new[5:]]).start()
        assert link.ask("read_back", time.monotonic() + 5.0)[0]["value"] == "new"
        link.close()
        other.close()


def test_real_time_is_needed():
    device = replace(record(), address="127.0.0.1:47807")
    assert 'needs a bench with "time: real"' in failing(lambda: MockClient(device, VirtualClock()))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": 1}, "options.start: true or false is expected, not 1"),
        ({"idle": 0}, "options.idle: a value above 0 is expected, not 0"),
        ({"presset": "ideal"}, 'unknown key "presset"; did you mean "preset"'),
    ],
)
def test_options_are_checked_before_anything_is_opened(options, message):
    device = replace(record(**options), address="127.0.0.1:47807")
    assert message in failing(lambda: MockClient(device, RealClock()))


def test_the_client_loads_nothing_heavy():
    script = "import sys, pmabench_drivers.mock.client\nprint(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    heavy = {"numpy", "scipy", "pandas", "pydantic", "asyncio", "subprocess", "pmabench.model.plant"}
    assert not heavy & set(loaded)


# -- life of the process -----------------------------------------------------------------------------------------


@realtime
def test_the_plant_outlives_who_started_it_and_ends_when_nobody_comes(tmp_path):
    """A client that is killed leaves the muscle under pressure; after `idle` the plant vents and ends."""
    device, log = with_service(record(valve=True), tmp_path, start=True, idle=1.5)
    code = (
        "import json, os, sys, signal\n"
        "from pmabench.base.clock import RealClock\n"
        "from pmabench.bench.interface import device_from\n"
        "from pmabench_drivers.mock.client import MockClient\n"
        "client = MockClient(device_from(json.load(sys.stdin)), RealClock())\n"
        "client.open()\n"
        "client.switch('dump_valve', on=True)\n"
        "client.write('pressure', 300 * 65.535)\n"
        "os.killpg(os.getpgid(0), signal.SIGKILL)\n"
    )
    with ended(log):
        killed = subprocess.run(
            [sys.executable, "-c", code], input=json.dumps(asdict(device)), text=True, start_new_session=True
        )
        assert killed.returncode == -signal.SIGKILL
        with opened(device) as client:
            assert client.read_back("pressure") == pytest.approx(300 * COUNT)
        lines = eventually(lambda: [line for line in read_log(log) if line["do"] == "end"] and read_log(log))
        (serve,) = (line for line in lines if line["do"] == "serve")
        (idle,) = (line for line in lines if line["do"] == "idle")
        left = max(line["t"] for line in lines if line["do"] == "disconnect")
        assert idle["t"] - left > 1.4
        assert idle["pressure"] == pytest.approx(300e3)
        assert lines[-1]["pressure"] < 1e3
        eventually(lambda: not Path(f"/proc/{serve['pid']}").exists())


@realtime
def test_two_who_start_it_at_once_find_one_plant(tmp_path):
    device, log = with_service(record(valve=True), tmp_path, start=True)
    clients = [MockClient(device, RealClock()) for _ in range(2)]
    errors = []

    def open_one(client):
        try:
            client.open()
        except DeviceError as error:
            errors.append(error)

    with ended(log):
        threads = [threading.Thread(target=open_one, args=[client]) for client in clients]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(20)
        assert not errors
        clients[0].write("pressure", 100 * COUNT)
        assert clients[1].read_back("pressure") == pytest.approx(100 * COUNT)
        assert len([line for line in read_log(log) if line["do"] == "serve"]) == 1
        for client in clients:
            client.close()


@realtime
def test_a_plant_that_cannot_be_says_why(tmp_path):
    device, _ = with_service(record(dead_band=5.0), tmp_path, start=True)
    client = MockClient(device, RealClock())
    with pytest.raises(DeviceError, match="plant: a dead band needs a lag above 0"):
        client.open()


def test_nobody_is_started_when_that_is_not_wanted(tmp_path):
    device, _ = with_service(record(), tmp_path)
    assert "nobody listens at 127.0.0.1:" in failing(MockClient(device, RealClock()).open)


@realtime
def test_another_bench_is_taken_only_when_the_plant_is_free_and_empty(tmp_path):
    with plant_server(tmp_path, record(valve=True, seed=1)) as plant:
        other = replace(plant.device, options={**plant.device.options, "seed": 2})
        with opened(plant.device) as client:
            client.switch("dump_valve", on=True)
            client.write("pressure", 300 * COUNT)
            eventually(lambda: plant.state()["pressure"] > 299e3)
            assert "another simulated bench" in failing(MockClient(other, RealClock()).open)
        assert "under pressure" in eventually(
            lambda: (said := failing(MockClient(other, RealClock()).open)) and "pressure" in said and said
        )
        with opened(plant.device) as client:
            client.write("pressure", 0)
            eventually(lambda: plant.state()["pressure"] < 1e3)

        def taken():
            try:
                with opened(other) as client:
                    return client.read_back("pressure") == 0
            except DeviceError:
                return False

        eventually(taken)
        assert [line["do"] for line in plant.commands("serve")] == ["serve", "serve"]


# -- a link that fails -------------------------------------------------------------------------------------------


@pytest.fixture
def plant(tmp_path):
    with plant_server(tmp_path, record(valve=True, preset="bench", noise=0)) as plant:
        yield plant


@pytest.fixture
def client(plant):
    with opened(plant.device) as client:
        client.switch("dump_valve", on=True)
        client.write("pressure", 300 * COUNT)
        eventually(lambda: plant.state()["pressure"] > 299e3)
        yield client


@realtime
def test_while_calls_hang_the_second_way_vents(client, plant):
    plant.inject("hang")
    assert "did not answer in time" in failing(lambda: client.write("pressure", 500 * COUNT))
    assert "did not answer in time" in failing(client.collect)
    client.rescue("pressure", 0.0)
    client.rescue("dump_valve", 0)
    roles = [(line["do"], line["role"]) for line in plant.commands("write", "switch")[-2:]]
    assert roles == [("write", "rescue"), ("switch", "rescue")]
    eventually(lambda: plant.state()["pressure"] < 1e3)
    plant.clear("hang")
    assert client.read_back("pressure") == 0
    assert [round(line["si"]) for line in plant.commands("write")] == [300_000, 0]


@realtime
def test_a_dead_device_answers_the_second_way_neither(client, plant):
    plant.inject("dead")
    assert "did not answer in time" in failing(lambda: client.rescue("pressure", 0.0))
    plant.clear("dead")
    client.rescue("pressure", 0.0)


@realtime
def test_a_lost_link_is_reported_and_found_again(client, plant):
    plant.inject("lost")
    said = eventually(lambda: failing(lambda: client.write("pressure", 0.0)))
    assert "link lost" in said
    failing(lambda: client.rescue("pressure", 0.0))
    plant.clear("lost")
    assert client.read_back("pressure") == pytest.approx(300 * COUNT)
    assert len(plant.commands("write")) == 1


@realtime
def test_a_write_whose_answer_is_lost_is_carried_out_once_and_settled_by_read_back(client, plant):
    plant.inject("mute")
    assert "did not answer in time" in failing(lambda: client.write("pressure", 100 * COUNT))
    plant.clear("mute")
    assert client.read_back("pressure") == pytest.approx(100 * COUNT)
    assert [round(line["si"]) for line in plant.commands("write")] == [300_000, 100_000]


@realtime
def test_a_late_answer_never_counts_for_a_newer_question_and_a_late_write_is_not_carried_out(client, plant):
    pid = plant.commands("serve")[0]["pid"]
    for k in range(3):
        os.kill(pid, signal.SIGSTOP)
        try:
            failing(lambda: client.write("pressure", 555 * COUNT))  # it lies in the server's inbox now
            failing(lambda: client.read_back("pressure"))
        finally:
            os.kill(pid, signal.SIGCONT)
        wanted = (100 + k) * COUNT

        def written(wanted=wanted):
            try:
                client.write("pressure", wanted)
            except DeviceError:
                return False
            return True

        eventually(written)
        assert client.read_back("pressure") == pytest.approx(wanted)
    assert not [line for line in plant.commands("write") if line["si"] > 400e3]
    assert [line["asked"] for line in plant.commands("late")].count("write") >= 3


@realtime
def test_questions_that_make_no_sense_do_not_end_the_plant(client, plant):
    address = parse_address("plant", plant.address)
    hostile = [
        b"nonsense\n",
        b"\x00" * 100 + b"\n",
        b'{"bytes": 99999999999}\n',
        b'{"do": "write", "output": "pressure", "value": 1}\n',
        b'{"do": "hello"}\n',
        b'{"do": "hello", "role": "client"}\n',
        b'{"do": "hello", "role": "client", "zero": "x", "device": 5}\n',
        b'{"do": "hello", "role": "control"}\n{"do": "inject", "fault": 7, "errors": 3}\n{"do": "inject", "after": []}\n',
    ]
    for line in hostile:
        with socket.create_connection(address, 5) as link:
            link.sendall(line)
            link.shutdown(socket.SHUT_WR)
            while link.recv(4096):
                pass
    assert client.read_back("pressure") == pytest.approx(300 * COUNT)
    for question in ({"do": "write"}, {"do": "write", "output": "pressure", "value": "x"}, {"do": "follow"}, {}):
        with pytest.raises(DeviceError):
            client._ask(question.get("do", ""), **{k: v for k, v in question.items() if k != "do"})
    assert client.read_back("pressure") == pytest.approx(300 * COUNT)


@realtime
def test_a_program_whose_samples_another_one_takes_is_reported_so(client, plant):
    """Two programs with states of their own do not see one another's locks, and share the plant."""
    client.start(100.0)
    eventually(lambda: len(client.collect().time))
    other = Link("plant", parse_address("plant", plant.address), 5.0)
    by = time.monotonic() + 5
    try:
        other.ask("hello", by, role="client", pid=1, zero=0.0, device=asdict(plant.device))
        other.ask("start", by, rate=50.0)
        assert "is sampled by another program now (process 1)" in failing(client.collect)
        other.ask("stop", by)
        assert "process 1" in failing(client.collect)
    finally:
        other.close()
    client.start(100.0)
    eventually(lambda: len(client.collect().time))
