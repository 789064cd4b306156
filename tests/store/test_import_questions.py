"""What changes results and what no file tells is a question with its candidates; open ones go along to the report."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from pmabench.base.errors import InvalidFile
from pmabench.cli.main import main
from pmabench.files.document import Document
from pmabench.kinds.registry import importable
from pmabench.store.importers.guess.columns import Proposal, choose, unit_in, words
from pmabench.store.importers.guess.write import map_text
from pmabench.store.importers.map_file import questions_of
from pmabench.store.importers.prepare import _moves, prepare
from tests.importing import guess_files, read_map

T = np.arange(0, 20, 0.01)
RISE = 500.0 * np.clip(T / 10, 0, 1) * np.clip((20 - T) / 10, 0, 1)
"""Pressure up and down [kPa]."""
NOISE = np.random.default_rng(3).standard_normal((3, len(T)))
P = RISE + 0.2 * NOISE[0]
F = 1.2 * P + 5.0 + NOISE[1]
"""A straight line from the first kPa on: no threshold changes its slope."""


def file(path, columns, digits=4):
    """A CSV of columns by name."""
    rows = zip(*(np.round(values, digits) for values in columns.values()), strict=True)
    lines = [",".join(f"{value:.10g}" for value in row) for row in rows]
    path.write_text("\n".join([",".join(columns), *lines]) + "\n", encoding="utf-8")
    return path


def asked(path):
    """Key -> question of the guessed map of one file."""
    questions = questions_of(Document("map.yaml", map_text(guess_files([path]))))
    return {question.what: question for question in questions}


def findings(path):
    """Kinds and levels of what an import of one file by its guessed map finds."""
    (path.parent / "map.yaml").write_text(map_text(guess_files([path])), encoding="utf-8")
    prepared = prepare(path, read_map(path.parent / "map.yaml", unresolved=True))
    return {each.kind: each for each in prepared.findings}, prepared


def call(*args, code=0):
    result = CliRunner().invoke(main, [str(arg) for arg in args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result.output


def test_a_file_that_shows_everything_is_asked_nothing(tmp_path):
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P [kPa]": P, "F [N]": F})
    assert asked(path) == {}


@pytest.mark.parametrize(
    ("scale", "used", "candidates"),
    [(0.01, "bar", "bar: at most 498 kPa"), (0.145, "kPa", "kPa: at most 72.1 kPa; psi: at most 497 kPa")],
)
def test_a_pressure_whose_unit_is_not_given_is_asked_for(tmp_path, scale, used, candidates):
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P": scale * P, "F [N]": F})
    found = asked(path)
    assert list(found) == ["columns.P.unit"]
    assert found["columns.P.unit"].used == used
    assert candidates in found["columns.P.unit"].question


@pytest.mark.parametrize(
    ("name", "scale", "unit"), [("P [kPa]", 0.01, "bar"), ("P [MPa]", 0.01, ""), ("P [bar]", 1.0, "")]
)
def test_a_pressure_whose_unit_cannot_be_withholds(tmp_path, name, scale, unit):
    found, _ = findings(file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, name: scale * P, "F [N]": F}))
    assert found["magnitude"].withholds
    assert f"is it {unit}?" in found["magnitude"].text or not unit


def test_whole_numbers_without_a_unit_are_never_newtons(tmp_path):
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P [kPa]": P, "load cell": F}, digits=4)
    assert asked(path)["columns.load cell.unit"].used == "N"
    path = file(tmp_path / "held_9mm_Test1.csv", {"t [s]": T, "P [kPa]": P, "load cell": np.round(F)})
    found = asked(path)
    assert [(key, found[key].used) for key in found] == [
        ("columns.load cell.line.slope", ""),
        ("columns.load cell.line.offset", ""),
    ]
    assert "which line makes a force of it" in found["columns.load cell.line.slope"].question


@pytest.mark.parametrize(
    ("label", "scale", "candidate"), [("kPa", 0.145038, "in psi (499 kPa)"), ("bar", 1e-3, "in MPa (499 kPa)")]
)
def test_a_low_pressure_with_the_force_of_a_high_one_is_a_question_of_the_import(tmp_path, label, scale, candidate):
    """2.3 N/kPa is a muscle of 20 mm; read in a unit too small by 6.9 or 10 it would be one of 50 mm and more."""
    columns = {"t [s]": T, f"P [{label}]": scale * P, "F [N]": 2.3 * P + 5 + NOISE[1]}
    _, prepared = findings(file(tmp_path / "held_8mm_Test1.csv", columns, digits=6))
    (question,) = prepared.questions
    assert question.what == "pressure-unit"
    assert candidate in question.question


@pytest.mark.parametrize("force", [np.round(1.46 * F + 210), np.round(F)])
def test_whole_newtons_are_a_question_of_the_import(tmp_path, force):
    """Counts, or a display of whole newtons."""
    _, prepared = findings(file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P [kPa]": P, "F [N]": force}))
    assert [question.what for question in prepared.questions] == ["counts"]


@pytest.mark.parametrize("driven", [False, True])
def test_a_force_whose_cell_reads_pulling_as_negative_withholds_with_the_line_to_write(tmp_path, driven):
    columns = {"t [s]": T, "P [kPa]": P, "F [N]": -F}
    if driven:
        x = 5.0 - 5.0 * np.cos(2 * np.pi * 0.5 * T)
        columns = {"t [s]": T, "P [kPa]": 300 + 0.2 * NOISE[0], "x [mm]": x, "F [N]": 20 * x - 500 + NOISE[1]}
    found, _ = findings(file(tmp_path / "held_8mm_Test1.csv", columns))
    assert found["magnitude"].withholds
    assert "say line: {slope: -1 N/N, offset: 0 N}" in found["magnitude"].text


def test_a_unit_of_time_that_no_test_has_is_asked_for(tmp_path):
    path = file(tmp_path / "held_8mm_Test1.csv", {"time (ms)": T, "P [kPa]": P, "F [N]": F})
    question = asked(path)["columns.time (ms).unit"]
    assert question.used == "ms"
    assert "1e+05 samples a second, 0.02 s in all" in question.question
    assert "s: 100 samples a second, 20 s" in question.question
    path = file(tmp_path / "held_9mm_Test1.csv", {"time (s)": 1e3 * T, "P [kPa]": P, "F [N]": F})
    assert "ms: 100 samples a second" in asked(path)["columns.time (s).unit"].question
    assert asked(file(tmp_path / "held_7mm_Test1.csv", {"time (s)": 100 * T, "P [kPa]": P, "F [N]": F})) == {}


def test_minutes_without_a_unit_are_asked_for(tmp_path):
    """20 s at 100 samples a second, in minutes, were taken for 0.33 s at 6000; such a rate nobody sets."""
    for rate in (50.0, 100.0, 200.0):
        t = np.arange(len(T)) / rate
        path = file(tmp_path / "held_8mm_Test1.csv", {"time": t / 60.0, "P [kPa]": P, "F [N]": F}, 9)
        question = asked(path)["columns.time.unit"]
        assert question.used == "s"
        assert f"min: {rate:g} samples a second" in question.question
        assert asked(file(path, {"time": t, "P [kPa]": P, "F [N]": F})) == {}


def test_sentinels_make_no_ramps(tmp_path):
    wrong = P.copy()
    wrong[::50] = -999.25
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P [kPa]": wrong, "F [N]": F})
    assert guess_files([path]).trials == {"by": "file"}


def test_wrong_samples_do_not_move_what_is_asked(tmp_path):
    wrong = F.copy()
    wrong[::50] = 99999.0
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P [kPa]": P, "F [N]": wrong})
    assert asked(path) == {}, "the checks of the import find them"


def test_an_absolute_pressure_that_does_not_say_so_is_asked_for(tmp_path):
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P [kPa]": P + 101.3, "F [N]": F})
    found = asked(path)
    assert list(found) == ["columns.P [kPa].line.offset"]
    assert found["columns.P [kPa].line.offset"].used == "-101.325 kPa"


@pytest.mark.parametrize(
    ("names", "point"),
    [
        (("iso_8p5kg", "iso_12p5kg"), {"mass": (8.5, 12.5)}),  # both were 5 kg
        (("load_80N_t1", "load_120N_t1"), {"load": (80.0, 120.0)}),  # nothing was read: repeats of one test
        (("step_8000g", "step_12000g"), {"mass": (8.0, 12.0)}),
        (("iso_-8mm", "iso_-4mm"), {"contraction": (-8e-3, -4e-3)}),  # the sign was lost
        (("iso_stretch8mm", "iso_stretch4mm"), {"contraction": (8e-3, 4e-3)}),
        (("len242mm", "len250mm"), {"contraction": (0.242, 0.25)}),
        (("iso_7p5mm", "iso_0p5mm"), {"contraction": (7.5e-3, 0.5e-3)}),
    ],
)
def test_numbers_in_names_that_may_be_others_are_asked_for(tmp_path, names, point):
    files = [file(tmp_path / f"{name}.csv", {"t [s]": T, "P [kPa]": P, "F [N]": F}) for name in names]
    ((key, values),) = point.items()
    text = map_text(guess_files(files))
    assert f"name_tells.units.{key}" in {each.what for each in questions_of(Document("map.yaml", text))}
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    answers = [("trials.point.contraction", "1 mm")] if key != "contraction" else []
    rules = read_map(tmp_path / "map.yaml", answers, unresolved=True)
    assert [prepare(path, rules).named.point[key] for path in files] == pytest.approx(values)


@pytest.mark.parametrize(
    "names", [("iso_8mm_500N", "iso_4mm_500N"), ("gap3mm_8mm_2g", "gap3mm_4mm_2g"), ("x8mm", "x4mm")]
)
def test_usual_names_are_not(tmp_path, names):
    files = [file(tmp_path / f"{name}.csv", {"t [s]": T, "P [kPa]": P, "F [N]": F}) for name in names]
    guess = guess_files(files)
    assert not [each for each in questions_of(Document("map.yaml", map_text(guess))) if "name" in each.what]
    assert set(guess.names.units) == {"contraction"}


def test_the_contraction_that_no_name_shows_is_asked_for(tmp_path):
    path = file(tmp_path / "monday.csv", {"t [s]": T, "P [kPa]": P, "F [N]": F})
    assert [(key, question.used) for key, question in asked(path).items()] == [("trials.point.contraction", "")]
    path = file(tmp_path / "Festo-10mm_Test1.csv", {"t [s]": T, "P [kPa]": P, "F [N]": F})
    assert list(asked(path)) == ["trials.point.contraction"], "the 10 mm may be its diameter"


@pytest.mark.parametrize(
    ("name", "reported", "used"),
    [("contraction [mm]", True, ""), ("x [mm]", False, "8 mm"), ("muscle length [mm]", False, "")],
)
def test_a_constant_length_is_no_step_test(tmp_path, name, reported, used):
    still = 8.0 + 0.004 * NOISE[2]
    path = file(tmp_path / "monday.csv", {"t [s]": T, "P [kPa]": P, "F [N]": F, name: still})
    guess = guess_files([path])
    assert guess.kind == "isometric"
    found = asked(path)
    if reported:
        assert found == {}
        assert "point: {contraction: 8 mm}" in map_text(guess)
    else:
        assert found["trials.point.contraction"].used == used


def test_a_threshold_that_moves_the_slope_is_asked_for_with_what_each_does(tmp_path):
    slack = np.maximum(0.0, 1.2 * (P - 150.0)) + NOISE[1]
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P [kPa]": P, "F [N]": slack})
    question = asked(path)["analysis.force_above"]
    assert question.used in {"19 N", "20 N", "21 N"}, "a twentieth of 420 N, the noise aside"
    assert "the slope moves by" in question.question


def test_a_threshold_of_a_force_in_kg_is_asked_for_in_newtons(tmp_path):
    slack = np.maximum(0.0, 1.2 * (P - 150.0)) + NOISE[1]
    for unit, newtons in (("kg", 9.80665), ("g", 9.80665e-3)):
        path = file(tmp_path / f"held_8mm_{unit}.csv", {"t [s]": T, "P [kPa]": P, f"F [{unit}]": slack / newtons})
        assert asked(path)["analysis.force_above"].used in {"19 N", "20 N", "21 N"}


def test_the_frequency_of_a_sine_is_fitted_where_no_name_shows_it(tmp_path):
    command = 300.0 + 100.0 * np.sin(2 * np.pi * 0.73 * T)
    late = 300.0 + 90.0 * np.sin(2 * np.pi * 0.73 * T - 0.3) + 0.2 * NOISE[0]
    x = 10.0 + 3.0 * np.sin(2 * np.pi * 0.73 * T - 0.5) + 0.002 * NOISE[2]
    path = file(tmp_path / "wave.csv", {"t [s]": T, "P [kPa]": late, "Pset [kPa]": command, "x [mm]": x})
    guess = guess_files([path])
    assert {column.name: column.role for column in guess.columns}["Pset [kPa]"] == "pressure_command"
    assert guess.kind == "recorded-sine"
    assert guess.trials["by"] == "sine"
    assert asked(path) == {}
    (tmp_path / "map.yaml").write_text(map_text(guess), encoding="utf-8")
    call("import", path, "--map", tmp_path / "map.yaml", "--out", tmp_path / "runs")
    (run,) = (tmp_path / "runs").iterdir()
    reported = json.loads(call("runs", "show", run, "--json"))
    assert [trial["point"]["frequency"] for trial in reported["trials"]] == [pytest.approx(0.73, rel=2e-3)]


@pytest.mark.parametrize(
    ("role", "names"),
    [
        ("displacement_command", "Sollweg, Sollweg [mm], Sollweg/mm, Soll-Weg, SOLLWEG, s_soll, x_soll, Wegsollwert, Weg Sollwert (mm), targetpos"),
        ("pressure_command", "Solldruck, Solldruck [bar], Soll-Druck, p_soll, pSoll, Drucksollwert, Druckvorgabe, pressureset"),
        ("displacement", "Istweg, Istweg [mm], Ist-Weg, s_ist, Wegistwert, Kolbenweg, Länge [mm], Verkürzung [mm]"),
        ("pressure", "Istdruck, p_ist, Druckistwert, Muskeldruck, Drucksensor, Betriebsdruck [bar]"),
        ("force", "Kraft, Istkraft, Zugkraft [N], Kraftmessdose, Druckkraft"),
        ("supply", "Versorgungsdruck [bar], Speisedruck, Vordruck [bar]"),
        ("trial", "Versuch, Versuch Nr., Versuchsnummer, Versuchs-Nr, Trial, test no"),
        ("ignore", "Sollkraft [N], Umgebungsdruck [mbar], Raumtemperatur, Temperatursensor, timeout"),
    ],
)  # fmt: skip
def test_words_in_one_say_what_each_of_them_does(role, names):
    t = np.arange(0, 10, 0.01)
    for name in names.split(", "):
        column = Proposal(name, 1 + np.floor(t / 3), unit=unit_in(name))
        choose([Proposal("t [s]", t, unit="s"), column])
        assert column.role == role, name


def test_a_trial_of_number_0_is_doubted_since_0_means_none():
    t = np.arange(0, 10, 0.01)
    column = Proposal("Versuch", np.floor(t / 3))
    choose([Proposal("t [s]", t, unit="s"), column])
    assert column.role == "trial"
    assert "number the trials from 1" in column.doubts[0]


@pytest.mark.parametrize("name", ["Pset [kPa]", "Psoll [bar]", "p_cmd", "SetPressure", "P des", "pRef"])
def test_a_commanded_pressure_is_known_by_its_name(name):
    assert {"set", "soll", "cmd", "des", "ref"} & words(name)


def test_two_clocks_that_disagree_are_a_question(tmp_path):
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P [kPa]": P, "F [N]": F, "time daq [s]": 1.1 * T})
    question = asked(path)["columns.t [s].is"]
    assert question.used == "time"
    assert '"t [s]" lasts 19.99 s, "time daq [s]" 21.99 s' in question.question
    path = file(tmp_path / "held_7mm_Test1.csv", {"t [s]": T, "P [kPa]": P, "F [N]": F, "time daq [s]": T + 0.04})
    assert "is 40 ms later than" in asked(path)["columns.t [s].is"].question
    path = file(tmp_path / "held_9mm_Test1.csv", {"t [s]": T, "P [kPa]": P, "F [N]": F, "time daq [ms]": 1e3 * T})
    assert asked(path) == {}


def test_a_time_that_counts_samples_is_a_question(tmp_path):
    path = file(tmp_path / "held_8mm_Test1.csv", {"t": np.arange(len(T)), "P [kPa]": P, "F [N]": F})
    question = asked(path)["columns.t.unit"]
    assert question.used == "ms"
    assert "is it a time, or does it count the samples" in question.question
    path = file(tmp_path / "held_9mm_Test1.csv", {"Sample": np.arange(len(T)), "P [kPa]": P, "F [N]": F})
    assert "counts the samples: how far apart are they?" in asked(path)["columns.Sample.period"].question


@pytest.mark.parametrize(("left", "role"), [("P [kPa]", "force"), ("F [N]", "pressure")])
def test_a_channel_that_no_name_gives_is_the_one_question(tmp_path, left, role):
    columns = {"t [s]": T, "ch0": NOISE[2], left: P, "ch1": 0.1 * RISE}
    (tmp_path / "monday.csv").unlink(missing_ok=True)
    found = asked(file(tmp_path / "monday.csv", columns))
    assert list(found) == ["columns.ch0"]
    assert found["columns.ch0"].question.startswith(
        f'which column is the {role}? No name says it; there is "ch0", "ch1"'
    )


def test_a_command_is_not_taken_for_the_measured_pressure(tmp_path):
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "Pset [kPa]": np.round(P, -2), "F [N]": F})
    found = asked(path)
    assert [(key, found[key].used) for key in found] == [("columns.Pset [kPa].is", "pressure_command")]
    assert 'is "Pset [kPa]" it (pressure), or pressure_command' in found["columns.Pset [kPa].is"].question


def test_a_frequency_in_the_name_that_the_command_contradicts_is_not_believed(tmp_path):
    columns = {"t [s]": T, "P [kPa]": P, "Pset [kPa]": 300 + 100 * np.sin(2 * np.pi * 1.3 * T)}
    columns["x [mm]"] = 10 + 3 * np.sin(2 * np.pi * 1.3 * T - 0.5)
    assert guess_files([file(tmp_path / "wave_5Hz.csv", columns)]).trials["by"] == "sine"
    assert guess_files([file(tmp_path / "wave_1.3Hz.csv", columns)]).trials["by"] == "file"


def test_digits_that_may_be_grouped_are_a_question(tmp_path):
    rows = zip(*(np.round(values, 3) for values in (T + 1, P + 2, F)), strict=True)
    lines = [";".join(f"{value:.3f}".replace(".", ",") for value in row) for row in rows]
    (tmp_path / "held_8mm_Test1.csv").write_text("\n".join(["t [s];P [kPa];F [N]", *lines]) + "\n")
    question = asked(tmp_path / "held_8mm_Test1.csv")["file.decimal"]
    assert question.used == "comma"
    assert 'is "1,000" a number with decimals, or are its digits grouped?' in question.question


def test_a_file_without_a_time_is_asked_for_its_period(tmp_path):
    path = file(tmp_path / "held_8mm_Test1.csv", {"P [kPa]": P, "F [N]": F})
    assert list(asked(path)) == ["file.period"]


def test_open_questions_are_refused_answered_or_go_along(tmp_path):
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P": P, "F [N]": F})
    reported = call("import", "--guess", path, "-o", tmp_path / "map.yaml")
    assert "1 question that no file answers" in reported
    assert "[until then: kPa]" in reported
    words = ["import", path, "--map", tmp_path / "map.yaml", "--out"]
    refused = call(*words, tmp_path / "none", code=3)
    assert 'in which unit is "P"? The file does not say it. Read in kPa: at most 498 kPa' in refused
    assert "--set 'columns.P.unit=...'" in refused
    assert not (tmp_path / "none").exists()
    reported = call(*words, tmp_path / "typo", "--set", "columns.Q.unit=bar", code=3)
    assert 'there is no "Q"' in reported
    reported = call(*words, tmp_path / "typo", "--set", "columns.P.unt=bar", "--unresolved", code=3)
    assert 'unknown key "unt"; did you mean "unit"?' in reported
    call(*words, tmp_path / "kPa", "--set", "columns.P.unit=kPa", "--set", "specimen.nominal_length=130 mm")
    (run,) = (tmp_path / "kPa").iterdir()
    specimen = json.loads((run / "manifest.json").read_text())["specimen"]
    assert specimen["nominal_length"] == 0.13, "a key that is no question can be set, too"
    data = json.loads(call("process", run, "--json"))
    slope = next(e for e in data["analyses"][0]["estimates"] if e["symbol"] == "m")
    assert slope["value"] == pytest.approx(1.2e-3, rel=0.01)
    assert json.loads((run / "manifest.json").read_text())["imported"]["unresolved"] == []
    open_ended = call(*words, tmp_path / "open", "--unresolved")
    assert "not answered: columns.P.unit:" in open_ended
    (run,) = (tmp_path / "open").iterdir()
    (entry,) = json.loads((run / "manifest.json").read_text())["imported"]["unresolved"]
    assert (entry["what"], entry["used"]) == ("columns.P.unit", "kPa")
    assert "not answered columns.P.unit:" in call("runs", "show", run)
    reported = call("process", run, code=6)
    assert "not accepted: isometric: not answered:" in " ".join(reported.split())
    page = tmp_path / "page.html"
    call("report", run, "-o", page)
    front = page.read_text(encoding="utf-8").split("<nav")[0]
    assert "not answered" in front
    assert "kPa: at most 498 kPa" in front


def test_a_source_that_was_changed_afterwards_is_reported(tmp_path):
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P [kPa]": P, "F [N]": F})
    call("import", "--guess", path, "-o", tmp_path / "map.yaml")
    call("import", path, "--map", tmp_path / "map.yaml", "--out", tmp_path / "runs")
    (run,) = (tmp_path / "runs").iterdir()
    source = run / "source" / path.name
    source.chmod(0o644)
    source.write_text(source.read_text(encoding="utf-8").replace("F [N]", "F [lbf]"), encoding="utf-8")
    reported = call("process", run, code=6)
    assert f"source/{path.name} was changed: its sha256 does not fit" in reported


def test_questions_of_maps_that_people_wrote(tmp_path):
    text = "schema: pmabench.map/1\nname: a\nsource: b\nkind: '?? isometric'\nfile: {format: lvm}\ncolumns: {}\n"
    (tmp_path / "map.yaml").write_text(text + "sampling: {rate: ['??', 9 Hz], gap: 1 s}\n", encoding="utf-8")
    with pytest.raises(InvalidFile) as caught:
        read_map(tmp_path / "map.yaml", unresolved=True)
    (problem,) = caught.value.problems
    assert (problem.line, problem.message.split(";")[0]) == (7, "not answered: no file gives it")
    assert Path(problem.path).name == "map.yaml"


def test_a_guess_prints_each_question_once_and_the_map_only_where_it_is_asked_for(tmp_path):
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P": P, "F [N]": F})
    brief = call("import", "--guess", path)
    assert (brief.count("in which unit is"), "schema: pmabench.map/1" in brief) == (1, False)
    assert "  columns.P.unit: " in brief
    assert "schema: pmabench.map/1" in call("import", "--guess", path, "-v")


def test_a_file_without_a_pressure_is_no_test_of_a_muscle(tmp_path):
    path = file(tmp_path / "line.csv", {"t [s]": T, "F [N]": F})
    assert "no pressure was found, and without one this is no test of a muscle" in call("import", "--guess", path)


@pytest.mark.parametrize("begin", [b"PK\x03\x04", b"\xd0\xcf\x11\xe0"])
def test_a_workbook_is_refused_with_the_way_on(tmp_path, begin):
    (tmp_path / "old.xlsx").write_bytes(begin + bytes(200))
    assert "Excel workbook, or another archive: save the sheet as CSV" in call(
        "import", "--guess", tmp_path / "old.xlsx", code=3
    )


@pytest.mark.parametrize(("swap", "period", "late", "expected"), [
    (False, 0.0, 15, False), (True, 0.0, 15, True), (False, 0.2, 15, False),
])  # fmt: skip
def test_a_pressure_before_its_command_is_doubted(tmp_path, swap, period, late, expected):
    """Command and measured pressure that were exchanged were imported without a word; a fast sine shows no order."""
    t = 0.01 * np.arange(4000)
    command = 100.0 * np.floor(t / 4) if not period else 200 + 100 * np.sin(2 * np.pi * t / period)
    reached, rng = np.full(len(t), command[0]), np.random.default_rng(2)
    for i in range(1, len(t)):
        reached[i] = reached[i - 1] + (command[max(0, i - late)] - reached[i - 1]) / 12.0
    reached += rng.normal(0, 0.2, len(t))
    x = 0.02 * np.concatenate([np.zeros(10), reached[:-10]])
    one, two = ("P_act [kPa]", "P_set [kPa]")[:: -1 if swap else 1]
    path = file(tmp_path / "a.csv", {"t [s]": t, one: reached, two: command, "x [mm]": x})
    found, _ = findings(path)
    assert ("led" in found) == expected
    assert not expected or "exchanged" in found["led"].text


@pytest.mark.parametrize("every", [3, 20])
def test_a_channel_with_blanks_is_one_of_numbers(tmp_path, every):
    """A force that was written in every third row or less was "words, not numbers", and dropped without a question."""
    path = file(tmp_path / "held_8mm_Test1.csv", {"t [s]": T, "P [kPa]": P, "F [N]": F})
    head, *lines = path.read_text().splitlines()
    blank = [line if k % every == 0 else f"{line.rpartition(',')[0]}," for k, line in enumerate(lines)]
    path.write_text("\n".join([head, *blank]) + "\n")
    found, prepared = findings(path)
    force = next(channel.si for channel in prepared.checked if channel.rule.role == "force")
    assert force[::every] == pytest.approx(F[::every], abs=1e-3)
    assert found["missing"].level == "doubt"
    path.write_text(
        "\n".join([f"{head},note", *(f"{line},{'valve on' if k == 9 else ''}" for k, line in enumerate(lines))])
    )
    assert [column.reasons[0] for column in guess_files([path]).columns][-1] == "holds words, not numbers"


@pytest.mark.parametrize(("kind", "moves"), [("recorded-pull", True), ("sinusoidal-displacement", True), ("recorded-step", True), ("isometric-pressurisation", False), ("isometric", False)])  # fmt: skip
def test_a_length_that_hardly_moves_has_another_unit_but_where_it_is_held(kind, moves):
    """Metres called mm: 3 N/mm would be 3000 times too much; at full length an isometric test does not move at all."""
    assert _moves(importable()[kind]) is moves
