"""A Modbus device that only measures, and its connection breaks: its samples are believed where it is still the same."""

import struct
import time
from array import array

import pytest

from pmabench.bench.interface import ChannelRecord, DeviceRecord, Scale
from tests.drivers.common import opened, until
from tests.drivers.wires.rigs import MODBUS, Peer

pytestmark = pytest.mark.realtime


class Daq:
    """Answers with its serial number (at 112), uptime (120) and a force (0); cuts the connection after `change`."""

    def __init__(self):
        self.serial, self.on, self.force, self.cut = 4711, time.monotonic() - 50.0, 100.0, False

    def change(self, **what):
        """Another device takes its place, or itself after a restart."""
        vars(self).update(what)
        self.cut = True

    def __call__(self, request):
        if self.cut:
            self.cut = False
            raise ConnectionResetError
        number, _, _, unit, function, address, count = struct.unpack(">HHHBBHH", request)
        data = {
            0: struct.pack(">f", self.force),
            112: struct.pack(">I", self.serial),
            120: struct.pack(">I", int(time.monotonic() - self.on)),
        }[address]
        assert len(data) == 2 * count
        return struct.pack(">HHHBBB", number, 0, 3 + len(data), unit, function, len(data)) + data


def daq(address):
    channel = ChannelRecord("force", "force", "daq", "force", "float64", "N", Scale(), -50.0, 1950.0)
    registers = {
        "rate": "100 Hz",
        "identity": {"maker": "Acme", "serial": {"address": 112, "type": "uint32"}},
        "uptime": {"address": 120, "type": "uint32"},
        "inputs": {"force": {"address": 0, "type": "float32"}},
        "outputs": {},
    }
    return DeviceRecord("daq", MODBUS, address, {"map": registers}, (channel,))


def after(device, seconds):
    time.sleep(seconds)
    return device.collect().columns["force"]


def test_the_same_device_goes_on():
    truth = Daq()
    with Peer(truth) as peer, opened(daq(peer.address)) as device:
        device.start(100.0)
        assert set(after(device, 0.3)) == {100.0}
        for force in (101.0, 102.0):
            truth.change(force=force)
            assert until(lambda force=force: force in device.collect().columns["force"], 1.0)
            assert set(after(device, 0.2)) == {force}


@pytest.mark.parametrize("change", [{"serial": 9999}, {"on": "now"}], ids=["another", "restarted"])
def test_what_another_one_measures_is_not_believed(change):
    truth = Daq()
    change = {key: time.monotonic() if key == "on" else value for key, value in change.items()}
    with Peer(truth) as peer, opened(daq(peer.address)) as device:
        device.start(100.0)
        assert set(after(device, 0.3)) == {100.0}
        truth.change(force=50.0, **change)
        assert set(after(device, 0.6)) <= {100.0}
        assert after(device, 0.3) == array("d")
        assert device.held() == {
            "serial": str(truth.serial),
            "uptime": pytest.approx(time.monotonic() - truth.on, abs=2),
        }
