"""Old files become runs that keep the file, its readings and what is wrong with it; or nothing is written at all."""

import hashlib
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmabench.base.errors import InvalidFile, RecordError
from pmabench.store.importers import importing, prepare
from pmabench.store.reader import open_run, read_stream
from pmabench.store.records import Flag
from pmabench.store.verify import verify
from tests import fixtures_old_runs as made
from tests.importing import import_files, read_map

OLD = Path(__file__).resolve().parents[2] / "fixtures" / "old-runs"
ISOMETRIC = OLD / "isometric.yaml"
MAPS = {"step": "*step_exp", "sine": "*frq*", "pull": "*characterization_exp"}


def polled(kind):
    return sorted(OLD.glob(f"polled/{MAPS[kind]}/*_data.dat"))


def one(path, map_path, out):
    (run,) = import_files([path], map_path, out)
    return run, open_run(run.path)


def test_the_fixtures_are_what_their_script_makes(tmp_path):
    made.make(tmp_path)
    for path in [*tmp_path.rglob("*.csv"), *tmp_path.rglob("*.dat"), *tmp_path.rglob("*.txt")]:
        kept = (OLD / path.relative_to(tmp_path)).read_text(encoding="utf-8").split("\n")
        again = path.read_text(encoding="utf-8").split("\n")
        assert len(kept) == len(again)
        differing = sum(a != b for a, b in zip(kept, again, strict=True))
        assert differing <= 0.01 * len(kept), f"{path.name}: run python -m tests.fixtures_old_runs"
    assert sum(p.stat().st_size for p in OLD.rglob("*") if p.is_file()) < 500_000


def test_a_run_keeps_the_file_its_readings_and_the_map(tmp_path):
    source = OLD / "isometric" / "10mm_13cm_Kinked4mm_Test1.csv"
    run, data = one(source, ISOMETRIC, tmp_path)
    reported = data.manifest["imported"]
    assert (run.path / "source" / source.name).read_bytes() == source.read_bytes()
    assert reported["sha256"] == hashlib.sha256(source.read_bytes()).hexdigest()
    assert (run.path / "map.yaml").read_bytes() == ISOMETRIC.read_bytes()
    assert sorted(p.name for p in run.path.glob("map-included*"))
    assert data.status == "finished"
    assert not data.simulated
    raw = read_stream(run.path, raw=True)
    assert raw["force"].dtype == np.int32
    newtons = np.loadtxt(source, delimiter=",")[:, 0]
    counts = (newtons / 4.45 + 30.882) / 1.6475
    assert np.array_equal(raw["force"], np.round(counts))
    assert np.allclose(data.trials[0].channels["force"], (np.round(counts) * 0.1535 - 1.963) * 4.45)
    assert not verify(run.path)


def test_names_show_the_point_and_the_test(tmp_path):
    runs = import_files(sorted(OLD.glob("isometric/*.csv")), ISOMETRIC, tmp_path)
    reported = {run.source.stem: open_run(run.path).trials[0] for run in runs}
    assert reported["10mm_13cm_Kinked4mm_Test10"].point == {"contraction": 0.004}
    assert reported["10mm_13cm_Kinked4mm_Test10"].repeat == 10
    assert reported["10mm_13cm_Unkinked_Test2"].point == {"contraction": 0.0}


def test_phases_come_from_their_column_or_from_the_map(tmp_path):
    for name in ("10mm_13cm_Unkinked_Test1.csv", "10mm_13cm_Unkinked_Test2.csv"):
        _, data = one(OLD / "isometric" / name, ISOMETRIC, tmp_path)
        phases = [(event.data["name"], event.t) for event in data.events if event.kind == "phase"]
        assert [name for name, _ in phases] == ["fill", "exhaust"]
        assert phases[1][1] == pytest.approx(27.0, abs=0.1)


def test_faults_of_a_file_are_counted_and_located(tmp_path):
    run, data = one(OLD / "isometric" / "10mm_13cm_Kinked4mm_Test2.csv", ISOMETRIC, tmp_path)
    assert dict(run.flagged) == {"overrange": 1, "suspect": 1}
    lines = {found["kind"]: found["line"] for found in data.manifest["imported"]["findings"]}
    assert lines["out-of-range"] == 301
    assert lines["twice"] == 41
    assert data.trials[0].flags[300] == Flag.OVERRANGE


def test_a_file_that_was_rewritten_twice_is_found_among_its_siblings(tmp_path):
    files = [*OLD.glob("isometric/*Kinked4mm*.csv"), OLD / "isometric" / "rewritten" / "10mm_13cm_Kinked4mm_Test10.csv"]
    *good, bad = import_files(files, ISOMETRIC, tmp_path)
    assert {"not-whole", "sibling"} <= {found.kind for found in bad.findings if found.level == "fault"}
    assert bad.flagged["suspect"] == bad.rows
    assert not any(found.level == "fault" for run in good for found in run.findings)
    assert not open_run(bad.path).trials[0].usable.any()


def test_steps_are_found_in_the_command_and_its_zeros_are_none(tmp_path):
    run, data = one(polled("step")[0], OLD / "step.yaml", tmp_path)
    assert [trial.point["from"] for trial in data.trials] == pytest.approx([120e3, 360e3])
    assert [trial.point["pressure"] for trial in data.trials] == pytest.approx([360e3, 120e3])
    assert [trial.commands[0].t for trial in data.trials] == pytest.approx([2.0, 4.0], abs=0.03)
    assert data.trials[0].point["mass"] == 5.0
    assert run.flagged["suspect"] == 2
    assert "5 kg hanging" in data.manifest["imported"]["notes"]
    assert data.manifest["started_utc"].startswith("2026-01-05T10:15")
    assert data.channels["displacement"].gain_uncertainty == pytest.approx(0.23)


def test_a_last_line_without_an_end_is_not_trusted(tmp_path):
    run, data = one(polled("step")[1], OLD / "step.yaml", tmp_path)
    assert "cut-end" in {found.kind for found in run.findings}
    assert data.trials[-1].flags[-1] & Flag.SUSPECT


def test_the_frequency_of_a_sine_is_in_the_name_with_a_decimal_comma(tmp_path):
    runs = [open_run(run.path) for run in import_files(polled("sine"), OLD / "sine.yaml", tmp_path)]
    frequencies = [run.trials[0].point["frequency"] * 2 * np.pi for run in runs]
    assert frequencies == pytest.approx([6.28, 12.56, 18.84])
    command = runs[0].trials[0].commands[0]
    assert command.kind == "sine"
    assert command.value == pytest.approx(300e3, rel=0.01)
    assert command.data["amplitude"] == pytest.approx(300e3, rel=0.01)


def test_a_clock_that_jumps_back_is_a_fault_and_the_gap_stays(tmp_path):
    run, data = one(polled("sine")[2], OLD / "sine.yaml", tmp_path)
    assert run.flagged["gap"] == 1
    assert any(f.kind == "time-jump" and "back by 1.19 s" in f.text for f in run.findings)
    t = read_stream(run.path)["t"].to_numpy()
    assert (np.diff(t) < -1.0).sum() == 1
    assert len(data.trials[0].t) == run.rows


def test_pauses_part_a_pull_test(tmp_path):
    run, data = one(polled("pull")[0], OLD / "pull.yaml", tmp_path)
    assert [trial.point["contraction"] for trial in data.trials] == pytest.approx(list(made.TRUTH["pull"]), abs=1e-4)
    assert run.flagged["dropout"] == 12
    assert "load" not in data.trials[0].point
    assert len(data.trials[0].commands) == 3


def nothing_left(out):
    return not out.exists() or not list(out.iterdir())


def test_one_bad_file_and_nothing_is_written(tmp_path):
    bad = tmp_path / "10mm_13cm_Unkinked_Test3.csv"
    bad.write_bytes(b"1,2,3\n1,2\n1,2,3\n")
    odd = tmp_path / "something.csv"
    odd.write_bytes(b"1,2,3\n")
    out = tmp_path / "out"
    with pytest.raises(InvalidFile) as caught:
        import_files([*OLD.glob("isometric/*.csv"), bad, odd, tmp_path / "nowhere_Test1.csv"], ISOMETRIC, out)
    assert len(caught.value.problems) == 3
    assert any("fits none of the forms" in problem.message for problem in caught.value.problems)
    assert nothing_left(out)


def test_a_failed_write_leaves_nothing_behind(tmp_path, monkeypatch):
    calls = []

    def fails(writer, prepared):
        calls.append(1)
        if len(calls) > 2:
            raise RecordError("the disk is full")

    monkeypatch.setattr(importing, "_events", fails)
    with pytest.raises(RecordError):
        import_files(sorted(OLD.glob("isometric/*.csv")), ISOMETRIC, tmp_path / "out")
    assert nothing_left(tmp_path / "out")


def test_the_same_file_twice_is_refused(tmp_path):
    source = OLD / "isometric" / "10mm_13cm_Kinked4mm_Test1.csv"
    copy = tmp_path / "10mm_13cm_Kinked4mm_Test9.csv"
    shutil.copy(source, copy)
    with pytest.raises(InvalidFile, match="same bytes"):
        import_files([source, copy], ISOMETRIC, tmp_path / "out")
    with pytest.raises(InvalidFile):
        import_files([source, source], ISOMETRIC, tmp_path / "out")
    with pytest.raises(InvalidFile):
        import_files([], ISOMETRIC, tmp_path / "out")


def test_a_step_file_without_steps_has_no_trial_and_says_so(tmp_path):
    folder = tmp_path / "2026-01-05_101500_step_exp"
    folder.mkdir()
    text = polled("step")[0].read_text(encoding="utf-8").split("\n")
    (folder / "step_data.dat").write_text("\n".join(text[:100]) + "\n", encoding="utf-8")
    run, data = one(folder / "step_data.dat", OLD / "step.yaml", tmp_path / "out")
    assert not data.trials
    assert any(found.kind == "no-trial" and found.level == "fault" for found in run.findings)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.data())
def test_mutated_logs_are_prepared_or_refused(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp() / "2026-01-05_101500_step_exp"
    folder.mkdir(exist_ok=True)
    content = bytearray(b"\n".join(polled("step")[0].read_bytes().split(b"\n")[:30]) + b"\n")
    for _ in range(data.draw(st.integers(1, 5))):
        at = data.draw(st.integers(90, len(content) - 1))
        until = at + data.draw(st.integers(0, 8))
        content[at:until] = data.draw(st.text(alphabet="0123456789.,-e\n", max_size=8)).encode()
    (folder / "step_data.dat").write_bytes(bytes(content))
    try:
        prepared = prepare.prepare(folder / "step_data.dat", read_map(OLD / "step.yaml"))
    except InvalidFile as refused:
        assert refused.problems
    else:
        assert len(prepared.flags) == len(prepared.t)
