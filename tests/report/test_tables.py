"""Tables say what is known and how well: rounding by the interval, units, what is not identifiable, harmless text."""

import io
import json
from dataclasses import replace

import pandas as pd
import pytest
from rich.console import Console

from pmabench.plotting.wording import half_width, printed, rounded, shown
from pmabench.report.document import tables
from pmabench.report.files.csv_files import write_tables
from pmabench.report.foremost import print_coefficients
from pmabench.store.analyses.results import Analysis, Dropped, Estimate, Finding, Parts

from . import samples


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (7.552, 0.021, "7.552 ± 0.021"),
        (7.5523, 0.0996, "7.55 ± 0.10"),
        (5970.348, 8.34, "5970.3 ± 8.3"),
        (934.8, 1234.0, "900 ± 1200"),
        (-48.94, 1.9, "−48.9 ± 1.9"),
        (-0.001, 0.3, "0.00 ± 0.30"),
        (9.734e-6, 1.23e-7, "(9.73 ± 0.12)×10⁻⁶"),
        (1.23456789, 1e-12, "1.234568 ± 0.000001"),
        (7.55234, None, "7.552"),
        (7.55234, float("inf"), "7.552"),
        (None, None, "not identifiable"),
        (float("nan"), 1.0, "not identifiable"),
    ],
)
def test_a_value_is_rounded_to_the_second_digit_of_its_interval(value, half, text):
    assert rounded(value, half) == text


@pytest.mark.parametrize(
    ("half", "text"), [(None, ""), (0.0, "0"), (0.02134, "0.021"), (1234.0, "1200"), (2.3e-5, "2.3×10⁻⁵")]
)
def test_half_widths_have_two_digits(half, text):
    assert half_width(half) == text


@pytest.mark.parametrize(
    ("quantity", "unit", "display", "scale"),
    [
        ("stiffness", "N/m", "N/mm", 1e3),
        ("", "N/m/Pa2", "N/(mm·kPa²)", 1e-3),
        ("", "Pa/(m.s)", "kPa/(mm·s)", 1e6),
        ("", "Pa.s/m", "kPa·s/mm", 1e6),
        ("", "1", "", 1.0),
        ("ratio", "1", "%", 0.01),
    ],
)
def test_units_are_those_that_people_read(quantity, unit, display, scale):
    assert shown(quantity, unit).unit == display
    assert shown(quantity, unit).scale == pytest.approx(scale)


def test_the_coefficient_table_names_units_and_what_cannot_be_known():
    frame = pd.DataFrame(tables.coefficient_table(samples.all_analyses()).rows)
    main = frame[frame["method"] == "measured-pressure"].set_index("P [kPa]")
    assert {"F_ce [N]", "K [N/mm]", "B_c [N·s/mm]", "B_r [N·s/mm]"} <= set(main.columns)
    assert main.loc["400", "K [N/mm]"] == "7.552 ± 0.021"
    assert main.loc["500", "B_r [N·s/mm]"] == "not identifiable"
    assert list(main.index) == ["150", "200", "250", "300", "350", "400", "450", "500"]


def test_sines_alone_have_their_coefficients_in_the_first_table():
    frame, reported = tables.primary_table([samples.sine()])
    assert list(frame.columns) == ["P [kPa]", "K [N/mm]", "B [N·s/mm]"]
    assert frame["K [N/mm]"] == ["6.773 ± 0.020"]
    assert reported == "sine-harmonic at mean x = 30 mm, amplitude = 10 mm"
    one = samples.sine()
    shallow = [replace(e, at={**e.at, "amplitude": 0.002}, value=2 * (e.value or 0.0)) for e in one.estimates]
    frame, reported = tables.primary_table([replace(one, estimates=(*one.estimates, *shallow))])
    assert list(zip(frame["amplitude [mm]"], frame["K [N/mm]"], strict=True)) == [
        ("2", "13.546 ± 0.020"),
        ("10", "6.773 ± 0.020"),
    ]
    assert reported == "sine-harmonic at mean x = 30 mm"
    frame, reported = tables.primary_table([samples.contraction(), one])
    assert len(frame) == 8, "a row for each pressure, with what the sines say of one of them"
    assert reported


def test_every_estimate_is_in_one_table():
    analysis = samples.contraction()
    cells = [cell for row in tables.coefficient_table([analysis]).cells() for cell in row]
    for table in tables.other_tables(analysis):
        cells += [cell for row in table.frame.cells() for cell in row]
    for estimate in analysis.estimates:
        assert tables.cell(estimate) in cells
    assert len(tables.parts_table(analysis, {})) == len(analysis.estimates)


def test_methods_stand_side_by_side():
    names = {table.caption: table.frame for table in tables.method_tables(samples.all_analyses())}
    forces = next(frame for name, frame in names.items() if name.startswith("F_ce"))
    assert list(forces.columns) == ["P [kPa]", "static-mean", "measured-pressure", "step-exponential"]


def test_settings_stand_in_both_forms_with_units():
    frame = tables.tuning_table([samples.ultimate_gain()])
    assert list(frame.columns[:5]) == ["operating point", "rule", "K_p [kPa/mm]", "T_i [s]", "K_i [kPa/(mm·s)]"]
    second = [row for row in frame.rows if row["rule"] == "Ziegler-Nichols PI"][1]
    assert second["K_p [kPa/mm]"].startswith("26.9")
    assert second["phase margin [deg]"] == "33.8"


def test_facts_of_any_shape_make_no_table_and_no_error():
    for tuning in (None, 3, "x", [1, {"gains": 4}, {"gains": {"K_p": 7, "T_i": {"value": "a"}}}]):
        analysis = replace(samples.ultimate_gain(), facts={"tuning": tuning})
        tables.tuning_table([analysis])


def terminal(analyses, width=80) -> str:
    console = Console(file=io.StringIO(), width=width, color_system=None)
    print_coefficients(analyses, console)
    return console.file.getvalue()


def test_the_terminal_table_fits_80_columns_and_breaks_no_number():
    out = terminal(samples.all_analyses())
    assert max(len(line) for line in out.splitlines()) <= 80
    assert "7.552 ± 0.021" in out
    assert "not identifiable" in out
    assert "SIMULATED" in out


def test_tables_of_one_method_have_titles_of_their_own():
    points = [{"pressure": 3e5, "mean": 0.01}, *({"pressure": 3e5, "mean": 0.01, "frequency": f} for f in (0.5, 3.0))]
    found = tuple(Estimate("K", 6773.0, "N/m", "stiffness", "sine-harmonic", at, Parts(2.0)) for at in points)
    lines = terminal([Analysis("sinusoidal-displacement", ("r",), False, found)]).splitlines()
    titles = [line.strip() for line in lines if "sine-harmonic" in line]
    assert titles == [
        "sine-harmonic, by pressure, at mean x = 10 mm",
        "sine-harmonic, by frequency, at P = 300 kPa, mean x = 10 mm",
    ]


def test_the_terminal_shows_why_a_value_or_an_interval_is_missing():
    m = Estimate("m", 6e-4, "N/Pa", "force per pressure", "isometric-line", {"contraction": 0.0}, note="one test only")
    K = Estimate("K", None, "N/m", "stiffness", "isometric-line", {"contraction": 0.0}, note="no oscillation")
    known = Estimate("K_u", 6e7, "Pa/m", "gain", "isometric-line", {"contraction": 0.0}, Parts(1e6), note="quite so")
    out = terminal([Analysis("isometric", ("r",), False, (m, K, known))])
    assert "m: no interval: one test only" in out
    assert "K: no oscillation" in out
    assert "quite so" not in out


def test_an_interval_that_ends_at_0_is_written_by_its_ends():
    at, kind = {"pressure": 3e5}, "command-to-motion"
    time = Estimate("t_d", 0.022, "s", "time", "onset", at, Parts(0.049), coordinate=kind, positive=True)
    assert tables.cell(time) == "0.022 (0 to 0.071)"
    assert tables.cell(replace(time, parts=Parts(0.004))) == "0.0220 ± 0.0040"
    assert tables.cell(replace(time, parts=Parts(None, 0.004))) == "0.02200"


HOSTILE = ["[/dev/ttyUSB0]", "[bold]x[/]", "=1+1", "<script>alert(1)</script>", "a\x1b[31mb\x00c", "\u202egnp"]


@pytest.mark.parametrize("text", HOSTILE)
def test_the_terminal_takes_any_text(text):
    estimate = Estimate(text, 1.0, text, text, text, {"pressure": 1e5, text: 2.0})
    out = terminal([Analysis(text, (text,), False, (estimate,))])
    assert "\x1b" not in out
    assert "\x00" not in out


def test_no_csv_cell_is_a_formula(tmp_path):
    hostile = "=HYPERLINK(1)"
    analysis = Analysis(
        "isometric",
        ("@run",),
        False,
        estimates=(Estimate(hostile, 1.0, "+u", "", "-m", {hostile: 1.0}, Parts(0.1), note="@n", trials=("=t",)),),
        dropped=(Dropped("=t/1", {hostile: 1.0}, " -2+3"),),
        findings=(Finding("note", "+cmd"),),
    )
    paths = write_tables(analysis, tmp_path)
    assert {path.name for path in paths} == {
        "coefficients.csv", "estimates.csv", "curves.csv", "dropped.csv", "findings.csv",
    }  # fmt: skip
    for path in paths:
        frame = pd.read_csv(path, dtype=str, keep_default_na=False)
        for value in [*frame.columns, *frame.to_numpy().ravel()]:
            assert not value.lstrip().startswith(("=", "+", "@")), (path.name, value)
            if value.lstrip().startswith("-"):
                float(value)


def test_csv_files_hold_full_numbers_with_units_in_headers(tmp_path):
    write_tables(samples.contraction(), tmp_path)
    frame = pd.read_csv(tmp_path / "coefficients.csv")
    row = frame[(frame["method"] == "measured-pressure") & (frame["P [kPa]"] == 400.0)].iloc[0]
    assert row["K [N/mm]"] == pytest.approx(7.552, abs=1e-12)
    assert row["K half width 95 % [N/mm]"] == pytest.approx(0.021)
    assert row["F_ce [N]"] == pytest.approx(383.0)


def test_the_json_of_an_estimate_is_what_the_table_rounds():
    estimate = next(e for e in samples.contraction().estimates if e.symbol == "K")
    assert json.loads(json.dumps(estimate.to_dict()))["value"] == estimate.value


def test_the_skew_of_several_clocks_has_a_column_where_there_are_several():
    one = samples.contraction()
    assert "skew" not in tables.parts_table(one, {}).columns
    several = [replace(e, parts=replace(e.parts, skew=20.0)) if e.symbol == "K" else e for e in one.estimates]
    frame = tables.parts_table(replace(one, estimates=tuple(several)), {})
    reported = {(row["symbol"], row["value"] != "not identifiable"): row["skew"] for row in frame.rows}
    assert reported["K", True] == "0.020"
    assert reported["B_r", False] == ""


def test_what_the_computer_rounds_is_no_number():
    error = Estimate("P_err", 0.0, "Pa", "pressure", "m", {"frequency": 1.0}, Parts(repeats=8.4e-11))
    assert tables.cell(error) == "below resolution"
    assert tables.cell(replace(error, value=8.4e-11, parts=Parts())) == "below resolution"
    assert tables.cell(replace(error, value=500.0)) == "0.5000000 ± 0.0000001"
    (row,) = tables.parts_table(Analysis("x", (), False, (error,)), {}).rows
    assert (row["value"], row["repeats"]) == ("below resolution", "< 10⁻⁹")
    term = replace(error, unit="N/m/Pa2", quantity="stiffness per pressure squared", value=9.7e-12)
    assert tables.cell(replace(term, parts=Parts(repeats=1e-13))) != "below resolution"
    assert half_width(9.96e-4) == "0.0010"


@pytest.mark.parametrize(
    ("reported", "expected"),
    [
        ("begins at 45.77 +- 1.5 kPa", "begins at 45.77 ± 1.5 kPa"),
        ("K -0.025 to +0.03 %, known to +-7 %", "K −0.025 to +0.03 %, known to ±7 %"),
        ("B 1.5 N.s/mm, gain (-3 kPa.s/mm)", "B 1.5 N·s/mm, gain (−3 kPa·s/mm)"),
        ("run 2026-11-22 of R1-4, eq. 8.1", "run 2026-11-22 of R1-4, eq. 8.1"),
    ],
)
def test_sentences_have_the_signs_of_print(reported, expected):
    assert printed(reported) == expected
