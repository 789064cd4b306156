"""Trials are found in signals that nobody marked: steps, ramps and sines with the levels, times and frequencies made."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmabench.kinds.free_contraction.reduction import reduce as free_contraction
from pmabench.kinds.isometric.reduction import reduce as isometric
from pmabench.kinds.isometric_pressurisation.reduction import reduce as isometric_pressurisation
from pmabench.kinds.recorded_sine.reduction import reduce as sines
from pmabench.kinds.recorded_step.reduction import reduce as steps
from pmabench.store.importers import motion
from pmabench.store.importers.commands import alike
from pmabench.store.importers.guess.write import map_text
from pmabench.store.reader import open_run
from tests.importing import guess_files, import_files

MAP = """\
schema: pmabench.map/1
name: a bench
source: nobody
kind: {kind}
file: {{delimiter: comma, header: first line}}
columns:
  t: {{is: time, unit: s}}
  p: {{is: pressure, unit: kPa}}
  {other}
sampling: {{rate: [95 Hz, 105 Hz], gap: 50 ms}}
trials: {trials}
specimen: {{type: muscle}}
"""
DISPLACEMENT = "x: {is: displacement, unit: mm}"


def noise(n, size, seed=1):
    return np.random.default_rng(seed).normal(0, size, n)


def imported(tmp_path, columns, kind, trials, other=DISPLACEMENT):
    (run,) = all_imported(tmp_path, [columns], kind, trials, other)
    return run


def all_imported(tmp_path, files, kind, trials, other=DISPLACEMENT):
    """The runs of files of one layout that are imported in one call, in their order."""
    paths = [tmp_path / f"old{number:02d}.csv" for number in range(len(files))]
    for path, columns in zip(paths, files, strict=True):
        rows = "\n".join(",".join(f"{value:.6g}" for value in row) for row in zip(*columns.values(), strict=True))
        path.write_text(",".join(columns) + "\n" + rows + "\n", encoding="utf-8")
    (tmp_path / "map.yaml").write_text(MAP.format(kind=kind, trials=trials, other=other), encoding="utf-8")
    return [open_run(run.path) for run in import_files(paths, tmp_path / "map.yaml", tmp_path / "runs")]


def lagged(t, command, tau):
    out = np.full(len(t), command[0], dtype=float)
    for k in range(1, len(t)):
        out[k] = out[k - 1] + (command[k - 1] - out[k - 1]) * (1 - np.exp(-(t[k] - t[k - 1]) / tau))
    return out


def test_steps_of_the_measured_pressure_where_no_command_was_recorded(tmp_path):
    t = np.arange(0, 16, 0.01)
    command = np.where((t >= 3) & (t < 8), 300.0, np.where((t >= 8) & (t < 12), 200.0, 100.0))
    P = lagged(t, command, 0.06) + noise(len(t), 0.3)
    data = imported(tmp_path, {"t": t, "p": P, "x": P / 20}, "recorded-step", "{by: step, smallest: 20 kPa, lead: 1 s}")
    reported = [(trial.point["from"], trial.point["pressure"]) for trial in data.trials]
    assert reported == [(100e3, 300e3), (300e3, 200e3), (200e3, 100e3)]
    assert [trial.commands[0].t for trial in data.trials] == pytest.approx([3.0, 8.0, 12.0], abs=0.04)
    assert all(trial.commands[0].data["found"] for trial in data.trials)
    reduced = steps([data])
    assert {estimate.symbol for estimate in reduced.estimates} >= {"tau_P", "X"}
    assert "t_d" not in {estimate.symbol for estimate in reduced.estimates}
    assert any("tell no dead time" in finding.text for finding in reduced.findings)
    stroke = {e.at["pressure"]: e.value for e in reduced.estimates if e.symbol == "X"}
    assert stroke[300e3] == pytest.approx(10e-3, rel=0.01)


def test_ramps_are_found_with_their_two_branches(tmp_path):
    t = np.arange(0, 40, 0.01)
    P = 500 * np.interp(t, [0, 2, 9, 11, 18, 22, 29, 31, 38, 40], [0, 0, 1, 1, 0, 0, 1, 1, 0, 0])
    branch = np.where(((t > 2) & (t < 10)) | ((t > 22) & (t < 30)), -5.0, 5.0)
    F = 0.6 * P - 20 + branch
    columns = {"t": t, "p": P + noise(len(t), 0.4), "f": F + noise(len(t), 0.5, 2)}
    trials = "{by: ramp, smallest: 50 kPa, point: {contraction: 4 mm}}\nanalysis: {phases: [fill, exhaust], force_above: 20 N}"
    data = imported(tmp_path, columns, "isometric", trials, "f: {is: force, unit: N}")
    assert len(data.trials) == 2
    for trial, (begin, turn, end) in zip(data.trials, ((2, 11, 18), (22, 31, 38)), strict=True):
        phases = {e.data["name"]: e.t for e in data.events if e.kind == "phase" and e.data["trial"] == trial.index}
        assert phases["fill"] == pytest.approx(begin, abs=0.5)
        assert phases["exhaust"] == pytest.approx(turn, abs=0.5)
        assert trial.t[-1] == pytest.approx(end, abs=0.5)
    slopes = [e.value for e in isometric([data]).estimates if e.symbol == "m"]
    assert slopes
    assert all(slope == pytest.approx(0.6e-3, rel=0.02) for slope in slopes)


def test_sines_of_several_frequencies_in_one_file(tmp_path):
    t = np.arange(0, 30, 0.01)
    made = ((1.0, 9.0, 1.0, 80.0), (11.0, 19.0, 2.5, 60.0), (21.0, 29.0, 5.0, 40.0))
    P = np.full(len(t), 300.0)
    for begin, end, frequency, amplitude in made:
        P += np.where((t >= begin) & (t < end), amplitude * np.sin(2 * np.pi * frequency * (t - begin)), 0.0)
    data = imported(
        tmp_path, {"t": t, "p": P + noise(len(t), 0.3), "x": P / 20}, "recorded-sine", "{by: sine, smallest: 30 kPa}"
    )
    assert [trial.point["frequency"] for trial in data.trials] == pytest.approx([1.0, 2.5, 5.0], rel=2e-3)
    for trial, (_, _, _, amplitude) in zip(data.trials, made, strict=True):
        assert trial.commands[0].data["amplitude"] == pytest.approx(amplitude * 1e3, rel=0.02)
    sizes = [e.value for e in sines([data]).estimates if e.symbol == "P"]
    assert sizes == pytest.approx([80e3, 60e3, 40e3], rel=0.02)


def test_drift_ramps_and_noise_are_no_steps():
    t = np.arange(0, 20, 0.01)
    for values in (1e5 + 1e4 * t + noise(len(t), 300), 1e5 + noise(len(t), 300), np.full(len(t), 1e5)):
        assert not motion.levels(t, values, 20e3)
    assert not motion.levels(t[:5], np.zeros(5), 1.0)


def test_squares_and_noise_are_no_sines():
    t = np.arange(0, 20, 0.01)
    assert not motion.waves(t, np.sign(np.sin(2 * np.pi * t)), 0.5)
    assert not motion.waves(t, noise(len(t), 1.0), 0.5)
    assert not motion.waves(t, np.zeros(len(t)), 0.5)


def test_a_spike_in_the_command_makes_no_step(tmp_path):
    t = np.arange(0, 8, 0.01)
    command = np.where(t >= 3, 300.0, 100.0)
    P = lagged(t, command, 0.06)
    command[600] = 0.0
    columns = {"t": t, "p": P, "c": command, "x": P / 20}
    other = DISPLACEMENT + "\n  c: {is: pressure_command, unit: kPa}"
    data = imported(tmp_path, columns, "recorded-step", "{by: step, smallest: 20 kPa, lead: 1 s}", other)
    assert [trial.point["pressure"] for trial in data.trials] == [300e3]


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60),
    st.floats(1e-3, 1e6),
)
def test_turns_alternate_and_are_as_far_apart_as_was_asked(values, smallest):
    values = np.array(values)
    marks = motion.turns(values, smallest)
    steps = np.diff(values[marks])
    assert sorted(set(marks)) == marks
    assert (np.abs(steps) >= smallest * (1 - 1e-12)).all()
    assert (np.sign(steps[1:]) == -np.sign(steps[:-1])).all()


@pytest.mark.parametrize("kind", ["step", "ramp", "sine"])
def test_a_guess_cuts_files_without_command_as_they_are(tmp_path, kind):
    t = np.arange(0, 40, 0.01)
    P = {
        "step": lagged(t, np.where((t % 20) < 10, 100.0, 300.0), 0.06),
        "ramp": 250 * (1 - np.cos(2 * np.pi * t / 13)),
        "sine": 300 + 50 * np.where(t < 20, np.sin(2 * np.pi * t), np.sin(4 * np.pi * t)),
    }[kind]
    other = "F (N)" if kind == "ramp" else "x (mm)"
    rows = "\n".join(f"{a:.2f},{b:.3f},{b / 20:.4f}" for a, b in zip(t, P + noise(len(t), 0.3), strict=True))
    (tmp_path / "old.csv").write_text(f"t (s),p (kPa),{other}\n{rows}\n", encoding="utf-8")
    guess = guess_files([tmp_path / "old.csv"])
    assert guess.trials["by"] == kind
    (tmp_path / "map.yaml").write_text(map_text(guess), encoding="utf-8")
    answers = {"step": [("columns.p (kPa).line.offset", "0 kPa")], "ramp": [("trials.point.contraction", "4 mm")]}
    (run,) = import_files(
        [tmp_path / "old.csv"], tmp_path / "map.yaml", tmp_path / "runs", answers.get(kind, ()), unresolved=True
    )
    assert run.trials == {"step": 3, "ramp": 3, "sine": 2}[kind]


@pytest.mark.parametrize("late", [0.0, 0.04])
def test_a_pressure_that_is_recorded_late_shows_at_a_step(tmp_path, late):
    t = np.arange(0, 8, 0.01)
    P = lagged(t, np.where(t >= 3, 300.0, 100.0), 0.06)
    x = lagged(t, P / 20, 0.02)
    columns = {"t": t, "p": np.interp(t - late, t, P) + noise(len(t), 0.3), "x": x + noise(len(t), 0.005, 2)}
    data = imported(tmp_path, columns, "recorded-step", "{by: step, smallest: 20 kPa, lead: 1 s}")
    found = [f for f in data.manifest["imported"]["findings"] if f["kind"] == "late"]
    assert bool(found) == (late > 0)
    for finding in found:
        assert "displacement moves" in finding["text"]
        assert finding["t"] == pytest.approx(3.0, abs=0.05)
        assert finding["line"] == finding["index"] + 2


def test_every_finding_has_its_row_and_time(tmp_path):
    t = np.arange(0, 8, 0.02)  # half the rate that the map expects
    P = lagged(t, np.where(t >= 3, 300.0, 100.0), 0.06)
    data = imported(tmp_path, {"t": t, "p": P, "x": 10 - P / 20}, "recorded-step", "{by: step, smallest: 20 kPa}")
    found = data.manifest["imported"]["findings"]
    assert {"rate", "sign"} <= {finding["kind"] for finding in found}
    assert all(finding["index"] is not None and finding["t"] is not None for finding in found)


@pytest.mark.parametrize("typed_in", [-3.0, -1.5, -0.1, 0.3])
def test_a_weight_that_is_typed_in_between_two_trials_is_that_of_the_trial(tmp_path, typed_in):
    """`typed_in` [s] from the first command of the trial; 0.3 s after it the column contradicts the trial."""
    t = np.arange(0, 30, 0.01)
    p_set = np.where((t >= 2) & ((t - 2) % 10 < 4), 300.0, 0.0)
    weight = np.where(t < 12 + typed_in, 4.0, np.where(t < 22 + typed_in, 8.0, 12.0))
    P = lagged(t, p_set, 0.06) + noise(len(t), 0.1)
    data = imported(
        tmp_path,
        {"t": t, "p": P, "x": P / 20, "c": p_set, "kg": weight},
        "contraction-relaxation",
        "{by: command, smallest: 20 kPa, lead: 1 s}",
        f"{DISPLACEMENT}\n  c: {{is: pressure_command, unit: kPa}}\n  kg: {{is: point, of: load, unit: kg}}",
    )
    loads = [trial.point.get("load", 0.0) / 9.80665 for trial in data.trials]
    assert loads == pytest.approx([4.0, 8.0, 12.0] if typed_in < 0 else [4.0, 0.0, 0.0])
    if typed_in < 0:
        assert data.trials[0].t[-1] - data.trials[0].t[0] == pytest.approx(min(10, 11 + typed_in), abs=0.05)
        assert data.trials[1].t[0] == pytest.approx(max(11, 12 + typed_in), abs=0.05)


def test_ramps_of_a_test_with_phases_of_its_own_keep_their_rests(tmp_path):
    t = np.arange(0, 70, 0.01)
    P = 400 * np.interp(t, [0, 3, 18, 20, 35, 40, 55, 57, 70], [0, 0, 1, 1, 0, 0, 1, 1, 0])
    F = np.maximum(0.9 * P - 40 + np.where(np.gradient(P) < 0, 6, 0), 0)
    columns = {"t": t, "p": P + noise(len(t), 0.15), "x": 10 + noise(len(t), 0.003, 2), "f": F + noise(len(t), 0.3, 3)}
    trials = "{by: ramp, smallest: 50 kPa}"
    data = imported(
        tmp_path, columns, "isometric-pressurisation", trials, f"{DISPLACEMENT}\n  f: {{is: force, unit: N}}"
    )
    assert [[command.phase for command in trial.commands] for trial in data.trials] == [["fill", "empty"]] * 2
    assert [len(trial.t) for trial in data.trials] == pytest.approx([3750, 3250], abs=60)
    (slope,) = [e.value for e in isometric_pressurisation([data]).estimates if e.symbol == "m" and "line" in e.method]
    assert slope == pytest.approx(0.9e-3, rel=2e-3)


def filled(P, seed):
    """Nothing, then P [kPa], then nothing: the contraction is a 20th of the pressure [mm]."""
    t = np.arange(0, 14, 0.02)
    pressure = np.interp(t, [0, 2, 2 + P / 100, 11, 11 + P / 100, 14], [0, 0, P, P, 0, 0])
    return {"t": t, "p": pressure + noise(len(t), 0.05, seed), "x": pressure / 20 + noise(len(t), 5e-3, 99 + seed)}


def test_a_pressure_that_several_files_reached_but_for_the_scatter_of_a_regulator_is_one(tmp_path):
    """Files without a command: what each came to is the truth, and the level is the mean of what is meant to be one."""
    came = (49.8, 50.1, 50.3, 148.9, 151.2, 150.2, 0.0)
    files = [filled(P, seed) for seed, P in enumerate(came)]
    trials = "{by: file}\nsettings: {nominal_length: 0.25}\nconfirmed: [magnitude, pressure-unit]"
    runs = all_imported(tmp_path, files, "free-contraction", trials)
    levels = [trial.point["pressure"] / 1e3 for run in runs for trial in run.trials]
    assert levels == pytest.approx([50.07] * 3 + [150.1] * 3 + [0.0], abs=0.25)
    found = {e.at["pressure"]: e for e in free_contraction(runs).estimates if e.symbol == "L" and not e.coordinate}
    assert [found[P].n for P in sorted(found)] == [1, 3, 3]
    for e in found.values():  # the length at the level itself
        assert e.value == pytest.approx(0.25 - e.at["pressure"] / 20e6, abs=15e-6)


@pytest.mark.parametrize("step", [2e3, 5e3])
def test_levels_of_a_staircase_are_no_scatter(step):
    scatter = np.random.default_rng(4).uniform(-0.04, 0.04, (3, 12)) * step
    levels = alike("pressure", (np.arange(4, 16) * step + scatter).ravel())
    assert sorted(set(levels.values())) == pytest.approx(np.arange(4, 16) * step + scatter.mean(0), abs=60)


def test_a_weight_that_a_cell_read_in_several_files_is_one(tmp_path):
    weights = (50.2, 49.7, 80.3, 79.9)
    files = [filled(200.0, seed) | {"f": np.full(700, W) + noise(700, 0.05, seed)} for seed, W in enumerate(weights)]
    other = f"{DISPLACEMENT}\n  f: {{is: force, unit: N}}"
    runs = all_imported(tmp_path, files, "contraction-relaxation", "{by: file}", other)
    points = [trial.point for run in runs for trial in run.trials]
    assert [point["load"] for point in points] == pytest.approx([49.95, 49.95, 80.1, 80.1], abs=0.02)
    assert [point["mass"] for point in points] == pytest.approx(
        [W / 9.80665 for W in (49.95, 49.95, 80.1, 80.1)], abs=2e-3
    )
    assert len({(point["pressure"], point["load"]) for point in points}) == 2
