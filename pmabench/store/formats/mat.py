"""MATLAB files, version 5 read by scipy and version 7.3 by h5py: vectors, columns of matrices, structs.

Names are as in MATLAB: vectors `P` or `log.P`, columns of a matrix `X(:,1)`, `X(:,2)`, elements of an array of structs
`signals(2).values`. Objects, cells and texts are left out. Each matrix and each struct may have its own clock; its
columns were then sampled together.
"""

from __future__ import annotations

import io
import re
import zlib
from collections.abc import Collection, Mapping
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from pmabench.base.errors import invalid
from pmabench.store.formats.record import Column, Format, Layout, Recorded, begins, damaged, numbers
from pmabench.store.records import Array

EVEN = 5.0
"""Longest step of a clock column [median steps]."""
_MATRIX = re.compile(r"(.+)\(:,(\d+)\)")


def matrix_of(name: str) -> str:
    """The matrix that a column belongs to; empty where it is a vector."""
    return match[1] if (match := _MATRIX.fullmatch(name)) else ""


def is_clock(values: Array) -> bool:
    """Whether a column increases with every row, in steps of similar size."""
    if len(values) < 10 or not np.isfinite(values).all():
        return False
    steps = np.diff(values)
    return bool(steps.min() > 0 and steps.max() < EVEN * float(np.median(steps)))


def together(columns: Mapping[str, Array]) -> dict[str, str]:
    """Column -> matrix or struct with whose clock it was sampled; empty for the clock of the whole file."""
    clocks = {(_places(name)[0], len(values)) for name, values in columns.items() if is_clock(values)}

    def shared(name: str, rows: int) -> str:
        return next((place for place in _places(name) if (place, rows) in clocks), "")

    return {name: shared(name, len(values)) for name, values in columns.items()}


def _places(name: str) -> list[str]:
    """The matrix of a column and the structs around it, innermost first: `a.b(:,1)` -> `a.b`, `a`, "" (the file)."""
    places = [matrix_of(name)] if matrix_of(name) else []
    inside = matrix_of(name) or name
    while "." in inside:
        inside = inside.rpartition(".")[0]
        places.append(inside)
    return [*places, ""]


DEEPEST = 8
MOST_COLUMNS = 200
"""Largest number of columns of a matrix of channels; one with more is left out."""
MOST_ELEMENTS = 200
"""Largest number of elements that are read of an array of structs."""
HEADER = 128
COMPRESSED = 15


class MatLayout(Layout):
    """MATLAB 5 and 7.3: vectors, columns of matrices, structs and arrays of structs."""

    format: Literal["mat"]


def read_mat(path: str, content: bytes, layout: MatLayout | None, only: Collection[str] | None) -> Recorded:
    """All numeric columns that are in `only` (None: all); raises InvalidFile."""
    recorded = Recorded([])
    if content.startswith(b"MATLAB 7.3"):
        with damaged(path, "MAT 7.3"):
            _read_73(recorded, path, content, only)
    elif content.startswith(b"MATLAB 5.0"):
        with damaged(path, "MAT 5"):
            _read_5(recorded, path, content, only)
    else:
        raise invalid(path, 'is no MAT file of version 5 or 7.3: it begins with neither "MATLAB 5.0" nor "MATLAB 7.3"')
    return recorded


def _add(recorded: Recorded, name: str, array: Any, only: Collection[str] | None) -> None:
    """Add a MATLAB array: (n, 1) and (1, n) as a vector, other matrices by columns."""
    if array.ndim != 2 or array.dtype.kind not in "biuf" or array.size == 0:
        recorded.left_out.append(name)
        return
    if 1 in array.shape:
        columns = {name: array.reshape(-1)}
    elif array.shape[1] <= MOST_COLUMNS:
        columns = {f"{name}(:,{k + 1})": array[:, k] for k in range(array.shape[1])}
    else:
        recorded.left_out.append(name)
        return
    for each, values in columns.items():
        column = numbers(values)
        if column is not None and (only is None or each in only):
            recorded.columns.append(Column(each, column))
        else:
            recorded.left_out.append(each)


# -- version 5 --------------------------------------------------------------------------------------------------


def _read_5(recorded: Recorded, path: str, content: bytes, only: Collection[str] | None) -> None:
    from scipy.io import loadmat

    _sums(path, content)
    file: Any = io.BytesIO(content)
    wanted = None if only is None else sorted({name.split(".")[0].split("(")[0] for name in only})
    for name, value in loadmat(file, variable_names=wanted).items():
        if not name.startswith("__"):
            _value_5(recorded, name, value, only, 0)


def _sums(path: str, content: bytes) -> None:
    """Unpack every compressed part to verify its checksum, which scipy does not check."""
    mark = content[126:128]
    if mark not in {b"IM", b"MI"}:
        raise invalid(path, "is damaged: its header does not say the order of bytes")
    order: Any = "little" if mark == b"IM" else "big"
    at = HEADER
    while at < len(content):
        if at + 8 > len(content):
            raise invalid(path, f"is cut off at byte {at}")
        kind = int.from_bytes(content[at : at + 4], order)
        size = int.from_bytes(content[at + 4 : at + 8], order)
        if at + 8 + size > len(content):
            raise invalid(path, f"is cut off: the part at byte {at} has {len(content) - at - 8} of {size} bytes")
        if kind == COMPRESSED:
            try:
                unpacked = zlib.decompressobj()
                for begin in range(at + 8, at + 8 + size, 1 << 16):
                    rest = content[begin : min(begin + (1 << 16), at + 8 + size)]
                    while rest and not unpacked.eof:
                        unpacked.decompress(rest, 1 << 20)
                        rest = unpacked.unconsumed_tail
                complete = unpacked.eof
            except zlib.error:
                complete = False
            if not complete:
                raise invalid(path, f"is damaged: the checksum of the part at byte {at} is wrong")
        at += 8 + size


def _value_5(recorded: Recorded, name: str, value: Any, only: Collection[str] | None, depth: int) -> None:
    if not isinstance(value, np.ndarray) or depth > DEEPEST:
        recorded.left_out.append(name)
    elif value.dtype.names:
        elements = value.reshape(-1, order="F")[:MOST_ELEMENTS]
        for index, element in enumerate(elements, 1):
            of = name if len(elements) == 1 else f"{name}({index})"
            for key in value.dtype.names:
                _value_5(recorded, f"{of}.{key}", element[key], only, depth + 1)
    else:
        _add(recorded, name, value, only)


# -- version 7.3 ------------------------------------------------------------------------------------------------


def _read_73(recorded: Recorded, path: str, content: bytes, only: Collection[str] | None) -> None:
    import h5py

    ends = _end(content)
    if ends is not None and ends != len(content):
        recorded.doubts.append(f"its head says {ends} bytes, there are {len(content)}: bytes were lost or put in")
    with h5py.File(io.BytesIO(content), "r") as file:
        _group_73(recorded, path, file, "", only, 0)
        recorded.doubts += _shared(file)


def _shared(file: Any) -> list[str]:
    """Doubts about arrays that overlap in the file: an address in it is wrong."""
    import h5py

    places: list[tuple[int, int, str]] = []

    def look(name: str, value: Any) -> None:
        if isinstance(value, h5py.Dataset) and value.chunks is None and value.id.get_offset() is not None:
            places.append((value.id.get_offset(), value.id.get_offset() + value.nbytes, name))

    file.visititems(look)
    places.sort()
    return [
        f'"{one[2][:80]}" and "{other[2][:80]}" lie on the same bytes: an address in the file is wrong'
        for one, other in pairwise(places)
        if one[1] > other[0]
    ][:10]


def _end(content: bytes) -> int | None:
    """End of an HDF5 file [bytes] from its superblock (versions 0 to 3, addresses of 8 bytes); None if not found."""
    at = content.find(b"\x89HDF\r\n\x1a\n", 0, 1 << 16)
    if at < 0 or at + 64 > len(content):
        return None
    place = {0: 40, 1: 44, 2: 28, 3: 28}.get(content[at + 8])
    return None if place is None else int.from_bytes(content[at + place : at + place + 8], "little")


def _group_73(recorded: Recorded, path: str, group: Any, name: str, only: Collection[str] | None, depth: int) -> None:
    import h5py

    for key in group:
        if key.startswith("#"):
            continue
        each = f"{name}.{key}" if name else key
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            raise invalid(path, f'"{each[:80]}" leads to another place or file; that is not followed')
        _value_73(recorded, path, group[key], each, only, depth)


def _value_73(recorded: Recorded, path: str, value: Any, name: str, only: Collection[str] | None, depth: int) -> None:
    import h5py

    if depth > DEEPEST:
        recorded.left_out.append(name)
        return
    if isinstance(value, h5py.Group):
        _group_73(recorded, path, value, name, only, depth + 1)
        return
    if not isinstance(value, h5py.Dataset) or value.is_virtual or value.external:
        raise invalid(path, f'"{name[:80]}" lies in another file; that is not followed')
    kind = value.attrs.get("MATLAB_class", b"")
    kind = kind.decode("ascii", "replace") if isinstance(kind, bytes) else ""
    if "MATLAB_empty" in value.attrs or kind in {"char", "cell", "function_handle"}:
        recorded.left_out.append(name)
    elif h5py.check_ref_dtype(value.dtype) is not None:
        _elements_73(recorded, path, value, name, only, depth)
    else:
        _add(recorded, name, value[()].T, only)


def _elements_73(
    recorded: Recorded, path: str, value: Any, name: str, only: Collection[str] | None, depth: int
) -> None:
    """A field of an array of structs: one reference for each element."""
    of, _, key = name.rpartition(".")
    for index, reference in enumerate(value[()].T.reshape(-1, order="F")[:MOST_ELEMENTS], 1):
        if reference:
            each = f"{of}({index}).{key}" if of else f"{name}({index})"
            _value_73(recorded, path, value.file[reference], each, only, depth + 1)


FORMAT = Format("mat", "MATLAB", MatLayout, begins(b"MATLAB "), read_mat, None, ("h5py", "scipy.io"), "h5py", together)
