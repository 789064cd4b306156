"""A PDF with its plain objects packed into compressed streams (PDF 1.5 and later), not a mark on any page changed.

A tagged PDF says of every cell of every table what it is; as plain text these objects are most of a long report.
Knows files as typst writes them: one table of references, nothing encrypted.
"""

from __future__ import annotations

import re
import zlib
from itertools import pairwise

PER_STREAM = 400
"""Objects of one compressed stream."""
LEVEL = 9
_TRAILER = re.compile(rb"trailer\s*<<(.*?)>>\s*startxref\s*(\d+)\s*%%EOF\s*$", re.DOTALL)
_HEAD = re.compile(rb"\s*(\d+) 0 obj\s*")


def packed(data: bytes) -> bytes:
    """The same document in fewer bytes; unchanged where it is not as expected, or already packed."""
    trailer = _TRAILER.search(data[-4096:])
    if trailer is None or b"/Encrypt" in trailer[1] or b"/Prev" in trailer[1]:
        return data
    table = int(trailer[2])
    objects = _objects(data, table)
    if not objects:
        return data
    out = bytearray(data[: min(offset for offset, _ in objects.values())])
    places: dict[int, tuple[int, int, int]] = {0: (0, 0, 65535)}
    plain: list[tuple[int, bytes]] = []
    for number, (_, body) in sorted(objects.items()):
        if body.endswith(b"endstream"):
            places[number] = (1, len(out), 0)
            out += b"%d 0 obj\n%s\nendobj\n" % (number, body)
        else:
            plain.append((number, body))
    free = max(objects) + 1
    for first in range(0, len(plain), PER_STREAM):
        members = plain[first : first + PER_STREAM]
        heads, at = [], 0
        for place, (number, body) in enumerate(members):
            places[number] = (2, free, place)
            heads.append(b"%d %d" % (number, at))
            at += len(body) + 1
        head = b" ".join(heads) + b"\n"
        stream = zlib.compress(head + b"\n".join(body for _, body in members), LEVEL)
        places[free] = (1, len(out), 0)
        said = b"/Type/ObjStm/N %d/First %d/Filter/FlateDecode/Length %d" % (len(members), len(head), len(stream))
        out += b"%d 0 obj\n<<%s>>\nstream\n%s\nendstream\nendobj\n" % (free, said, stream)
        free += 1
    begin = len(out)
    places[free] = (1, begin, 0)
    rows = b"".join(
        kind.to_bytes(1, "big") + where.to_bytes(4, "big") + rank.to_bytes(2, "big")
        for kind, where, rank in (places.get(number, (0, 0, 0)) for number in range(free + 1))
    )
    stream = zlib.compress(rows, LEVEL)
    kept = re.sub(rb"/Size\s*\d+", b"", trailer[1])
    said = b"/Type/XRef/Size %d/W[1 4 2]/Filter/FlateDecode/Length %d" % (free + 1, len(stream))
    out += b"%d 0 obj\n<<%s%s>>\nstream\n%s\nendstream\nendobj\n" % (free, said, kept, stream)
    out += b"startxref\n%d\n%%%%EOF\n" % begin
    return bytes(out)


def _objects(data: bytes, table: int) -> dict[int, tuple[int, bytes]]:
    """Number -> offset and body of every object, by the table of references; empty where that is not as expected."""
    head = re.match(rb"xref\s+0 (\d+)\s+", data[table : table + 64])
    if head is None:
        return {}
    rows = data[table + head.end() :]
    entries = [rows[20 * n : 20 * n + 18].split() for n in range(int(head[1]))]
    if any(
        len(entry) != 3 or entry[1:] not in ([b"00000", b"n"], [b"65535", b"f"], [b"00000", b"f"]) for entry in entries
    ):
        return {}
    offsets = {n: int(entry[0]) for n, entry in enumerate(entries) if entry[2] == b"n"}
    ends = sorted([*offsets.values(), table])
    after = dict(pairwise(ends))
    found = {}
    for number, offset in offsets.items():
        text = data[offset : after[offset]]
        begin, end = _HEAD.match(text), text.rfind(b"endobj")
        if begin is None or int(begin[1]) != number or end < 0:
            return {}
        found[number] = offset, text[begin.end() : end].strip()
    return found
