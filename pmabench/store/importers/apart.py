"""Reads other programs' files in separate processes: bytes in, numbers or messages out.

A file can crash a parser, make it hang or use up memory; then only the child process ends. A child receives the bytes
and opens no file itself. One process per format is kept running (`python -m pmabench.store.importers.apart FORMAT`),
and is replaced when it dies or exceeds its time.

A question is one line of JSON and the bytes of the file, or of a piece of it for formats that are read in pieces; the
first question has the layout and the wanted columns. The answer is one line of JSON and the columns as float64, little
endian. Its sizes are checked before anything is built from it.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from typing import IO, Any, BinaryIO

import numpy as np

from pmabench.base.errors import InvalidFile, PmaError, Problem, did_you_mean, invalid
from pmabench.base.system import end_after_cpu, limit_memory
from pmabench.base.text import printable
from pmabench.store.formats.record import Column, Format, Layout, Recorded, formats
from pmabench.store.records import Array

MEMORY = 2_000_000_000
"""Limit of a child's address space [bytes]."""
CPU = 2.0
"""CPU time for a file or a piece of text [s] ..."""
CPU_PER_MB = 0.3
"""... plus this for each MB [s]: enough for large files, and small ones cannot hang."""


def serve(kind: str, ask: BinaryIO, answer: BinaryIO) -> None:
    """Answer questions until the other side closes its end."""
    form, absent = formats()[kind], ""
    try:
        for module in form.modules:  # before the time limit starts
            import_module(module)
    except ImportError as error:
        absent = str(error)
    reader: Any = None
    while line := ask.readline():
        question = json.loads(line)
        content = ask.read(question["bytes"])
        if absent:
            _send_answer(answer, {"absent": absent}, [])
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
        _send_answer(answer, head, arrays)


def _send_answer(answer: BinaryIO, head: Mapping[str, Any], arrays: Sequence[Any]) -> None:
    answer.write(json.dumps(head).encode() + b"\n")
    for array in arrays:
        answer.write(np.ascontiguousarray(array, dtype="<f8").data)
    answer.flush()


def _reader(form: Format, question: Mapping[str, Any]) -> Any:
    """A reader for the file whose first question this is."""
    layout = form.layout.model_construct(**question["layout"])  # the asking process has validated it
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
    """Columns to read; None for all, which may then differ in length."""
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
        """The wanted columns and the existing ones of `optional`, all equally long; raises InvalidFile otherwise."""
        has = {column.name: column for column in recorded.columns}
        names = [*(self.wanted or ()), *(name for name in self.optional if name in has)]
        if missing := [name for name in names if name not in has]:
            there, none = [*has, *recorded.left_out], "; it has no columns of numbers at all"
            texts = (f'has no column "{name}"{did_you_mean(name, there) or none}' for name in missing)
            raise InvalidFile(Problem(self.path, 0, 0, text) for text in texts)
        recorded.left_out += [name for name in has if name not in {*names, *self.ignored}]
        lengths = {name: len(has[name].values) for name in names}
        if len(set(lengths.values())) > 1:
            each = ", ".join(f'"{name}" {length}' for name, length in lengths.items())
            text = f"the columns of the map are not equally long: {each}; they were not sampled together"
            raise invalid(self.path, text)
        if not any(lengths.values()):
            raise invalid(self.path, "holds no samples in the columns of the map")
        return [has[name] for name in names]


def main() -> None:
    """Main function of the child process: answers on standard output; output of libraries is discarded."""
    warnings.simplefilter("ignore")
    os.environ["HDF5_PLUGIN_PRELOAD"] = "::"  # load no filter plug-ins of this machine
    ask, answer = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    limit_memory(MEMORY)
    serve(sys.argv[1], ask, answer)


if __name__ == "__main__":
    main()


WALL = 20.0
"""Wall-clock time after which a silent child counts as hung, as a multiple of its CPU time: the machine may be busy."""
START = 60.0
"""Time for a child to start and to take a question [s]."""
LONGEST_HEAD = 4_000_000
MOST_NUMBERS = 250_000_000
"""Largest number of values in an answer: as many as fit into a child's memory."""


class ReaderMissing(PmaError):
    """The package that reads a format is not installed."""

    exit_code = 3


@dataclass(frozen=True)
class Answer:
    """Answer of a child: columns by name, line numbers, and the rest of its head."""

    columns: dict[str, Array]
    lines: Array
    head: Mapping[str, Any]


class _Child:
    """One process for one format."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.owner = os.getpid()
        self.asked = 0
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "pmabench.store.importers.apart", kind],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )
        self._ask: Any = self.process.stdin
        self._answers: Any = self.process.stdout

    def send(self, content: bytes, question: Mapping[str, Any]) -> None:
        """Send a question; call `answer` before the next one. EOFError if the process has ended."""
        self.asked += 1
        with self._within(START + WALL * CPU):
            self._ask.write(json.dumps({**question, "bytes": len(content)}).encode() + b"\n" + content)
            self._ask.flush()

    def answer(self, size: int) -> Answer:
        """The answer to a question with `size` bytes. EOFError if there is none, or it is invalid."""
        with self._within(START + WALL * (CPU + CPU_PER_MB * size / 1e6)):
            return _read_answer(self._answers)

    @contextmanager
    def _within(self, seconds: float) -> Iterator[None]:
        """Kill the process after `seconds` of wall-clock time; EOFError if it ends or its answer is invalid."""
        clock = threading.Timer(seconds, self.process.kill)
        clock.daemon = True
        clock.start()
        try:
            yield
        except (BrokenPipeError, ValueError, TypeError, KeyError) as error:
            raise EOFError from error
        finally:
            clock.cancel()

    def end(self) -> None:
        """Stop the process."""
        for act in (self._ask.close, self._answers.close, self.process.kill):
            with suppress(OSError):
                act()
        self.process.wait()

    def ended(self) -> int:
        """Exit code of a process that gave no answer; ends it if it still runs."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(1.0)
        code = self.process.poll() or 0
        self.end()
        return code


def _read_answer(stream: IO[bytes]) -> Answer:
    """Read the next answer; its sizes are checked first. ValueError, TypeError or KeyError if it is invalid."""
    head = dict(json.loads(stream.readline(LONGEST_HEAD)))
    if "columns" not in head:
        return Answer({}, np.empty(0), head)
    lengths = [*head.get("lengths", [head["rows"]] * len(head["columns"])), head["rows"]]
    count = sum(lengths)
    if any(not isinstance(n, int) or n < 0 for n in lengths) or count > MOST_NUMBERS:
        raise ValueError("no such answer")
    numbers = np.frombuffer(stream.read(8 * count), dtype="<f8", count=count).astype(np.float64)
    *columns, lines = np.split(numbers, np.cumsum(lengths)[:-1])
    return Answer({str(name): part for name, part in zip(head["columns"], columns, strict=True)}, lines, head)


_children: dict[str, _Child] = {}
_lock = threading.Lock()


def read_apart(kind: str, path: str, pieces: Iterable[bytes], question: Mapping[str, Any]) -> Iterator[Answer]:
    """Read a file of format `kind` in its child; gives one answer per piece, the last with the end of the file.

    `question`: `layout`, `wanted` (None: all), `optional`, `ignored`; for text `texts` and `order`, as `TextReader` has
    them. The child reads a piece while the caller works on the previous answer. Raises InvalidFile with the reason,
    also if reading the file ended the child; ReaderMissing if a package is not installed.
    """
    asked: dict[str, Any] = {"optional": [], "ignored": [], "texts": {}, "order": "", **question, "path": path}
    pending: Answer | None = None
    with _lock:
        for piece, last in _with_last(pieces):
            while True:
                with _asking(kind, path, len(piece)) as child:
                    child.send(piece, {**asked, "last": last})
                    if pending is not None:
                        yield pending  # if the caller stops here the child is ended: its answer is pending
                    answer = child.answer(len(piece))
                if "lack" in answer.head:
                    _children.pop(kind).end()
                if "lack" not in answer.head or not asked or child.asked == 1:
                    break  # else memory used by earlier files may be the reason: try a new child
            asked = {}
            _check(kind, path, answer.head)
            pending = answer
    if pending is not None:
        yield pending


def _with_last(pieces: Iterable[bytes]) -> Iterator[tuple[bytes, bool]]:
    """Each piece, and whether it is the last."""
    rest = iter(pieces)
    piece = next(rest, b"")
    for following in rest:
        yield piece, False
        piece = following
    yield piece, True


def _check(kind: str, path: str, head: Mapping[str, Any]) -> None:
    """Raise the error that an answer without numbers reports."""
    if "absent" in head:
        package, why = formats()[kind].package, str(head["absent"])[:100]
        text = f"files of this kind are read with {package}, which is not installed ({why})"
        raise ReaderMissing(f'{path}: {text}: pip install "pmabench[import]"')
    if head.get("lack") == "MemoryError":
        text = f"needs more than {MEMORY / 1e9:g} GB of memory to be read; is it damaged? If not, part it"
        raise invalid(path, text)
    if "lack" in head:
        raise invalid(path, "is nested deeper than any file of measurements; it is damaged or hostile")
    if "problems" in head:
        raise InvalidFile(Problem(path, int(line), int(at), printable(text)) for line, at, text in head["problems"])


@contextmanager
def _asking(kind: str, path: str, size: int) -> Iterator[_Child]:
    """The child of a format; if it ends meanwhile, this is reported as a fault of the file."""
    child = _children.get(kind)
    if child is None or child.owner != os.getpid() or child.process.poll() is not None:
        close_readers(kind)
        child = _children[kind] = _Child(kind)
    try:
        yield child
    except EOFError as error:
        _children.pop(kind, None)
        code = child.ended()
        raise invalid(path, f"{_why(code, size)}; it is damaged or hostile, and nothing of it was taken") from error
    except BaseException:
        _children.pop(kind, None)
        child.end()
        raise


def _why(code: int, size: int) -> str:
    """How a child ended, for a message."""
    if code == -getattr(signal, "SIGPROF", 0):
        return f"takes more than {CPU + CPU_PER_MB * size / 1e6:.1f} s of CPU to read"
    if code < 0:
        with suppress(ValueError):
            return f"made its reader end ({signal.Signals(-code).name})"
    return f"made its reader end (code {code})"


@atexit.register
def close_readers(*kinds: str) -> None:
    """End the children of these formats, or of all, that this process started."""
    for child in [_children.pop(kind) for kind in kinds or list(_children) if kind in _children]:
        if child.owner == os.getpid():
            child.end()
