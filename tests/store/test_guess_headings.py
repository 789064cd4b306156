"""What a heading says besides the name of its column: factors, units that nobody knows, clocks, absolute pressures.

The files are written here: a pressure that rises and falls in 20 s, a force of 1.2 N/kPa.
"""

import numpy as np
import pytest

from pmabench.base.errors import InvalidFile
from pmabench.files.document import Document
from pmabench.kinds.recorded_sine.reduction import reduce
from pmabench.store.importers.guess.columns import split_factor, value_of
from pmabench.store.importers.guess.write import map_text
from pmabench.store.importers.map_file import questions_of
from pmabench.store.reader import open_run
from tests.importing import guess_files, import_files

T = np.arange(0, 20, 0.01)
NOISE = np.random.default_rng(5).standard_normal((3, len(T)))
P = 500.0 * np.clip(T / 10, 0, 1) * np.clip((20 - T) / 10, 0, 1) + 0.2 * NOISE[0]
F = 1.2 * P + 5.0 + NOISE[1]
PLAIN = {"t [s]": T, "P [kPa]": P, "F [N]": F}


def file(folder, columns, below=()):
    """A CSV of columns by name, with a line below the names where one is given."""
    path = folder / "held_8mm_Test1.csv"
    rows = [",".join(f"{value:.10g}" for value in row) for row in zip(*columns.values(), strict=True)]
    head = [",".join(columns), *([",".join(below)] if below else [])]
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
    return path


def asked(path):
    """Key -> question of the guessed map of one file."""
    questions = questions_of(Document("map.yaml", map_text(guess_files([path]))))
    return {question.what: question for question in questions}


def imported(path, **answers):
    """Channels and times of the run that the guessed map makes, by the answers to its questions."""
    (path.parent / "map.yaml").write_text(map_text(guess_files([path])), encoding="utf-8")
    given = [(key, value) for key in asked(path) for part, value in answers.items() if key.endswith(part)]
    (run,) = import_files([path], path.parent / "map.yaml", path.parent / "runs", given)
    (trial,) = open_run(run.path).trials
    return trial


@pytest.mark.parametrize(
    ("name", "factor", "value"),
    [
        ("F x10 [N]", "x10", 10.0),
        ("F [N] x10", "x10", 10.0),
        ("F [N] (x10)", "x10", 10.0),
        ("F_x10_N", "x10", 10.0),
        ("F 10x [N]", "10x", 10.0),
        ("F*0.1 [N]", "*0.1", 0.1),
        ("F [N]*10^-1", "*10^-1", 0.1),
        ("F [N]·10⁻¹", "·10^-1", 0.1),
        ("F [N]/10", "/10", 0.1),
        ("F [N/10]", "/10", 0.1),
        ("F [10 N]", "10", 10.0),
        ("F [0.1 N]", "0.1", 0.1),
        ("F [1/10 N]", "1/10", 0.1),
        ("F in 10 N", "10", 10.0),
        ("F [1e3 mN]", "1e3", 1e3),
    ],
)
def test_a_factor_next_to_a_unit_is_asked_for(tmp_path, name, factor, value):
    path = file(tmp_path, {"t [s]": T, "P [kPa]": P, name: F / value * (1e3 if "mN" in name else 1.0)})
    found = asked(path)
    assert list(found) == [f"columns.{name}.line.slope"]
    question = found[f"columns.{name}.line.slope"]
    assert not question.used, "labs write it for what was and for what is to be done: nothing may be taken"
    unit = "mN" if "mN" in name else "N"
    assert f'has "{factor}" with its unit' in question.question
    assert f"({value:g} {unit}/{unit})" in question.question
    assert value_of(factor) == pytest.approx(value)


@pytest.mark.parametrize(
    "name",
    ["F [N]", "F2 [N]", "Cell (500 N) [N]", "Cell 500N [N]", "Force sensor 10 [N]", "Dev1/ai1 F [N]", "x10 F [N]"],
)
def test_numbers_of_sensors_and_axes_are_no_factors(tmp_path, name):
    assert asked(file(tmp_path, {"t [s]": T, "P [kPa]": P, name: F})) == {}
    for other in ("P [kg/cm2]", "x1 [mm]", "x10 [mm]", "a [m/s2]", "P [lbf/in²]", "data(:,10)", "P [N/mm^2]"):
        assert split_factor(other)[1] == ""


@pytest.mark.parametrize(("name", "slope"), [("F x10 [N]", "10 N/N"), ("F [kg]/10", "0.980665 N/kg")])
def test_the_answer_is_the_scale(tmp_path, name, slope):
    weight = 9.80665 if "kg" in name else 1.0
    path = file(tmp_path, {"t [s]": T, "P [kPa]": P, name: F / float(slope.split()[0])})
    assert slope in asked(path)[f"columns.{name}.line.slope"].question
    force = imported(path, slope=slope).channels["force"]
    assert force == pytest.approx(F, abs=1e-6 * weight)


def test_a_factor_in_a_line_of_units_or_of_a_command_is_asked_for(tmp_path):
    path = file(tmp_path, dict(zip("tPF", (T, P, F / 10), strict=True)), ("s", "kPa", "10 N"))
    assert list(asked(path)) == ["columns.F.line.slope"]
    path = file(tmp_path, {"t": 100 * T, "P": P, "F": F}, ("10 ms", "kPa", "N"))
    assert list(asked(path)) == ["columns.t.period"]
    columns = {"t [s]": T, "P [bar] x0.1": P / 10, "Pset [bar] x0.1": np.round(P / 10), "x [mm]/10": P}
    assert [key for key in asked(file(tmp_path, columns)) if "slope" in key] == [
        "columns.P [bar] x0.1.line.slope",
        "columns.Pset [bar] x0.1.line.slope",
        "columns.x [mm]/10.line.slope",
    ]


@pytest.mark.parametrize(
    ("name", "one"),
    [("t [10 ms]", "10 ms"), ("t [0.1 ms]", "0.1 ms"), ("t (100us)", "100 us"), ("t [1/10 s]", "0.1 s")],
)
def test_a_time_in_tens_of_a_unit_is_asked_for(tmp_path, name, one):
    seconds = float(one.split()[0]) * {"s": 1.0, "ms": 1e-3, "us": 1e-6}[one.split()[1]]
    path = file(tmp_path, {name: T / seconds, "P [kPa]": P, "F [N]": F})
    found = asked(path)
    assert list(found) == [f"columns.{name}.period"]
    assert f"As it is written {seconds:g} s" in found[f"columns.{name}.period"].question
    trial = imported(path, period=one)
    assert trial.t[-1] - trial.t[0] == pytest.approx(T[-1], rel=1e-9)


@pytest.mark.parametrize("name", ["ticks", "t [ticks]", "t [jiffies]", "clk"])
def test_a_time_whose_unit_nobody_knows_is_asked_for(tmp_path, name):
    question = asked(file(tmp_path, {name: 1e4 * T, "P [kPa]": P, "F [N]": F}))[f"columns.{name}.unit"]
    assert "10 samples a second" in question.question
    assert "period: 0.1 ms" in question.question
    assert asked(file(tmp_path, {"time": T, "P [kPa]": P, "F [N]": F})) == {}, "s by its steps"


def sine(t):
    """A contraction of 1 Hz, 0.5 rad behind its pressure [mm]."""
    return 20 + 4 * np.sin(2 * np.pi * t - 0.5)


def two_clocks(folder, later, begins=0.0):
    """A pressure and its time, a length and its own that much later [s]; its clock begins at `begins` [s]."""
    t = np.arange(0, 12, 0.01)
    noise = np.random.default_rng(7).standard_normal((2, len(t)))
    pressure = 250 + 46 * np.sin(2 * np.pi * t) + 0.3 * noise[0]
    length = sine(t + later) + 0.003 * noise[1]
    path = folder / "sine_1Hz.csv"
    columns = np.column_stack([t, pressure, 1e3 * (t + later + begins), length])
    np.savetxt(path, columns, fmt="%.5f", delimiter=",", header="t_P [s],P [kPa],t_x [ms],x [mm]", comments="")
    return path


def test_a_second_clock_that_is_later_in_each_row_is_a_question(tmp_path):
    """By the moments of the pressure the length is 0.126 rad too early; with the lateness of the question it is not."""
    path = two_clocks(tmp_path, 0.02)
    question = asked(path)["columns.t_P [s].is"]
    assert '"t_x [ms]" is 20 ms later than "t_P [s]" in each row' in question.question
    assert "the later one is the time" in question.question
    text = map_text(guess_files([path]))
    for old, new in (
        ('"t_P [s]": {is: "?? time", unit: s}', '"t_P [s]": ignore'),
        ('"t_x [ms]": ignore', '"t_x [ms]": {is: time, unit: ms}'),
        ("is: pressure\n", "is: pressure\n    late_by: [20 ms, 20 ms]\n"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    (run,) = import_files([path], tmp_path / "map.yaml", tmp_path / "runs")
    (phase,) = [e for e in reduce([open_run(run.path)]).estimates if e.symbol == "phi_x"]
    assert phase.value == pytest.approx(-0.5, abs=0.003)


@pytest.mark.parametrize(("later", "begins"), [(0.0, 0.0), (0.0004, 0.0), (0.0, 3600.0)])
def test_clocks_of_the_same_moments_and_of_other_zeros_are_no_question(tmp_path, later, begins):
    assert "columns.t_P [s].is" not in asked(two_clocks(tmp_path, later, begins))


def test_a_coarse_clock_is_no_later_clock(tmp_path):
    columns = {"t [s]": T, "time daq [s]": np.floor(10 * T) / 10, **dict(list(PLAIN.items())[1:])}
    assert asked(file(tmp_path, columns)) == {}


@pytest.mark.parametrize("name", ["Pabs [kPa]", "P_abs [kPa]", "Pressure abs [kPa]", "pAbs [kPa]"])
def test_an_absolute_pressure_that_never_vents_is_a_question(tmp_path, name):
    path = file(tmp_path, {"t [s]": T, name: P + 201.3, "F [N]": F})
    question = asked(path)[f"columns.{name}.line.offset"]
    assert question.used == "-101.325 kPa"
    assert "never falls below 201" in question.question
    path = file(tmp_path, {"t [s]": T, name: P + 101.325, "F [N]": F})
    assert asked(path) == {}, "vented, it reads the pressure of air"
    assert imported(path).channels["pressure"] == pytest.approx(1e3 * P, abs=1.0)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("0.{k};2 49{k};1 49{k}", '"2 490" seems to have its digits in groups'),
        ('"0.{k}","2,49{k}","{k}"', r'or digits in groups \("2,490"\): "P \[Pa\]" have the comma'),
    ],
)
def test_a_refusal_names_digits_in_groups(tmp_path, row, said):
    mark = ";" if ";" in row else ","
    path = tmp_path / "groups.csv"
    rows = "".join(row.replace("{k}", str(k)) + "\n" for k in range(10))
    path.write_text(mark.join(("t [s]", "P [Pa]", "x [V]")) + "\n" + rows, encoding="utf-8")
    with pytest.raises(InvalidFile, match=said):
        guess_files([path])
