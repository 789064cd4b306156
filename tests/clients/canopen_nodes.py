"""canopen in front of a CiA 402 drive (node 5) and a CiA 406 encoder (node 12): calls of its pages that the driver needs.

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
    0x1000: "I Device type", 0x1001: "B Error register", 0x1008: "s Manufacturer device name", 0x100A: "s Software",
    0x1016: "a Consumer heartbeat time", 0x1017: "H Producer heartbeat time", 0x1018: "r Identity",
}  # fmt: skip
OF_DRIVE = {
    0x6007: "h Abort connection option", 0x603F: "H Error code", 0x6040: "H Controlword", 0x6041: "H Statusword",
    0x605A: "h Quick stop option", 0x6060: "b Modes of operation", 0x6061: "b Modes of operation display",
    0x6064: "i Position actual value", 0x607A: "i Target position", 0x6081: "I Profile velocity",
    0x6502: "I Supported drive modes",
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
        for sub, kind in ((0, "B"), (1, "I"), (2, "B")):
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


def restart(node):
    """Reset it: its boot-up message comes, and no emergency."""
    node.emcy.reset()
    node.nmt.state = "RESET"
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

with call("nmt.state = 'RESET', wait_for_bootup"):
    usual = drive.sdo[0x6081].raw
    drive.sdo[0x6081].raw = usual + 1
    drive.sdo[0x1016][1].raw = 127 << 16 | 500
    restart(drive)
    assert (drive.sdo[0x6081].raw, drive.sdo[0x1016][1].raw) == (usual, 0)
    restart(encoder)

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

with call("tpdo.read, rpdo.read"):
    drive.nmt.state = "PRE-OPERATIONAL"
    drive.tpdo.read()
    drive.rpdo.read()
    assert (drive.tpdo[1].cob_id, drive.rpdo[1].cob_id) == (0x180 + DRIVE, 0x200 + DRIVE)
    assert [drive.tpdo[1].enabled, drive.rpdo[1].enabled] == [False, False]

with call("tpdo: clear, add_variable, save, sync.start, wait_for_reception"):
    drive.tpdo[1].clear()
    drive.tpdo[1].add_variable("Statusword")
    drive.tpdo[1].add_variable("Position actual value")
    drive.tpdo[1].trans_type = 1
    drive.tpdo[1].enabled = True
    drive.tpdo.save()
    drive.nmt.state = "OPERATIONAL"
    network.sync.start(0.02)
    assert drive.tpdo[1].wait_for_reception(1) is not None, "sends no TPDO after SYNC"
    network.sync.stop()
    assert drive.tpdo["Statusword"].raw == drive.sdo["Statusword"].raw
    assert drive.tpdo["Position actual value"].raw == drive.sdo["Position actual value"].raw

with call("setup_402_state_machine"):
    drive.nmt.state = "PRE-OPERATIONAL"
    drive.setup_402_state_machine(read_pdos=False)
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
    drive.sdo[0x1016][1].raw = 0
    drive.sdo["Controlword"].raw = 0x00
    drive.sdo["Controlword"].raw = 0x80
    wait(lambda: drive.emcy.active == [], "emergency 0000h")
    assert drive.sdo[0x1001].raw == 0

with call("RESET while operation is enabled") as saw:
    drive.nmt.state = "OPERATIONAL"
    drive.state = "OPERATION ENABLED"
    network.sync.stop()
    restart(drive)
    assert drive.sdo["Statusword"].raw & 0x4F == 0x40, "keeps its power"
    at(3_000, saw)

with call("CiA 406: position") as saw:
    position = number(encoder, 0x6004, signed=True)
    assert number(encoder, 0x6020, 0) == 1
    assert abs(number(encoder, 0x6020, 1, signed=True) - position) < 500
    saw["displacement"] = 1e-9 * number(encoder, 0x6005, 1) * position
    refused(0x06010002, encoder.sdo.download, 0x6004, 0, bytes(4))

with call("CiA 406: alarms"):
    assert number(encoder, 0x6503) == 0

with call("CiA 406: tpdo at each SYNC"):
    heard = []
    network.subscribe(0x180 + ENCODER, lambda _identifier, data, _time: heard.append(bytes(data)))
    encoder.nmt.state = "PRE-OPERATIONAL"
    encoder.sdo.download(0x1800, 2, b"\x01")
    encoder.nmt.state = "OPERATIONAL"
    time.sleep(0.1)
    for _ in range(5):
        network.sync.transmit()
        time.sleep(0.05)
    assert len(heard) == 5, f"{len(heard)} PDOs after 5 SYNCs"
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
