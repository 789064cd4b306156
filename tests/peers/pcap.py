"""Exchanges over TCP as a capture file of packets (libpcap 2.4, Ethernet, IPv4): what was sent, in order, one each."""

import struct

CLIENT, SERVER = (b"\x0a\x00\x00\x01", 40000), (b"\x0a\x00\x00\x02", 502)
PSH_ACK = 0x18


def checksum(data):
    """RFC 1071."""
    data += b"\0" * (len(data) % 2)
    total = sum(struct.unpack(f">{len(data) // 2}H", data))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF


def packet(to_server, sequence, acknowledged, data, number):
    """One segment in its frame."""
    (source, sport), (target, dport) = (CLIENT, SERVER) if to_server else (SERVER, CLIENT)
    pseudo = source + target + struct.pack(">BBH", 0, 6, 20 + len(data))
    head = struct.pack(">HHIIBBHHH", sport, dport, sequence, acknowledged, 5 << 4, PSH_ACK, 65535, 0, 0)
    head = head[:16] + struct.pack(">H", checksum(pseudo + head + data)) + head[18:]
    size = 20 + len(head) + len(data)
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, size, number & 0xFFFF, 0, 64, 6, 0, source, target)
    ip = ip[:10] + struct.pack(">H", checksum(ip)) + ip[12:]
    return b"\2\0\0\0\0\2\2\0\0\0\0\1\x08\0" + ip + head + data


def pcap(exchange):
    """A file of (time [s], whether to the server, bytes)."""
    file = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
    sent = {True: 1, False: 1}
    for number, (time, to_server, data) in enumerate(exchange):
        frame = packet(to_server, sent[to_server], sent[not to_server], data, number)
        sent[to_server] += len(data)
        file += struct.pack("<IIII", int(time), round(time % 1 * 1e6) % 1_000_000, len(frame), len(frame)) + frame
    return file
