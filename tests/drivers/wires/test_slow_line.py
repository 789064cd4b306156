"""A regulator whose answers take long (RTU at 9600 baud): calls go before samples, and what it cannot do is said first."""

import contextlib
import socket
import struct
import threading
import time
from dataclasses import replace

import pytest
from pmabench_drivers.modbus import ModbusDevice

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Identity
from pmabench.engine.bench_checks import refuse_slow
from tests.drivers.wires.rigs import regulator
from tests.engine.benches import mounted

pytestmark = pytest.mark.realtime


class Slow:
    """A Modbus TCP device by hand: any register reads 0 or what was written; each answer takes `takes` seconds."""

    def __init__(self, takes):
        self.takes, self.held, self.asked = takes, {110: 0x0011, 111: 0x2233}, []
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._server.close()

    def _accept(self):
        while True:
            try:
                link, _ = self._server.accept()
            except OSError:
                return
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self._serve, args=(link,), daemon=True).start()

    def _serve(self, link):
        with link, contextlib.suppress(OSError):
            while len(head := link.recv(7, socket.MSG_WAITALL)) == 7:
                number, _, length, unit = struct.unpack(">HHHB", head)
                pdu = link.recv(length - 1, socket.MSG_WAITALL)
                self.asked.append((time.monotonic(), pdu))
                time.sleep(self.takes)
                answer = self._answer(pdu)
                link.sendall(struct.pack(">HHHB", number, 0, len(answer) + 1, unit) + answer)

    def _answer(self, pdu):
        function, address, count = struct.unpack(">BHH", pdu[:5])
        if function in {1, 2}:
            return bytes([function, 1, 1])
        if function in {3, 4}:
            words = [self.held.get(address + n, 0) for n in range(count)]
            return bytes([function, 2 * count]) + struct.pack(f">{count}H", *words)
        if function == 6:
            self.held[address] = count
        if function == 16:
            self.held |= dict(enumerate(struct.unpack(f">{count}H", pdu[6:]), address))
        return pdu[:5]


def polled(slow, rate, seconds):
    """The device, open and polled at `rate` [Hz] for a while: its identity, what it is polled at, and its samples."""
    device = ModbusDevice(regulator(slow.address, rate=f"{rate} Hz"), RealClock())
    identity = device.open()
    used = device.start(100.0)
    time.sleep(seconds)
    return device, identity, used


def test_a_call_waits_for_one_answer_of_a_line_that_is_polled_all_the_time():
    """The thread that polls took the line again at once, and calls came to nothing."""
    with Slow(0.04) as slow:
        device, _, _ = polled(slow, 200.0, 0.2)
        took = []
        for n in range(10):
            begun = time.monotonic()
            device.write("pressure", 100.0 + n)
            took.append(time.monotonic() - begun)
            time.sleep(0.02)
        assert max(took) < 0.18, took
        time.sleep(0.1)
        assert len(device.collect().time) > 3, "samples are taken in between"
        device.close()


def test_samples_carry_the_time_when_they_were_asked_for_however_long_that_waited():
    with Slow(0.04) as slow:
        device, _, _ = polled(slow, 50.0, 0.1)
        clock = device._clock
        ended = time.monotonic() + 1.0
        while time.monotonic() < ended:
            device.level("e_stop")
        block = device.collect()
        device.close()
        asked = [t - clock.start for t, pdu in slow.asked if pdu[0] == 4]
        for taken in block.time:
            assert any(abs(taken * 1e-9 - (t + 0.02)) < 0.015 for t in asked), "halfway between question and answer"


def test_any_answer_feeds_its_watchdog_and_it_is_asked_nothing_more_for_that():
    with Slow(0.001) as slow:
        device, _, _ = polled(slow, 100.0, 0.1)
        device.arm_watchdog(0.5)
        begun = len(slow.asked)
        for _ in range(20):
            device.feed_watchdog()
            time.sleep(0.01)
        assert [pdu for _, pdu in slow.asked[begun:] if pdu[0] == 3] == []
        assert len(device.collect().time) > 10, "the program is there: it is polled"
        device.stop()
        time.sleep(0.1)
        device.feed_watchdog()
        assert slow.asked[-1][1][0] == 3, "nothing else was asked: the question feeds it"
        device.close()


def test_it_is_polled_at_what_its_line_allows_and_how_long_it_answers_is_known():
    with Slow(0.04) as slow:
        device, identity, used = polled(slow, 100.0, 0.0)
        assert identity.answers == pytest.approx(0.043, abs=0.005)
        questions = 0.25 + 0.043 * 3 / 0.45  # an interlock, and what is held: at most a quarter, and three in 0.45 s
        assert used == pytest.approx((1 - questions) / 0.043, rel=0.15)
        device.close()
    with Slow(0.0) as slow:
        device, _, used = polled(slow, 100.0, 0.0)
        assert used == 100.0
        device.close()


CASES = {
    "the rate": (100.0, 0.025, 0.5, r"takes 25 ms for an answer: .* 11 times a second, and 100 Hz .* rate: 7.7 Hz"),
    "a command": (5.0, 0.07, 1.0, r"takes 70 ms for an answer: a command .* 210 ms, and the guard waits 200 ms"),
    "its watchdog": (5.0, 0.04, 0.2, r"takes 40 ms for an answer: its watchdog .* declare watchdog: 0.38 s"),
}


def test_a_stale_limit_that_one_lost_answer_crosses_is_refused_before_it_is_armed():
    """At 6.3 Hz, as advised for 30 ms, 300 ms tripped and latched the bench at the first fill."""
    bench = mounted("mock-realtime").bench
    [device], [stale] = bench.devices, [trip for trip in bench.trips if trip.kind == "stale" and trip.action == "vent"]
    identities = {device.name: Identity("Acme", "R", "1", "1", answers=0.03)}
    says = r"at 6.3 Hz there may be no sample for 0.58 s, and the bench trips after 0.3 s .*:12:5.*for: 580 ms"
    for delay in (0.3, 0.57, 0.58):
        others = tuple(trip for trip in bench.trips if trip.kind != "stale")
        slow = replace(bench, trips=(*others, replace(stale, delay=delay)))
        with (
            contextlib.nullcontext()
            if delay == 0.58
            else pytest.raises(DeviceError, match=says.replace("0.3 s", f"{delay} s"))
        ):
            refuse_slow(slow, identities, 6.3, {device.name: 6.3})


@pytest.mark.parametrize("what", CASES)
def test_what_a_slow_device_cannot_do_is_said_before_it_is_armed(what):
    wanted, takes, watchdog, says = CASES[what]
    bench = mounted("mock-realtime").bench
    device = replace(bench.devices[0], watchdog=watchdog, fastest=100.0, fastest_from="map.yaml:3:7")
    identities = {device.name: Identity("Acme", "R", "1", "1", answers=takes)}
    slow = replace(bench, devices=(device,), trips=())
    with pytest.raises(DeviceError, match=says):
        refuse_slow(slow, identities, wanted, {device.name: min(11.0, wanted)})
    quick = {device.name: Identity("Acme", "R", "1", "1", answers=0.005)}
    refuse_slow(slow, quick, wanted, {device.name: wanted})
