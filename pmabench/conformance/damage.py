"""What a bad wire does to a piece of bytes from the device; pure functions of the bytes and a random source."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from random import Random

Pieces = Sequence[tuple[float, bytes]]
"""What arrives instead: after so long [s], these bytes."""
Damage = Callable[[bytes], Pieces]


def silence(_data: bytes) -> Pieces:
    """Nothing arrives."""
    return ()


def late(seconds: float) -> Damage:
    """Everything arrives, `seconds` later."""
    return lambda data: ((seconds, data),)


def _cut(data: bytes, chance: Random, _before: bytes) -> Pieces:
    return ((0.0, data[: chance.randrange(len(data))]),)


def _flipped(data: bytes, chance: Random, _before: bytes) -> Pieces:
    changed = bytearray(data)
    for _ in range(chance.randint(1, 3)):
        changed[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return ((0.0, bytes(changed)),)


def _repeated(data: bytes, _chance: Random, _before: bytes) -> Pieces:
    return ((0.0, data + data),)


def _garbage_before(data: bytes, chance: Random, _before: bytes) -> Pieces:
    return ((0.0, chance.randbytes(chance.randint(1, 12)) + data),)


def _garbage_behind(data: bytes, chance: Random, _before: bytes) -> Pieces:
    return ((0.0, data + chance.randbytes(chance.randint(1, 12))),)


def _other(data: bytes, chance: Random, _before: bytes) -> Pieces:
    return ((0.0, chance.randbytes(len(data))),)


def _long(data: bytes, chance: Random, _before: bytes) -> Pieces:
    return ((0.0, data + chance.randbytes(chance.randint(300, 5000))),)


def _in_parts(data: bytes, chance: Random, _before: bytes) -> Pieces:
    middle = chance.randrange(len(data))
    return ((0.0, data[:middle]), (chance.uniform(0.0, 0.02), data[middle:]))


def _older(data: bytes, _chance: Random, before: bytes) -> Pieces:
    return ((0.0, before or data),)


def _late(data: bytes, chance: Random, _before: bytes) -> Pieces:
    return ((chance.uniform(0.02, 0.4), data),)


def _nothing(_data: bytes, _chance: Random, _before: bytes) -> Pieces:
    return ()


KINDS: dict[str, Callable[[bytes, Random, bytes], Pieces]] = {
    "cut": _cut,
    "bits flipped": _flipped,
    "repeated": _repeated,
    "garbage before": _garbage_before,
    "garbage behind": _garbage_behind,
    "other bytes": _other,
    "far too long": _long,
    "in parts": _in_parts,
    "an older answer": _older,
    "late": _late,
    "nothing": _nothing,
}
"""Name -> what arrives instead of `data`, where `before` came last."""
SELDOM = {"late", "nothing"}
"""They cost a time-out each."""


class Hostile:
    """Damages every piece in the way `kind`; remembers the piece before."""

    def __init__(self, chance: Random) -> None:
        self._chance = chance
        self._before = b""
        self.kind = "cut"
        self.done = 0
        """Pieces that were damaged."""

    def another(self) -> str:
        """Choose a kind for what comes now; its name."""
        names = [name for name in KINDS if name not in SELDOM or self._chance.random() < 0.3]
        self.kind = self._chance.choice(names)
        return self.kind

    def __call__(self, data: bytes) -> Pieces:
        """As a `Damage`."""
        before, self._before = self._before, data
        self.done += 1
        return KINDS[self.kind](data, self._chance, before) if data else ()
