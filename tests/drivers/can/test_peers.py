"""Independent peers: the canopen library on either side of the bus, and tshark over what was exchanged."""

import json
import shutil
import struct
import subprocess
import time

import canopen
import pytest
from canopen.objectdictionary import ODArray, ODRecord, ODVariable
from canopen.objectdictionary import datatypes as dt
from canopen.profiles.p402 import BaseNode402
from pmabench_drivers.canbus import CanBus
from pmabench_drivers.canbus.emulated import Hub
from pmabench_drivers.emulator.faults import LINK, Faults

from pmabench.base.clock import RealClock
from pmabench.bench.interface import Segment
from tests.drivers.can.rigs import bus, rig
from tests.drivers.common import until

pytestmark = pytest.mark.realtime

KINDS = {
    "B": dt.UNSIGNED8,
    "b": dt.INTEGER8,
    "H": dt.UNSIGNED16,
    "h": dt.INTEGER16,
    "I": dt.UNSIGNED32,
    "i": dt.INTEGER32,
}


def variable(index, sub, kind, value=0):
    item = ODVariable(f"o{index:04X}_{sub}", index, sub)
    item.data_type, item.access_type, item.value = KINDS[kind], "rw", value
    item.default = value
    return item


def dictionary():
    """Objects of a CiA 402 drive, written out by hand."""
    known = canopen.ObjectDictionary()
    single = {
        0x1000: ("I", 402), 0x1001: ("B", 0), 0x1017: ("H", 0), 0x603F: ("H", 0), 0x6040: ("H", 0), 0x6041: ("H", 0x40),
        0x6060: ("b", 0), 0x6061: ("b", 0), 0x607A: ("i", 0), 0x6062: ("i", 0), 0x6064: ("i", 250), 0x6081: ("I", 0),
        0x6502: ("I", 0x81), 0x6007: ("h", 1), 0x605A: ("h", 2), 0x6065: ("I", 0xFFFFFFFF),
    }  # fmt: skip
    for index, (kind, value) in single.items():
        known.add_object(variable(index, 0, kind, value))
    for index, text in ((0x1008, "a drive of canopen"), (0x100A, "2.4")):
        item = ODVariable(f"o{index:04X}", index, 0)
        item.data_type, item.access_type, item.value, item.default = dt.VISIBLE_STRING, "const", text, text
        known.add_object(item)
    groups = {
        0x1016: [("B", 1), ("I", 0)], 0x1018: [("B", 4), ("I", 1), ("I", 2), ("I", 3), ("I", 4711)],
        0x607D: [("B", 2), ("i", -10_000), ("i", 100_000)], 0x60C2: [("B", 2), ("B", 1), ("b", -3)],
    }  # fmt: skip
    for first, node in ((0x1400, 0x200), (0x1401, 0x300), (0x1800, 0x180), (0x1801, 0x280)):
        groups[first] = [("B", 2), ("I", 0x80000000 | node + 5), ("B", 255)]
        groups[first + 0x200] = [("B", 0)] + [("I", 0)] * 8
    for index, members in groups.items():
        group = ODArray(f"g{index:04X}", index) if index == 0x1016 else ODRecord(f"g{index:04X}", index)
        for sub, (kind, value) in enumerate(members):
            group.add_member(variable(index, sub, kind, value))
        known.add_object(group)
    return known


class PeerDrive:
    """A drive whose SDO server, NMT and heartbeat are those of canopen; its states as a table of CiA 402."""

    STEPS = {(0x40, 0x06): 0x21, (0x21, 0x07): 0x23, (0x23, 0x0F): 0x27, (0x27, 0x02): 0x07, (0x07, 0x0F): 0x27}

    def __init__(self, address):
        self.network = canopen.Network()
        self.network.connect(
            interface="slcan", channel=address.removeprefix("slcan:"), sleep_after_open=0, bitrate=500_000
        )
        self.node = self.network.add_node(canopen.LocalNode(5, dictionary()))
        self.node.add_write_callback(self._written)
        self.network.subscribe(0x80, self._sync)
        self.network.subscribe(0x205, lambda _i, data, _t: self._put(0x607A, 0, data))
        self.words, self.targets = [], []
        self.node.nmt.send_command(0)
        self.node.nmt.start_heartbeat(100)

    def close(self):
        self.node.nmt.stop_heartbeat()
        self.network.disconnect()

    def get(self, index, sub, kind):
        return struct.unpack(f"<{kind}", self.node.get_data(index, sub))[0]

    def _put(self, index, sub, data):
        self.node.data_store.setdefault(index, {})[sub] = bytes(data)

    def _written(self, index, subindex, od, data):
        if index == 0x6060:
            self._put(0x6061, 0, data)
        if index == 0x6040:
            [word] = struct.unpack("<H", data)
            self.words.append(word)
            status = self.get(0x6041, 0, "H") & 0x6F
            follows = self.STEPS.get((status, word & 0x0F), status)
            if follows == 0x27 and word & 0x10:
                self.targets.append((self.get(0x607A, 0, "i"), self.get(0x6081, 0, "I")))
                self._put(0x6064, 0, self.node.get_data(0x607A, 0))
            self._put(0x6041, 0, struct.pack("<H", follows | 0x610 | (0x1000 if word & 0x10 else 0)))

    def _sync(self, _identifier, _data, _time):
        if self.get(0x6061, 0, "b") == 8 and self.get(0x6041, 0, "H") & 0x6F == 0x27:
            self._put(0x6064, 0, self.node.get_data(0x607A, 0))
        for parameter in (0x1800, 0x1801):
            identifier = self.get(parameter, 1, "I")
            if identifier & 1 << 31 or self.get(parameter, 2, "B") != 1:
                continue
            entries = [
                self.get(parameter + 0x200, sub, "I") for sub in range(1, 1 + self.get(parameter + 0x200, 0, "B"))
            ]
            data = b"".join(self.node.get_data(entry >> 16, entry >> 8 & 255) for entry in entries)
            self.network.send_message(identifier & 0x7FF, data)


def test_the_driver_drives_a_drive_of_the_canopen_library():
    hub = Hub("bus", "slcan:socket://127.0.0.1:0", Faults(LINK), lambda _k, _d: None)
    hub.start()
    peer = driver = None
    try:
        peer = PeerDrive(hub.address)
        nodes = {"drive": {"profile": 402, "node": 5, "approach": "50 mm/s"}}
        record = bus(hub.address, channels=bus().channels[1:], nodes=nodes, sync="20 ms")
        driver = CanBus(record, RealClock())
        identity = driver.open()
        assert identity.model == "a drive of canopen"
        assert (identity.serial, identity.firmware, identity.simulated) == ("4711", "2.4", False)
        assert peer.get(0x1A00, 1, "I") == 0x60410010  # statusword, then actual position, in the first TPDO
        assert peer.get(0x1A00, 2, "I") == 0x60640020
        assert (peer.get(0x1600, 0, "B"), peer.get(0x1600, 1, "I")) == (1, 0x607A0020)
        assert (peer.get(0x60C2, 1, "B"), peer.get(0x60C2, 2, "b")) == (20, -3)
        assert driver.arm_watchdog(0.4) == 0.4
        assert peer.get(0x1016, 1, "I") == 127 << 16 | 400
        assert (peer.get(0x6007, 0, "h"), peer.get(0x605A, 0, "h")) == (3, 6)
        assert peer.words == [0x06, 0x07]  # no power before a command
        driver.write("drive.position", 1234.0)
        assert peer.targets == [(1234, 50_000)]
        assert peer.words[2:] == [0x0F, 0x0F, 0x3F, 0x0F]
        assert driver.read_back("drive.position") == 1234.0
        assert driver.start(50.0) == 50.0
        sine = Segment("sine", driver._clock.now(), 1234.0, amplitude=500.0, frequency=2.0, cycles=1)
        driver.follow("drive.position", sine)
        time.sleep(0.8)
        shown = driver.collect().columns["drive_position"]
        assert max(shown) == pytest.approx(1734, abs=20)
        assert min(shown) == pytest.approx(734, abs=20)
        assert shown[-1] == 1234
        driver.halt("drive.position")
        assert peer.get(0x6041, 0, "H") & 0x6F == 0x07
    finally:
        if driver is not None:
            driver.close()
        if peer is not None:
            peer.close()
        hub.close()


def test_the_canopen_library_drives_the_emulated_drive():
    with rig(opened=False) as (emulator, served, _driver):
        network = canopen.Network()
        channel = served.address.removeprefix("slcan:")
        network.connect(interface="slcan", channel=channel, sleep_after_open=0, bitrate=500_000)
        try:
            node = network.add_node(BaseNode402(5, dictionary()))
            node.sdo.RESPONSE_TIMEOUT = 2.0
            assert node.sdo[0x1008].raw.startswith("emulated unproven CiA 402 drive")
            assert node.sdo[0x1000].raw & 0xFFFF == 402
            node.nmt.state = "OPERATIONAL"
            node.sdo[0x1017].raw = 50
            node.nmt.wait_for_heartbeat(2)
            node.setup_402_state_machine(read_pdos=False)
            for name in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
                node.state = name
                assert node.state == name
            node.op_mode = "PROFILED POSITION"
            node.sdo[0x6081].raw = 100_000
            node.sdo[0x607A].raw = 8000
            node.controlword = 0x3F
            assert node.statusword & 0x1000
            assert until(lambda: node.sdo[0x6064].raw == 8000)
            assert emulator.log.of("move")[-1]["si"] == pytest.approx(0.008)
            node.controlword = 0x0F
            node.state = "QUICK STOP ACTIVE" if node.sdo[0x605A].raw >= 5 else "SWITCH ON DISABLED"
            assert node.state == "SWITCH ON DISABLED"
            with pytest.raises(canopen.SdoAbortedError, match="0x06020000"):
                node.sdo.upload(0x2345, 0)
            with pytest.raises(canopen.SdoAbortedError, match="0x06010002"):
                node.sdo.download(0x6064, 0, b"\0\0\0\0")
        finally:
            network.disconnect()


def pcap(path, entries):
    """What a log of the emulator says was exchanged, as SocketCAN frames (link type 227)."""
    parts = [struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 227)]
    kept = {"sent": b"", "received": b""}
    for entry in entries:
        *lines, kept[entry["kind"]] = (kept[entry["kind"]] + bytes.fromhex(entry["data"])).split(b"\r")
        for line in lines:
            if line[:1] == b"t":
                data = bytes.fromhex(line[5:].decode())
                frame = struct.pack(">IB3x", int(line[1:4], 16), len(data)) + data
                seconds = int(entry["t"])
                parts.append(struct.pack("<IIII", seconds, round((entry["t"] - seconds) * 1e6), len(frame), len(frame)))
                parts.append(frame)
    path.write_bytes(b"".join(parts))
    return (len(parts) - 1) // 2


@pytest.mark.skipif(shutil.which("tshark") is None, reason="not run: no tshark")
def test_tshark_finds_nothing_malformed_in_what_was_exchanged(tmp_path):
    log, file = tmp_path / "log.jsonl", tmp_path / "bus.pcap"
    with rig(log=log) as (_emulator, _served, driver):
        driver.arm_watchdog(0.5)
        driver.start(100.0)
        driver.write("drive.position", 2000.0)
        assert until(lambda: driver._nodes["drive"].position == 2000)
        sine = Segment("sine", driver._clock.now(), 2000.0, amplitude=100.0, frequency=5.0, cycles=1)
        driver.follow("drive.position", sine)
        driver.feed_watchdog()
        time.sleep(0.3)
        driver.halt("drive.position")
        driver.disarm_watchdog()
    frames = pcap(file, [e for e in map(json.loads, log.read_text().splitlines()) if e["kind"] in {"sent", "received"}])
    command = ["tshark", "-r", str(file), "-d", "can.subdissector,canopen", "-T", "fields", "-e", "_ws.col.Info"]
    command += ["-e", "_ws.malformed", "-e", "_ws.expert.message"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.splitlines()
    assert len(shown) == frames > 100
    assert not [line for line in shown if "alformed" in line or "rror" in line.split("\t", 1)[1]]
    reported = {line.split("\t")[0] for line in shown}
    for what in ("SYNC", "PDO1 (rx)", "PDO1 (tx)", "PDO2 (tx)", "Default-SDO (tx): Upload segment response"):
        assert what in reported
    for what in ("NMT: Start remote node [0x5]", "NMT Error Control: Operational [0xc]"):
        assert what in reported
    assert "NMT Error Control: Operational [0x7f]" in reported  # what feeds the drive's watchdog
