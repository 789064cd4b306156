"""The process that reads other programs' files: bytes in, numbers or sentences out; it has no path and no network.

A file can crash a parser, make it hang or take all memory; then this process ends, and nothing else does. Started by
`warm.py` as `python -m pmabench.store.importers.child FORMAT`. A question is one line of JSON and the bytes of
the file (a piece of it, where the format is read in pieces; the first question has the layout and what is wanted); the
answer is one line of JSON and the columns as float64, little endian.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, BinaryIO

import numpy as np

from pmabench.base.errors import InvalidFile, Problem, did_you_mean, invalid
from pmabench.base.system import end_after_cpu, limit_memory
from pmabench.store.formats.record import Column, Format, Layout, Recorded
from pmabench.store.formats.registry import formats

MEMORY = 2_000_000_000
"""Bytes of addresses."""
CPU = 2.0
"""Seconds of CPU for a file, or a piece of text ..."""
CPU_PER_MB = 0.3
"""... and for each MB of it more, so that large ones can be read and small ones cannot hang."""


def serve(kind: str, ask: BinaryIO, answer: BinaryIO) -> None:
    """Answer until nobody asks any more."""
    form, absent = formats()[kind], ""
    try:
        for module in form.modules:  # before any clock runs
            import_module(module)
    except ImportError as error:
        absent = str(error)
    reader: Any = None
    while line := ask.readline():
        question = json.loads(line)
        content = ask.read(question["bytes"])
        if absent:
            _tell(answer, {"absent": absent}, [])
            continue
        end_after_cpu(CPU + CPU_PER_MB * len(content) / 1e6)
        try:
            if "layout" in question:
                reader = _reader(form, question)
            head, arrays = reader.answer(content, last=question["last"])
        except InvalidFile as error:
            head, arrays = {"problems": [[p.line, p.column, p.message] for p in error.problems]}, []
        except (MemoryError, RecursionError) as error:
            head, arrays = {"lack": type(error).__name__}, []
        end_after_cpu(0.0)
        _tell(answer, head, arrays)


def _tell(answer: BinaryIO, head: Mapping[str, Any], arrays: Sequence[Any]) -> None:
    answer.write(json.dumps(head).encode() + b"\n")
    for array in arrays:
        answer.write(np.ascontiguousarray(array, dtype="<f8").data)
    answer.flush()


def _reader(form: Format, question: Mapping[str, Any]) -> Any:
    """What reads the file that begins; its pieces follow."""
    layout = form.layout.model_construct(**question["layout"])  # it was checked by who asks
    asked = {key: question[key] for key in ("path", "wanted", "optional", "ignored")}
    if form.reader is None:
        return _Whole(form, layout, **asked)
    return form.reader(layout=layout, texts=question["texts"], order=question["order"], **asked)


@dataclass
class _Whole:
    """Reads a file that comes in one piece."""

    form: Format
    layout: Layout
    path: str
    wanted: Sequence[str] | None
    """None: all columns, which may differ in length."""
    optional: Sequence[str]
    ignored: Sequence[str]

    def answer(self, content: bytes, *, last: bool) -> tuple[dict[str, Any], list[Any]]:
        """The head of the answer and its arrays; raises InvalidFile."""
        only = None if self.wanted is None else {*self.wanted, *self.optional}
        recorded = self.form.read(self.path, content, self.layout, only) if self.form.read and last else Recorded([])
        columns = recorded.columns if self.wanted is None else self._chosen(recorded)
        lengths = [len(column.values) for column in columns]
        lines = np.arange(max(lengths, default=0)) + recorded.first_line
        return {
            "columns": [column.name for column in columns],
            "lengths": lengths,
            "rows": len(lines),
            "cut_end": recorded.cut_end,
            "units": [column.unit for column in columns],
            "started": None if recorded.started is None else recorded.started.isoformat(),
            "doubts": recorded.doubts,
            "left_out": sorted(set(recorded.left_out))[:100],
        }, [*(column.values for column in columns), lines]

    def _chosen(self, recorded: Recorded) -> list[Column]:
        """The wanted columns and those of `optional` that there are, all equally long; raises InvalidFile otherwise."""
        has = {column.name: column for column in recorded.columns}
        names = [*(self.wanted or ()), *(name for name in self.optional if name in has)]
        if missing := [name for name in names if name not in has]:
            there = [*has, *recorded.left_out]
            raise InvalidFile(
                Problem(self.path, 0, 0, f'has no column "{name}"{did_you_mean(name, there) or _some(there)}')
                for name in missing
            )
        recorded.left_out += [name for name in has if name not in {*names, *self.ignored}]
        lengths = {name: len(has[name].values) for name in names}
        if len(set(lengths.values())) > 1:
            each = ", ".join(f'"{name}" {length}' for name, length in lengths.items())
            text = f"the columns of the map are not equally long: {each}; they were not sampled together"
            raise invalid(self.path, text)
        if not any(lengths.values()):
            raise invalid(self.path, "holds no samples in the columns of the map")
        return [has[name] for name in names]


def _some(names: list[str]) -> str:
    if not names:
        return "; it has no columns of numbers at all"
    shown = ", ".join(f'"{name[:60]}"' for name in names[:8])
    return f"; it has {shown}{' and others' if len(names) > 8 else ''}"


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
