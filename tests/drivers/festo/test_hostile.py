"""Answers that make no sense: every call ends in time, in a sentence, or with what a whole right answer says."""

import random
import struct
from contextlib import closing
from dataclasses import replace
from time import monotonic

import pytest
from pmabench_drivers.festo_cpx_e import FestoCpxE

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from tests.drivers.common import timed
from tests.drivers.festo.rigs import terminal
from tests.drivers.wires.rigs import Heart, Peer
from tests.reliability.cases import cases


def spoiled(request, chance):
    """An answer to a request, right or spoiled in one of many ways."""
    head, pdu = request[:7], request[7:]
    if pdu[0] in {3, 4}:
        count = struct.unpack(">H", pdu[3:5])[0]
        body = bytes([pdu[0], 2 * count]) + chance.randbytes(2 * count)
    elif pdu[0] == 0x2B:
        body = bytes([0x2B, 0x0E, pdu[2], 0x82, 0, 0, 1, 0, 5]) + b"Festo"
    else:
        body = pdu[:5]

    def frame(content, transaction=head[:2], protocol=b"\0\0", unit=b"\1", length=None):
        size = len(content) + 1 if length is None else length
        return transaction + protocol + struct.pack(">H", size & 0xFFFF) + unit + content

    kind = chance.randrange(12)
    if kind == 0:
        return frame(body)
    if kind == 1:
        return frame(body, transaction=chance.randbytes(2))
    if kind == 2:
        return frame(body, protocol=chance.randbytes(2))
    if kind == 3:
        return frame(body, length=chance.randrange(65536))
    if kind == 4:
        return frame(body, unit=chance.randbytes(1))
    if kind == 5:
        return frame(bytes([chance.randrange(256)]) + body[1:])
    if kind == 6:
        return frame(body[:-1] if len(body) > 1 else body)
    if kind == 7:
        return frame(body + chance.randbytes(chance.randrange(1, 9)))
    if kind == 8:
        return frame(bytes([pdu[0] | 0x80]) + chance.randbytes(chance.randrange(3)))
    if kind == 9:
        return chance.randbytes(chance.randrange(1, 300))
    if kind == 10:
        return frame(body[:1] + bytes([chance.randrange(256)]) + body[2:])
    place = chance.randrange(len(frame(body)))
    whole = bytearray(frame(body))
    whole[place] ^= 1 << chance.randrange(8)
    return bytes(whole)


def says(request, answer):
    """The registers of a whole and right answer to a reading request, by the specification; None otherwise."""
    count = struct.unpack(">H", request[10:12])[0]
    size = 2 * count
    if answer[:4] != request[:2] + b"\0\0" or len(answer) < 9 + size or answer[7] != 3 or answer[8] != size:
        return None
    return list(struct.unpack(f">{count}H", answer[9 : 9 + size]))


def _device(peer):
    """A terminal whose line is made and not yet open, and which waits 10 ms for an answer."""
    device = FestoCpxE(replace(terminal(peer.address), address=peer.address), RealClock())
    device._map = replace(device._map, timeout=0.01)
    device._link = device._new_line()
    return device


def test_no_answer_is_taken_for_what_it_is_not():
    chance, answers = random.Random(20261121), []

    def reply(request):
        answer = spoiled(request, chance)
        answers.append((request, answer))
        return answer

    outcomes = {"value": 0, "sentence": 0}
    with Peer(reply) as peer, closing(_device(peer)) as device, Heart() as heart:
        device._streaming = True
        reads = {
            "ao4.0": lambda: device.read_back("ao4.0"),
            "di1.0": lambda: device.level("di1.0"),
            "do2.0": lambda: device.is_on("do2.0"),
        }
        for number in range(cases(300)):
            name = chance.choice([*reads, "poll", "feed", "names"])
            answers.clear()
            if name in reads:
                took, outcome = heart.timed(reads[name])
            elif name == "poll":
                device._samples.take()
                took, outcome = heart.timed(device._poll)
                block = device._samples.take()
                outcome = list(block.columns["pressure"]) or outcome
            elif name == "feed":
                took, outcome = heart.timed(device.feed_watchdog)
            else:
                took, outcome = heart.timed(device._link.identification, monotonic() + 0.1)
            assert took < 0.3
            if isinstance(outcome, Exception):
                assert isinstance(outcome, DeviceError), f"case {number}: {name}: {answers}"
                outcomes["sentence"] += 1
                continue
            outcomes["value"] += 1
            if name == "names":
                assert all(isinstance(text, str) and text.isprintable() for text in outcome.values())
                continue
            if name == "feed" and not answers:
                continue  # what it answered right before has fed it
            words = says(*max(answers, key=lambda pair: pair[0][:2]))  # an older connection may be served late
            assert words is not None, f"case {number}: {name} took {answers} for {outcome}"
            if name == "ao4.0":
                assert outcome == words[0] - (words[0] >> 15 << 16)
            elif name in reads:
                assert outcome is bool(words[0] & 1)
            elif name == "poll":
                assert outcome == [words[4] - (words[4] >> 15 << 16)]  # 45399: four registers after the first
    assert min(outcomes.values()) > cases(300) / 30, outcomes


def test_an_answer_to_a_question_never_asked_is_none():
    """Every function code in place of the one that was asked: the library knows many of them, in shapes of their own."""
    function, rest = 0, b"\2\1\1"

    def reply(request):
        return request[:4] + struct.pack(">HBB", len(rest) + 2, 1, function) + rest

    with Peer(reply) as peer, closing(_device(peer)) as device:
        for function in [*range(3), *range(4, 256)]:
            _took, outcome = timed(device._link.read, "holding", 45404, 1, monotonic() + 0.1)
            assert isinstance(outcome, DeviceError), f"{function}: {outcome!r}"
        device._link._timeout = 0.5  # a busy machine needs longer than 10 ms for a sentence to be this one
        function, rest = 43, b"\x0e\1\x82\0\0\1\0\5Festo"  # names, where a register was asked for
        with pytest.raises(DeviceError, match="an answer that makes no sense"):
            device._link.read("holding", 45404, 1, monotonic() + 1.0)
        function, rest = 3, b"\2\1\1"
        assert device._link.read("holding", 45404, 1, monotonic() + 1.0) == [0x0101]
