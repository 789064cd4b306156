"""What is compared when a drive is opened, what is refused with a sentence, and what `check` says of the options."""

from dataclasses import replace

import pytest
from pmabench_drivers.festo_cmmt import FestoCmmt
from pymodbus.client import ModbusTcpClient

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import UNPROVEN, Scale
from tests.drivers.common import timed, until
from tests.drivers.festo_cmmt.rigs import drive, served


def problems(record):
    return {".".join(map(str, place)): text for place, text in FestoCmmt.check(record)}


def test_good_options_have_no_problems():
    assert problems(drive(speed="20 mm/s", acknowledge_faults=True)) == {}


@pytest.mark.parametrize(
    ("options", "place", "words"),
    [
        ({"speed": "20"}, "options.speed", '"20 mm/s"'),
        ({"speed": "20 m/s"}, "options.speed", "outside 0.0001 to 1 m/s"),
        ({"rate": "1 kHz"}, "options.rate", "outside 1 to 200 Hz"),
        ({"acknowledge_faults": "yes"}, "options.acknowledge_faults", "true or false"),
        ({"spead": "20 mm/s"}, "options.spead", 'did you mean "speed"'),
        ({"watchdog": 0.0}, "", 'needs "watchdog"'),
        ({"watchdog": 0.05}, "watchdog", "waits 0.1 to 65.535 s"),
        ({"address": "drive:502"}, "address", "an IP address with a port"),
    ],
)
def test_each_mistake_has_its_place(options, place, words):
    assert words in problems(drive(**options))[place]


def test_names_and_units_that_a_drive_does_not_have():
    record = drive()
    channel, output = record.channels[0], record.outputs[0]
    assert "it has position and set_point" in next(
        iter(problems(replace(record, channels=(replace(channel, input="posiion"),))).values())
    )
    assert "gives counts" in next(
        iter(problems(replace(record, channels=(replace(channel, raw_type="float64"),))).values())
    )
    assert "no length" in next(
        iter(problems(replace(record, outputs=(replace(output, quantity="pressure"),))).values())
    )
    assert "32 bits" in next(iter(problems(replace(record, outputs=(replace(output, scale=Scale(1e-12)),))).values()))


@pytest.mark.realtime
def test_it_shows_who_answers_and_that_it_is_emulated():
    with served() as rig:
        who = rig.device.open()
    assert (who.maker, who.model, who.firmware) == ("emulator of pmabench", f"{UNPROVEN}CMMT-AS", "1")
    assert who.simulated


def refused(rig, message):
    took, outcome = timed(rig.device.open)
    assert isinstance(outcome, DeviceError), outcome
    assert message in str(outcome)
    assert took < 2.3
    with pytest.raises(DeviceError, match="is not open"):
        rig.device.read_back("position")
    assert rig.log("power") == []


@pytest.mark.realtime
def test_another_telegram_is_refused():
    with served() as rig:
        rig.inside.parameters[3490] = b"\x09\x00"
        refused(rig, "has telegram 9 selected, and this driver speaks 111")


@pytest.mark.realtime
def test_other_units_are_refused():
    with served() as rig:
        rig.inside.parameters[11724] = b"\xf9"
        refused(rig, "counts in 1e-7 m, and the bench file in 1e-06 m")


@pytest.mark.realtime
def test_a_parameter_that_it_does_not_have_is_named():
    with served() as rig:
        del rig.inside.parameters[11725]
        refused(rig, "drive.parameter 11725: does not give its value (mailbox state 3)")


@pytest.mark.realtime
def test_velocities_are_in_the_drives_own_unit():
    """With velocities in micrometres a second, 10 mm/s are 10000."""
    with served() as rig:
        rig.inside.parameters[11725] = b"\xfa"
        rig.device.open()
        rig.device.arm_watchdog(20.0)
        rig.device.write("position", 0.0)
        assert rig.device._command.velocity * rig.device._command.override == 20000 * 0x4000


@pytest.mark.realtime
@pytest.mark.parametrize("kind", ["silence", "lost", "hang-up", "reset", "stale", "truncated", "garbage", "exception"])
def test_a_drive_that_does_not_answer_properly(kind):
    with served() as rig:
        rig.server.faults.set(kind)
        refused(rig, "drive")


@pytest.mark.realtime
def test_another_stack_reads_and_moves_the_same():
    """pymodbus by itself in front of our frames, with the maker's addresses and bits written out."""
    with served() as rig:
        rig.inside.timeout = 0
        host, port = rig.server.address.split(":")
        client = ModbusTcpClient(host, port=int(port), timeout=1, retries=0)

        def reported():
            return client.read_holding_registers(100, count=28).registers

        try:
            assert (
                client.read_device_information(read_code=2, object_id=0).information[4] == b"emulated unproven CMMT-AS"
            )
            for address, value in ((500, 3490), (501, 0), (502, 1), (503, 1)):
                assert not client.write_register(address, value).isError()
            assert client.read_holding_registers(503, count=1).registers == [0x10]
            assert client.read_holding_registers(504, count=1).registers == [2]
            assert client.read_holding_registers(510, count=1).registers == [111]
            rest = [0, 0, 0x4000, 0xD8F0, 0xFFFF, 100, 0, 0x4000, 0x4000]  # -10000 at 100
            for control in (0x043E, 0x043F):
                assert not client.write_registers(0, [control, 0x9100, *rest]).isError()
            deadline = 200
            while not reported()[0] & 1 << 2 and deadline:
                deadline -= 1
            assert reported()[0] & (1 << 2 | 1 << 3 | 1 << 9 | 1 << 11) == 1 << 2 | 1 << 9 | 1 << 11
            client.write_registers(0, [0x047F, 0x9100, *rest])
            assert reported()[0] & 1 << 12
            place = [0xD8F0, 0xFFFF]
            assert until(lambda: (words := reported())[0] & 1 << 10 and words[5:7] == place, 5)
            assert client.write_registers(400, [250, 0]).isError() is False
            assert client.read_holding_registers(400, count=2).registers == [250, 0]
            assert client.read_holding_registers(150, count=1).exception_code == 2
            assert client.write_registers(0, [0x043E] * 5).exception_code == 2
        finally:
            client.close()
