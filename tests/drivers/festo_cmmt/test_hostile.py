"""Answers that make no sense: every call ends in time, in a sentence, or with what a whole right answer says."""

import random
import struct
from contextlib import closing
from dataclasses import replace
from time import monotonic

import pytest
from pmabench_drivers.festo_cmmt import FestoCmmt
from pmabench_drivers.festo_cmmt import link as link_module
from pmabench_drivers.festo_cmmt import telegram as t
from pmabench_drivers.festo_cmmt.link import DriveLink

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from tests.drivers.common import timed
from tests.drivers.festo.test_hostile import says, spoiled
from tests.drivers.festo_cmmt.rigs import drive
from tests.drivers.wires.rigs import Heart, Peer
from tests.reliability.cases import cases

pytestmark = pytest.mark.realtime


def _device(peer):
    return FestoCmmt(replace(drive(), address=peer.address), RealClock())


def test_no_answer_is_taken_for_what_it_is_not(monkeypatch):
    """Process data, time-out and parameters read through a peer that spoils its answers; commands sent to it."""
    chance, answers = random.Random(20261122), []
    monkeypatch.setattr(link_module, "ANSWER", 0.01)

    def reply(request):
        answer = spoiled(request, chance)
        answers.append((request, answer))
        return answer

    outcomes = {"value": 0, "sentence": 0}
    with Peer(reply) as peer, closing(_device(peer)) as device, Heart() as heart:
        link = device._link = DriveLink("drive", peer.address)
        calls = {
            "look": lambda: link.look(monotonic() + 0.05),
            "time-out": lambda: link.get(t.TIMEOUT, monotonic() + 0.05),
            "parameter": lambda: link.parameter(t.TARGET, "int32", monotonic() + 0.05),
            "sample": device._sample,
            "write": lambda: device.write("position", 1.0),
            "halt": lambda: device.halt("position"),
        }
        weights = [6, 6, 2, 2, 1, 1]
        for number in range(cases(300)):
            [name] = chance.choices(list(calls), weights)
            answers.clear()
            device._command = None
            took, outcome = heart.timed(calls[name])
            assert took < 0.4
            if isinstance(outcome, Exception):
                assert isinstance(outcome, DeviceError), f"case {number}: {name}: {outcome!r}: {answers}"
                outcomes["sentence"] += 1
                continue
            outcomes["value"] += 1
            if name in {"look", "time-out"}:
                words = says(*answers[-1])
                assert words is not None, f"case {number}: {name} took {answers} for {outcome}"
                if name == "look":
                    assert outcome.word == words[0]
                    assert outcome.position == struct.unpack(">i", struct.pack(">HH", words[6], words[5]))[0]
                    assert outcome.fault == words[9]
                else:
                    assert outcome == words[0] + (words[1] << 16)
    assert min(outcomes.values()) > cases(300) / 30, outcomes


def test_a_command_is_never_sent_twice_by_one_call(monkeypatch):
    """Only the cycle repeats process data, and it does not run here."""
    monkeypatch.setattr(link_module, "ANSWER", 0.02)
    with (
        Peer(lambda request: b"" if request[7] == 16 else says_ready(request)) as peer,
        closing(_device(peer)) as device,
    ):
        device._link = DriveLink("drive", peer.address)
        device._command = t.Command(on=True, task=True)
        assert isinstance(timed(device.write, "position", 123.0)[1], DeviceError)
        sent = [request for request in peer.requests if request[7] == 16]
        assert len(sent) == 1


def says_ready(request):
    """Under power, homed, controlled over the network, standing; the mailbox fails."""
    if request[7] != 3:
        return request
    count = struct.unpack(">H", request[10:12])[0]
    body = bytes([3, 2 * count]) + struct.pack(f">{count}H", 0x3A07, *[0] * (count - 1))
    return request[:4] + struct.pack(">HB", len(body) + 1, 1) + body
