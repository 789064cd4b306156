"""Kinds of test: found by their folders and by entry points, known to nothing outside of them."""

import ast
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from pmabench.base import system
from pmabench.base.kind import Kind, load
from pmabench.kinds import registry
from pmabench.model.library import MODELS

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = sorted(path.parent for path in (ROOT / "pmabench/kinds").glob("*/__init__.py"))
DEFAULTS = {
    ("pmabench/cli/init.py", "contraction-relaxation"),
    *(
        ("pmabench/bench/lab/questions.py", name)
        for name in (
            "contraction-relaxation",
            "static-load",
            "isobaric-ramp",
            "sinusoidal-displacement",
            "isometric-pressurisation",
        )
    ),
    ("pmabench/bench/lab/files.py", "surface"),
    ("pmabench/bench/dry_run.py", "surface"),
    ("pmabench/bench/plant.py", "surface"),
    ("pmabench/model/presets.py", "surface"),
    ("pmabench/report/document/special_tables.py", "relaxation"),
}
"""Words that name a kind of test, too: the shipped protocols that `init` offers, a part of the plant of a muscle."""


def kinds_of(folder):
    kind = load(f"pmabench.kinds.{folder.name}:KIND")
    return (kind, *kind.also)


def targets(kind):
    """Every "module:name" of a record, with where it is."""
    for field in fields(Kind):
        value = getattr(kind, field.name)
        for text in value.values() if isinstance(value, dict) else [value]:
            if isinstance(text, str) and text.startswith("pmabench.") and ":" in text:
                yield field.name, text


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_record_names_parts_that_are_there_and_none_of_another_kind(folder):
    for kind in kinds_of(folder):
        for field, target in targets(kind):
            assert target.startswith(
                (f"pmabench.kinds.{folder.name}.", "pmabench.kinds.reduce:", "pmabench.plotting.", "pmabench.analysis.")
            ), (
                field,
                target,
            )
            assert callable(load(target)), (field, target)


def test_nothing_outside_its_folder_names_a_kind_of_test():
    names = set(registry.all_kinds())
    found = set()
    for path in [*(ROOT / "pmabench").rglob("*.py"), *(ROOT / "drivers").rglob("*.py")]:
        place = path.relative_to(ROOT).as_posix()
        if place.startswith("pmabench/kinds/") and path.parent.name != "kinds":
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            model = place.startswith("pmabench/model/") and isinstance(node, ast.Constant) and node.value in MODELS
            if isinstance(node, ast.Constant) and node.value in names and not model:
                found.add((place, node.value))
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pmabench.kinds."):
                shared = {"registry", "compile", "reduce", "campaign"}
                assert node.module.split(".")[2] in shared, (place, node.module)
    assert found == DEFAULTS


def test_titles_and_papers_are_there():
    for kind in registry.all_kinds().values():
        assert kind.title, kind.name
        assert kind.results, kind.name
        assert kind.papers or not kind.protocol, kind.name


KIND = """
from pmabench.base.kind import Kind, Result

KIND = Kind(
    name="weighing", title="Weighing", results=(Result("c", "mass on the hook", "mass", headline=True),),
    reduction="weighing_kind:reduce", protocol="weighing_kind:Weighing", papers=("a bathroom scale",),
)
"""


def _read_anew():
    system.installed.cache_clear()
    registry.all_kinds.cache_clear()


def test_a_package_brings_a_kind_by_an_entry_point(tmp_path, monkeypatch):
    (tmp_path / "weighing_kind.py").write_text(KIND)
    about = tmp_path / "weighing-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: weighing\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[pmabench.kinds]\nweighing = weighing_kind:KIND\n")
    monkeypatch.syspath_prepend(tmp_path)
    _read_anew()
    try:
        assert registry.kind_of("weighing").title == registry.title_of("weighing") == "Weighing"
        assert "weighing" in registry.protocols()
        with pytest.raises(ValueError, match='unknown kind of test "weighin"; did you mean "weighing"'):
            registry.kind_of("weighin")
    finally:
        monkeypatch.undo()
        _read_anew()
        sys.modules.pop("weighing_kind", None)
    assert registry.find("weighing") is None
