"""The driver in front of emulated controllers on pseudo-terminals, over both protocols, and all that goes wrong."""

import contextlib
import math
import os
import random
import re
import select
import struct
import threading
import time
import tty

import pytest
from pmabench_drivers.alicat import AlicatController, ascii_link
from pymodbus.framer import FramerRTU

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, NotSent
from pmabench.bench.interface import Segment
from tests.drivers.alicat.rigs import HandPeer, controller, listing, replace
from tests.drivers.common import opened, timed, until
from tests.drivers.wires.rigs import emulated
from tests.reliability.cases import cases

pytestmark = pytest.mark.realtime

CALL = 0.4
"""A call ends within 0.2 s; a busy machine gets some more."""


@pytest.fixture(params=["ascii", "modbus"])
def protocol(request):
    return request.param


@pytest.fixture
def rig(tmp_path, protocol):
    record = controller(tmp_path / "controller", protocol, slowest="100 ms")
    with emulated(record, preset="ideal") as (emulator, [record]), opened(record) as device:
        yield emulator, record, device


def fault(emulator, kind, value=None, count=-1):
    emulator.devices["controller"].faults.set(kind, value, count)


def failure(device, within=3.0):
    """What `collect` raises within a time."""
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        took, outcome = timed(device.collect)
        assert took < 0.1
        if isinstance(outcome, Exception):
            return str(outcome)
        time.sleep(0.01)
    return ""


def behind(emulator):
    """The controller behind the wire."""
    served = emulator.devices["controller"]
    return served.controller if hasattr(served, "controller") else served.registers.controller


# -- what it does -----------------------------------------------------------------------------------------------------


def test_it_says_who_it_is_and_that_it_is_an_emulator(tmp_path, protocol):
    with emulated(controller(tmp_path / "c", protocol)) as (emulator, [record]):
        device = AlicatController(record, RealClock())
        identity = device.open()
        device.close()
        assert identity.maker == "Alicat"
        assert identity.model == "emulated unproven controller"
        assert identity.simulated
        assert emulator.log.of("set") == emulator.log.of("valves") == []


def test_it_measures_what_it_commands(rig):
    emulator, _, device = rig
    assert device.start(500.0) == 50.0
    device.write("pressure", 250.0)
    assert device.read_back("pressure") == pytest.approx(250.0)
    rows = []
    assert until(lambda: rows.extend(device.collect().columns["pressure"]) or (rows and abs(rows[-1] - 250.0) < 0.02))
    assert [entry["si"] for entry in emulator.log.of("set")] == [pytest.approx(250e3)]
    time.sleep(0.3)
    block = device.collect()
    assert len(block.time) >= 4
    assert set(block.columns["pressure_command"]) == {250.0}
    assert all(later > earlier for earlier, later in zip(block.time, block.time[1:], strict=False))


@pytest.mark.parametrize("unit", [pytest.param("bar", marks=pytest.mark.slow), "psi"])
def test_numbers_are_in_the_unit_of_the_bench(tmp_path, protocol, unit):
    served = emulated(controller(tmp_path / "c", protocol, unit), preset="ideal")
    with served as (emulator, [record]), opened(record) as device:
        scale = record.outputs[0].scale
        device.start(50.0)
        device.write("pressure", scale.to_raw(200e3))
        assert emulator.log.of("set")[-1]["si"] == pytest.approx(200e3, abs=0.01 * 6895)
        rows = []
        assert until(
            lambda: (
                rows.extend(device.collect().columns["pressure"]) or (rows and abs(scale.to_si(rows[-1]) - 200e3) < 100)
            )
        )


def test_the_safe_value_exhausts_and_never_holds_closed(rig, protocol):
    """Modbus: command 6 with argument 3; ASCII: set-point 0 and no hold. The next set-point ends the exhaust."""
    emulator, _, device = rig
    device.start(50.0)
    device.write("pressure", 300.0)
    assert until(lambda: emulator.plant.quantities()["pressure"] > 299e3)
    device.write("pressure", 0.0)
    assert behind(emulator).valves == ("EXH" if protocol == "modbus" else "")
    assert behind(emulator).set_point == 0.0
    assert until(lambda: emulator.plant.quantities()["pressure"] < 1e3)
    time.sleep(0.35)
    device.collect()  # the exhaust that it has opened itself is no trouble
    device.write("pressure", 100.0)
    assert behind(emulator).valves == ""
    assert until(lambda: emulator.plant.quantities()["pressure"] > 99e3)
    assert {entry["setting"] for entry in emulator.log.of("valves")} <= {"EXH", ""}


@pytest.mark.parametrize("setting", ["closed", pytest.param("HLD", marks=pytest.mark.slow)])
def test_held_valves_are_said_and_a_vent_ends_the_hold(rig, setting):
    emulator, _, device = rig
    device.write("pressure", 200.0)
    assert until(lambda: emulator.plant.quantities()["pressure"] > 199e3)
    device.start(50.0)
    behind(emulator).set_valves(setting)
    assert "traps the pressure" in failure(device)
    device.write("pressure", 0.0)
    assert until(lambda: emulator.plant.quantities()["pressure"] < 1e3)


def test_an_exhaust_that_somebody_else_opened_is_said(rig):
    emulator, _, device = rig
    device.write("pressure", 200.0)
    device.start(50.0)
    behind(emulator).set_valves("EXH")
    assert "not by this program" in failure(device)


def test_a_single_valve_controller_is_distinguished_from_a_dual_valve_one(tmp_path):
    record = controller(tmp_path / "c", "modbus")
    single = replace(record, options={**record.options, "valves": 1})
    with emulated(single, preset="ideal") as (emulator, _):
        with opened(record) as device, pytest.raises(DeviceError, match='one valve only\\? then "valves: 1"'):
            device.write("pressure", 0.0)
        assert behind(emulator).set_point == 0.0
        with opened(single) as device:
            device.write("pressure", 100.0)
            device.write("pressure", 0.0)
        assert {entry["setting"] for entry in emulator.log.of("valves")} <= {""}


def test_ramps_are_stepped_and_their_end_vents(rig, protocol):
    emulator, _, device = rig
    device.start(50.0)
    device.write("pressure", 200.0)
    device.follow("pressure", Segment("ramp", device._clock.now(), 200.0, 0.0, 800.0))
    assert until(lambda: emulator.log.of("set")[-1]["raw"] == 0.0 and not device._following)
    sent = [entry["raw"] for entry in emulator.log.of("set")]
    assert len(sent) > 4
    assert sent == sorted(sent, reverse=True)
    assert all(0.0 <= value <= 200.0 for value in sent)
    assert behind(emulator).valves == ("EXH" if protocol == "modbus" else "")
    count = len(sent)
    time.sleep(0.2)
    assert len(emulator.log.of("set")) == count


def test_a_set_point_ends_a_ramp(rig):
    emulator, _, device = rig
    device.write("pressure", 100.0)
    device.follow("pressure", Segment("ramp", device._clock.now(), 100.0, 400.0, 200.0))
    assert until(lambda: emulator.log.of("set")[-1]["raw"] > 101.0)
    device.write("pressure", 0.0)
    time.sleep(0.15)
    assert emulator.log.of("set")[-1]["raw"] == 0.0
    assert behind(emulator).set_point == 0.0


def test_a_step_that_waits_for_the_line_is_not_sent_after_the_ramp_was_ended(rig):
    emulator, _, device = rig
    device.write("pressure", 100.0)
    device.follow("pressure", Segment("ramp", device._clock.now(), 100.0, 400.0, 100.0))
    time.sleep(0.1)
    with device._link._lock:
        time.sleep(0.03)
        sent = len(emulator.log.of("set"))
        device._following.clear()
    time.sleep(0.1)
    assert len(emulator.log.of("set")) == sent


# -- what goes wrong --------------------------------------------------------------------------------------------------


def test_silence_changes_nothing_so_that_a_computer_that_dies_leaves_the_pressure(rig):
    """The device has no watchdog, and the page says so: the emulator must not be kinder than the device."""
    emulator, _, device = rig
    device.write("pressure", 200.0)
    device.close()
    time.sleep(0.6)
    assert emulator.plant.quantities()["pressure"] == pytest.approx(200e3, abs=100)


def test_another_set_point_source_is_refused_when_opened(tmp_path):
    with emulated(controller(tmp_path / "c")) as (emulator, [record]):
        for source, said in (("A", "analogue input"), ("U", "its knob")):
            behind(emulator).source = source
            with pytest.raises(DeviceError, match=said), opened(record):
                pass


def test_set_points_that_are_ignored_are_noticed(rig):
    emulator, _, device = rig
    behind(emulator).source = "A"
    with pytest.raises(NotSent, match="was commanded 150 and holds 0: is its set-point source"):  # nothing comes later
        device.write("pressure", 150.0)
    behind(emulator).source = "S"
    device.write("pressure", 150.0)


@pytest.mark.parametrize("source", ["A", "U"])
def test_a_vent_takes_the_set_point_back_from_the_panel(tmp_path, source):
    """Without a dump valve nothing else empties the muscle. Over Modbus it is the exhaust that empties it."""
    with emulated(controller(tmp_path / "c")) as (emulator, [record]), opened(record) as device:
        device.write("pressure", 150.0)
        behind(emulator).source = source
        device.write("pressure", 0.0)
        assert behind(emulator).source == "S"
        assert device.read_back("pressure") == 0.0
    with emulated(controller(tmp_path / "m", "modbus")) as (emulator, [record]), opened(record) as device:
        device.write("pressure", 150.0)
        behind(emulator).source = source
        with pytest.raises(DeviceError, match="holds 150"):
            device.write("pressure", 0.0)


def test_another_unit_is_refused_when_opened(tmp_path):
    with emulated(controller(tmp_path / "c", "ascii", "bar")):
        wanted = r"gives .Gauge Press. in barG \(unit 7\) and the bench expects kPa \(unit 4\)"
        with pytest.raises(DeviceError, match=wanted), opened(controller(tmp_path / "c", "ascii", "kPa")):
            pass


def test_with_another_unit_it_is_vented_and_not_measured(tmp_path):
    """0 is 0 in every unit; a reading in another one would confirm a vent that is none."""
    with emulated(controller(tmp_path / "c", "ascii", "bar")) as (emulator, [record]):
        with opened(record) as device:
            device.write("pressure", 3.0)
        device = AlicatController(controller(tmp_path / "c", "ascii", "kPa"), RealClock())
        with contextlib.closing(device):
            device.open_to_vent()
            device.write("pressure", 0.0)
            with pytest.raises(DeviceError, match="the bench expects kPa"):
                device.start(50.0)
        assert emulator.log.of("set")[-1]["si"] == 0.0


def test_hectopascal_and_millibar_are_one_unit(tmp_path):
    with (
        emulated(controller(tmp_path / "c", "ascii", "mbar")),
        opened(controller(tmp_path / "c", "ascii", "hPa")) as device,
    ):
        device.write("pressure", 1000.0)


@pytest.mark.parametrize(
    ("kind", "said"),
    [("sensor", "cannot be read"), pytest.param("limit", "own pressure limit", marks=pytest.mark.slow)],
)
def test_a_bad_status_is_an_error_and_its_numbers_are_no_samples(rig, kind, said):
    emulator, _, device = rig
    device.start(50.0)
    fault(emulator, kind)
    assert said in failure(device)
    fault(emulator, "clear")
    device.start(50.0)
    assert until(lambda: len(device.collect().time) > 0)


def test_over_range_is_no_number(rig):
    emulator, _, device = rig
    device.start(50.0)
    fault(emulator, "over")
    assert until(lambda: any(math.isnan(value) for value in device.collect().columns["pressure"]))
    time.sleep(0.1)
    assert all(math.isnan(value) for value in device.collect().columns["pressure"])


SLOW = [
    pytest.param(kind, marks=pytest.mark.slow)
    for kind in ("lost", "delay", "truncated", "garbage", "double", "hang-up")
]


@pytest.mark.parametrize("kind", ["silence", *SLOW])
def test_every_call_ends_in_time_and_shows_the_truth(rig, kind):
    """Whatever the line does, a set-point that is not refused is the one that the device holds."""
    emulator, _, device = rig
    device.start(50.0)
    for number in range(2):
        fault(emulator, kind, {"truncated": 3.0, "delay": 0.15}.get(kind))
        for call, *arguments in ((device.write, "pressure", 50.0 + number), (device.read_back, "pressure")):
            took, outcome = timed(call, *arguments)
            assert took < CALL
            if not isinstance(outcome, DeviceError):
                assert behind(emulator).set_point == pytest.approx(50.0 + number)
        if kind != "hang-up":
            fault(emulator, "clear")
            time.sleep(0.2)
            device.start(50.0)
            took, outcome = timed(device.write, "pressure", 80.0 + number)
            assert outcome is None
            assert took < CALL
    if kind == "hang-up":
        assert failure(device)


def test_a_silent_device_is_said_by_collect(rig):
    emulator, record, device = rig
    device.start(50.0)
    fault(emulator, "silence")
    said = failure(device)
    assert f"no answer from {record.address}" in said or "not taken for a new one" in said


def test_one_lost_answer_is_a_gap_and_no_failure(rig):
    emulator, _, device = rig
    device.start(50.0)
    time.sleep(0.2)
    fault(emulator, "lost", count=1)
    time.sleep(0.4)
    assert len(device.collect().time) > 5
    assert not failure(device, 0.1)


def test_answers_that_are_late_for_a_moment_are_a_gap_and_no_failure(tmp_path, protocol):
    """A computer that did something else for 0.15 s ended a good run: over Modbus nothing was asked for half a second."""
    record = controller(tmp_path / "c", protocol, slowest="500 ms", timeout="60 ms")
    with emulated(record, preset="ideal") as (emulator, [record]), opened(record) as device:
        device.start(50.0)
        time.sleep(0.2)
        fault(emulator, "delay", 0.15, count=1)
        assert not failure(device, 0.6)


def test_late_answers_are_never_taken_for_new_ones(tmp_path, protocol):
    """Answers up to three time-outs late, and questions that wait behind them: what is not refused is true."""
    chance = random.Random(11)
    record = controller(tmp_path / "c", protocol, timeout="15 ms", slowest="120 ms")
    right = refused = 0
    with emulated(record, preset="ideal") as (emulator, [record]), opened(record) as device:
        for number in range(cases(20)):
            fault(emulator, "delay", chance.uniform(0.0, 3.0) * 0.015, count=1)
            took, outcome = timed(device.write, "pressure", 100.0 + number)
            assert took < CALL
            fault(emulator, "delay", chance.uniform(0.0, 3.0) * 0.015, count=1)
            _, held = timed(device.read_back, "pressure")
            refused += isinstance(outcome, DeviceError) + isinstance(held, DeviceError)
            if not isinstance(outcome, DeviceError):
                right += 1
                assert behind(emulator).set_point == pytest.approx(100.0 + number)
            if not isinstance(held, DeviceError):
                assert held == pytest.approx(behind(emulator).set_point)
            time.sleep(0.05)
    assert right >= 3
    assert refused >= 5


def test_one_port_one_program(rig):
    _, record, _ = rig
    with pytest.raises(DeviceError, match=r"another program|no connection"), opened(record):
        pass


def test_nobody_there_is_a_sentence(tmp_path, protocol):
    with (
        pytest.raises(DeviceError, match=r"cannot open|no connection to"),
        opened(controller(tmp_path / "no", protocol)),
    ):
        pass


def test_another_protocol_is_a_sentence(tmp_path, protocol):
    """Both kinds meet on one line: neither waits longer than opening may take."""
    other = {"ascii": "modbus", "modbus": "ascii"}[protocol]
    with emulated(controller(tmp_path / "c", protocol)):
        took, outcome = timed(AlicatController(controller(tmp_path / "c", other), RealClock()).open)
        assert isinstance(outcome, DeviceError)
        assert re.search(r"nobody answers|no answer|sends", str(outcome))
        assert took < 2.1


# -- what is on the wire ----------------------------------------------------------------------------------------------

LISTING = listing(
    ("700", "Unit ID", "string", "1", ""),
    ("006", "Gauge Press", "s decimal", "8/2", "004 02 kPaG"),
    ("038", "Gauge Press Setpt", "s decimal", "8/2", "004 02 kPaG"),
    ("702", "*Status", "string", "3", "HLD"),
)


def by_the_book(question, held):
    """A controller by hand, of firmware that does not know LSS; `held` is its set-point."""
    if question == "A??M*":
        return b"A  M04 Model Number PCD-150PSIG-D\rA  M05 Serial Number 521641\rA  M09 Software Revision 9v02.0-R23\r"
    if question == "A??D*":
        return b"\r".join(LISTING) + b"\r"
    if question == "AVE":
        return b"A   9v02.0-R23 Jan  9 2025,15:04:07\r"
    if question.startswith("AS"):
        held[0] = float(question[2:])
    elif question not in {"A", "AC"}:
        return b"?\r"
    return f"A +0012.34 {held[0]:+08.2f}\r".encode()


def test_the_ascii_commands_are_those_of_the_manual(tmp_path):
    held = [0.0]
    with HandPeer(tmp_path / "c", lambda question: by_the_book(question, held)) as peer:
        device = AlicatController(controller(tmp_path / "c"), RealClock())
        identity = device.open()
        assert (identity.model, identity.serial, identity.firmware) == ("PCD-150PSIG-D", "521641", "9v02.0-R23")
        assert not identity.simulated
        begun = len(peer.questions)
        device.write("pressure", 123.456)
        assert device.read_back("pressure") == 123.46
        device.write("pressure", 0.0)
        device.close()
        assert peer.questions[begun:] == ["AS123.46", "A", "AS0.00", "AC"]


def test_a_late_answer_does_not_prove_a_vent(tmp_path):
    """An old line that shows set-point 0 comes where the answers to a lost vent should; the device holds 300."""
    held, script = [0.0], {}
    old = by_the_book("A", held)

    def reply(question):
        if question not in script:
            return by_the_book(question, held)
        if question == "AS300.00":
            held[0] = 300.0
        return script[question]

    with HandPeer(tmp_path / "c", reply), opened(controller(tmp_path / "c", timeout="20 ms")) as device:
        script |= {"A": b"", "AS300.00": b"", "AVE": b"", "AS0.00": old, "AC": old}
        for call in (
            (device.read_back, "pressure"),
            (device.write, "pressure", 300.0),
            (device.write, "pressure", 0.0),
        ):
            assert isinstance(timed(*call)[1], DeviceError)
        assert held == [300.0]


def test_only_the_firmware_clears_the_line_of_late_answers(tmp_path):
    held, script = [0.0], {}
    old = by_the_book("A", held)
    peer = HandPeer(tmp_path / "c", lambda question: script.get(question, by_the_book(question, held)))
    with peer, opened(controller(tmp_path / "c", timeout="20 ms", slowest="100 ms")) as device:
        script["A"] = b""
        assert isinstance(timed(device.read_back, "pressure")[1], DeviceError)
        held[0] = 100.0
        script |= {"AVE": old, "A": old}
        assert isinstance(timed(device.read_back, "pressure")[1], DeviceError)
        script.clear()
        time.sleep(0.15)
        assert device.read_back("pressure") == 100.0


def test_hostile_answers_never_make_a_number_or_a_hang(tmp_path):
    """Junk, pieces, other shapes and refusals in place of answers: calls end in time, and no sample is wrong."""
    chance, held, hostile = random.Random(7), [0.0], [False]
    junk = (
        lambda line: b"",
        lambda line: line[: chance.randrange(len(line))],
        lambda line: bytes(chance.randrange(256) for _ in range(chance.randrange(1, 60))) + b"\r",
        lambda line: b"?\r",
        lambda line: line.replace(b"A ", b"B ", 1),
        lambda line: line * 3,
        lambda line: b"A " + b"9" * 400 + b"\r",
        lambda line: b"A nan inf\r",
        lambda line: b"A +0012.34\r",
        lambda line: line.replace(b"+00", b"+0", 1),
        lambda line: b"\r" * 20,
    )

    def reply(question):
        answer = by_the_book(question, held)
        return chance.choice(junk)(answer) if hostile[0] and chance.random() < 0.8 else answer

    record = controller(tmp_path / "c", timeout="10 ms", slowest="20 ms")
    with HandPeer(tmp_path / "c", reply), opened(record) as device:
        device.start(50.0)
        hostile[0] = True
        believed = 0
        for number in range(cases(300)):
            call = (device.write, "pressure", float(number % 50)) if number % 3 else (device.read_back, "pressure")
            took, outcome = timed(*call)
            assert took < CALL
            assert outcome is None or isinstance(outcome, float | DeviceError), outcome
            if not isinstance(outcome, DeviceError):
                believed += 1
                assert outcome is None or outcome == pytest.approx(held[0])
            with contextlib.suppress(DeviceError):
                assert set(device.collect().columns["pressure"]) <= {12.34}
        hostile[0] = False
        time.sleep(0.3)
        device.start(50.0)
        device.write("pressure", 77.0)
        assert held[0] == 77.0
        assert believed > 5


class RawTerminal:
    """A far end that keeps the bytes it gets, and answers nothing."""

    def __init__(self, path):
        self.near, self._far = os.openpty()
        tty.setraw(self._far)
        path.symlink_to(os.ttyname(self._far))
        self.data, self._ended = b"", threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        while not self._ended.is_set():
            if select.select([self.near], [], [], 0.02)[0]:
                self.data += os.read(self.near, 1000)

    def close(self):
        self._ended.set()
        self._thread.join(5)
        os.close(self.near)
        os.close(self._far)


def test_modbus_registers_are_those_of_the_manual_less_one(tmp_path):
    """Numbers 1000, 1010 and 1201 of the manual: 999, 1009 and 1200 on the wire; set-point and exhaust by function 16."""
    from pmabench_drivers.alicat import Options
    from pmabench_drivers.alicat.modbus_link import ModbusLink
    from pmabench_drivers.modbus.adapter import Line

    terminal = RawTerminal(tmp_path / "c")
    try:
        link = ModbusLink("c", str(tmp_path / "c"), Options(protocol="modbus", baud=115200, timeout=0.02), RealClock())
        link._line = Line("c", str(tmp_path / "c"), 1, 0.02, serial={"baudrate": 115200})
        link._regulating = True
        for call in (
            lambda: link.command(300.0, time.monotonic() + 0.05, 0.0),
            lambda: link.vent(0.0, time.monotonic() + 0.2, 0.0),
            lambda: link.poll(time.monotonic() + 0.03),
        ):
            with pytest.raises(DeviceError, match="no answer"):
                call()
        link.close()
    finally:
        time.sleep(0.1)
        terminal.close()

    def frame(*parts):
        body = b"".join(parts)
        return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")

    def write(number, data):
        return frame(b"\x01\x10", struct.pack(">HHB", number - 1, len(data) // 2, len(data)), data)

    assert write(1010, bytes.fromhex("43960000")) in terminal.data  # 300.0 as IEEE 754
    begun = terminal.data.index(write(1010, bytes(4)))
    assert terminal.data.index(write(1000, struct.pack(">HH", 6, 3))) > begun
    assert any(frame(bytes([1, code]), struct.pack(">HH", 1200, 4)) in terminal.data for code in (3, 4))
    for trap in (1, 2):
        assert write(1000, struct.pack(">HH", 6, trap)) not in terminal.data


# -- somebody at its panel ------------------------------------------------------------------------------------------


class Panel:
    """A controller by hand whose pressures are shown in another unit from `psi` on; `knows`: firmware 10v05 or later."""

    def __init__(self, *, knows):
        self.knows, self.psi, self.set_point = knows, False, [0.0]

    def reply(self, question):
        unit = "10 PSIG" if self.psi else "4 kPaG"
        if self.knows and question == "ADCU 38":
            return f"A {unit}\r".encode()
        if self.knows and question == "ALSS":
            return b"A S\r"
        answer = by_the_book(question, self.set_point)
        return answer.replace(b"004 02 kPaG", b"010 02 PSIG") if self.psi else answer


def test_a_unit_that_is_changed_at_the_panel_while_vented_is_seen_and_no_number_is_sent(tmp_path):
    """0 is 0 in every unit: nothing else shows it, and 100 kPa would be 689 kPa."""
    panel = Panel(knows=True)
    with HandPeer(tmp_path / "c", panel.reply) as peer, opened(controller(tmp_path / "c")) as device:
        assert device.held() == {"unit of the set-point": "4 kPaG", "source of the set-point": "the serial line"}
        device.write("pressure", 50.0)
        device.write("pressure", 0.0)
        panel.psi = True
        assert device.held()["unit of the set-point"] == "10 PSIG"
        begun = len(peer.questions)
        with pytest.raises(DeviceError, match="takes set-points in 10 PSIG now, not in kPa"):
            device.write("pressure", 100.0)
        assert "AS100.00" not in peer.questions[begun:]
        device.write("pressure", 0.0)
        panel.psi = False
        device.write("pressure", 100.0)
        begun = len(peer.questions)
        device.write("pressure", 120.0)
        assert peer.questions[begun:] == ["AS120.00"], "under pressure its set-point shows it"


def test_older_firmware_lists_its_columns_again_now_and_then(tmp_path, monkeypatch):
    panel = Panel(knows=False)
    with HandPeer(tmp_path / "c", panel.reply) as peer, opened(controller(tmp_path / "c")) as device:
        assert device.held() == {"unit of the set-point": "4 kPaG"}
        begun, panel.psi = len(peer.questions), True
        assert device.held() == {"unit of the set-point": "4 kPaG"}
        assert peer.questions[begun:] == [], "asked again only after 2 s"
        monkeypatch.setattr(ascii_link, "LISTED_EVERY", 0.0)
        begun_at = time.monotonic()
        assert device.held() == {"unit of the set-point": "10 PSIG"}
        assert time.monotonic() - begun_at < 0.1, "its last row is known: no silence is waited for"
    monkeypatch.setattr(ascii_link, "LONGEST_LIST", 0.0)
    with HandPeer(tmp_path / "d", Panel(knows=False).reply), opened(controller(tmp_path / "d")) as device:
        assert device.held() == {}, "a line that is too slow for it"
