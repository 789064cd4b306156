"""`pmabench emulate` as a process: what it prints, serves and refuses, and that it cleans up."""

import json
import re
import socket
import subprocess
import sys
import time
from itertools import pairwise

import pytest

from pmabench.bench.compile import mount
from tests.drivers.common import opened
from tests.drivers.emulated_bench import ask, emulate
from tests.drivers.wires.test_options import SPECIMEN, bench
from tests.ports import free_port

pytestmark = pytest.mark.realtime


def own_bench(tmp_path):
    path = bench(tmp_path, "127.0.0.1:15020", f"127.0.0.1:{free_port()}")
    path.write_text(path.read_text().replace("/tmp/pmabench-wires", str(tmp_path / "ports")))
    return path


def test_a_bench_is_served_where_its_file_says_and_the_drivers_find_it(tmp_path):
    path, log = own_bench(tmp_path), tmp_path / "log.jsonl"
    devices = {device.name: device for device in mount(path, SPECIMEN).bench.devices}
    with emulate(path, "--log", str(log)) as (_process, said):
        assert said["devices"] == {name: device.address for name, device in devices.items()}
        for device in devices.values():
            with opened(device) as driver:
                driver.start(50.0)
        with opened(devices["regulator"]) as regulator:
            regulator.switch("dump_valve", on=True)
            regulator.write("pressure", 1234.0)
        assert ask(said["control"], load={"force": 58.86, "mass": 8.0}) == {"ok": True}
        assert ask(said["control"], device="regulator", fault="hang-up") == {"ok": True}
        assert "did you mean" in ask(said["control"], device="regulator", fault="hang-ups")["why"]
        assert "did you mean" in ask(said["control"], plant="bursts")["why"]
        assert ask(said["control"], log="set")["entries"][0]["si"] == pytest.approx(123400.0)
        assert ask(said["control"], nothing=1)["ok"] is False
    logged = [json.loads(line) for line in log.read_text().splitlines()]
    assert [(e["output"], e["raw"]) for e in logged if e["kind"] == "set"] == [("pressure", 1234.0)]
    assert all(a["t"] <= b["t"] for a, b in pairwise(logged))
    assert not list((tmp_path / "ports").iterdir())


def until(met, seconds=10.0):
    end = time.monotonic() + seconds
    while not met() and time.monotonic() < end:
        time.sleep(0.02)
    assert met()


def test_a_free_port_is_printed_and_what_was_planned_and_typed_happens_and_is_logged(tmp_path):
    path, log, plan = own_bench(tmp_path), tmp_path / "log.jsonl", tmp_path / "plan.txt"
    path.write_text(re.sub(r"address: 127.0.0.1:\d+", "address: 127.0.0.1:0", path.read_text()))
    plan.write_text("fault regulator exception 6 count 1 after 200 ms\nload 6 kg after 10 ms\n")

    def logged(*kinds):
        return [entry for entry in map(json.loads, log.read_text().splitlines()) if entry["kind"] in kinds]

    with emulate(path, "--log", str(log), "--faults", str(plan)) as (process, said):
        host, port = said["devices"]["regulator"].split(":")
        assert int(port) > 0
        until(lambda: logged("load") and [e for e in logged("fault") if e["fault"] == "exception"])
        with socket.create_connection((host, int(port)), timeout=5) as link:
            link.settimeout(5)
            asked = bytes.fromhex("123400000006010400000001")
            link.sendall(asked)
            assert link.recv(100) == bytes.fromhex("123400000003018406")
            process.stdin.write("fault regulator corrupted 2 count 1\n")
            until(lambda: [e for e in logged("fault") if e["fault"] == "corrupted"])
            link.sendall(asked)
            assert link.recv(100)[:4] == bytes.fromhex("1234ff00")
    assert logged("load")[0]["force"] == pytest.approx(58.86)
    exchanged = [e for e in logged("received", "sent") if e["device"] == "regulator"]
    assert [e["kind"] for e in exchanged] == ["received", "sent"] * 2
    assert [e["data"] for e in exchanged[:3]] == [asked.hex(), "123400000003018406", asked.hex()]
    assert exchanged[3]["data"].startswith("1234ff00")


def refused(*arguments):
    command = [sys.executable, "-m", "pmabench", "emulate", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL)
    assert "Traceback" not in done.stderr
    return done.returncode, done.stderr


def test_what_cannot_be_served_is_refused_in_a_sentence(tmp_path):
    code, why = refused("mock")
    assert code == 2
    assert "no device whose driver has an emulator" in why
    path = own_bench(tmp_path)
    text = path.read_text()
    elsewhere = tmp_path / "elsewhere.yaml"
    elsewhere.write_text(text.replace("address: 127.0.0.1:", "address: 192.168.0.5:"))
    code, why = refused(elsewhere)
    assert code == 2
    assert "192.168.0.5" in why
    assert "--expose" in why
    occupied = tmp_path / "ports"
    occupied.mkdir()
    (occupied / "gauge").write_text("something of value")
    code, why = refused(path)
    assert code == 2
    assert "is no link of an emulator" in why
    assert (occupied / "gauge").read_text() == "something of value"
    assert refused("nothing")[0] == 3


def test_the_port_may_be_taken(tmp_path):
    path = own_bench(tmp_path)
    port = int(path.read_text().split("address: 127.0.0.1:")[1].split()[0])
    with socket.create_server(("127.0.0.1", port)):
        code, why = refused(path)
    assert code == 2
    assert f"cannot serve regulator at 127.0.0.1:{port}" in why


def test_signals_that_follow_each_other_end_it_once(tmp_path):
    """Two at a time waited for each other: it served on, and held its ports, until it was killed."""
    path = own_bench(tmp_path)
    for _ in range(3):
        with emulate(path) as (process, _said):
            for _ in range(20):
                process.terminate()
