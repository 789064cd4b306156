"""canopen in front of a CiA 402 drive (node 5) and a CiA 406 encoder (node 12): the calls of its pages.

Calls: quick start, network, NMT, SDO, PDO, SYNC, EMCY and device profiles of https://canopen.readthedocs.io (2.4), and
examples/simple_ds402_node.py. A count of both is a micrometre. Which objects there are: CiA 301, CiA 402 and, for the
encoder, table 17 of the operation manual of the Temposonics E-Series CANopen.
"""

import logging
import sys
import time

import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable
from canopen.objectdictionary import datatypes as dt
from canopen.profiles.p402 import BaseNode402
from said import call, not_tried

DRIVE, ENCODER = 5, 12
KINDS = {
    "b": dt.INTEGER8, "h": dt.INTEGER16, "i": dt.INTEGER32, "B": dt.UNSIGNED8, "H": dt.UNSIGNED16, "I": dt.UNSIGNED32,
    "s": dt.VISIBLE_STRING,
}  # fmt: skip
COMMON = {
    0x1000: "I Device type", 0x1001: "B Error register", 0x1003: "a Error field", 0x1005: "I SYNC",
    0x1006: "I Cycle period", 0x1008: "s Manufacturer device name", 0x1009: "s Hardware", 0x100A: "s Software",
    0x100C: "H Guard time", 0x100D: "B Life time factor", 0x1014: "I EMCY", 0x1016: "a Consumer heartbeat time",
    0x1017: "H Producer heartbeat time", 0x1018: "r Identity",
}  # fmt: skip
OF_DRIVE = {
    0x6007: "h Abort connection option", 0x603F: "H Error code", 0x6040: "H Controlword", 0x6041: "H Statusword",
    0x605A: "h Quick stop option", 0x6060: "b Modes of operation", 0x6061: "b Modes of operation display",
    0x6064: "i Position actual value", 0x606C: "i Velocity actual value", 0x607A: "i Target position",
    0x6081: "I Profile velocity", 0x6083: "I Profile acceleration", 0x6502: "I Supported drive modes",
}  # fmt: skip


def dictionary(objects):
    """An object dictionary: variables, arrays (`a`) and records (`r`) of 32 bits, and two PDOs each way."""
    found = canopen.ObjectDictionary()
    for index, text in (COMMON | objects).items():
        kind, _, name = text.partition(" ")
        if kind in KINDS:
            found.add_object(variable(index, 0, kind, name))
            continue
        group = (ODArray if kind == "a" else ODRecord)(name, index)
        for sub in range(5):
            group.add_member(variable(index, sub, "I" if sub else "B", f"{name} {sub}"))
        found.add_object(group)
    for index in (0x1400, 0x1401, 0x1800, 0x1801):
        parameter, mapping = ODRecord(f"PDO {index:04X}", index), ODRecord(f"Mapping {index:04X}", index + 0x200)
        for sub, kind in ((0, "B"), (1, "I"), (2, "B"), (3, "H"), (5, "H")):
            parameter.add_member(variable(index, sub, kind, f"{sub}"))
        for sub in range(9):
            mapping.add_member(variable(index + 0x200, sub, "I" if sub else "B", f"{sub}"))
        found.add_object(parameter)
        found.add_object(mapping)
    return found


def variable(index, sub, kind, name):
    item = ODVariable(name, index, sub)
    item.data_type, item.access_type = KINDS[kind], "rw"
    return item


def refused(code, do, *arguments):
    """The node refuses it with this abort code."""
    try:
        do(*arguments)
    except canopen.SdoAbortedError as error:
        assert error.code == code, f"abort code {error.code:08X}h where {code:08X}h is right"
    else:
        raise AssertionError(f"is not refused, and abort code {code:08X}h is right")


def number(node, index, sub=0, *, signed=False):
    """An object that the dictionary of the client does not have."""
    return int.from_bytes(node.sdo.upload(index, sub), "little", signed=signed)


def wait(condition, what, within=3.0):
    until = time.monotonic() + within
    while not condition():
        assert time.monotonic() < until, f"no {what} within {within:g} s"
        time.sleep(0.01)


def at(position, saw):
    """The drive stands there, and the encoder sees it."""
    wait(lambda: abs(drive.sdo[0x6064].raw - position) < 50, f"drive at {position}")
    time.sleep(0.3)
    seen = number(encoder, 0x6004, signed=True)
    assert abs(seen - drive.sdo[0x6064].raw) < 500, f"the encoder tells {seen} and the drive {drive.sdo[0x6064].raw}"
    saw["displacement"] = 1e-6 * drive.sdo[0x6064].raw


def becomes(node, state):
    """Its heartbeat says so; one that was on its way before may say something else."""
    wait(lambda: node.nmt.wait_for_heartbeat(1) == state, f"heartbeat that says {state}")


def restart(node, how):
    """Reset it: its boot-up message comes, and no emergency."""
    node.emcy.reset()
    node.nmt.state = how
    node.nmt.wait_for_bootup(2)
    time.sleep(0.1)
    assert [f"{error.code:04X}" for error in node.emcy.log] == [], "sends an emergency"
    assert node.nmt.state == "PRE-OPERATIONAL", node.nmt.state
    assert node.sdo[0x1001].raw == 0


logging.disable(logging.CRITICAL)
network = canopen.Network()
drive = BaseNode402(DRIVE, dictionary(OF_DRIVE))
encoder = canopen.RemoteNode(ENCODER, dictionary({}))

with call("Network.connect, add_node"):
    channel = sys.argv[1].removeprefix("slcan:")
    network.connect(interface="slcan", channel=channel, bitrate=500_000, sleep_after_open=0)
    network.add_node(drive)
    network.add_node(encoder)
    network.check()

with call("network.scanner.search"):
    network.scanner.search()
    wait(lambda: {DRIVE, ENCODER} <= set(network.scanner.nodes), "answer of both nodes")

with call("sdo: device type, name, identity"):
    assert drive.sdo[0x1000].raw == 402 | 2 << 16  # a servo drive
    assert encoder.sdo[0x1000].raw == 406 | 8 << 16  # an absolute linear encoder
    assert "CiA 402" in drive.sdo["Manufacturer device name"].raw
    assert [encoder.sdo[0x1018][sub].raw for sub in (0, 4)] == [4, ENCODER]
    assert drive.sdo[0x1018][4].raw != encoder.sdo[0x1018][4].raw

with call("sdo.upload, sdo.download"):
    assert len(drive.sdo.upload(0x1017, 0)) == 2
    drive.sdo.download(0x1017, 0, b"\x32\x00")
    assert drive.sdo["Producer heartbeat time"].raw == 50

with call("SdoAbortedError: codes"):
    refused(0x06020000, drive.sdo.upload, 0x2FFF, 0)
    refused(0x06090011, drive.sdo.upload, 0x1018, 9)
    refused(0x06010002, drive.sdo.download, 0x6041, 0, b"\0\0")
    refused(0x06070012, drive.sdo.download, 0x6040, 0, b"\0\0\0")
    refused(0x06070012, drive.sdo.download, 0x6040, 0, bytes(12))
    refused(0x06070013, drive.sdo.download, 0x607A, 0, b"\0\0")
    refused(0x06090030, drive.sdo.download, 0x6060, 0, b"\x63")

with call("sdo: error log"):
    assert [error.raw for error in drive.sdo[0x1003].values()] == []
    refused(0x08000024, drive.sdo.upload, 0x1003, 1)

with call("nmt.state = 'RESET COMMUNICATION', wait_for_bootup"):
    for node in (drive, encoder):
        node.sdo[0x1017].raw = 100
        restart(node, "RESET COMMUNICATION")
        assert node.sdo[0x1017].raw == 0, "keeps its heartbeat time"

with call("nmt.state = 'RESET', wait_for_bootup"):
    usual = drive.sdo[0x6081].raw
    drive.sdo[0x6081].raw = usual + 1
    drive.sdo[0x1016][1].raw = 127 << 16 | 500
    restart(drive, "RESET")
    assert (drive.sdo[0x6081].raw, drive.sdo[0x1016][1].raw) == (usual, 0)
    restart(encoder, "RESET")

with call("nmt.state = 'OPERATIONAL', wait_for_heartbeat"):
    for node in (drive, encoder):
        node.sdo[0x1017].raw = 50
        node.nmt.state = "OPERATIONAL"
        becomes(node, "OPERATIONAL")

with call("nmt.state = 'STOPPED'"):
    encoder.nmt.state = "STOPPED"
    try:
        becomes(encoder, "STOPPED")
        encoder.sdo.upload(0x1000, 0)
    except canopen.SdoCommunicationError:
        pass  # as it should: no SDO while it is stopped
    else:
        raise AssertionError("answers to SDO while it is stopped")
    finally:
        encoder.nmt.state = "OPERATIONAL"

with call("nmt.start_node_guarding"):
    encoder.sdo[0x1017].raw = 0
    heard = []
    network.subscribe(0x700 + ENCODER, lambda _identifier, data, _time: heard.append(bytes(data)))
    encoder.nmt.start_node_guarding(0.05)
    time.sleep(0.5)
    encoder.nmt.stop_node_guarding()
    network.unsubscribe(0x700 + ENCODER)
    network.subscribe(0x700 + ENCODER, encoder.nmt.on_heartbeat)
    assert len(heard) > 4
    assert {message[0] & 0x7F for message in heard} == {5}
    assert {message[0] >> 7 for message in heard} == {0, 1}, "its toggle bit stays"

with call("tpdo.read, rpdo.read"):
    drive.nmt.state = "PRE-OPERATIONAL"
    drive.tpdo.read()
    drive.rpdo.read()
    assert (drive.tpdo[1].cob_id, drive.rpdo[1].cob_id) == (0x180 + DRIVE, 0x200 + DRIVE)
    assert [item.index for item in drive.tpdo[1].map] == [0x6041]
    assert [item.index for item in drive.rpdo[1].map] == [0x6040]
    assert [item.index for item in drive.rpdo[2].map] == [0x6040, 0x6060]

with call("tpdo: clear, add_variable, save, sync.start, wait_for_reception"):
    drive.tpdo[1].clear()
    drive.tpdo[1].add_variable("Statusword")
    drive.tpdo[1].add_variable("Velocity actual value")
    drive.tpdo[1].trans_type = 1
    drive.tpdo[1].event_timer = 0
    drive.tpdo[1].enabled = True
    drive.tpdo.save()
    drive.nmt.state = "OPERATIONAL"
    network.sync.start(0.02)
    assert drive.tpdo[1].wait_for_reception(1) is not None, "sends no TPDO after SYNC"
    network.sync.stop()
    assert drive.tpdo["Statusword"].raw == drive.sdo["Statusword"].raw
    assert drive.tpdo["Velocity actual value"].raw == 0

with call("setup_402_state_machine"):
    drive.nmt.state = "PRE-OPERATIONAL"
    drive.setup_402_state_machine()
    drive.nmt.state = "OPERATIONAL"
    network.sync.start(0.02)

with call("BaseNode402.state"):
    for state in ("SWITCH ON DISABLED", "READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
        drive.state = state
        assert drive.state == state
    drive.sdo["Quick stop option"].raw = 6  # it stays there, and does not go on to switch on disabled
    for state in ("QUICK STOP ACTIVE", "SWITCH ON DISABLED"):
        drive.state = state
        assert drive.state == state

with call("BaseNode402.op_mode"):
    assert drive.is_op_mode_supported("PROFILED POSITION")
    drive.op_mode = "PROFILED POSITION"
    wait(lambda: drive.sdo[0x6061].raw == 1, "mode 1")

with call("profile position") as saw:
    drive.state = "OPERATION ENABLED"
    drive.sdo["Profile velocity"].raw = 20_000
    for target in (8_000, 3_000):
        drive.sdo["Target position"].raw = target
        drive.sdo["Controlword"].raw = 0x0F
        drive.sdo["Controlword"].raw = 0x1F
        wait(lambda: drive.sdo["Statusword"].raw & 1 << 12, "acknowledge of the set-point")
        drive.sdo["Controlword"].raw = 0x0F
        wait(lambda: drive.sdo["Statusword"].raw & 1 << 10, "target reached")
    at(3_000, saw)

with call("emcy: wait, log, active, reset_from_fault"):
    drive.emcy.reset()
    drive.sdo["Abort connection option"].raw = 1
    drive.sdo[0x1016][1].raw = 127 << 16 | 100
    network.send_message(0x700 + 127, b"\x05")
    error = drive.emcy.wait(0x8130, timeout=2)
    assert error is not None, "misses the heartbeat without an emergency"
    wait(lambda: drive.sdo[0x603F].raw == 0x8130, "error code 8130h")
    assert drive.sdo[0x1003][1].raw & 0xFFFF == 0x8130
    drive.sdo[0x1016][1].raw = 0
    drive.sdo["Controlword"].raw = 0x00
    drive.sdo["Controlword"].raw = 0x80
    wait(lambda: drive.emcy.active == [], "emergency 0000h")
    drive.sdo[0x1003][0].raw = 0
    assert drive.sdo[0x1001].raw == 0

with call("RESET COMMUNICATION while operation is enabled") as saw:
    drive.nmt.state = "OPERATIONAL"
    drive.state = "OPERATION ENABLED"
    network.sync.stop()
    restart(drive, "RESET COMMUNICATION")
    assert drive.sdo["Statusword"].raw & 0x4F == 0x40, "keeps its power"
    at(3_000, saw)

with call("CiA 406: identity"):
    assert number(encoder, 0x650B) == encoder.sdo[0x1018][4].raw
    assert number(encoder, 0x6507) != 0
    assert number(encoder, 0x6500) & 1 == 0
    assert number(encoder, 0x6000) == 0

with call("CiA 406: position") as saw:
    position = number(encoder, 0x6004, signed=True)
    assert number(encoder, 0x6020, 0) == 1
    assert abs(number(encoder, 0x6020, 1, signed=True) - position) < 500
    saw["displacement"] = 1e-9 * number(encoder, 0x6501) * position
    refused(0x06010002, encoder.sdo.download, 0x6004, 0, bytes(4))

with call("CiA 406: range and steps"):
    assert number(encoder, 0x6005, 0) == 2
    assert number(encoder, 0x6005, 1) == number(encoder, 0x6501) == 1000
    assert number(encoder, 0x6002) == number(encoder, 0x650A, 3, signed=True) - number(encoder, 0x650A, 2, signed=True)

with call("CiA 406: alarms and warnings"):
    assert [number(encoder, index) for index in (0x6503, 0x6504, 0x6505, 0x6506)] == [0, 1, 0, 0x7000]

with call("CiA 406: cyclic timer, tpdo"):
    heard = []
    network.subscribe(0x180 + ENCODER, lambda _identifier, data, _time: heard.append(bytes(data)))
    encoder.sdo.download(0x6200, 0, b"\x32\x00")
    assert number(encoder, 0x1800, 5) == 50
    encoder.nmt.state = "OPERATIONAL"
    time.sleep(0.2)
    heard.clear()
    time.sleep(1.0)
    assert 15 <= len(heard) <= 21, f"{len(heard)} PDOs in 1 s at 50 ms"
    assert abs(int.from_bytes(heard[-1][:4], "little", signed=True) - number(encoder, 0x6004, signed=True)) < 500

with call("sdo: block transfer"):
    try:
        encoder.sdo["Manufacturer device name"].open("rb", block_transfer=True).close()
    except canopen.SdoAbortedError as error:
        assert error.code == 0x05040001, f"abort code {error.code:08X}h"  # a node need not know it

with call("disconnect"):
    network.disconnect()

not_tried("homing, PROFILED VELOCITY", "the emulated drive has profile position and cyclic synchronous position")
not_tried("lss, time", "no such service is emulated")
