"""`pmabench model cascade`: files with all problems at once, pacing, results, drawings that need nothing else, replay."""

import csv
import doctest
import io
import json
import re
import shlex
import xml.etree.ElementTree as ET
from functools import partial
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from pmabench.base.clock import VirtualClock
from pmabench.base.errors import InvalidFile
from pmabench.cli.cascade import paced, show_pace
from pmabench.cli.common import Ui
from pmabench.model import cascade
from pmabench.model.cascade import PrintedMuscle, Step, simulate
from pmabench.model.muscle import quadratic
from pmabench.protocol.cascade import read_cascade
from pmabench.report.cascade_page import Scene, frame_rows, moments_of, snapshots
from pmabench.report.cascade_record import Result, read_result
from tests import calls

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "fixtures" / "cascades"


call = partial(calls.call, "model", "cascade")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("cascade") / "unlike"
    call("simulate", "unlike", "--out", made, "-q")
    return made


# -- files -----------------------------------------------------------------------------------------------------------

HEAD = """schema: pmabench.cascade/1
name: test
fce_eval: x0
sample_rate: 100 Hz
duration: 5 s
muscles:
"""
MUSCLE = "  - model: dmsp-40-305\n    pressure: [{at: 0 s, to: 6 bar}]\n"


def problems(tmp_path, text):
    path = tmp_path / "chain.yaml"
    path.write_text(text)
    with pytest.raises(InvalidFile) as refused:
        read_cascade(path)
    return [(p.line, p.column, p.message) for p in refused.value.problems]


def test_every_problem_comes_at_once_with_its_place(tmp_path):
    found = problems(
        tmp_path,
        HEAD.replace("duration: 5 s", "duration: 0 s")
        + "  - model: dmsp-40-305\n    pressure:\n      - {at: 0 s, to: 0.5 bar}\n      - {at: 0 s, to: 7 bar}\n"
        + "  - plant: paper1\n    preset: ideal\n    pressure: [{at: 1 s, to: 700 kPa}]\n"
        + "  - model: dmsp-40-305\n    plant: paper0\n    stagger: 1 s\n    pressure: [{at: 0 s, to: 6 bar}]\n",
    )
    reported = [(line, message) for line, _, message in found]

    def at(line, part):
        return any(where == line and part in message for where, message in reported)

    assert at(5, "above zero")
    assert at(9, "neither 0 nor 100 kPa to 600 kPa")
    assert at(10, "later than the step before")
    assert at(10, "700 kPa")
    assert at(11, 'did you mean "paper0"')
    assert at(14, "one of both")
    assert at(16, '"count" is 1')
    assert (10, 14) in {(line, column) for line, column, _ in found}


@pytest.mark.parametrize(
    ("text", "line", "part"),
    [
        (HEAD.replace("fce_eval: x0\n", "") + MUSCLE, 1, '"fce_eval" is missing'),
        (HEAD + "  - plant: paper0\n    pressure: [{at: 0 s, to: 6 bar}]\n", 3, "no muscle here is a dmsp-40-305"),
        (HEAD + MUSCLE + "    delay: 6 s\n", 8, "comes at 6 s, and the simulation ends at 5 s"),
        (HEAD + MUSCLE + "    count: 50\n    stagger: 0.2 s\n", 8, "the last of them comes at 9.8 s"),
        (HEAD + MUSCLE + "    delya: 1 s\n", 9, 'unknown key "delya"; did you mean "delay"'),
        (HEAD + MUSCLE.replace("6 bar", "6"), 8, "needs a unit"),
        (HEAD + (MUSCLE + "    name: a\n") * 2, 12, 'a second muscle is called "a"'),
        (HEAD + MUSCLE + '    name: "=cmd"\n', 9, "a name begins with a letter or digit"),
        (HEAD + MUSCLE + "    count: 101\n", 9, "100"),
        (HEAD.replace("100 Hz", "20 kHz") + MUSCLE, 4, "1 Hz to 10 kHz"),
        (HEAD.replace("100 Hz", "1 Hz") + MUSCLE, 4, "makes 5 samples; at least 10"),
        (HEAD.replace("muscles:", "load: -1 N\nmuscles:") + MUSCLE, 6, "no load"),
        (HEAD.replace("cascade/1", "bench/1") + MUSCLE, 1, "is a bench file"),
    ],
)
def test_what_cannot_be_is_reported_with_its_place(tmp_path, text, line, part):
    found = problems(tmp_path, text)
    assert any(where == line and part in message for where, _, message in found), found


def test_a_missing_file_and_exit_code_3():
    assert "did you mean" in call("simulate", "paper2", code=3).stderr


def test_a_plant_file_of_ones_own_is_a_muscle_and_its_problems_are_reported_too(tmp_path):
    own = (ROOT / "fixtures" / "plants" / "paper0.yaml").read_text()
    (tmp_path / "mine.yaml").write_text(own)
    chain = HEAD.replace("fce_eval: x0\n", "") + "  - plant: {}\n    pressure: [{{at: 0 s, to: {}}}]\n"
    for name, plant in (("mine", "mine.yaml"), ("shipped", "paper0")):
        (tmp_path / f"chain-{name}.yaml").write_text(chain.format(plant, "4 bar"))
    found = [json.loads(call("simulate", tmp_path / f"chain-{n}.yaml", "--json").stdout) for n in ("mine", "shipped")]
    np.testing.assert_allclose(found[0]["displacement"], found[1]["displacement"], atol=1e-9)
    assert found[0]["displacement"][-1] == pytest.approx(383 / 7.552e3, rel=1e-3)  # F_ce and K at 4 bar by hand
    assert any("for which" in message for _, _, message in problems(tmp_path, chain.format("mine.yaml", "9 bar")))
    assert any("no plant file" in message for _, _, message in problems(tmp_path, chain.format("no.yaml", "4 bar")))
    (tmp_path / "mine.yaml").write_text(own.replace("length:", "lenght:"))
    assert any("lenght" in message for _, _, message in problems(tmp_path, chain.format("mine.yaml", "4 bar")))


def test_printed_model_and_plant_of_the_dmsp_come_to_rest_together(tmp_path):
    text = (
        HEAD.replace("x0", "xmax").replace("muscles:", "load: 5 N\nmuscles:")
        + MUSCLE + MUSCLE.replace("model: dmsp", "plant: dmsp")
    )  # fmt: skip
    (tmp_path / "chain.yaml").write_text(text)
    data = json.loads(call("simulate", tmp_path / "chain.yaml", "--json").stdout)
    x = [m["displacement"][-1] for m in data["muscles"]]
    assert x == pytest.approx([0.0424, 0.0424], abs=5e-5)


# -- results ---------------------------------------------------------------------------------------------------------


def test_json_csv_and_the_files_hold_the_same_numbers(folder):
    data = json.loads(call("simulate", "unlike", "--json").stdout)
    assert data["schema"] == "pmabench.cascade-result/1"
    assert data["simulated"] is True
    kept = json.loads((folder / "cascade.json").read_text())
    assert kept == data
    text = call("simulate", "unlike", "--csv").stdout
    assert text == (folder / "cascade.csv").read_text()
    head, *rows = csv.reader(io.StringIO(text))
    assert head[:5] == ["time [s]", "displacement [m]", "force_ce_sum [N]", "force_ce [N]", "force [N]"]
    assert head[5:8] == ["upper: pressure [Pa]", "upper: displacement [m]", "upper: force_ce [N]"]
    columns = {name: [float(row[i]) for row in rows] for i, name in enumerate(head)}
    each = [columns[f"{m['name']}: displacement [m]"] for m in data["muscles"]]
    np.testing.assert_allclose(columns["displacement [m]"], np.sum(each, axis=0), rtol=1e-12)
    assert columns["force [N]"] == data["force"]
    # the chain's F_ce is that of one muscle, the sum is told apart
    F_ce = [columns[f"{m['name']}: force_ce [N]"] for m in data["muscles"]]
    np.testing.assert_array_equal(columns["force_ce [N]"], np.max(F_ce, axis=0))
    np.testing.assert_allclose(columns["force_ce_sum [N]"], np.sum(F_ce, axis=0))
    assert max(columns["force_ce_sum [N]"]) > 1.1 * max(columns["force_ce [N]"])


def test_the_shipped_chain_of_paper_1_gives_the_digests_numbers():
    data = json.loads(call("simulate", "paper1", "--json").stdout)
    x = np.interp([1, 2, 3, 5, 10.5, 12, 15, 20], data["time"], data["displacement"])
    one = 5312.244 / 69590  # F_ce at x = 0 over S, 6 bar, no load
    expected = [0.94017, 1.93659, 2.93638, 2.99977, 2.72608, 1.80514, 0.26450, 0.01077]
    np.testing.assert_allclose(x / one, expected, atol=3e-4)  # S is printed with four digits in the digest


def test_people_are_shown_what_is_no_force():
    out = call("simulate", "paper1").stdout
    assert out.startswith("SIMULATED")
    assert "that of one muscle" in out
    assert "nothing feels it" in out


# -- pace ------------------------------------------------------------------------------------------------------------


class Slow(VirtualClock):
    """A clock on which each block of the simulation takes some time."""

    def spend(self, seconds):
        self._now += seconds


def at_pace(cost):
    clock, shown = Slow(), []
    members = [PrintedMuscle([Step(0.0, 6e5), Step(5.0, 0.0)]) for _ in range(2)]

    def step(part):
        clock.spend(cost)
        return simulate(members, part)

    blocks, elapsed = paced(
        np.arange(1001) / 100, step, clock, lambda *reported: shown.append((clock.now(), *reported))
    )
    return blocks, elapsed, shown


@pytest.mark.parametrize("cost", [0.0, 0.01, 0.045])
def test_paced_time_is_simulated_time_within_2_percent(cost):
    blocks, elapsed, shown = at_pace(cost)
    assert elapsed == pytest.approx(10.0, rel=0.02)
    for now, t, _ in shown[1:]:
        assert now == pytest.approx(t, abs=0.06)
    whole = simulate([PrintedMuscle([Step(0.0, 6e5), Step(5.0, 0.0)]) for _ in range(2)], np.arange(1001) / 100)
    assert (np.concatenate([block.displacement for block in blocks]) == whole.displacement).all()


def test_a_computer_that_does_not_keep_up_is_reported(capsys):
    _, elapsed, _ = at_pace(0.08)
    assert elapsed > 11
    show_pace(Ui(), 10.0, elapsed)
    assert "does not keep up" in capsys.readouterr().err
    show_pace(Ui(), 10.0, 10.1)
    assert "+1.00 %" in capsys.readouterr().err


def test_the_pace_of_a_real_clock(tmp_path):
    (tmp_path / "short.yaml").write_text(HEAD.replace("5 s", "0.4 s") + MUSCLE)
    reported = call("simulate", tmp_path / "short.yaml", "--pace", "--json")
    data = json.loads(reported.stdout)["paced"]
    assert data["simulated"] == pytest.approx(0.4)
    assert data["elapsed"] >= 0.4 - 1e-6
    assert json.loads(call("simulate", tmp_path / "short.yaml", "--json").stdout)["paced"] is None


def test_examples_of_the_models_hold():
    assert doctest.testmod(cascade) == (0, 2)


# -- drawings --------------------------------------------------------------------------------------------------------

FILES = ("cascade.html", "snapshots.svg", "displacement.svg", "pressure.svg", "force-ce-sum.svg", "chain-force.svg")


def test_all_drawings_are_written_and_need_nothing_else(folder):
    for name in FILES:
        text = (folder / name).read_text()
        assert "SIMULATED" in text
        outside = set(re.findall(r"""(?:https?:)?//[\w.-]+""", text)) - {"http://www.w3.org"}
        assert not outside, (name, outside)
        assert not re.search(r"<(img|link|iframe|image|script src)", text)
        if name.endswith(".svg"):
            root = ET.fromstring(text)
            assert root.tag == "{http://www.w3.org/2000/svg}svg"
            names = re.findall(r' id="([^"]+)"', text)
            assert len(names) == len(set(names)), name
            assert set(re.findall(r'(?:url\(#|href="#)([^)"]+)', text)) <= set(names), name


class Tags(HTMLParser):
    """Ids and scripts of a page."""

    def __init__(self):
        super().__init__()
        self.ids, self.script, self.data = [], "", {}

    def handle_starttag(self, tag, attrs):
        self.ids += [value for key, value in attrs if key == "id"]
        self.script = tag if tag == "script" and ("id", "data") in attrs else ""

    def handle_data(self, data):
        if self.script:
            self.data = json.loads(data)
            self.script = ""


def test_the_page_holds_the_frames_and_each_name_once(folder):
    text = (folder / "cascade.html").read_text()
    page = Tags()
    page.feed(text)
    assert len(page.ids) == len(set(page.ids))
    assert set(re.findall(r'(?:url\(#|href="#)([^)"]+)', text)) <= set(page.ids)
    result = read_result(folder)
    d, rows, scene = page.data, frame_rows(result), Scene(result)
    assert d["t"] == [pytest.approx(result.time[row]) for row in rows]
    assert (d["t"][0], d["t"][-1]) == (0, 16)
    assert max(np.diff(d["t"])) < 0.06
    for row, frame in ((rows[0], 0), (rows[200], 200), (rows[-1], len(rows) - 1)):
        end = d["muscles"][-1]["begin"][frame] + d["muscles"][-1]["length"][frame] + d["muscles"][-1]["gap"]
        assert (scene.end - end) / scene.scale == pytest.approx(result.displacement[row], abs=0.1e-3)


def test_the_path_that_is_drawn_has_no_kink(folder):
    """From the SVG itself: control points of the left end, then the line of the body."""
    result = read_result(folder)
    paths = re.findall(
        r'class="outline" d="M0 -([\d.]+)Q([\d.]+) -([\d.]+) ([\d.]+) -([\d.]+)L([\d.]+) -([\d.]+)Q',
        snapshots(result, moments_of(result)),
    )
    assert len(paths) == 3 * len(moments_of(result))
    bulging = 0
    for path in paths:
        f, x1, y1, x2, y2, x3, y3 = map(float, path)
        assert y1 == y2 == y3
        assert x1 <= x2 < x3
        if y1 > f + 0.5:
            bulging += 1
            ends = [np.array(p) for p in ((0, f), (x1, y1), (x2, y2))]
            before, at = quadratic(*ends, np.array([1 - 1e-6, 1.0]))
            assert abs((at - before)[1] / (at - before)[0]) < 1e-5
    assert bulging > 6


def test_a_name_cannot_break_out_of_the_page(tmp_path):
    bad = 'x</script><script>alert(1)</script> & "<b>'
    (tmp_path / "chain.yaml").write_text(HEAD.replace("name: test", f"name: '{bad}'") + MUSCLE)
    call("simulate", tmp_path / "chain.yaml", "--out", tmp_path / "out", "-q")
    for name in FILES:
        assert "<script>alert" not in (tmp_path / "out" / name).read_text()
    ET.fromstring((tmp_path / "out" / "snapshots.svg").read_text())


@pytest.mark.parametrize(
    "text",
    [
        HEAD.replace("100 Hz", "20 Hz") + MUSCLE + "    count: 100\n    stagger: 0.02 s\n",
        HEAD.replace("muscles:", "load: 9 kN\nmuscles:") + MUSCLE,
    ],
    ids=["a hundred", "one that moves nothing"],
)
def test_any_number_of_muscles_and_no_motion_can_be_drawn(tmp_path, text):
    (tmp_path / "chain.yaml").write_text(text)
    found = Result.model_validate_json(call("simulate", tmp_path / "chain.yaml", "--json").stdout)
    drawing = ET.fromstring(snapshots(found, moments_of(found)))
    widths = [float(part) for part in drawing.attrib["viewBox"].split()]
    assert widths[2] == 1000
    assert widths[3] < 2000


# -- replay ----------------------------------------------------------------------------------------------------------


def test_replay_draws_the_same_without_a_simulation(folder, tmp_path, monkeypatch):
    def never(*_):
        raise AssertionError("simulated")

    monkeypatch.setattr("pmabench.model.cascade.simulate", never)
    call("replay", folder, "--out", tmp_path, "-q")
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()
    assert call("replay", folder / "cascade.json", "--csv").stdout == (folder / "cascade.csv").read_text()
    assert not (tmp_path / "cascade.json").exists()
    (tmp_path / "printed.json").write_text(call("replay", folder, "--json").stdout)
    assert call("replay", tmp_path / "printed.json", "--csv").stdout == (folder / "cascade.csv").read_text()


def test_moments_are_chosen(folder, tmp_path):
    call("replay", folder, "--out", tmp_path, "--at", "2 s", "--at", "7.5 s", "-q")
    assert re.findall(r">([\d.]+) s</text>", (tmp_path / "snapshots.svg").read_text()) == ["2.00", "7.50"]
    reported = call("replay", folder, "--at", "17 s", "--at", "x", code=2).stderr
    assert "outside the simulation, 0 to 16 s" in reported
    assert reported.count("--at:") == 2
    assert "--out FOLDER" in reported


def damaged(folder, change):
    data = json.loads((folder / "cascade.json").read_text())
    change(data)
    return json.dumps(data)


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda d: d["time"].pop(), "unlike length"),
        (lambda d: d["muscles"][0]["displacement"].__setitem__(5, 9.9), "no length"),
        (lambda d: d["muscles"][0].__setitem__("radius", -1), "muscles.0.radius"),
        (lambda d: d["time"].__setitem__(3, 0.0), "do not rise"),
        (lambda d: d.__setitem__("schema", "pmabench.run/1"), "no result of a cascade"),
        (lambda d: d.__setitem__("muscles", []), "muscles"),
    ],
)
def test_damaged_results_are_refused_in_a_sentence(folder, tmp_path, change, part):
    (tmp_path / "cascade.json").write_text(damaged(folder, change))
    assert part in call("replay", tmp_path, code=3).stderr


def test_what_is_no_result_is_refused(tmp_path):
    assert "there is no result here" in call("replay", tmp_path / "none", code=3).stderr
    (tmp_path / "cut.json").write_text('{"schema": "pmabench')
    assert "cut off" in call("replay", tmp_path / "cut.json", code=3).stderr
    call("replay", tmp_path / "cut.json", "--csv", "--json", code=2)


def test_a_place_that_takes_no_files_is_exit_7(tmp_path):
    (tmp_path / "taken").write_text("")
    call("simulate", "paper1", "--out", tmp_path / "taken" / "x", "-q", code=7)


# -- the page of the docs --------------------------------------------------------------------------------------------


def test_the_commands_of_the_papers_rows_work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = re.findall(r"`pmabench model cascade ([^`]*)`", (ROOT / "docs" / "papers.md").read_text())
    assert len(rows) >= 4
    for command in rows:
        if "--pace" not in command:
            call(*shlex.split(command))
    assert (tmp_path / "again" / "cascade.html").is_file()


def test_the_commands_and_the_file_of_the_page_work(tmp_path, monkeypatch):
    page = (ROOT / "docs" / "cascade.md").read_text()
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r"^pmabench model cascade (.*)$", page, re.MULTILINE)
    assert len(commands) == 4
    for command in commands:
        call(*shlex.split(command.partition(">")[0], comments=True))
    assert re.findall(r">([\d.]+) s</text>", (tmp_path / "again" / "snapshots.svg").read_text()) == ["2.00"]
    written = {path.name for path in (tmp_path / "chain").iterdir()}
    reported = set(re.findall(r"`([\w-]+\.(?:json|csv|html|svg))`", page.split("## What --out writes")[1]))
    assert written == reported
    (tmp_path / "own.yaml").write_text(re.search(r"```yaml\n(.*?)```", page, re.DOTALL)[1])
    data = json.loads(call("simulate", "own.yaml", "--json").stdout)
    assert [m["name"] for m in data["muscles"]] == ["near", "far"]
