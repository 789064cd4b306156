"""The driver in front of the emulated USB-6215: who it is, commands, lines, lost answers, who else is there."""

import sys
import time
from dataclasses import replace

import grpc
import nidaqmx
import nidaqmx.utils
import numpy as np
import pytest
from nidaqmx.constants import AcquisitionType
from pmabench_drivers.emulator import Emulator
from pmabench_drivers.ni_daq import NiDaq

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, UsageError
from pmabench.bench.interface import EMULATED, UNPROVEN, Segment, ValveRecord
from tests.drivers.common import timed, until
from tests.drivers.ni.rigs import STEP, at, daq, patiently, rig, start, task

pytestmark = pytest.mark.realtime

BOUND = 0.3
"""The contract is 0.2 s; the rest is for a busy machine."""


@pytest.fixture(name="bench")
def _bench():
    with rig() as parts:
        yield parts


@pytest.fixture(name="prompt")
def _prompt():
    """With the deadlines of a bench."""
    with rig(opened=False, slack=False) as parts:
        patiently(parts[2].open)
        yield parts


def sent(emulator, kind="set"):
    return emulator.log.of(kind, "daq")


# -- who it is ------------------------------------------------------------------------------------------------------


def test_it_says_who_it_is(bench):
    _emulator, _served, device = bench
    identity = device.open()
    assert (identity.maker, identity.firmware, identity.simulated) == ("NI", "NI-DAQmx 24.5.0", True)
    assert identity.model == f"{UNPROVEN}USB-6215"


def test_a_device_that_ni_simulates_is_simulated_and_another_is_not(bench, monkeypatch):
    _emulator, served, device = bench
    monkeypatch.setattr(served.board, "model", "USB-6215")
    assert (device.open().model, device.open().simulated) == ("USB-6215", False)
    monkeypatch.setattr(nidaqmx.system.device.Device, "is_simulated", True)
    assert (device.open().model, device.open().simulated) == (f"{EMULATED}USB-6215", True)


def test_without_nis_driver_on_this_computer_it_says_what_to_do():
    device = NiDaq(daq(server=""), RealClock())
    with pytest.raises(DeviceError, match="NI-DAQmx") as reported:
        device.open()
    if "knows no device" not in str(reported.value):  # as on a computer that has it
        assert "is not on this computer: install it from NI, or give the address of NI's gRPC server" in str(
            reported.value
        )


def test_without_nis_package_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "nidaqmx.system", None)
    with pytest.raises(DeviceError, match=r'package of NI is not installed .*pip install "pmabench\[ni\]"'):
        NiDaq(daq(server=""), RealClock()).open()


def test_a_name_that_ni_daqmx_does_not_know_is_reported_with_those_that_it_knows(bench):
    served = bench[1]
    with pytest.raises(DeviceError, match='NI-DAQmx knows no device "Dev2"; did you mean "Dev1"'):
        NiDaq(daq(server=served.address, address="Dev2"), RealClock()).open()


@pytest.mark.parametrize(
    ("record", "why"),
    [
        (
            replace(daq(), channels=(replace(daq().channels[0], input="ai20"),)),
            'no analogue input "ai20"; its last one is ai15',
        ),
        (replace(daq(), valves=(ValveRecord("v", "daq", "port0/line1"),)), 'no digital output "port0/line1"'),
        (replace(daq(), valves=(ValveRecord("v", "daq", "port1/line7"),)), "its last one is port1/line3"),
        (
            replace(daq(), outputs=(replace(daq().outputs[0], resolution=0.0001),)),
            r'steps of 0.0001 V, and they are 0.000305 V: "resolution: 0.000305 V"',
        ),
    ],
)
def test_what_the_device_does_not_have_is_refused(bench, record, why):
    with pytest.raises(DeviceError, match=why):
        NiDaq(at(record, bench[1].address), RealClock()).open()


def test_a_range_that_the_device_does_not_have_is_refused(bench, monkeypatch):
    monkeypatch.setattr("pmabench_drivers.ni_daq.emulated.SPANS", (10.0,))
    with pytest.raises(DeviceError, match="has no range of 0.2 V; it has 10 V"):
        NiDaq(daq(server=bench[1].address, ranges={"ai2": "0.2 V"}), RealClock()).open()


def test_nobody_there_is_reported_at_once(bench):
    emulator, served, _device = bench
    emulator.close()
    took, outcome = timed(NiDaq(daq(server=served.address), RealClock()).open)
    assert f"no connection to NI's gRPC server at {served.address}" in str(outcome)
    assert took < 2.0


def test_opening_moves_nothing(bench):
    emulator, served, device = bench
    device.switch("port1/line0", on=True)
    device.write("ao0", 1.5)
    commands = len(emulator.log.entries)
    device.open()
    assert len(emulator.log.entries) == commands
    assert served.board.volts["ao0"] == pytest.approx(1.5, abs=STEP)
    assert device.is_on("port1/line0")


# -- commands and lines ---------------------------------------------------------------------------------------------


def test_an_output_is_set_and_the_muscle_is_filled(bench):
    emulator, served, device = bench
    device.switch("port1/line0", on=True)
    device.write("ao0", 3.0)
    assert device.read_back("ao0") == 3.0
    assert served.board.volts["ao0"] == pytest.approx(3.0, abs=STEP / 2)
    assert [(e["output"], e["raw"], e["si"]) for e in sent(emulator)] == [("pressure", 3.0, pytest.approx(300e3))]
    assert until(lambda: emulator.plant.quantities()["pressure"] > 295e3)


def test_another_program_sees_the_same(bench):
    """NI's package by itself: the emulator is no mirror of the driver."""
    _emulator, served, device = bench
    device.switch("port1/line0", on=True)
    device.write("ao0", 2.5)
    with task(served, "lines") as other:
        other.do_channels.add_do_chan("Dev1/port1/line0")
        assert nidaqmx.stream_readers.DigitalSingleChannelReader(other.in_stream).read_one_sample_one_line() is True
    with task(served, "volts") as other:
        for terminal in ("ai0", "ai3"):
            other.ai_channels.add_ai_voltage_chan(f"Dev1/{terminal}", min_val=-10.0, max_val=10.0)
        other.timing.cfg_samp_clk_timing(1000.0, sample_mode=AcquisitionType.CONTINUOUS, samps_per_chan=1000)
        other.start()
        assert until(lambda: other.in_stream.avail_samp_per_chan > 700, 5.0)
        data = np.zeros((2, 700))
        reader = nidaqmx.stream_readers.AnalogMultiChannelReader(other.in_stream)
        reader.verify_array_shape = False
        reader.read_many_sample(data, 700)
        assert data[0, -1] == pytest.approx(3.0, abs=0.05)  # 250 kPa, -50 kPa at 0 V
        assert data[1, -1] == pytest.approx(2.5, abs=0.01)  # ao0, looped


def test_what_an_output_gives_is_not_known_before_it_was_set(bench):
    device = bench[2]
    with pytest.raises(DeviceError, match="what it gives is not known: nothing was set since it was opened"):
        device.read_back("ao0")
    device.write("ao0", 0.0)
    assert device.read_back("ao0") == 0.0


def test_a_set_point_of_another_program_is_measured_where_the_output_is_looped_into_an_input(bench):
    """NI MAX sets 4.5 V in a rest: NI-DAQmx tells nobody, the looped input shows it, and within 1 s it is a trip (S11)."""
    _emulator, served, device = bench
    start(device, 500.0)
    patiently(lambda: device.write("ao0", 1.0))
    for ends in (1.0, 3.0):  # at rest, on a ramp, and after it
        if ends > 1.0:
            device.follow("ao0", Segment("ramp", device._clock.now(), 1.0, ends, rate=4.0))
        stops = time.monotonic() + 1.0
        while time.monotonic() < stops:
            device.collect()
            assert device.read_back("ao0") <= ends
    assert device.read_back("ao0") == 3.0
    with task(served, "NI MAX") as other:
        other.ao_channels.add_ao_voltage_chan("Dev1/ao0", min_val=0.0, max_val=10.0)
        nidaqmx.stream_writers.AnalogSingleChannelWriter(other.out_stream, auto_start=True).write_one_sample(4.5)
        assert until(lambda: device.read_back("ao0") == pytest.approx(4.5, abs=0.05), 1.0)
        patiently(lambda: device.write("ao0", 0.0))
        assert device.read_back("ao0") == 0.0
        assert not until(lambda: device.read_back("ao0") != 0.0, 0.6)


def test_without_a_loop_what_was_acknowledged_counts(bench):
    _emulator, served, _device = bench
    record = daq(channels=3)
    other = NiDaq(at(record, served.address), RealClock())
    try:
        patiently(other.open)
        start(other, 500.0)
        patiently(lambda: other.write("ao0", 1.0))
        with task(served, "NI MAX") as foreign:
            foreign.ao_channels.add_ao_voltage_chan("Dev1/ao0", min_val=0.0, max_val=10.0)
            nidaqmx.stream_writers.AnalogSingleChannelWriter(foreign.out_stream, auto_start=True).write_one_sample(4.5)
        time.sleep(0.5)
        assert other.read_back("ao0") == 1.0
    finally:
        other.close()


def test_the_emergency_stop_is_read_also_while_it_samples(bench):
    emulator, _served, device = bench
    start(device, 200.0)
    assert device.level("port0/line0") is True
    emulator.plant.fail("e_stop_at")
    assert device.level("port0/line0") is False


def test_a_command_ends_a_ramp_for_good(bench, monkeypatch):
    """Also one that comes between the computing of a step and its sending."""
    emulator, _served, device = bench
    seen = []

    def interrupted(segment, now, resolution):
        device.write("ao0", 0.0)
        seen.append(now)
        return 2.0, False

    monkeypatch.setattr("pmabench_drivers.shared.device.stepped", interrupted)
    device.follow("ao0", Segment("ramp", 0.0, 0.0, 5.0, rate=1.0))
    assert until(lambda: seen)
    time.sleep(0.1)
    assert {entry["raw"] for entry in sent(emulator)} == {0.0}
    assert len(seen) == 1


def test_a_ramp_whose_steps_fail_is_reported(bench):
    _emulator, served, device = bench
    device.follow("ao0", Segment("ramp", 0.0, 0.0, 10.0, rate=0.1))
    served.faults.set("exception", -201003)
    time.sleep(0.5)
    with pytest.raises(DeviceError, match="is it plugged in, and has it power"):
        device.collect()


# -- lost answers ---------------------------------------------------------------------------------------------------


def test_a_switch_without_answer_is_settled_by_the_line(bench):
    emulator, served, device = bench
    served.faults.set("lost", count=1)
    device.switch("port1/line0", on=True)
    served.faults.set("silence", count=1)
    with pytest.raises(DeviceError, match=r"did not answer within [\d.]+ s, and its line is high"):
        device.switch("port1/line0", on=False)
    served.faults.set("ignore")
    with pytest.raises(DeviceError, match="was commanded 0 and its line is high"):
        device.switch("port1/line0", on=False)
    assert [entry["on"] for entry in sent(emulator, "switch")] == [True]
    served.faults.set("lost")
    with pytest.raises(DeviceError, match="whether it took 0 is not known"):
        device.switch("port1/line0", on=False)


def test_an_output_without_answer_is_not_known_and_sent_once(bench):
    emulator, served, device = bench
    device.write("ao0", 1.0)
    served.faults.set("lost", count=1)
    with pytest.raises(DeviceError, match="whether it took 2 V is not known"):
        device.write("ao0", 2.0)
    assert [entry["raw"] for entry in sent(emulator)] == [1.0, 2.0]
    with pytest.raises(DeviceError, match="or the answer was lost"):
        device.read_back("ao0")


@pytest.mark.parametrize("kind", ["silence", "lost", "delay", "truncated", "corrupted", "garbage", "hang-up"])
def test_every_call_ends_in_time_and_the_next_one_is_right(prompt, kind):
    _emulator, served, device = prompt
    patiently(lambda: device.write("ao0", 0.5))
    calls = [
        lambda: device.write("ao0", 1.0),
        lambda: device.read_back("ao0"),
        lambda: device.switch("port1/line0", on=True),
        lambda: device.is_on("port1/line0"),
        lambda: device.level("port0/line0"),
        lambda: device.start(200.0),
        device.collect,
        device.stop,
        lambda: device.rescue("ao0", 0.0),
        lambda: device.rescue("port1/line0", 0.0),
    ]
    for call in calls:
        served.faults.set(kind, 0.5 if kind == "delay" else None)
        took, outcome = timed(call)
        served.faults.set("clear")
        assert took < BOUND
        assert outcome is None or isinstance(outcome, DeviceError | bool | float) or hasattr(outcome, "columns")
    deadline = time.monotonic() + 5.0
    while isinstance(timed(lambda: device.write("ao0", 2.0))[1], DeviceError):  # a cut connection is made again
        assert time.monotonic() < deadline
        time.sleep(0.1)
    assert device.read_back("ao0") == 2.0


@pytest.mark.parametrize(
    ("code", "why"),
    [
        (-50103, "is reserved by another program or task: end that one first"),
        (-201003, "is it plugged in, and has it power"),
        (-200088, "the server was restarted, or another program took the device"),
        (-200452, r"An error that was asked for. \(NI-DAQmx error -200452\)"),
    ],
)
def test_errors_of_ni_daqmx_are_sentences_with_their_code(bench, code, why):
    _emulator, served, device = bench
    served.faults.set("exception", code)
    with pytest.raises(DeviceError, match=why) as reported:
        device.write("ao0", 1.0)
    assert str(code) in str(reported.value)
    assert "\n" not in str(reported.value)


# -- who else is there ------------------------------------------------------------------------------------------------


def test_a_program_that_died_leaves_no_task_behind(bench):
    """Over gRPC its tasks stay on the server: the next one ends them, samples and vents."""
    emulator, served, dead = bench
    dead.switch("port1/line0", on=True)
    dead.write("ao0", 2.0)
    start(dead, 200.0)
    dead._sampling.end()
    names = set(served.board.tasks)
    device = NiDaq(daq(server=served.address), RealClock())
    try:
        device.open()
        assert set(served.board.tasks) == names
        assert served.board.volts["ao0"] == pytest.approx(2.0, abs=STEP)
        start(device, 200.0)
        patiently(lambda: device.write("ao0", 0.0))
        patiently(lambda: device.switch("port1/line0", on=False))
        assert until(lambda: len(patiently(device.collect).time))
        assert sent(emulator)[-1]["raw"] == 0.0
    finally:
        device.close()


def test_another_computers_sampling_is_reported_as_reserved(bench, monkeypatch):
    _emulator, served, device = bench
    start(device, 200.0)
    monkeypatch.setattr("pmabench_drivers.ni_daq.connection.socket.gethostname", lambda: "another")
    other = NiDaq(daq(server=served.address), RealClock())
    try:
        other.open()
        with pytest.raises(DeviceError, match=r"is reserved by another program or task.*-50103"):
            other.start(200.0)
        other.write("ao0", 0.0)  # but venting is possible
    finally:
        other.close()


def test_with_nis_driver_on_this_computer_everything_goes_through_it(bench, monkeypatch):
    """As with NI's own library: no server, no named sessions, one way; here its calls are answered by the emulator."""
    emulator, served, over_grpc = bench
    over_grpc.close()
    select = nidaqmx.utils._select_interpreter
    with grpc.insecure_channel(served.address) as wire:
        monkeypatch.setattr(
            nidaqmx.utils, "_select_interpreter", lambda _o=None: select(nidaqmx.GrpcSessionOptions(wire, ""))
        )
        device = NiDaq(daq(server=""), RealClock())
        assert device.open().model == f"{UNPROVEN}USB-6215"
        device.switch("port1/line0", on=True)
        device.write("ao0", 1.0)
        start(device, 200.0)
        assert until(lambda: len(patiently(device.collect).time))
        device.rescue("ao0", 0.0)
        device.rescue("port1/line0", 0.0)
        assert sent(emulator)[-1]["raw"] == 0.0
        assert not device.is_on("port1/line0")
        device.close()
        assert served.board.tasks == {}


def test_only_this_machine_is_served_and_a_server_must_be_named():
    with pytest.raises(UsageError, match="where other machines could reach what is emulated"):
        Emulator([daq(server="192.168.0.5:31763")])
    with pytest.raises(UsageError, match=r'an emulator needs "options: \{server: 127.0.0.1:PORT\}"'):
        Emulator([daq(server="")])


def test_a_port_that_is_taken_is_reported(bench):
    with pytest.raises(UsageError, match="the port is taken"):
        Emulator([daq(server=bench[1].address)])
