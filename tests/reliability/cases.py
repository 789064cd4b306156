"""How many cases a reliability test takes: few with every commit, many on demand."""

import os

VARIABLE = "PMABENCH_CASES"


def cases(per_commit: int) -> int:
    """`per_commit`, or the number that `python -m tests.reliability` asks for."""
    return int(os.environ.get(VARIABLE) or per_commit)
