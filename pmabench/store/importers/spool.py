"""Columns of numbers that grow piece by piece: in memory while they are few, then in files without a name."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Iterable, Iterator, Mapping
from typing import IO

import numpy as np

from pmabench.store.records import Array

KEPT = 16_000_000
"""Bytes of all columns up to which nothing is written to disk."""


def _close(files: dict[str, IO[bytes]]) -> None:
    for file in files.values():
        file.close()


class Columns(Mapping[str, Array]):
    """Equally long columns by name; `columns[name]` is a whole one, `part` some rows of all."""

    def __init__(self) -> None:
        """Without columns; the first piece gives their names."""
        self.rows = 0
        self._pieces: dict[str, list[Array]] = {}
        self._files: dict[str, IO[bytes]] = {}
        weakref.finalize(self, _close, self._files)

    def append(self, piece: Mapping[str, Array]) -> None:
        """Put rows behind those that there are. Raises OSError where the folder for temporary files is full."""
        if not self._pieces:
            self._pieces = {name: [] for name in piece}
        for name, values in piece.items():
            if self._files:
                self._files[name].write(np.ascontiguousarray(values, dtype=np.float64).data)
            else:
                self._pieces[name].append(values)
        self.rows += len(next(iter(piece.values()), ()))
        if not self._files and 8 * self.rows * len(self._pieces) > KEPT:
            self._to_disk()

    def _to_disk(self) -> None:
        for name, pieces in self._pieces.items():
            file = self._files[name] = tempfile.TemporaryFile()  # noqa: SIM115  # lives as long as the columns
            while pieces:
                file.write(np.ascontiguousarray(pieces.pop(0), dtype=np.float64).data)

    def part(self, begin: int, end: int, names: Iterable[str] | None = None) -> dict[str, Array]:
        """Rows `begin` to `end` (without it) of all columns, or of some."""
        return {name: self._read(name, begin, end) for name in (names or self)}

    def _read(self, name: str, begin: int, end: int) -> Array:
        if not self._files:
            pieces = self._pieces[name]
            if len(pieces) > 1:
                pieces[:] = [np.concatenate(pieces)]
            return pieces[0][begin:end] if pieces else np.empty(0)
        file = self._files[name]
        file.flush()
        file.seek(8 * begin)
        return np.fromfile(file, dtype=np.float64, count=end - begin)

    def __getitem__(self, name: str) -> Array:
        return self._read(name, 0, self.rows)

    def __iter__(self) -> Iterator[str]:
        return iter(self._pieces)

    def __len__(self) -> int:
        return len(self._pieces)
