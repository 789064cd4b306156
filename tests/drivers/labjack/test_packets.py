"""The stream as bytes: numbers of scans through lost packets, full buffers and whatever else may come."""

import random

import pytest
from pmabench_drivers.labjack.stream import Packets, StreamBroken

from tests.drivers.labjack.rigs import packet
from tests.reliability.cases import cases

DUMMY = 0xFFFF


def numbered(packets, data):
    """{number of the scan: its counts} of all scans that come."""
    found = {}
    for scans in packets.feed(data):
        width = packets._channels
        for index in range(len(scans.raw) // width):
            number = scans.first + index
            assert number not in found
            found[number] = tuple(scans.raw[index * width : (index + 1) * width])
    return found


def test_bytes_written_by_hand():
    """Two channels, two scans a packet: AIN counts 0x8001, 0x0102 and 0x7FFF, 0xFFFE."""
    data = bytes.fromhex("0000 0000 0012 01 4c 10 00 0008 0000 0000 8001 0102 7fff fffe")
    packets = Packets(2, 2)
    assert numbered(packets, data) == {1: (0x8001, 0x0102), 2: (0x7FFF, 0xFFFE)}
    assert packet(0, [0x8001, 0x0102, 0x7FFF, 0xFFFE], backlog=8) == data


def test_it_does_not_matter_how_the_bytes_are_cut():
    data = b"".join(packet(k, [4 * k + 1, 0, 4 * k + 2, 0]) for k in range(50))
    whole = numbered(Packets(2, 2), data)
    assert len(whole) == 100
    for size in (1, 7, 23, 24, 25, 1000):
        packets, found = Packets(2, 2), {}
        for at in range(0, len(data), size):
            found |= numbered(packets, data[at : at + size])
        assert found == whole


@pytest.mark.parametrize("missing", [[3], [0], [3, 4, 5], [1, 7]])
def test_a_lost_packet_leaves_a_gap_of_its_size_at_its_place(missing):
    packets = Packets(1, 5)
    sent = [packet(k, range(5 * k + 1, 5 * k + 6)) for k in range(10) if k not in missing]
    found = numbered(packets, b"".join(sent))
    assert found == {n: (n,) for k in range(10) if k not in missing for n in range(5 * k + 1, 5 * k + 6)}
    assert packets.lost == 5 * len(missing)


def test_the_number_of_a_packet_has_16_bits():
    packets = Packets(1, 1)
    found = numbered(packets, b"".join(packet(k & 0xFFFF, [k & 0x7FFF]) for k in range(65600) if k != 65536))
    assert found == {k + 1: (k & 0x7FFF,) for k in range(65600) if k != 65536}
    assert packets.lost == 1


def test_what_the_device_left_out_is_a_gap_where_its_marker_is():
    """Five scans a packet; 700 are left out after scan 7, and the marker takes the place of none."""
    packets = Packets(2, 5)
    first = packet(0, [value for n in range(1, 6) for value in (n, n)], status=2940)
    marked = [6, 6, 7, 7, DUMMY, DUMMY, 708, 708, 709, 709]
    found = numbered(packets, first + packet(1, marked, status=2941, info=700) + packet(2, [710] * 2 + [711] * 8))
    assert found[7] == (7, 7)
    assert found[708] == (708, 708)
    assert found[710] == (710, 710)
    assert sorted(found)[6:8] == [7, 708]
    assert (packets.skipped, packets.lost) == (700, 0)


def test_a_reading_at_the_end_of_the_range_is_no_marker():
    assert numbered(Packets(2, 1), packet(0, [DUMMY, DUMMY])) == {1: (DUMMY, DUMMY)}
    marked = packet(0, [DUMMY, 5, DUMMY, DUMMY, 9, 9], status=2941, info=10)
    assert numbered(Packets(2, 3), marked) == {1: (DUMMY, 5), 12: (9, 9)}


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (packet(0, [1, 2], status=2942), "scans overlap"),
        (packet(0, [1, 2], status=2943, info=5), "did not count"),
        (packet(0, [1, 2], status=2944), "ended by itself"),
        (packet(0, [1, 2], status=2945), "buffer was full"),
        (packet(0, [1, 2], status=1), "status 1, which is not known"),
        (packet(0, [1, 2], status=2941, info=5), "nothing shows where"),
        (packet(0, [1, 2], status=2940) + packet(2, [1, 2]), "lost while the device was leaving out"),
        (packet(0, [1, 2, 3, 4]), "a packet of 18 bytes instead of 14"),
        (b"HTTP/1.1 400 Bad Request", "no stream packet"),
        (packet(0, [1, 2])[:6] + b"\x02" + packet(0, [1, 2])[7:], "no stream packet"),
    ],
)
def test_what_cannot_be_numbered_ends_the_stream(data, why):
    with pytest.raises(StreamBroken, match=why):
        numbered(Packets(2, 1), data)


def test_what_came_before_the_end_is_kept():
    kept = []
    with pytest.raises(StreamBroken, match="no stream packet"):
        kept.extend(Packets(1, 1).feed(packet(0, [7]) + bytes(16)))
    assert [list(scans.raw) for scans in kept] == [[7]]


def test_whatever_comes_no_number_comes_twice_and_the_memory_stays_small():
    """True streams with bytes changed, cut out and put in: each scan is right, or the stream ends."""
    for case in range(cases(300)):
        rng = random.Random(case)
        channels, scans = rng.randint(1, 8), rng.randint(1, 12)
        stream = bytearray()
        for k in range(12):
            stream += packet(k, [rng.randrange(65536) for _ in range(channels * scans)])
        for _ in range(rng.randint(1, 4)):
            at = rng.randrange(len(stream))
            change = rng.choice(("flip", "cut", "insert"))
            if change == "flip":
                stream[at] ^= 1 << rng.randrange(8)
            elif change == "cut":
                del stream[at : at + rng.randint(1, 40)]
            else:
                stream[at:at] = rng.randbytes(rng.randint(1, 40))
        packets, last = Packets(channels, scans), 0
        try:
            for at in range(0, len(stream), 50):
                for run in packets.feed(bytes(stream[at : at + 50])):
                    assert run.first > last
                    assert len(run.raw) % channels == 0
                    last = run.first + len(run.raw) // channels - 1
                assert len(packets._data) < 16 + 2 * channels * scans + 50
        except StreamBroken as error:
            assert str(error)
