"""One node at a time, without a bus: late answers, targets, silence."""

import struct
import time

import pytest
from pmabench_drivers.canbus import frames as f
from pmabench_drivers.canbus.drive import Drive
from pmabench_drivers.canbus.node import Objects, Transducer, Unanswered


def answer(index, sub, value):
    return struct.pack("<BHBI", 0x43, index, sub, value)


def test_a_late_answer_is_not_that_of_the_next_question():
    """A node that was slow once: what it says late to one question must not be taken for the answer to the same again."""
    asked, late = [], []

    def send(_identifier, data):
        _command, index, sub = struct.unpack_from("<BHB", data)
        asked.append(index)
        if len(asked) == 1:
            late.append(answer(index, sub, 1))  # comes only later
        elif len(asked) == 2:
            for waiting in (late[0], answer(index, sub, 402)):
                objects.take(waiting)
        else:
            objects.take(answer(index, sub, 2))

    objects = Objects("bus", "drive", 5, send)
    with pytest.raises(Unanswered, match=r"object 607Ah:0; is node 5 on"):
        objects.read(0x607A, 0, "I", time.monotonic() + 0.01)
    assert objects.read(0x607A, 0, "I", time.monotonic() + 1.0) == 2
    assert asked == [0x607A, f.DEVICE_TYPE, 0x607A]


def test_targets_never_go_faster_than_allowed_and_stop_with_the_motion():
    sent = []
    drive = Drive("bus", "drive", 5, lambda identifier, data: sent.append((identifier, *struct.unpack("<i", data))))
    drive._target_pdo, drive.lead = 0x205, 0.0
    drive.lead_to(1000, 50.0)
    assert sent == []  # no cyclic motion was begun
    drive._cyclic = True
    for target in (1000, 1000, 60, -1e9):
        drive.lead_to(target, 50.0)
    assert sent == [(0x205, 50), (0x205, 100), (0x205, 60), (0x205, 10)]


@pytest.mark.parametrize("kind", [Drive, Transducer])
def test_a_node_that_is_silent_restarts_or_stops_is_in_trouble_for_good(kind, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("pmabench_drivers.canbus.node.monotonic", lambda: now[0])

    def watched():
        node = kind("bus", "it", 5, lambda _identifier, _data: None)
        node.take_heartbeat(bytes([f.OPERATIONAL]))
        node._watched = True
        assert node.trouble() == ""
        return node

    silent = watched()
    now[0] += 0.49
    assert silent.trouble() == ""
    now[0] += 0.02
    assert silent.trouble().startswith("it: no heartbeat for 0.5 s")
    silent.take_heartbeat(bytes([f.OPERATIONAL]))
    assert silent.trouble()  # it may have started again meanwhile

    for state, word in ((f.BOOT, "starting"), (f.STOPPED, "stopped"), (f.PREOP, "pre-operational")):
        node = watched()
        node.take_heartbeat(bytes([state]))
        assert f"is {word} all of a sudden" in node.trouble()

    node = watched()
    node.take_emergency(bytes.fromhex("00 00 00 00 00 00 00 00"))
    assert node.trouble() == ""  # an error that is over is none
    node.take_emergency(bytes.fromhex("10 43 08 00 00 00 00 00"))
    assert node.trouble() == "it: emergency 4310h: temperature"


def test_a_transducers_position_is_its_steps():
    """E-Series: 6005h:1 in 0.001 um; position, velocity, status, least significant byte first."""
    gauge = Transducer("bus", "gauge", 12, lambda _identifier, _data: None)
    gauge._step = 5000 * 1e-3
    assert gauge._take(bytes.fromhex("E8 03 00 00 F6 FF 00"))
    assert gauge.position == pytest.approx(5000.0)  # um
    assert not gauge._take(bytes.fromhex("E8 03 00"))
    assert gauge.position == pytest.approx(5000.0)
