"""A format is one record: those of pmabench and those that a package next to it brings, without an edit here."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from openpyxl import Workbook

from pmabench.store.formats.record import format_of, formats
from pmabench.store.reader import open_run

ROOT = Path(__file__).resolve().parents[2]
MODULE = '''
"""Excel workbooks: the columns of one sheet, named by its first row."""

import io
from typing import Literal

import numpy as np

from pmabench.store.formats.record import Column, Format, Layout, Recorded, damaged


class XlsxLayout(Layout):
    """A workbook."""

    format: Literal["xlsx"]
    sheet: str = ""
    """Its first sheet where none is named."""


def read_xlsx(path, content, layout, only):
    from openpyxl import load_workbook

    with damaged(path, "workbook"):
        book = load_workbook(io.BytesIO(content), read_only=True, data_only=True)
        sheet = book[layout.sheet] if layout.sheet else book.worksheets[0]
        names, *rows = sheet.iter_rows(values_only=True)
        table = np.array(rows, dtype=float)
    return Recorded([Column(name, table[:, k]) for k, name in enumerate(names) if only is None or name in only])


def recognise(content):
    return content.startswith(b"PK\\x03\\x04") and b"xl/workbook.xml" in content


FORMAT = Format("xlsx", "Excel workbook", XlsxLayout, recognise, read_xlsx, modules=("openpyxl",), package="openpyxl")
'''
MAP = """\
schema: pmabench.map/1
name: a workbook
source: nobody
kind: isometric
file: {format: xlsx, sheet: pulls}
columns:
  t [s]: {is: time, unit: s}
  pressure [kPa]: {is: pressure, unit: kPa}
  force [N]: {is: force, unit: N}
sampling: {rate: [90 Hz, 110 Hz], gap: 50 ms}
trials: {by: file, point: {contraction: 4 mm}}
specimen: {type: muscle}
"""
t = np.arange(2000) / 100.0
PRESSURE = 300.0 * np.sin(np.pi * t / 20.0) ** 2
FORCE = 12.0 + 0.62 * PRESSURE


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A package with its dist-info, a workbook and its map."""
    folder = tmp_path_factory.mktemp("xlsx")
    about = folder / "site" / "pma_xlsx-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: pma-xlsx\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[pmabench.formats]\nxlsx = pma_xlsx:FORMAT\n")
    (folder / "site" / "pma_xlsx.py").write_text(MODULE)
    book = Workbook()
    book.active.append(["nothing"])
    sheet = book.create_sheet("pulls")
    sheet.append(["t [s]", "pressure [kPa]", "force [N]"])
    for row in np.column_stack([t, PRESSURE, FORCE]).tolist():
        sheet.append(row)
    book.save(folder / "pulls.xlsx")
    book.remove(book.worksheets[0])
    book.save(folder / "alone.xlsx")
    (folder / "map.yaml").write_text(MAP)
    return folder


def called(place, *args, code=0, site="site"):
    """What a command says as JSON, in a process that finds the package."""
    done = subprocess.run(
        [sys.executable, "-m", "pmabench", *args, "--json"],
        cwd=place, capture_output=True, text=True, env={"PYTHONPATH": f"{place / site}:{ROOT}", "HOME": str(place)},
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    return json.loads(done.stdout) if done.stdout else done.stderr


def test_a_package_next_to_pmabench_brings_a_format(place):
    (made,) = called(place, "import", "pulls.xlsx", "--map", "map.yaml", "--out", "runs")["runs"]
    assert (made["rows"], made["trials"], made["flagged"]) == (len(t), 1, {})
    trial = open_run(place / made["run"]).trials[0]
    np.testing.assert_allclose(trial.channels["pressure"], 1e3 * PRESSURE, rtol=1e-12, atol=1e-6)
    np.testing.assert_allclose(trial.channels["force"], FORCE, rtol=1e-12)
    np.testing.assert_allclose(trial.t, t, atol=1e-9)


def test_a_guess_recognises_it_and_its_map_is_taken(place):
    reported = called(place, "import", "--guess", "alone.xlsx", "-o", "guessed.yaml")
    assert (reported["format"], reported["kind"]) == ("xlsx", "isometric")
    assert any("Excel workbook" in reason for reason in reported["reasons"]["file"])
    (made,) = called(
        place, "import", "alone.xlsx", "--map", "guessed.yaml", "--out", "guessed", "--set", "trials.point.contraction=4 mm"
    )["runs"]  # fmt: skip
    np.testing.assert_allclose(open_run(place / made["run"]).trials[0].channels["force"], FORCE, rtol=1e-12)


def test_the_schema_of_a_map_knows_it(place):
    layouts = called(place, "schema", "map")["$defs"]
    assert layouts["XlsxLayout"]["properties"]["sheet"]["type"] == "string"


def test_a_damaged_file_of_it_is_a_sentence(place):
    content = (place / "pulls.xlsx").read_bytes()
    (place / "cut.xlsx").write_bytes(content[: len(content) // 2])
    assert "cannot be read as workbook" in called(place, "import", "cut.xlsx", "--map", "map.yaml", code=3)["error"]


def test_without_the_package_the_map_is_refused_with_the_formats_that_there_are(place):
    said = called(place, "import", "pulls.xlsx", "--map", "map.yaml", code=3, site="none")["error"]
    assert '"xlsx" is not known here' in said


def test_an_entry_point_that_is_no_format_is_named(place, tmp_path):
    about = tmp_path / "broken-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[pmabench.formats]\nodd = json:dumps\n")
    said = called(place, "import", "pulls.xlsx", "--map", "map.yaml", code=3, site=tmp_path)["error"]
    assert 'is not the record of the format "odd"' in said


def test_each_format_recognises_its_own_files_and_no_other():
    files = sorted((ROOT / "fixtures" / "old-runs" / "foreign").iterdir())
    assert {format_of(path.read_bytes()).name for path in files} == {"lvm", "tdms", "mat"}
    for path in files:
        content = path.read_bytes()
        assert [name for name, each in formats().items() if each.recognise(content)] == [path.suffix.removeprefix(".")]
    assert format_of(b"t,p,f\n0,1,2\n").name == "text"


def test_a_page_describes_every_format():
    pages = "\n".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").rglob("*.md"))
    assert [name for name in formats() if f"| `{name}`" not in pages] == []
