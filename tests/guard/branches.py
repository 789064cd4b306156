"""Which branches of the guard's code its tests take, on the level of the interpreter's own jumps.

`python -m tests.guard.branches` runs the tests of this folder with a trace on the guard's files and prints every
conditional jump that went only one way, and every line that was never reached. Exit code 1 where there is one that
`EXCUSED` does not name.
"""

from __future__ import annotations

import dis
import sys
import threading
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = {
    str(ROOT / "pmabench" / "guard" / f"{name}.py")
    for name in ("course", "guard", "limits", "owner", "process", "safe", "station", "supervision", "wire")
}
EXCUSED = (
    "except ",  # an exception of a kind that nothing there raises
    "with suppress(",
    "assert ",
    "lambda: None",
    'if sys.platform == "win32"',  # another system
    'return Path(os.environ.get("LOCALAPPDATA"',
)
"""Text of lines that need not be reached, or need not go both ways."""
RANDOM = (
    "test_no_sequence_of_hostile_commands_gets_past",
    "test_the_value_that_the_device_gets_lies_inside_after_rounding",
)
"""Tests of the folder that take no branch that the others leave out, and half of the time with a trace."""

taken: dict[CodeType, set[tuple[int, int]]] = defaultdict(set)
complete: set[CodeType] = set()
"""Code of which nothing is left to be seen: it needs no trace any more."""
calls: Counter[CodeType] = Counter()


def trace(frame: FrameType, event: str, _argument: Any) -> Any:
    """Follow the guard's own frames instruction by instruction, as long as these have not been everywhere."""
    code = frame.f_code
    if code.co_filename not in FILES or code in complete:
        return None
    calls[code] += 1
    if taken[code] and calls[code] & (calls[code] - 1) == 0 and not any(missed(code)):  # at the call 2, 4, 8 ...
        complete.add(code)
        return None
    frame.f_trace_opcodes, frame.f_trace_lines = True, False
    before = -1
    steps = taken[code]

    def local(frame: FrameType, event: str, _argument: Any) -> Any:
        nonlocal before
        if event == "opcode":
            steps.add((before, frame.f_lasti))
            before = frame.f_lasti
        return local

    return local


def missed(code: CodeType) -> Iterator[tuple[int, str]]:
    """Lines that were not reached and conditions that went one way only, in one piece of code.

    The interpreter has some conditions and lines twice (loops, `finally`); one of them is enough.
    """
    steps = taken.get(code, set())
    reached = {after for _, after in steps}
    instructions = [i for i in dis.get_instructions(code) if i.opname not in {"CACHE", "EXTENDED_ARG"}]
    lines: dict[int, bool] = {}
    ways: dict[Any, set[bool]] = {}
    for place, instruction in enumerate(instructions):
        line = instruction.positions.lineno if instruction.positions else None
        if line is None:
            continue
        if instruction.opname not in QUIET:
            lines[line] = lines.get(line, False) or instruction.offset in reached
        if instruction.offset in reached and "JUMP" in instruction.opname and "_IF_" in instruction.opname:
            jumps = "NOT" not in instruction.opname and "FALSE" not in instruction.opname
            went = ways.setdefault(instruction.positions, set())
            if (instruction.offset, instruction.argval) in steps:
                went.add(jumps)
            if (instruction.offset, instructions[place + 1].offset) in steps:
                went.add(not jumps)
    yield from ((line, "not reached") for line, seen in lines.items() if not seen and line != code.co_firstlineno)
    for where, went in ways.items():
        if len(went) < 2:
            yield where.lineno, f"its condition is always {next(iter(went), 'left by an exception')}"


QUIET = {"RESUME", "COPY_FREE_VARS", "MAKE_CELL", "RERAISE", "COPY", "POP_EXCEPT", "PUSH_EXC_INFO", "RETURN_GENERATOR"}
"""Of the interpreter's own making: what happens to exceptions that nobody raises."""


def codes(code: CodeType) -> Iterator[CodeType]:
    """A piece of code and all inside it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from codes(constant)


def main() -> int:
    """Run the tests and tell what they leave out."""
    threading.settrace(trace)
    sys.settrace(trace)
    here = Path(__file__).parent
    left_out = [f"--ignore={here / 'test_branches.py'}", "-k", " and ".join(f"not {name}" for name in RANDOM)]
    code = pytest.main(["-q", "-p", "no:cacheprovider", *left_out, str(here), *sys.argv[1:]])
    sys.settrace(None)
    total = left = 0
    by_place = {(c.co_filename, c.co_firstlineno, c.co_name): c for c in taken}
    for path in sorted(FILES):
        source = Path(path).read_text().splitlines()
        for known in codes(compile(Path(path).read_text(), path, "exec")):
            ran = by_place.get((path, known.co_firstlineno, known.co_name))
            if known.co_name == "<module>" or "class" in source[known.co_firstlineno - 1].split(" ")[0:1]:
                continue
            total += sum("JUMP" in i.opname and "IF" in i.opname for i in dis.get_instructions(known))
            found = list(missed(ran)) if ran is not None else [(known.co_firstlineno, f"{known.co_name} never called")]
            for line, what in found:
                if not any(text in source[line - 1] for text in EXCUSED):
                    left += 1
                    print(f"{Path(path).name}:{line}: {what}: {source[line - 1].strip()}")
    print(f"{total} conditional jumps, {left} places left out")
    return 1 if left or code else 0


if __name__ == "__main__":
    sys.exit(main())
