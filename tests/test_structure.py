"""What the structure promises: light help, a small guard, current schemas, no stray paths."""

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import jsonschema
import pytest

from pmabench.cli.files import KINDS, schema_text
from pmabench.files.document import read_document

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("numpy", "scipy", "pandas", "pymodbus", "can", "pint", "serial", "pydantic", "pyarrow")


def loaded_by(code: str) -> set[str]:
    script = f"import sys\n{code}\nprint('\\n'.join(sys.modules))"
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(out.stdout.splitlines())


def test_help_loads_nothing_heavy():
    code = "from pmabench.cli.main import main\ntry:\n main(['--help'])\nexcept SystemExit: pass"
    assert not set(HEAVY) & loaded_by(code)


def test_the_guard_loads_nothing_heavy():
    loaded = loaded_by("import pmabench.guard.guard")
    assert not {*HEAVY, "rich", "click", "pmabench.files", "pmabench.protocol", "pmabench.store"} & loaded


def test_importing_the_package_loads_nothing():
    assert not {*HEAVY, "rich", "click"} & loaded_by("import pmabench")


@pytest.mark.parametrize("kind", KINDS)
def test_schemas_are_current(kind):
    committed = (ROOT / "docs" / "schemas" / f"{kind}.schema.json").read_text()
    assert committed == schema_text(kind), "run `make schemas`"


FOLDERS = {
    "protocol": "protocols",
    "bench": "fixtures/benches",
    "specimen": "fixtures/specimens",
    "campaign": "fixtures/campaigns",
    "cascade": "fixtures/cascades",
    "plant": "fixtures/plants",
    "truth": "fixtures/truths",
    "registers": "fixtures/benches/registers",
}


@pytest.mark.parametrize("kind", FOLDERS)
def test_shipped_files_name_their_schema_and_satisfy_it(kind):
    schema = json.loads((ROOT / "docs" / "schemas" / f"{kind}.schema.json").read_text())
    files = sorted((ROOT / FOLDERS[kind]).glob("*.yaml"))
    assert files
    judge = jsonschema.validators.validator_for(schema)(schema)
    judge.check_schema(schema)
    for file in files:
        first = file.read_text().splitlines()[0]
        named = re.fullmatch(r"# yaml-language-server: \$schema=(\S+)", first)
        assert named, f"{file} names no schema"
        assert (file.parent / named[1]).resolve() == ROOT / "docs" / "schemas" / f"{kind}.schema.json"
        document = read_document(file)
        judge.validate(document.data)


JUDGES = {
    "tests/judge": "tests.judge",
    "tests/judge/second": "tests.judge.second",
    "tests/store/foreign": "tests.store.foreign",
}
"""Folder of what makes data with a known truth -> its modules; its own tests may import more."""


@pytest.mark.parametrize("folder", JUDGES)
def test_a_judge_imports_nothing_of_the_project(folder):
    allowed = {*sys.stdlib_module_names, "numpy", "scipy"}
    files = [file for file in sorted((ROOT / folder).glob("*.py")) if not file.name.startswith("test_")]
    assert files
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or "."] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                mine = f"{name}.".startswith(f"{JUDGES[folder]}.")
                assert mine or name.split(".")[0] in allowed, f"{file.name} imports {name}"


def test_no_file_names_a_registry_or_a_machine():
    listed = subprocess.run(["git", "ls-files"], capture_output=True, text=True, check=True, cwd=ROOT).stdout.split()
    wrong = re.compile(r"(?:pypi|files\.pythonhosted|registry\.npmjs)\.org|/(?:home|root|work)/\w")
    for name in listed:
        path = ROOT / name
        if path.suffix in {".py", ".yaml", ".toml", ".md", ".lock", ".html", ".css", ""} and path.is_file():
            found = wrong.search(path.read_text(encoding="utf-8", errors="replace"))
            assert name == "tests/test_structure.py" or found is None, f"{name}: {found}"


MAPPED = [
    folder.relative_to(ROOT / "pmabench").as_posix()
    for room in ("analysis", "kinds", "report")
    for folder in sorted({init.parent for init in (ROOT / "pmabench" / room).rglob("__init__.py")})
]


@pytest.mark.parametrize("room", MAPPED)
def test_the_map_of_a_room_names_every_module(room):
    """A newcomer finds everything: figures of one kind of test have a pattern."""
    folder = ROOT / "pmabench" / room
    named = set(re.findall(r"`([a-z_0-9]+)(?:\.py)?`", (folder / "__init__.py").read_text()))
    modules = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    modules |= {path.name for path in folder.iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert {name for name in modules - named if not name.endswith(("_figures", "_plots"))} == set()
    assert named - modules <= {"compare", "history"}


LONGEST = 60
"""Lines of a function without its docstring: what fits on a screen."""
RIDDLES = {"told", "beside", "stands", "stood", "heed", "spoilt", "bite", "foreseen"}
"""Words that a reader with another first language stumbles over; not in names."""


def trees():
    """Path and syntax tree of each module of the product, and of each test that has one of the words."""
    for folder in ("pmabench", "drivers", "tests"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            text = path.read_text("utf-8")
            if folder != "tests" or any(word in text.lower() for word in RIDDLES):
                yield path.relative_to(ROOT), ast.parse(text)


def test_functions_fit_on_a_screen_and_names_are_plain_words():
    wrong = []
    for path, tree in trees():
        for node in ast.walk(tree):
            names = {getattr(node, kind, None) for kind in ("name", "id", "arg", "attr")}
            words = {word for name in names if isinstance(name, str) for word in name.lower().split("_")}
            wrong += [f"{path}:{node.lineno} {word}" for word in RIDDLES & words]
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and path.parts[0] != "tests":
                docstring = node.body[0] if ast.get_docstring(node) is not None else None
                said = 0 if docstring is None else docstring.end_lineno - docstring.lineno + 1
                length = node.end_lineno - node.lineno + 1 - said
                wrong += [f"{path}:{node.lineno} {node.name}: {length} lines"] if length > LONGEST else []
    assert wrong == []
