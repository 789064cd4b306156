"""The guard's process stays small: what it loads, and how much of its own code that is."""

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OURS = {
    "pmabench", "pmabench.base", "pmabench.base.clock", "pmabench.base.errors", "pmabench.base.quantities",
    "pmabench.base.system", "pmabench.bench", "pmabench.bench.interface", "pmabench.bench.records", "pmabench.guard",
    "pmabench.guard.course", "pmabench.guard.guard", "pmabench.guard.limits", "pmabench.guard.owner",
    "pmabench.guard.process", "pmabench.guard.safe", "pmabench.guard.station", "pmabench.guard.wire",
}  # fmt: skip
"""All modules of the program that the guard loads, besides the driver that it is told."""
STATEMENTS = 920
"""Of all files that the process loads from pmabench/guard; it may become less, and more only for a reason."""


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


def statements(path):
    """Statements of a file, docstrings not counted: a measure that no formatting changes."""
    tree = ast.parse(path.read_text())
    docstrings = sum(isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant) for n in ast.walk(tree))
    return sum(isinstance(node, ast.stmt) for node in ast.walk(tree)) - docstrings


def test_the_guard_can_be_read_in_one_sitting():
    files = [ROOT / "pmabench" / "guard" / f"{name.rpartition('.')[2]}.py" for name in OURS if "guard." in name]
    counts = {path.name: statements(path) for path in files}
    assert sum(counts.values()) <= STATEMENTS, counts
