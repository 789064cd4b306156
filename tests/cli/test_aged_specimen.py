"""A simulated muscle that became 4 % stiffer: its protocol refuses it, `compare` finds 4 %, `history` says since when."""

import json
import os
import shutil
from math import hypot
from pathlib import Path

import pytest

from tests.calls import call

ROOT = Path(__file__).resolve().parents[2]
SMALL = (
    "--set", "sweep.matrix.load=[6 kg, 16 kg, 26 kg]", "--set", "sweep.matrix.pressure=[300 kPa, 400 kPa]",
    "--set", "sweep.repeat.count=1",
)  # fmt: skip


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A folder with two runs of one specimen, before and after, and the analyses of both; the line of the limit."""
    lab = tmp_path_factory.mktemp("lab")
    shutil.copytree(ROOT / "fixtures" / "benches", lab / "benches")
    plant = (ROOT / "fixtures" / "plants" / "paper0.yaml").read_text()
    stiffer = "K: {coefficients: [5.824, 1.04e-3, 1.0088e-5]"
    assert "K: {coefficients: [5.6, 1.0e-3, 9.7e-6]" in plant
    (lab / "benches" / "aged.plant.yaml").write_text(plant.replace("K: {coefficients: [5.6, 1.0e-3, 9.7e-6]", stiffer))
    (lab / "benches" / "aged.yaml").write_text(
        "include: mock.yaml\nname: aged\ndevices:\n  plant: {options: {plant: aged.plant.yaml, seed: 2}}\n"
    )
    text = (ROOT / "protocols" / "contraction-relaxation.yaml").read_text().split("\naccept:")[0]
    reference = "reference_trial: {load: 16 kg, pressure: 300 kPa, every: 3}"
    (lab / "mine.yaml").write_text(
        f"{text}\n{reference}\naccept:\n  K: {{of_specimen: 2 %}}\n  held_out: {{at_most: 1 %}}\n"
    )
    line = (lab / "mine.yaml").read_text().splitlines().index("  K: {of_specimen: 2 %}") + 1
    for bench in ("mock.yaml", "aged.yaml"):
        call("run", lab / "mine.yaml", "--bench", lab / "benches" / bench, "--specimen", "mas-20-250-paper0", *SMALL,
             "--yes", "--out", lab / "runs", "-q")  # fmt: skip
    by_bench = {json.loads((run / "manifest.json").read_text())["bench"]: run for run in (lab / "runs").glob("2*")}
    aged = by_bench.pop("aged")
    (before,) = by_bench.values()
    return {"folder": lab, "before": before, "aged": aged, "line": line,
            "ok": call("process", before), "refused": call("process", aged, "-v", code=6)}  # fmt: skip


def test_process_refuses_it_with_value_limit_and_line(lab):
    assert "NOT ACCEPTED" not in lab["ok"].output
    failed = [line for line in lab["refused"].output.splitlines() if line.startswith("NOT ACCEPTED")]
    assert len(failed) == 2  # at both pressures, and no other limit
    assert f"above the specimen file's 6.77 N/mm, accepted +-2 % (mine.yaml:{lab['line']})" in failed[0]
    assert "loads predicted by a fit to all others" in lab["refused"].output


def test_compare_finds_the_true_difference(lab):
    analyses = [lab["folder"] / "analyses" / lab[name].name for name in ("aged", "before")]
    reported = json.loads(call("compare", *analyses, "--method", "measured-pressure", "--json").output)
    K = [d for d in reported["differences"] if d["symbol"] == "K"]
    assert len(K) == 2
    for d in K:
        assert d["relative"] == pytest.approx(0.04, abs=0.004)
        assert abs(d["difference"] - 0.04 * d["b"]["value"]) < 1.5 * d["half_width"]
        assert d["agrees"] is False
        assert d["half_width"] == pytest.approx(hypot(d["a"]["half_width"], d["b"]["half_width"])), "with calibrations"
    same = [d for d in reported["differences"] if d["symbol"] in ("B_c", "F_c")]
    assert all(abs(d["E_n"]) < 1.5 for d in same)
    said = "\n".join(f["text"] for f in reported["findings"])
    assert "errors that both share count in both" in said
    assert "the calibrations, which both used, drop out" not in said  # neither run has a session, nor zeros of one


def test_history_shows_cycles_values_and_reference_trials(lab):
    page = lab["folder"] / "h.html"
    reported = json.loads(call("history", "MOCK-P0", lab["folder"] / "runs", "--json", "-o", page).output)
    assert reported["specimen"].endswith("MOCK-P0")
    # 5 cycles before the first trial, 6 trials, and a reference trial before, after the third and at the end
    assert [(run["cycles_before"], run["cycles"]) for run in reported["runs"]] == [(0, 14), (14, 14)]
    K = next(one for one in reported["series"] if one["symbol"] == "K" and one["at"]["pressure"] == 3e5)
    first, last = (value["value"] for value in K["values"])
    assert last / first == pytest.approx(1.04, abs=0.004)
    assert any(f["text"].startswith("K at ") and f["level"] == "doubt" for f in reported["findings"])
    (reference,) = reported["references"]
    strokes = [moment["stroke"] for moment in reference["strokes"]]
    assert len(strokes) == 6
    assert strokes[-1] / strokes[0] == pytest.approx(1 / 1.04, abs=0.01)
    text = page.read_text()
    assert "SIMULATED" in text
    assert "Control chart" in text
    by_file = json.loads(call("history", "mas-20-250-paper0", lab["folder"] / "runs", "--json").output)
    assert by_file["runs"] == reported["runs"]


def test_the_latest_analysis_of_a_run_counts_wherever_process_left_it(lab, tmp_path):
    shutil.copytree(lab["folder"] / "runs", tmp_path / "runs")
    old = tmp_path / "analyses" / "each" / lab["aged"].name
    shutil.copytree(lab["folder"] / "analyses" / lab["aged"].name, old)
    new = tmp_path / "analyses" / "again"
    shutil.copytree(old, new)
    reported = (new / "contraction-relaxation" / "analysis.json").read_text()
    for path, at in ((old, 1e9), (new, 2e9)):
        os.utime(path / "contraction-relaxation" / "analysis.json", (at, at))

    def F_c():
        data = json.loads(call("history", "MOCK-P0", tmp_path / "runs", "--json").output)
        return next(one for one in data["series"] if one["symbol"] == "F_c")["values"]

    (before,) = F_c()
    changed = json.loads(reported)
    for estimate in changed["estimates"]:
        if estimate["symbol"] == "F_c":
            estimate["value"] += 1.0
    (new / "contraction-relaxation" / "analysis.json").write_text(json.dumps(changed))
    (after,) = F_c()
    assert after["value"] == pytest.approx(before["value"] + 1.0)


def test_what_history_cannot_find_is_a_sentence(lab, tmp_path):
    runs = lab["folder"] / "runs"
    assert (
        'holds no run of "nobody"; the specimens of its runs: MAS-20' in call("history", "nobody", runs, code=3).output
    )
    assert "there is no such folder" in call("history", "MOCK-P0", tmp_path / "none", code=3).output
    alone = tmp_path / "runs"
    shutil.copytree(lab["aged"], alone / lab["aged"].name)
    shutil.copytree(lab["before"], alone / lab["before"].name)
    events = alone / lab["before"].name / "events.jsonl"
    events.write_bytes(events.read_bytes().replace(b'"value":300000.0', b'"value":100000.0'))
    result = call("history", "MOCK-P0", alone)
    assert "its cycles are not counted" in result.output
    assert "pmabench process makes them" in result.output
