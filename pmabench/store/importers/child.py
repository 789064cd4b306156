"""The process that reads other programs' files: bytes in, numbers or sentences out; it has no path and no network.

A file can crash a parser, make it hang or take all memory; then this process ends, and nothing else does. Started by
`warm.py` as `python -m pmabench.store.importers.child FORMAT`. A question is one line of JSON and the bytes of the
file, of text a piece of it; the answer one line of JSON and the columns as float64, little endian.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO

from pmabench.base.errors import InvalidFile, Problem
from pmabench.base.system import end_after_cpu, limit_memory

MEMORY = 2_000_000_000
"""Bytes of addresses."""
CPU = 2.0
"""Seconds of CPU for a file, or a piece of text ..."""
CPU_PER_MB = 0.3
"""... and for each MB of it more, so that large ones can be read and small ones cannot hang."""


def serve(kind: str, ask: BinaryIO, answer: BinaryIO) -> None:
    """Answer until nobody asks any more."""
    absent = _warm(kind)
    reader: Any = None
    while line := ask.readline():
        question = json.loads(line)
        content = ask.read(question["bytes"])
        if absent:
            _tell(answer, {"absent": absent}, [])
            continue
        end_after_cpu(CPU + CPU_PER_MB * len(content) / 1e6)
        try:
            if kind == "text":
                reader = _text(question) if "layout" in question else reader
                head, arrays = _rows(reader, content, last=question["last"])
            else:
                head, arrays = _read(kind, question, content)
        except InvalidFile as error:
            head, arrays = {"problems": [[p.line, p.column, p.message] for p in error.problems]}, []
        except (MemoryError, RecursionError) as error:
            head, arrays = {"lack": type(error).__name__}, []
        end_after_cpu(0.0)
        _tell(answer, head, arrays)


def _tell(answer: BinaryIO, head: Mapping[str, Any], arrays: Sequence[Any]) -> None:
    answer.write(json.dumps(head).encode() + b"\n")
    for array in arrays:
        answer.write(memoryview(array).cast("B"))
    answer.flush()


def _warm(kind: str) -> str:
    """Import what the format needs, before any clock runs; why it cannot be read, or nothing."""
    try:
        import numpy  # noqa: F401

        if kind == "text":
            import pmabench.store.importers.text  # noqa: F401
        elif kind == "tdms":
            import nptdms  # noqa: F401
        elif kind == "mat":
            import h5py  # noqa: F401
            import scipy.io  # noqa: F401
    except ImportError as error:
        return str(error)
    return ""


def _text(question: Mapping[str, Any]) -> Any:
    """A reader for the text file that begins; its pieces follow."""
    from pmabench.store.importers.map_file import TextLayout
    from pmabench.store.importers.text import TextReader

    layout = TextLayout.model_validate(question["layout"])
    keys = ("path", "wanted", "optional", "ignored", "texts", "order")
    return TextReader(layout=layout, **{key: question[key] for key in keys})


def _rows(reader: Any, content: bytes, *, last: bool) -> tuple[dict[str, Any], list[Any]]:
    """The rows that a piece of text completes; the end of the file is a piece, too."""
    import numpy as np

    rows = reader.feed(content)
    if last:
        rows = reader.joined([rows, reader.end()])
    head = {"columns": list(rows.columns), "rows": len(rows.lines), "starts": rows.starts}
    if last:
        head |= {"cut_end": reader.cut_end, "cut_row": reader.cut_row}
    head["head"] = reader.head
    return head, [
        *(np.ascontiguousarray(v, dtype="<f8") for v in rows.columns.values()),
        rows.lines.astype("<f8"),
    ]


def _read(kind: str, question: Mapping[str, Any], content: bytes) -> tuple[dict[str, Any], list[Any]]:
    """The head of the answer and its arrays; raises InvalidFile."""
    import numpy as np

    path: str = question["path"]
    from pmabench.store.importers.recorded import Column, chosen

    only = None if question["wanted"] is None else {*question["wanted"], *question["optional"]}
    recorded = _recorded(kind, path, content, only)
    if question["wanted"] is None:
        columns: Sequence[Column] = recorded.columns
    else:
        columns = list(chosen(path, recorded, question["wanted"], question["optional"], question["ignored"]).values())
    lengths = [len(column.values) for column in columns]
    lines = np.arange(max(lengths, default=0), dtype="<f8") + recorded.first_line
    return {
        "columns": [column.name for column in columns],
        "lengths": lengths,
        "rows": len(lines),
        "cut_end": recorded.cut_end,
        "units": [column.unit for column in columns],
        "started": None if recorded.started is None else recorded.started.isoformat(),
        "doubts": recorded.doubts,
        "left_out": sorted(set(recorded.left_out))[:100],
    }, [*(np.ascontiguousarray(column.values, dtype="<f8") for column in columns), lines]


def _recorded(kind: str, path: str, content: bytes, only: set[str] | None) -> Any:
    if kind == "lvm":
        from pmabench.store.importers.lvm import read_lvm

        return read_lvm(path, content)
    if kind == "tdms":
        from pmabench.store.importers.tdms import read_tdms

        return read_tdms(path, content, only)
    if kind == "mat":
        from pmabench.store.importers.mat import read_mat

        return read_mat(path, content, only)
    raise InvalidFile([Problem(path, 0, 0, f'no format is called "{kind}"')])


def main() -> None:
    """Keep the answers to itself: what libraries print goes nowhere."""
    warnings.simplefilter("ignore")
    os.environ["HDF5_PLUGIN_PRELOAD"] = "::"  # no filter is loaded from a folder of this machine
    ask, answer = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    limit_memory(MEMORY)
    serve(sys.argv[1], ask, answer)


if __name__ == "__main__":
    main()
