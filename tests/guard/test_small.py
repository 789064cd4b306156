"""The guard's process stays small: what it loads, and how much of its own code that is."""

import ast
import io
import subprocess
import sys
import tokenize
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OURS = {
    "pmabench", "pmabench.base", "pmabench.base.clock", "pmabench.base.errors", "pmabench.base.quantities",
    "pmabench.base.system", "pmabench.bench", "pmabench.bench.interface", "pmabench.guard",
    "pmabench.guard.course", "pmabench.guard.guard", "pmabench.guard.limits", "pmabench.guard.links",
    "pmabench.guard.owner", "pmabench.guard.process", "pmabench.guard.safe", "pmabench.guard.station",
    "pmabench.guard.supervision", "pmabench.guard.wire",
}  # fmt: skip
"""All modules of the program that the guard loads, besides the driver that it is told."""
COMMANDS = ("guard", "links", "limits", "safe", "course", "owner")
"""What may command (docs/decisions/0011). The rest only asks devices, or is how the engine reaches the guard."""
MAY_COMMAND, WHOLE = 1020, 1597
"""Lines of code that may be there; they may become fewer, and more only for a reason (last: docs/decisions/0042, a gauge that stands still)."""


def loaded(code):
    script = f"import sys\n{code}\nprint('\\n'.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(done.stdout.split())


def foreign(modules):
    top = {name.split(".")[0] for name in modules}
    return {name for name in top - set(sys.stdlib_module_names) if not name.startswith(("_", "pmabench"))}


def test_the_guard_loads_these_modules_of_ours_and_nothing_but_the_standard_library():
    bare = loaded("pass")
    modules = loaded("import pmabench.guard.process") - bare
    assert {name for name in modules if name.startswith("pmabench")} == OURS
    assert foreign(modules) == set()
    assert not modules & {"asyncio", "concurrent.futures", "multiprocessing", "email", "http", "ssl", "unittest"}


def test_the_driver_of_the_mock_adds_no_library():
    bare = loaded("pass")
    code = (
        f"sys.path.insert(0, {str(ROOT / 'drivers')!r})\nimport pmabench.guard.process\n"
        "from pmabench_drivers.mock.client import MockClient"
    )
    modules = loaded(code) - bare
    assert foreign(modules) == set()


def lines_of_code(path):
    """Lines that hold code: no blank ones, comments, docstrings or imports."""
    text = path.read_text()
    left_out = set()
    for node in ast.walk(ast.parse(text)):
        docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if docstring or isinstance(node, ast.Import | ast.ImportFrom):
            left_out |= set(range(node.lineno, node.end_lineno + 1))
    nothing = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    held = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in nothing:
            held |= set(range(token.start[0], token.end[0] + 1))
    return len(held - left_out)


def test_the_guard_can_be_read_in_one_sitting():
    names = {name.rpartition(".")[2] for name in OURS if "guard." in name}
    counts = {name: lines_of_code(ROOT / "pmabench" / "guard" / f"{name}.py") for name in names}
    assert sum(counts[name] for name in COMMANDS) <= MAY_COMMAND, counts
    assert sum(counts.values()) <= WHOLE, counts
