"""A map is proposed for files never seen: right for the layouts that are known, and silent about what no file tells."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from pmabench.base.errors import InvalidFile
from pmabench.base.text import sparkline
from pmabench.cli.main import main
from pmabench.files.document import read_document
from pmabench.store.importers.guess.columns import unit_in
from pmabench.store.importers.guess.layout import guess_layout
from pmabench.store.importers.guess.write import map_text, still_open
from pmabench.store.importers.map_file import dotted, left_open
from pmabench.store.importers.motion import only_sine
from pmabench.store.reader import open_run
from tests.importing import guess_files, import_files, read_map
from tests.recorded import recorded_data

OLD = Path(__file__).resolve().parents[2] / "fixtures" / "old-runs"
POLLED = {
    "T_(ms)": ("time", "ms"),
    "Sys_Volts_(V)": ("ignore", "V"),
    "Comp_P_(mA)": ("supply", "mA"),
    "Piezo_P_(mA)": ("pressure", "mA"),
    "Piezo_out_(mV)": ("pressure_command", "mV"),
    "V_dist_(mA)": ("displacement", "mA"),
    "LC_(grams)": ("force", "g"),
}
ENDS = {
    "columns.Piezo_P_(mA).points.1.1": "12 bar",
    "columns.Piezo_out_(mV).points.1.1": "6 bar",
    "columns.V_dist_(mA).points.1.1": "101.6 mm",
}


def roles(guess):
    return {column.name: (column.role, column.unit) for column in guess.columns}


def asked(path):
    """Keys of the questions in a map."""
    return [dotted(location) for location in left_open(read_document(path).data, ())]


def imported(files, path, out):
    """Runs with what the map proposes for its questions, at a contraction of 0 mm where it has no proposal."""
    answers = [(key, "0 mm") for key in asked(path) if key == "trials.point.contraction"]
    return import_files(files, path, out, answers, unresolved=True)


def written(tmp_path, guess):
    path = tmp_path / "guessed.yaml"
    path.write_text(map_text(guess), encoding="utf-8")
    return path


@pytest.mark.parametrize("last", ["ignore", "{is: phase, marks: {fill: 1, exhaust: 2}, optional: true}"])
def test_what_each_column_of_files_without_names_is_must_be_answered(tmp_path, last):
    files = sorted((OLD / "isometric").glob("*.csv"))
    guess = guess_files(files)
    assert {role for role, _ in roles(guess).values()} == {"time", "ignore"}
    assert [column.name for column in guess.columns if "some files lack it: add optional: true" in column.question] == [
        "column 4"
    ]
    assert set(guess.names.forms) == {"10mm_13cm_Unkinked_Test{test}", "10mm_13cm_Kinked{contraction}mm_Test{test}"}
    path = written(tmp_path, guess)
    answers = {
        "kind": "isometric",
        "columns.column 1": "{is: force, unit: N}",
        "columns.column 2": "{is: pressure, unit: kPa}",
        "columns.column 4": last,
        "name_tells.otherwise.contraction": "0 mm",
    }
    assert set(asked(path)) == set(answers), "no header, and a name without a contraction"
    runs = [open_run(run.path) for run in import_files(files, path, tmp_path / "runs", list(answers.items()))]
    assert {run.trials[0].point["contraction"] for run in runs} == {0.0, 0.004}
    assert runs[0].trials[0].channels["pressure"].max() == pytest.approx(640e3, rel=0.01)
    path.write_text(path.read_text(encoding="utf-8").replace("# siblings:", "siblings:"), encoding="utf-8")
    assert read_map(path, list(answers.items())).file.siblings == {"force": 0.3, "pressure": 0.1}


def test_only_one_column_of_files_without_names_is_the_time(tmp_path):
    """The clock of a shorter file stands in another column than that of a longer one."""
    t = np.arange(100) * 0.01
    still, moving = np.ones(100), np.sin(7 * t)
    np.savetxt(tmp_path / "a.csv", np.column_stack([t, moving]), delimiter=",")
    np.savetxt(tmp_path / "b.csv", np.column_stack([still, moving, t]), delimiter=",")
    guess = guess_files([tmp_path / "a.csv", tmp_path / "b.csv"])
    assert [column.role for column in guess.columns] == ["time", "ignore", "ignore"]
    last = guess.columns[-1]
    assert (last.name, last.question) == (
        "column 3",
        '"time" is the time too: what is column 3? Write what it is, or ignore; some files lack it: add optional: true',
    )
    assert guess.layout.names == ["time", "column 2", "column 3"]


@pytest.mark.parametrize(
    ("pattern", "kind"),
    [("*step_exp", "recorded-step"), ("*frq*", "recorded-sine"), ("*characterization*", "recorded-pull")],
)
def test_files_of_currents_are_reported_by_their_header(tmp_path, pattern, kind):
    files = sorted((OLD / "polled").glob(f"{pattern}/*_data.dat"))
    guess = guess_files(files)
    assert roles(guess) == POLLED
    assert guess.kind == kind
    open_map = written(tmp_path, guess)
    with pytest.raises(InvalidFile) as caught:
        read_map(open_map)
    assert {problem.line for problem in caught.value.problems} <= set(still_open(open_map.read_text(encoding="utf-8")))
    rules = read_map(open_map, list(ENDS.items()))
    pressure, displacement = rules.column("pressure"), rules.column("displacement")
    assert pressure.slope * 12 + pressure.offset == pytest.approx(6e5)
    assert displacement.slope == pytest.approx(-0.1016 / 16)
    runs = import_files(files, open_map, tmp_path / "runs", list(ENDS.items()))
    assert all(run.trials for run in runs)
    assert open_run(runs[0].path).manifest["started_utc"].startswith("2026-01-05T10:")


@pytest.mark.parametrize("name", ["one.lvm", "comma.lvm", "segments.lvm", "bench.tdms"])
def test_formats_that_name_their_channels_and_units(tmp_path, name):
    guess = guess_files([OLD / "foreign" / name])
    reported = {role: unit for role, unit in roles(guess).values() if role != "ignore"}
    assert reported == {"time": "s", "pressure": "mA", "force": "N", "displacement": "mm", "pressure_command": "bar"}
    assert guess.kind == "recorded-step"
    path = written(tmp_path, guess)
    answers = [(key, "8 bar") for key in asked(path)]
    assert len(answers) == 1
    (run,) = import_files([OLD / "foreign" / name], path, tmp_path / "runs", answers)
    trials = open_run(run.path).trials
    assert [trial.commands[0].t for trial in trials] == pytest.approx([1.5, 3.5])
    assert run.flagged["dropout"] == 2


def test_a_mat_file_whose_columns_have_no_names_says_so():
    for name in ("log5.mat", "log73.mat"):
        guess = guess_files([OLD / "foreign" / name])
        assert roles(guess)["log.pressure_mA"] == ("pressure", "mA")
        assert roles(guess)["log.time_s"] == ("time", "s")
        assert roles(guess)["log.cmd_bar"] == ("pressure_command", "bar")
        (force,) = [column for column in guess.columns if column.name == "log.FX(:,1)"]
        assert force.role == "ignore"
        assert 'what is "log.FX(:,1)"? It has no name' in force.question


@pytest.mark.parametrize(
    ("content", "layout", "units"),
    [
        (
            "Zeit (s);Druck (bar);Kraft (N)\n0,0;1,5;2,5\n0,1;1,6;2,6\n",
            {"delimiter": "semicolon", "decimal": "comma"},
            "s bar N",
        ),
        ("# a log\n# t [ms], p [kPa], f [N]\n0,1.5,2\n10,1.6,3\n", {"comment": "#", "header": "none"}, "ms kPa N"),
        (
            "made by hand\n\ntime\tpressure\tforce\ns\tkPa\tlbf\n0.0\t1\t2\n0.1\t2\t3\n",
            {"skip_lines": 4, "header": "none"},
            "s kPa lbf",
        ),
        ("t_s p_psi F_N\n0 1.5 2\n0.1 1.6 n/a\n0.2 1.7 3\n", {"delimiter": "blank", "missing": ["n/a"]}, "s psi N"),
        ("t_s|p_MPa|note|x_mm\n0|1|good|2\n0.1|2|bad|2\n", {"delimiter": "bar"}, "s MPa mm"),
        ("a,b\nt_s,p_bar\n0,1\n0.5,2\n", {"skip_lines": 1, "header": "first line"}, "s bar"),
        (
            '"t_s";"p_bar";"F_N"\n"0.00";"1.23";"4.56"\n"0.10";"1.25";"4.60"\n',
            {"quoted": True, "delimiter": "semicolon", "decimal": "point", "header": "first line"},
            "s bar N",
        ),
        (
            '"t_s","p_bar","F_N"\n"0,00","1,23","4,56"\n"0,10","1,25","4,60"\n',
            {"quoted": True, "delimiter": "comma", "decimal": "comma"},
            "s bar N",
        ),
        ("t_s,p_bar,F_N\n0,1,2\n0.1,,\n0.2,,\n0.3,2,3\n", {"missing": [""]}, "s bar N"),
    ],
)
def test_layouts_of_text(tmp_path, content, layout, units):
    (tmp_path / "old.txt").write_text(content, encoding="utf-8")
    guess = guess_files([tmp_path / "old.txt"])
    for key, value in layout.items():
        assert getattr(guess.layout, key) == value, key
    assert [column.unit for column in guess.columns if column.unit] == units.split()
    path = written(tmp_path, guess)
    if guess.role("force") or guess.role("displacement"):
        assert imported([tmp_path / "old.txt"], path, tmp_path / "runs")


def test_numbers_in_quotation_marks_are_those_numbers(tmp_path):
    """The same numbers with point and comma, and what is not quoted among them."""
    files = {
        "point.csv": '"t_s";"p_bar";"F_N"\n"0.00";"1.23";"4.56"\n0.10;"1.25";"-4.60"\n"0.20";"1.5";"1e1"\n',
        "comma.csv": '"t_s","p_bar","F_N"\n"0,00","1,23","4,56"\n"0,10","1,25","-4,60"\n"0,20","1,5","1e1"\n',
    }
    for name, content in files.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
        path = tmp_path / f"{name}.yaml"
        path.write_text(map_text(guess_files([tmp_path / name])), encoding="utf-8")
        (run,) = imported([tmp_path / name], path, tmp_path / "runs")
        channels = open_run(run.path).trials[0].channels
        assert channels["pressure"] == pytest.approx([1.23e5, 1.25e5, 1.5e5])
        assert channels["force"] == pytest.approx([4.56, -4.6, 10.0])
    (tmp_path / "cut.csv").write_text(files["point.csv"][:-2], encoding="utf-8")
    with pytest.raises(InvalidFile, match="cut.csv:4:1  the line ends within quotation marks"):
        imported([tmp_path / "cut.csv"], tmp_path / "point.csv.yaml", tmp_path / "runs")


def test_columns_with_different_decimal_signs_are_refused(tmp_path):
    rows = "".join(f'"{0.1 * k:.2f}";"{1 + k},5";"{k}.25"\n' for k in range(9))
    (tmp_path / "mixed.csv").write_text('"t_s";"p_bar";"F_N"\n' + rows, encoding="utf-8")
    with pytest.raises(InvalidFile, match='two decimal signs in one file: "p_bar" have the comma'):
        guess_files([tmp_path / "mixed.csv"])


def matrix():
    """Steps of a command, a pressure with a lag behind it, force above a threshold, contraction [mm]."""
    t = np.arange(0, 20, 0.01)
    command = np.where(t < 2, 0.0, np.where(t < 8, 300.0, np.where(t < 14, 500.0, 100.0)))
    P = np.zeros_like(t)
    for k in range(1, len(t)):
        P[k] = P[k - 1] + 0.05 * (command[k] - P[k - 1])
    noise = np.random.default_rng(1).standard_normal((3, len(t)))
    P = P + 0.5 * noise[0] + 2.0
    force = np.maximum(0.0, 1.08 * (P - 50.0)) + noise[1]
    return np.column_stack([t, command, force, P, 0.05 * np.maximum(0.0, P - 80) + 0.01 * noise[2]])


@pytest.mark.parametrize("name", ["X", "data"])
def test_what_each_column_of_a_matrix_is_must_be_answered(tmp_path, name):
    """Which column is which no number shows: two of the same range could be exchanged."""
    from scipy.io import savemat

    savemat(tmp_path / "old.mat", {name: matrix()})
    guess = guess_files([tmp_path / "old.mat"])
    assert roles(guess) == {f"{name}(:,1)": ("time", "s")} | {f"{name}(:,{k})": ("ignore", "") for k in (2, 3, 4, 5)}
    path = written(tmp_path, guess)
    with pytest.raises(InvalidFile) as caught:
        import_files([tmp_path / "old.mat"], path, tmp_path / "runs")
    refused = str(caught.value)
    assert all(f'what is "{name}(:,{k})"? It has no name; its numbers: ' in refused for k in (2, 3, 4, 5))
    assert "which kind of test is it" in refused
    what = ("pressure_command, unit: kPa", "force, unit: N", "pressure, unit: kPa", "displacement, unit: mm")
    answers = [(f"columns.{name}(:,{k})", f"{{is: {role}}}") for k, role in zip((2, 3, 4, 5), what, strict=True)]
    answers += [("kind", "recorded-step"), ("trials", "{by: step, smallest: 20 kPa, lead: 1 s}")]
    (run,) = import_files([tmp_path / "old.mat"], path, tmp_path / "runs", answers)
    assert len(open_run(run.path).trials) == 3
    assert run.unresolved == ()


def test_a_matrix_without_a_pressure_is_not_made_into_one(tmp_path):
    from scipy.io import savemat

    rng = np.random.default_rng(1)
    savemat(tmp_path / "old.mat", {"X": np.column_stack([np.arange(500) * 0.01, rng.normal(-5e4, 1e3, (500, 2))])})
    guess = guess_files([tmp_path / "old.mat"])
    assert [column.role for column in guess.columns] == ["time", "ignore", "ignore"]
    assert any("no column was found that is a pressure" in doubt for doubt in guess.doubts)


def test_a_pressure_alone_is_said_to_give_no_result(tmp_path):
    t = np.arange(500) * 0.01
    (tmp_path / "fill.csv").write_text("t [s],P [kPa]\n" + "\n".join(f"{s:.2f},{600 * s / 5:.2f}" for s in t))
    assert any("a pressure alone gives no result" in doubt for doubt in guess_files([tmp_path / "fill.csv"]).doubts)


def test_what_the_guess_left_open_is_reported_where_it_is(tmp_path):
    files = sorted((OLD / "polled").glob("*step_exp/*.dat"))
    path = written(tmp_path, guess_files(files))
    with pytest.raises(InvalidFile, match="not answered: which pressure is 20 mA of") as caught:
        read_map(path)
    assert [problem.line for problem in caught.value.problems] == still_open(path.read_text(encoding="utf-8"))


def test_a_table_without_time_is_reported_what_it_is_good_for(tmp_path):
    (tmp_path / "chart.csv").write_text("P_bar,contraction,F_N\n2,0,100\n2,0.1,50\n3,0,200\n", encoding="utf-8")
    assert any("report --overlay" in doubt for doubt in guess_files([tmp_path / "chart.csv"]).doubts)


def test_other_encodings(tmp_path):
    text = "Zeit (s);Druck Öl (bar);Kraft (N)\n0,0;1,5;2,5\n0,1;1,6;2,6\n"
    for encoding in ("latin-1", "utf-16", "utf-8-sig"):
        assert guess_layout("old", text.encode(encoding)).names[1] == "Druck Öl (bar)"


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("T_(ms)", "ms"),
        ("LC_(grams)", "g"),
        ("Druck [bar]", "bar"),
        ("p_kPa", "kPa"),
        ("Force, N", "N"),
        ("x/mm", "mm"),
        ("P", ""),
        ("items", ""),
        ("Pressão ABS. (MPa)", "MPa"),
        ("Piezo_P_(mA)", "mA"),
        ("sensor_a", ""),
        ("pressureBar", "bar"),
        ("forceNewton", "N"),
        ("pressureMPa", "MPa"),
        ("valveIn", ""),
        ("forceMin", ""),
    ],
)
def test_units_in_names(name, unit):
    assert unit_in(name) == unit


def test_what_is_no_table_is_refused_in_a_sentence(tmp_path):
    prose = b"A LICENCE\nVersion 3, 29 June 2007\n" + b"and many more words without any number\n" * 9
    for content, reported in (
        (b"hello\nthere\n", "no rows of at least two numbers"),
        (b"\x00\x01\x02\x03", "is binary"),
        (prose, "is no table of numbers"),
    ):
        (tmp_path / "old").write_bytes(content)
        with pytest.raises(InvalidFile, match=reported):
            guess_files([tmp_path / "old"])
    (tmp_path / "old").write_text("t_s,p_bar\n0,1\n0.5,2\n", encoding="utf-8")
    with pytest.raises(InvalidFile, match="guess them apart"):
        guess_files([tmp_path / "old", OLD / "polled/2026-01-05_101500_step_exp/step_data.dat"])


def test_an_absolute_pressure_becomes_a_gauge_pressure(tmp_path):
    (tmp_path / "old.csv").write_text(
        "t (s),Pressure abs (MPa),F (N)\n0,0.101325,1\n0.1,0.601325,2\n", encoding="utf-8"
    )
    path = written(tmp_path, guess_files([tmp_path / "old.csv"]))
    (run,) = imported([tmp_path / "old.csv"], path, tmp_path / "runs")
    assert open_run(run.path).trials[0].channels["pressure"] == pytest.approx([0.0, 500e3], abs=1e-3)


def test_names_full_of_markup_stay_text_in_the_map(tmp_path):
    evil = 'p_bar": {is: force}\\n #<b>&\x1b[31m'
    header = ",".join(["t_s", evil, "F_N"])
    (tmp_path / "old.csv").write_text(header + "\n0,1,2\n0.1,2,3\n", encoding="utf-8")
    guess = guess_files([tmp_path / "old.csv"])
    text = map_text(guess)
    assert "\x1b" not in text
    reported = CliRunner().invoke(main, ["import", "--guess", str(tmp_path / "old.csv")]).output
    assert "\x1b" not in reported


def test_a_sine_is_distinguished_from_steps_and_noise():
    t = np.arange(0, 10, 0.01)
    assert only_sine(t, 3 + np.sin(2 * np.pi * 1.5 * t)) == pytest.approx(1.5, abs=0.06)
    assert only_sine(t, np.sign(np.sin(2 * np.pi * 0.5 * t))) == 0
    assert only_sine(t, np.random.default_rng(1).normal(size=len(t))) == 0


def test_the_picture_goes_from_low_to_high():
    assert sparkline([0, 1, 2, 3, 4, 5, 6, 7]) == "▁▂▃▄▅▆▇█"
    assert sparkline([1.0, float("nan"), 1.0]) == "▁ ▁"
    assert len(sparkline(list(range(1000)), 60)) == 60
    assert not sparkline([])


def call(*args, code=0):
    result = CliRunner().invoke(main, [str(arg) for arg in args], catch_exceptions=False)
    assert result.exit_code == code, result.output
    return result.output


def test_at_the_command_line(tmp_path):
    source = OLD / "foreign" / "one.lvm"
    reported = call("import", "--guess", source, "-o", tmp_path / "map.yaml")
    assert "because: the file says its unit, mA" in reported
    (key,) = asked(tmp_path / "map.yaml")
    answer = ("--set", f"{key}=8 bar")
    call("import", source, "--map", tmp_path / "map.yaml", "--out", tmp_path / "runs", *answer)
    assert len(list((tmp_path / "runs").iterdir())) == 1
    assert "is there already" in call("import", "--guess", source, "-o", tmp_path / "map.yaml", code=2)
    data = json.loads(call("import", "--guess", source, "--json"))
    assert data["open"]
    assert {column["is"] for column in data["columns"]} >= {"time", "pressure", "force"}
    assert "give --map to import, or --guess" in call("import", source, code=2)


def test_recorded_files_of_both_benches():
    folder = recorded_data()
    for path in sorted((folder / "aarl_10mm").rglob("*.csv")):
        first, second, time = guess_files([path]).columns
        assert (first.role, second.role, time.role, time.unit) == ("ignore", "ignore", "time", "s"), path
        assert all("It has no name" in column.question for column in (first, second)), path
    kinds = {"step": "recorded-step", "frq": "recorded-sine", "cha": "recorded-pull"}
    for path in sorted((folder / "mit_2-151").rglob("*_data.dat")):
        guess = guess_files([path])
        assert roles(guess) == POLLED, path
        assert guess.kind == kinds[next(key for key in kinds if path.name.startswith(key))]


def test_recorded_samples_of_other_formats():
    samples = recorded_data().parent / "reader_samples"
    reported = {
        path.name: roles(guess_files([path]))
        for path in samples.rglob("*.*")
        if path.suffix in {".lvm", ".tdms", ".mat"}
    }
    assert reported["short.lvm"] == {
        "X_Value": ("time", "s"),
        "Excitation (Trigger)": ("force", "N"),
        "Response (Trigger)": ("ignore", ""),
    }
    pressure = {
        name for name, (role, unit) in reported["with_comments.lvm"].items() if (role, unit) == ("pressure", "MPa")
    }
    assert len(pressure) == 1
    assert {role for role, _ in reported["no_decimal_separator.lvm"].values()} == {"time", "ignore"}
    assert reported["raw1.tdms"]["Layer Data/@time"] == ("time", "s")
    assert {unit for role, unit in reported["raw1.tdms"].values() if role == "ignore"} == {"V"}
    assert [role for role, _ in reported["Digital_Input.tdms"].values()].count("time") == 1
    assert reported["testfile6.mat"] == {"B": ("ignore", "")}
