"""Steps and sines of pressure from polled logs: what is known is found, what cannot be known is not claimed."""

from dataclasses import replace
from math import atan, hypot
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import TransferFunction, lsim

from pmabench.analysis.imported import import_findings
from pmabench.kinds.isometric import reduction as isometric
from pmabench.kinds.recorded_sine import reduction as recorded_sines
from pmabench.kinds.recorded_step import reduction as recorded_steps
from pmabench.kinds.reduce import reduce_runs, verdicts
from pmabench.store.reader import open_run
from pmabench.store.records import Command, Flag, TrialData
from tests import fixtures_old_runs as made
from tests.analysis.loop_rig import as_run
from tests.importing import import_files
from tests.recorded import recorded_data

FIXTURES = Path(__file__).resolve().parents[2] / "fixtures"
OLD = FIXTURES / "old-runs"
TRUTH = made.TRUTH


def runs_of(files, map_path, out):
    return [open_run(run.path) for run in import_files(sorted(files), map_path, out)]


@pytest.fixture(scope="module")
def steps(tmp_path_factory):
    return runs_of(OLD.glob("polled/*step_exp/*_data.dat"), OLD / "step.yaml", tmp_path_factory.mktemp("steps"))


@pytest.fixture(scope="module")
def sines(tmp_path_factory):
    return runs_of(OLD.glob("polled/*frq*/*_data.dat"), OLD / "sine.yaml", tmp_path_factory.mktemp("sines"))


def only(analysis, symbol, **at):
    (found,) = [e for e in analysis.estimates if e.symbol == symbol and dict(e.at) == pytest.approx(at)]
    return found


def covers(estimate, truth):
    low, high = estimate.ci95
    return low <= truth <= high


def with_lateness(run, late):
    imported = {**run.manifest["imported"], "late_by": late}
    return replace(run, manifest={**run.manifest, "imported": imported})


def test_ringing_of_a_known_mass_gives_K_and_B(steps):
    analysis = recorded_steps.reduce(steps)
    for before, after in ((120e3, 360e3), (360e3, 120e3)):
        at = {"from": before, "pressure": after}
        K, B = only(analysis, "K", **at), only(analysis, "B", **at)
        assert K.value == pytest.approx(TRUTH["K"], rel=0.1)
        assert B.value == pytest.approx(TRUTH["B"], rel=0.1)
        assert covers(K, TRUTH["K"])
        assert covers(B, TRUTH["B"])
        stroke = TRUTH["force_per_pressure"] * (after - before) / TRUTH["K"]
        assert only(analysis, "X", **at).value == pytest.approx(stroke, rel=0.03)
        assert only(analysis, "X", **at).parts.calibration == pytest.approx(0.23 * abs(stroke), rel=0.03)


def test_the_dead_time_says_how_well_it_is_known(steps):
    estimate = only(recorded_steps.reduce(steps), "t_d")
    assert covers(estimate, TRUTH["dead"])
    assert estimate.parts.method > 0.015


def test_the_best_lateness_is_near_the_true_one(steps):
    analysis = recorded_steps.reduce(steps)
    for step in analysis.facts["steps"]:
        best = min(step["motions"], key=lambda motion: motion["rms"])
        assert best["late"] == pytest.approx(TRUTH["late"], abs=0.006)


def test_without_a_mass_only_ratios_are_known(steps):
    bare = [
        replace(
            run,
            trials=tuple(
                replace(t, point={"from": t.point["from"], "pressure": t.point["pressure"]}) for t in run.trials
            ),
        )
        for run in steps
    ]
    analysis = recorded_steps.reduce(bare)
    K = only(analysis, "K", **{"from": 120e3, "pressure": 360e3})
    assert K.value is None
    assert "ratios only" in K.note


def test_a_mass_that_rings_shows_the_time_between_the_channels_itself(steps):
    analysis = recorded_steps.reduce([with_lateness(run, {"pressure": [-0.03, 0.035]}) for run in steps])
    found = [e for e in analysis.estimates if e.symbol in {"K", "B"} and e.value is not None]
    assert len(found) == 4
    assert all(covers(e, TRUTH[e.symbol]) for e in found)


def test_unknown_lateness_is_said(steps, sines):
    for module, runs in ((recorded_steps, steps), (recorded_sines, sines)):
        analysis = module.reduce([with_lateness(run, {}) for run in runs])
        assert any("nothing is known of the time between the channels" in f.text for f in analysis.findings)


def test_a_step_without_onset_is_dropped(steps):
    def flat(trial):
        return replace(trial, channels={**trial.channels, "pressure": np.full(len(trial.t), 2e5)})

    analysis = recorded_steps.reduce([replace(run, trials=tuple(flat(t) for t in run.trials)) for run in steps])
    assert len(analysis.dropped) == 4
    assert not analysis.estimates


def test_amplitudes_and_phases_of_sines(sines):
    def prompt(run):  # its sensors are known to have no filter
        return replace(run, channels={name: replace(info, sensor_lag=1e-5) for name, info in run.channels.items()})

    analysis = recorded_sines.reduce([prompt(run) for run in sines])
    for omega in (6.28, 12.56):
        at = {"frequency": omega / (2 * np.pi)}
        assert only(analysis, "x", **at).value == pytest.approx(0.020, rel=0.005)
        assert only(analysis, "P/x", **at).value == pytest.approx(1 / TRUTH["sine_gain"], rel=0.005)
        phase = only(analysis, "phi_x", **at)
        assert phase.value == pytest.approx(TRUTH["sine_phase"], abs=0.01)
        assert phase.parts.method == pytest.approx(omega * 0.015)
        width = 2 * 0.020 * np.sin(abs(TRUTH["sine_phase"]))
        assert only(analysis, "H", **at).value == pytest.approx(width, rel=0.03)
        assert only(analysis, "phi_P", **at).value == pytest.approx(-0.01 * omega, abs=0.01)


def test_a_sine_over_a_jumping_clock_is_not_fitted(sines):
    assert np.any(sines[2].trials[0].flags & np.uint16(Flag.TIME_JUMP))
    (dropped,) = recorded_sines.reduce(sines).dropped
    assert "its clock jumps" in dropped.reason


def test_a_wrong_frequency_in_the_name_is_doubted(sines):
    trial = sines[0].trials[0]
    wrong = replace(sines[0], trials=(replace(trial, point={"frequency": trial.point["frequency"] * 0.97}),))
    analysis = recorded_sines.reduce([wrong])
    assert any(f.level == "doubt" and "off the frequency" in f.text for f in analysis.findings)


def _step(zeta, late, seed=1, M=10.0, K=5000.0, rate=500.0):
    """A mass on a spring and a damper, in closed form (scipy's lsim), stepped by a lagged pressure; stamps are off."""
    w = np.sqrt(K / M)
    fine = np.arange(0.0, 4.0, 2e-4)
    since = fine - 1.02
    P = 200e3 + 100e3 * np.where(since > 0, 1 - np.exp(-np.maximum(since, 0.0) / 0.0955), 0.0)
    _, x, _ = lsim(TransferFunction([2e-3], [M, 2 * zeta * w * M, K]), P - 200e3, fine)
    t, rng = np.arange(0.0, 4.0, 1 / rate), np.random.default_rng(seed)
    return TrialData(
        run="r1", index=0, point={"from": 200e3, "pressure": 300e3, "mass": M}, repeat=0, reference=False,
        status="finished", t=t,
        channels={
            "pressure": np.interp(t - late, fine, P) + rng.normal(0, 300.0, len(t)),
            "displacement": 0.01 + np.interp(t, fine, x) + rng.normal(0, 5e-6, len(t)),
        },
        flags=np.zeros(len(t), np.uint16),
        commands=(Command(1.0, "pressure", "set", 300e3, 200e3, "step", {"within": 1 / rate}),), found={},
    )  # fmt: skip


@pytest.mark.parametrize(("zeta", "late"), [(0.7, -0.01), (0.7, 0.01), (1.6, 0.0), (3.0, 0.01)])
def test_a_damped_motion_never_gives_K_from_its_mass(zeta, late):
    """Fits with free K and B give 0.36 to 10 times the truth there."""
    analysis = recorded_steps.reduce([as_run("recorded-step", [_step(zeta, late)])])
    K, B = (next(e for e in analysis.estimates if e.symbol == symbol) for symbol in "KB")
    assert K.withheld
    assert B.withheld
    assert "does not ring" in K.note


@pytest.mark.parametrize("late", [-0.02, 0.0, 0.02])
def test_a_ringing_motion_gives_K_and_B_whatever_is_unknown_of_its_stamps(late):
    analysis = recorded_steps.reduce([as_run("recorded-step", [_step(0.15, late)])])
    K, B = (next(e for e in analysis.estimates if e.symbol == symbol) for symbol in "KB")
    assert abs(K.value - 5000.0) < K.parts.method < 0.01 * K.value
    assert abs(B.value - 2 * 0.15 * np.sqrt(5000.0 * 10.0)) < B.parts.method < 0.05 * B.value


@pytest.mark.parametrize("late", [-0.06, 0.06])
def test_beyond_what_is_looked_for_a_ringing_motion_gives_none(late):
    analysis = recorded_steps.reduce([as_run("recorded-step", [_step(0.15, late)])])
    K, B = (next(e for e in analysis.estimates if e.symbol == symbol) for symbol in "KB")
    assert K.value is None
    assert B.value is None


def _sine(amplitude, name, f=0.5):
    t = np.arange(0.0, 20.0, 0.01)
    P = 300e3 + amplitude * np.sin(2 * np.pi * f * t)
    trial = TrialData(
        run=name, index=0, point={"frequency": f}, repeat=0, reference=False, status="finished", t=t,
        channels={"pressure": P, "displacement": 0.02 + 8e-8 * (P - 300e3)}, flags=np.zeros(len(t), np.uint16),
        commands=(), found={},
    )  # fmt: skip
    return replace(as_run("recorded-sine", [trial]), id=name)


def test_sines_of_different_amplitude_are_no_repeats():
    analysis = recorded_sines.reduce([_sine(184e3, "a"), _sine(220e3, "b"), _sine(184.4e3, "c")])
    found = {round(e.at["amplitude"], 4): e for e in analysis.estimates if e.symbol == "P"}
    assert {amplitude: (round(e.value / 1e3, 1), e.n) for amplitude, e in found.items()} == {
        0.0147: (184.2, 2),
        0.0176: (220.0, 1),
    }
    assert all(e.parts.combined < 3e3 for e in found.values())
    alone = recorded_sines.reduce([_sine(184e3, "a"), _sine(184.4e3, "c")])
    assert all("amplitude" not in e.at for e in alone.estimates)


DEAD_ENDS = {
    "isometric": ("  F: {is: force, unit: N}", "{by: file}", "point: {contraction: 4 mm}"),
    "recorded-step": ("  x: {is: displacement, unit: mm}", "{by: file}", "kind: isometric"),
}


@pytest.mark.parametrize("kind", DEAD_ENDS)
def test_what_a_map_lacks_is_said_with_what_to_write(tmp_path, kind):
    more, trials, reported = DEAD_ENDS[kind]
    t = np.arange(0.0, 10.0, 0.01)
    P = 300 * np.sin(np.pi * t / 10)
    other = 5.0 + np.random.default_rng(1).normal(0, 1e-3, len(t)) if kind == "recorded-step" else 0.9 * P
    np.savetxt(tmp_path / "a.csv", np.column_stack([t, P, other]), delimiter=",", header=f"t,p,{more.strip()[0]}",
               comments="")  # fmt: skip
    (tmp_path / "m.yaml").write_text(
        f"schema: pmabench.map/1\nname: m\nsource: test\nkind: {kind}\nfile: {{delimiter: comma, header: first line}}\n"
        f"columns:\n  t: {{is: time, unit: s}}\n  p: {{is: pressure, unit: kPa}}\n{more}\n"
        f"sampling: {{rate: [50 Hz, 200 Hz], gap: 50 ms}}\ntrials: {trials}\nspecimen: {{type: M, serial: '1'}}\n"
    )
    runs = runs_of([tmp_path / "a.csv"], tmp_path / "m.yaml", tmp_path / "runs")
    (said,) = verdicts(runs, reduce_runs(runs))
    assert reported in said


def test_a_sine_without_a_frequency_in_its_map_is_looked_at(tmp_path):
    t = np.arange(0.0, 20.0, 0.01)
    P = 300 + 100 * np.sin(2 * np.pi * 0.75 * t)
    np.savetxt(tmp_path / "a.csv", np.column_stack([t, P, 0.05 * P, P]), delimiter=",", header="t,p,x,c", comments="")
    (tmp_path / "m.yaml").write_text(
        "schema: pmabench.map/1\nname: m\nsource: test\nkind: recorded-sine\n"
        "file: {delimiter: comma, header: first line}\ncolumns:\n  t: {is: time, unit: s}\n"
        "  p: {is: pressure, unit: kPa}\n  x: {is: displacement, unit: mm}\n  c: {is: pressure_command, unit: kPa}\n"
        "sampling: {rate: [50 Hz, 200 Hz], gap: 50 ms}\ntrials: {by: file}\nspecimen: {type: M, serial: '1'}\n"
    )
    runs = runs_of([tmp_path / "a.csv"], tmp_path / "m.yaml", tmp_path / "runs")
    ratio = only(recorded_sines.reduce(runs), "P/x", frequency=0.75)
    assert ratio.value == pytest.approx(1e3 / 0.05e-3, rel=1e-3)


def test_traces_have_columns_of_one_length(steps, sines):
    for analysis in (recorded_steps.reduce(steps), recorded_sines.reduce(sines)):
        assert analysis.traces
        assert analysis.to_dict()["schema"]
        for trace in analysis.traces:
            assert len({len(column) for column in trace.columns.values()}) == 1
            assert set(trace.quantities) == set(trace.columns)


def test_recorded_steps_of_a_lab(tmp_path):
    files = recorded_data().glob("mit_2-151/*step_exp/*_data.dat")
    analysis = recorded_steps.reduce(runs_of(files, FIXTURES / "maps" / "mit-2-151-step.yaml", tmp_path))
    assert analysis.facts["trials"] == 11
    assert not analysis.dropped
    t_d = only(analysis, "t_d")
    assert 0 < t_d.value < 0.06
    K = only(analysis, "K", **{"from": 120e3, "pressure": 360e3})
    assert K.withheld, "0 to 30 ms between the channels move it by more than 15 %, and the cell moves with the stroke"
    assert K.note.startswith("a spring pulls, too"), "its force column moves with the stroke"
    assert only(analysis, "K", **{"from": 360e3, "pressure": 120e3}).value is None


def test_recorded_sines_of_a_lab(tmp_path):
    files = recorded_data().glob("mit_2-151/*frq*/*_data.dat")
    analysis = recorded_sines.reduce(runs_of(files, FIXTURES / "maps" / "mit-2-151-sine.yaml", tmp_path))
    assert len(analysis.facts["frequencies"]) == 7
    assert not analysis.dropped
    phases = [e for e in analysis.estimates if e.symbol == "phi_x"]
    assert all(e.value < 0 for e in phases)
    # 15 ms of the stamps either way, and a filter of 5 ms that neither the gauge nor the encoder declares
    assert [e.parts.method for e in phases] == pytest.approx(
        [hypot(w * 0.015, 2**0.5 * atan(w * 0.005)) for w in (1.57, 3.14, 6.28, 9.42, 12.56, 18.84, 31.4)]
    )


def test_a_recorded_pull_test_of_a_lab(tmp_path):
    files = recorded_data().glob("mit_2-151/*characterization_exp/*_data.dat")
    analysis = isometric.reduce(runs_of(files, FIXTURES / "maps" / "mit-2-151-pull.yaml", tmp_path))
    slopes = [e.value for e in analysis.estimates if e.symbol == "m" and e.method == isometric.METHOD]
    assert len(slopes) == 10
    assert slopes[0] == pytest.approx(0.885e-3, rel=0.01)
    assert analysis.facts["flagged"]["gap"] == 13


def test_spikes_of_many_files_are_one_doubt_for_each_channel():
    def old(name, *channels):
        reported = [
            {"level": "doubt", "kind": "spike", "channel": channel, "text": f"{channel}: alone"} for channel in channels
        ]
        reported.append({"level": "doubt", "kind": "dropout", "channel": "force", "text": "force: a cut wire"})
        return replace(
            as_run("isometric", []), manifest={"imported": {"folder": "f", "file": name, "findings": reported}}
        )

    found = import_findings([old("a", "pressure"), old("b", "pressure", "force"), old("c", "pressure")])
    assert [f.text for f in found] == [
        "f/a: force: a cut wire",
        "f/b: force: a cut wire",
        "f/c: force: a cut wire",
        "f/a: pressure: alone (and in 2 more files)",
        "f/b: force: alone",
    ]
    assert {f.level for f in found} == {"doubt"}
