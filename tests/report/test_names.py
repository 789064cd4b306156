"""Titles and headlines come from the kind of test that declares them; what is withheld is seen wherever values are."""

import csv
import io
import json
from dataclasses import replace

import openpyxl
import pytest
from rich.console import Console

from pmabench.base.kind import Result
from pmabench.report.document import tables
from pmabench.report.document.content import content_of, page_of
from pmabench.report.document.formats import workbook_bytes
from pmabench.report.files.csv_files import write_with_tables
from pmabench.report.foremost import print_coefficients, tiles_of
from pmabench.report.words import declared, distinct
from pmabench.store.analyses.folder import read_analysis, write_analysis
from pmabench.store.analyses.results import Analysis, Estimate, Parts, withhold

from . import samples
from .samples import render

SPEED = Result("c", "speed of sound", "speed", headline=True)
QUIET = Result("q", "noise of the hiss", "pressure")
BULK = Result("K", "bulk modulus", "pressure", headline=True)


def estimate(symbol, value, unit, quantity, at=None):
    return Estimate(symbol, value, unit, quantity, "echo", at or {}, Parts(0.01 * value), 3)


def echo() -> Analysis:
    """A kind of test that nobody here knows, with symbols that others use for other things."""
    found = (
        estimate("c", 340.0, "m/s", "speed"),
        estimate("q", 12.0, "Pa", "pressure"),
        *(estimate("K", 1.4e5, "Pa", "pressure", {"pressure": P}) for P in samples.PRESSURES),
    )
    return Analysis("echo", ("r",), False, found, results=(SPEED, QUIET, BULK))


def terminal(analyses) -> str:
    out = io.StringIO()
    print_coefficients(analyses, Console(file=out, width=80, color_system=None))
    return out.getvalue()


def test_a_symbol_is_titled_as_its_kind_of_test_declares_it():
    reported = {tile.symbol: tile.name for tile in tiles_of([echo()])}
    assert reported == {"c": "speed of sound", "K": "bulk modulus"}
    (whole,) = [t for t in tables.other_tables(echo()) if "whole" in t.caption]
    assert list(whole.frame["quantity"]) == ["speed of sound", "noise of the hiss"]


def test_a_declared_headline_is_on_the_terminal_and_another_result_is_named_there():
    out = terminal([echo()])
    assert "340000 ± 3400  mm/s" in out
    assert "140.0 ± 1.4" in out
    assert "more in the tables of the analysis folder: q (noise of the hiss)" in out


def test_what_nobody_declares_is_shown_by_its_symbol():
    old = replace(echo(), results=())
    out = terminal([old])
    assert "340000 ± 3400  mm/s" in out
    assert [tile.name for tile in tiles_of([old])] == ["", "", ""]


def test_declarations_are_kept_in_the_analysis_folder(tmp_path):
    folder = write_analysis(echo(), tmp_path / "echo")
    back = read_analysis(folder)
    assert back.results == (SPEED, QUIET, BULK)
    assert terminal([back]) == terminal([echo()])
    reported = json.loads((folder / "analysis.json").read_text(encoding="utf-8"))
    del reported["results"]
    (folder / "analysis.json").write_text(json.dumps(reported), encoding="utf-8")
    assert read_analysis(folder).results == ()


def test_one_symbol_for_two_things_is_never_mixed_in_a_report():
    both = [samples.contraction(), echo()]
    assert [list(declared([a]))[-1] for a in distinct(both)][1] == "K (bulk modulus)"
    content = content_of(both, [])
    assert {tile.symbol: tile.name for tile in content.tiles}["K"] == "stiffness"
    heads = [column.head for grid in content.coefficients for column in grid.columns]
    assert "K [N/mm]" in heads
    assert "K (bulk modulus) [kPa]" in heads
    titles = [item.picture.title for item in content.front]
    assert "stiffness K and damping" in titles[0]


def withheld() -> Analysis:
    """K is withheld at two of its pressures, F_c altogether."""
    analysis = samples.contraction()
    places = {("K", 200e3), ("K", 250e3)}
    reason = "the fit leaves 3.1 times the noise; at most 1.2 is expected; check the mount"
    found = [
        withhold(e, reason)
        if ((e.symbol, e.at.get("pressure")) in places and e.method == "measured-pressure") or e.symbol == "F_c"
        else e
        for e in analysis.estimates
    ]
    return replace(analysis, estimates=tuple(found), refusals=("the force drifts by 15 N",))


def test_what_is_withheld_is_on_the_terminal_with_its_reason():
    out = terminal([withheld()])
    assert out.count("withheld") >= 4
    assert "K: withheld: the fit leaves 3.1 times the noise" in out
    assert "F_c: withheld: the fit leaves 3.1 times the noise" in out


def test_a_refusal_and_a_long_serial_number_are_printed_whole():
    made = replace(samples.contraction(), refusals=("K at 200 kPa: interval +-12 %, accepted +-2 %",))
    specimen = {
        "make": "Festo",
        "type": "MAS-20",
        "serial": f"SN-{'0123456789' * 9}",
        "nominal_length": 0.25,
        "inner_diameter": 0.02,
    }
    text = render([made], [samples.run("contraction-relaxation", specimen=specimen)])
    assert "interval ±12 %, accepted ±2 %" in text.partition("Appendices")[0]
    assert "+-" not in text.partition("<script")[0]
    assert "nominal length 250 mm, inner diameter 20 mm</p>" in text


def test_what_is_withheld_is_on_the_first_page():
    run = samples.run("contraction-relaxation")
    content = content_of([withheld()], [run])
    assert content.verdict.word == "Not accepted"
    assert content.verdict.text.startswith("2 reasons")
    assert [text.partition(":")[0] for text in content.failed] == [
        "the force drifts by 15 N",
        "K at pressure 200 kPa, K at pressure 250 kPa, F_c",
    ]
    tiles = {tile.symbol: tile for tile in content.tiles}
    assert tiles["F_c"].value == "withheld"
    page = page_of(content)
    assert page.index("the force drifts by 15 N") < page.index("step-exponential against measured-pressure")
    (figure,) = [item.picture for item in content.front if "stiffness" in item.picture.title]
    assert "Withheld: K at 200 kPa and K at 250 kPa." in figure.caption


def test_what_is_withheld_is_in_every_table(tmp_path):
    analysis = withheld()
    frame, _ = tables.primary_table([analysis])
    assert list(frame["K [N/mm]"]).count("withheld") == 2
    parts = tables.parts_table(analysis, {})
    assert sum(note.startswith("withheld: the fit leaves") for note in parts["note"]) == 3
    folder = write_with_tables(analysis, tmp_path / "a")
    rows = list(csv.DictReader((folder / "estimates.csv").read_text(encoding="utf-8").splitlines()))
    held = [row for row in rows if row["note"].startswith("withheld: the fit leaves")]
    assert [(row["symbol"], row["value"]) for row in held] == [("K", ""), ("K", ""), ("F_c", "")]
    rows = list(csv.DictReader((folder / "coefficients.csv").read_text(encoding="utf-8").splitlines()))
    assert sum(row["withheld"].startswith("K: withheld: the fit leaves") for row in rows) == 2
    content = content_of([analysis], [samples.run("contraction-relaxation")])
    book = openpyxl.load_workbook(io.BytesIO(workbook_bytes(content, [analysis])))
    texts = [str(cell.value) for sheet in book for row in sheet.iter_rows() for cell in row if cell.value]
    assert sum(text.startswith("K: withheld: ") for text in texts) == 2
    assert any(text.startswith("Not accepted") for text in texts)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_what_is_no_finite_number_is_no_value(value):
    e = Estimate("K", value, "N/m", "stiffness", "m", parts=Parts(1.0), note="two trials")
    assert (e.value, e.ci95) == (None, None)
    assert e.note == "two trials; no finite number came out"
    e = Estimate("K", 1.0, "N/m", "stiffness", "m", parts=Parts(1.0, method=value))
    assert (e.value, e.ci95) == (1.0, None)
    assert e.note == "no interval: one of its parts has no bound"


def test_the_difference_of_two_tests_is_no_key_number():
    difference = replace(estimate("F", 0.015, "N", "force", {"pressure": 3e5}), coordinate="difference")
    assert tiles_of([Analysis("agreement", ("a", "b"), True, (difference,))]) == []


def test_a_muscle_that_was_not_named_is_called_so():
    """Maps of old files say `unknown`: the certificate said "unknown", "serial unknown," and ISO 17025 was content."""
    bare = samples.run("contraction-relaxation", specimen={"type": "unknown", "serial": "unknown"})
    content = content_of([samples.contraction()], [bare])
    assert (content.sheet.item, content.sheet.about) == (
        "Muscle of unknown type",
        "type and serial number are not recorded",
    )
    assert content.title == "Characterisation of a pneumatic muscle"
    assert [item.there for item in content.checklist if item.asked == "the item, unmistakably"] == [False]
    half = samples.run("contraction-relaxation", specimen={"type": "unknown", "serial": "A017"})
    assert content_of([samples.contraction()], [half]).sheet.item == "A017"
