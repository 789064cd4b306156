"""Devices that only measure belong to the engine: asked in real time whether they are still what they were (S11)."""

from __future__ import annotations

import contextlib
import json
import time
from dataclasses import replace
from pathlib import Path

import pytest

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, LimitRefused
from pmabench.bench.interface import Block, ChannelRecord, DeviceRecord, Scale
from pmabench.engine.source import OwnDevices
from pmabench.guard.supervision import HELD
from tests.engine.benches import mounted
from tests.engine.forked import Forks
from tests.engine.realtime_rig import Reader, Run, assert_safe_since, served
from tests.realtime import eventually

pytestmark = [pytest.mark.realtime, pytest.mark.singly]


class Reporting(Reader):
    """Reports a serial number and for how long it is on, and what its file says; writes down that it was closed."""

    def __init__(self, device, clock):
        super().__init__(device, clock)
        self._file, self._flag = self._flag, Path("nowhere")
        self._on = time.monotonic() - 100.0

    def open(self):
        if self._says().get("refuses"):
            raise DeviceError("gauge", "is another one")
        return super().open()

    def close(self):
        self._file.with_suffix(".closed").touch()

    def start(self, rate):
        self._begun = getattr(self, "_begun", 0) + 1
        return super().start(rate)

    def collect(self):
        if self._says().get("broken", 0) >= self._begun:
            raise DeviceError("gauge", "lost bytes")
        if self._says().get("silent"):
            return Block([], {"supply": []})
        return Block([int(self._clock.now() * 1e9)], {"supply": [0.0]})

    def held(self):
        says = self._says()
        time.sleep(says.get("slow", 0.0))
        if says.get("once"):
            self._file.unlink()
        found = {"serial": "4711", "uptime": time.monotonic() - self._on}
        return {**found, **{key: value for key, value in says.items() if key in found}}

    def _says(self):
        return json.loads(self._file.read_text()) if self._file.exists() else {}


def gauge(file, name="gauge"):
    channel = ChannelRecord("supply", "pressure", name, "in", "float64", "Pa", Scale(), -1e5, 1e6)
    return DeviceRecord(name, f"{__name__}:Reporting", str(file), channels=(channel,))


def say(file, **what):
    written = file.with_suffix(".new")
    written.write_text(json.dumps(what))
    written.rename(file)


SERIAL = (
    "gauge: its serial was 4711 when the bench was armed and is 9999 now: it restarted, or something else commands it"
)
CHANGES = {
    "another serial number": ({"serial": "9999"}, SERIAL),
    "an uptime that begins anew": ({"uptime": 0.0}, "gauge: it restarted: its uptime fell from 10"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_device_that_restarts_in_a_run_is_a_trip(tmp_path, change):
    """It goes on measuring all the time: nothing else shows it."""
    said, why = CHANGES[change]
    with Forks() as forks, served(tmp_path) as (bench, plant):
        made = replace(bench, devices=(*bench.devices, gauge(tmp_path / "gauge.json")))
        run = Run(forks, made, plant, tmp_path / "run", "hold")
        try:
            run.in_step()
            begun = time.monotonic()
            say(tmp_path / "gauge.json", **said)
            eventually(lambda: run.said("status"), 8.0)
            assert assert_safe_since(plant, begun) < 2.0
            assert run.end() == 5, run.lines()
        finally:
            run.kill_rest()
        assert run.said("status") == "tripped"
        assert run.said("why").startswith(why)
        assert run.said("vent") == "confirmed"
        assert run.bench_state["what"] == "tripped"


def test_what_it_measures_confirms_the_vent(tmp_path):
    """The pressure is that of the engine's device: the guard cannot read it itself."""
    with Forks() as forks, served(tmp_path) as (bench, plant):
        safe = tuple(replace(act, target="supply") if act.do == "confirm" else act for act in bench.safe_state)
        made = replace(bench, devices=(*bench.devices, gauge(tmp_path / "gauge.json")), safe_state=safe)
        run = Run(forks, made, plant, tmp_path / "run", "short")
        try:
            assert run.end() == 0, run.lines()
        finally:
            run.kill_rest()
        assert run.said("vent") == "confirmed"


@pytest.mark.parametrize("fault", ["broken", "silent"])
def test_a_stream_that_has_failed_is_begun_again_while_it_vents(tmp_path, fault):
    """Twice: the first new one has failed as well. Nobody waits for it, and one that gives samples is left alone."""
    own = opened(gauge(tmp_path / "gauge.json"))
    try:
        stream, device = own.streams["gauge"], own._links.devices["gauge"]
        eventually(lambda: own.keep_measuring(20.0) or getattr(device, "_begun", 0), 2.0)  # the first start had failed
        eventually(lambda: len(stream.collect().time), 1.0)
        own.keep_measuring(20.0)
        say(tmp_path / "gauge.json", **{fault: 2})

        def again():
            own.keep_measuring(20.0)
            with contextlib.suppress(DeviceError):
                stream.collect()
            return device._begun == 3

        eventually(again, 2.0)
        say(tmp_path / "gauge.json")
        eventually(lambda: len(stream.collect().time), 1.0)
    finally:
        own.close()


def opened(*devices):
    own = OwnDevices(replace(mounted("mock-realtime").bench, devices=devices), RealClock())
    own.open()
    return own


def test_a_question_that_takes_long_does_not_hold_up_who_collects_samples(tmp_path):
    own = opened(gauge(tmp_path / "gauge.json"))
    try:
        stream, longest, asked = own.streams["gauge"], 0.0, 0.15
        assert stream.start(100.0) == 100.0
        own.supervision.begin()
        say(tmp_path / "gauge.json", slow=asked)
        end = time.monotonic() + 1.6
        while (now := time.monotonic()) < end:
            own.supervision.look(now)
            stream.collect()
            longest = max(longest, time.monotonic() - now)
            time.sleep(0.01)
        assert own.supervision._count["gauge" + HELD[0]] > 0, "it was asked"
        assert longest < 0.5 * asked
        say(tmp_path / "gauge.json", slow=3.0)
        with pytest.raises(DeviceError, match="gauge: has not answered for 1 s"):
            asked_for(2.0, own)
    finally:
        own.close()


def asked_for(seconds, own):
    end = time.monotonic() + seconds
    while (now := time.monotonic()) < end:
        own.supervision.look(now)
        time.sleep(0.01)


@pytest.mark.parametrize("after", [0.5, 0.6, 0.7])
def test_one_whose_samples_stay_away_is_asked_at_once(tmp_path, after):
    """Within 0.1 s and the question itself; by the round of questions it may be half a second."""
    own = opened(gauge(tmp_path / "gauge.json"))
    try:
        own.streams["gauge"].start(100.0)
        own.supervision.begin()
        sampled_for(after, own)
        say(tmp_path / "gauge.json", serial="9999", silent=True)
        begun = time.monotonic()
        with pytest.raises(LimitRefused, match="9999"):
            sampled_for(1.0, own)
        assert time.monotonic() - begun < 0.3
    finally:
        own.close()


def sampled_for(seconds, own):
    end = time.monotonic() + seconds
    while (now := time.monotonic()) < end:
        own.supervision.look(now)
        own.streams["gauge"].collect()
        time.sleep(0.01)


def test_what_is_reported_once_only_is_no_difference(tmp_path):
    """As with the devices of the guard: asked again a moment later."""
    own = opened(gauge(tmp_path / "gauge.json"))
    try:
        own.supervision.begin()
        say(tmp_path / "gauge.json", serial="9999", once=True)
        asked_for(1.0, own)
        say(tmp_path / "gauge.json", serial="9999")
        with pytest.raises(LimitRefused, match="9999"):
            asked_for(1.0, own)
    finally:
        own.close()


def test_where_one_cannot_be_opened_none_stays_open(tmp_path):
    say(tmp_path / "second.json", refuses=True)
    with pytest.raises(DeviceError, match="is another one"):
        opened(gauge(tmp_path / "first.json", "first"), gauge(tmp_path / "second.json", "second"))
    eventually((tmp_path / "first.closed").exists, 2.0)
