"""Keeps one warm child process for each format, asks it, and replaces it when it dies or overruns.

The answer of a child is believed no more than the file is: its sizes are checked before anything is built from it.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import IO, Any

import numpy as np

from pmabench.base.errors import InvalidFile, PmaError, Problem, invalid
from pmabench.base.text import printable
from pmabench.store.formats.registry import formats
from pmabench.store.importers.child import CPU, CPU_PER_MB, MEMORY
from pmabench.store.records import Array

WALL = 20.0
"""A child that is silent for so many times its seconds of CPU hangs; the machine may be busy."""
START = 60.0
"""Seconds in which a child must be ready and take a question."""
LONGEST_HEAD = 4_000_000
MOST_NUMBERS = 250_000_000
"""As many as fit into the memory of a child."""


class ReaderMissing(PmaError):
    """The package that reads a format is not installed."""

    exit_code = 3


@dataclass(frozen=True)
class Answer:
    """What a child found: arrays by name, and what else it reported."""

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
            [sys.executable, "-P", "-m", "pmabench.store.importers.child", kind],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )

    def send(self, content: bytes, question: Mapping[str, Any]) -> None:
        """Put a question; its answer is fetched by `answer` before the next one. EOFError where the process ended."""
        ask = self.process.stdin
        if ask is None:
            raise EOFError
        found = json.dumps({**question, "bytes": len(content)}).encode() + b"\n"
        self.asked += 1
        with self._within(START + WALL * CPU):
            try:
                ask.write(found + content)
                ask.flush()
            except (BrokenPipeError, ValueError) as error:
                raise EOFError from error

    def answer(self, size: int) -> tuple[Mapping[str, Any], bytes]:
        """Head and numbers of the answer to a question with `size` bytes."""
        answer = self.process.stdout
        if answer is None:
            raise EOFError
        with self._within(START + WALL * (CPU + CPU_PER_MB * size / 1e6)):
            try:
                head = json.loads(_exactly(answer.readline(LONGEST_HEAD)))
                count = _count(head)
                return head, _exactly(answer.read(8 * count), 8 * count)
            except (BrokenPipeError, ValueError, TypeError, KeyError) as error:
                raise EOFError from error

    @contextmanager
    def _within(self, seconds: float) -> Iterator[None]:
        """Kill the process after `seconds` of wall clock."""
        clock = threading.Timer(seconds, self.process.kill)
        clock.daemon = True
        clock.start()
        try:
            yield
        finally:
            clock.cancel()

    def end(self) -> int:
        """Stop the process; its exit code."""
        for stream in (self.process.stdin, self.process.stdout):
            _close(stream)
        with suppress(OSError):
            self.process.kill()
        return self.process.wait()

    def ended(self) -> int:
        """The exit code of a process that gave no answer."""
        try:
            code = self.process.wait(1.0)
        except subprocess.TimeoutExpired:
            code = 0
        self.end()
        return code


def _close(stream: IO[bytes] | None) -> None:
    if stream is not None:
        with suppress(OSError):
            stream.close()


def _exactly(raw: bytes, size: int | None = None) -> bytes:
    if not raw or (size is not None and len(raw) != size):
        if size == 0:
            return b""
        raise EOFError
    return raw


def _count(head: Mapping[str, Any]) -> int:
    """How many numbers follow a head; raises ValueError where it cannot be."""
    if "columns" not in head:
        return 0
    lengths = head.get("lengths", [head["rows"]] * len(head["columns"]))
    count = sum(lengths) + head["rows"]
    if any(not isinstance(n, int) or n < 0 for n in (*lengths, head["rows"])) or count > MOST_NUMBERS:
        raise ValueError("no such answer")
    if len(lengths) != len(head["columns"]):
        raise ValueError("no such answer")
    return int(count)


_children: dict[str, _Child] = {}
_lock = threading.Lock()


def read_apart(kind: str, path: str, pieces: Iterable[bytes], question: Mapping[str, Any]) -> Iterator[Answer]:
    """What each piece of a file of format `kind` completes, read in its child; the last answer says how the file ends.

    `question`: `layout`, `wanted` (None: all), `optional`, `ignored`; for text `texts` and `order`, as `TextReader` has
    them. The child reads a piece while the caller works on what the one before held. Raises InvalidFile with what is
    wrong with the file, also where reading it ended the child; ReaderMissing where a package is not installed.
    """
    asked: dict[str, Any] = {"texts": {}, "order": "", **question, "path": path}
    pending: Answer | None = None
    with _lock:
        for piece, last in _with_last(pieces):
            while True:
                with _asking(kind, path, len(piece)) as child:
                    child.send(piece, {**asked, "last": last})
                    if pending is not None:
                        yield pending  # a caller that stops here ends the child, for its answer is still to come
                    head, numbers = child.answer(len(piece))
                if "lack" in head:
                    _children.pop(kind).end()
                if "lack" not in head or not asked or child.asked == 1:
                    break  # else what files before it left in the memory of the child may be in the way
            asked = {}
            _check(kind, path, head)
            pending = _answer(head, numbers)
    if pending is not None:
        yield pending


def _with_last(pieces: Iterable[bytes]) -> Iterator[tuple[bytes, bool]]:
    """Each piece, and whether it is the last."""
    before: bytes | None = None
    for piece in pieces:
        if before is not None:
            yield before, False
        before = piece
    yield before or b"", True


def _check(kind: str, path: str, head: Mapping[str, Any]) -> None:
    """Raises what an answer without numbers says."""
    if "absent" in head:
        package, why = formats()[kind].package, str(head["absent"])[:100]
        text = f"files of this kind are read with {package}, which is not installed ({why})"
        raise ReaderMissing(f'{path}: {text}: pip install "pmabench[import]"')
    if "lack" in head:
        if head["lack"] == "MemoryError":
            raise invalid(
                path, f"needs more than {MEMORY / 1e9:g} GB of memory to be read; is it damaged? If not, part it"
            )
        raise invalid(path, "is nested deeper than any file of measurements; it is damaged or hostile")
    if "problems" in head:
        raise InvalidFile(
            Problem(path, int(line), int(column), printable(text)) for line, column, text in head["problems"]
        )


@contextmanager
def _asking(kind: str, path: str, size: int) -> Iterator[_Child]:
    """The child of a format; where it ends in between, that is a fault of the file."""
    child = _children.get(kind)
    if child is None or child.owner != os.getpid() or child.process.poll() is not None:
        if child is not None and child.owner == os.getpid():
            child.end()
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
    """How a child ended, in words."""
    if code == -getattr(signal, "SIGPROF", 0):
        return f"takes more than {CPU + CPU_PER_MB * size / 1e6:.1f} s of CPU to read"
    if code < 0:
        with suppress(ValueError):
            return f"made its reader end ({signal.Signals(-code).name})"
    return f"made its reader end (code {code})"


def _answer(head: Mapping[str, Any], numbers: bytes) -> Answer:
    flat = np.frombuffer(numbers, dtype="<f8").astype(np.float64)
    lengths = head.get("lengths", [head["rows"]] * len(head["columns"]))
    ends = np.cumsum([*lengths, head["rows"]])
    parts = np.split(flat, ends[:-1])
    columns = {str(name): part for name, part in zip(head["columns"], parts, strict=False)}
    return Answer(columns, parts[-1], head)


@atexit.register
def close_readers() -> None:
    """End all children that this process started."""
    for kind in list(_children):
        child = _children.pop(kind)
        if child.owner == os.getpid():
            child.end()
