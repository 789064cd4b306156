"""Open-loop steps recorded on simulated benches against the phase equation; friction is told and gives no number."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import brentq

from pmabench.analysis.trial import Quick
from pmabench.cli.main import main
from pmabench.cli.prepare import prepare
from pmabench.display.verdicts import measure
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.ultimate_gain.open_loop import examine
from pmabench.kinds.ultimate_gain.open_loop_fit import Step, fit
from pmabench.kinds.ultimate_gain.reduction import reduce
from pmabench.model.loop import ultimate
from pmabench.store.analyses.results import Analysis
from pmabench.store.reader import open_run
from pmabench.store.records import RunData
from tests.analysis.test_ultimate_gain import texts, theory

SPECIMEN = {"mock": "mas-20-250-paper0", "mock-serres2009": "mas-20-250-serres2009", "mock-dmsp": "dmsp-40-305"}
FREE = {"friction": 0, "b_relax": "b_contract"}


def paper0(P: float) -> tuple[float, float, float, float]:
    """F_ce [N], K [N/m], B_c and B_r [N.s/m] of plant 5.1 at P [Pa]."""
    p = P / 1e3
    return 1.08 * p - 49.0, 5600 + p + 9.7e-3 * p * p, 1200 + 1.6 * p, 1100 + 3.4 * p


def serres2009(P: float) -> tuple[float, float, float, float]:
    p = P / 1e3
    K = 32.7 - 0.0321 * p if p <= 314 else 17 + 0.0179 * p
    return 2.91 * p + 44.6, 1e3 * K, 2900.0, 1570.0 if p <= 372 else 311 + 3.38 * p


LAWS = {"mock": paper0, "mock-serres2009": serres2009}


def at(bench: str, x: float, load: float, mass: float, lag: float, same: bool) -> tuple[float, float, float]:
    """Bias [Pa] that holds x [m], K_u and T_u there; a hanging mass M makes a second lag of M x'' + B x' + K x."""
    law = LAWS[bench]
    P = float(brentq(lambda p: law(p)[0] - load - law(p)[1] * x, 5e4, 6e5))
    _, K, B_c, B_r = law(P)
    slope = (np.array(law(P + 50)) - np.array(law(P - 50))) / 100
    B = B_c if same else (B_c + B_r) / 2
    root = (B * B - 4 * mass * K) ** 0.5
    pair = [(B + root) / (2 * K), (B - root) / (2 * K)]
    return (P, *theory((slope[0] - slope[1] * x) / K, 0.041, lag, *pair))


def recorded(
    out: Path, bench: str, x: float, P: float, load: str = "0 kg", amplitude: str = "20 kPa", **options: Any
) -> RunData:
    """The shipped protocol on a shipped bench, with its set-point, bias and options of the simulated muscle."""
    settings = [
        ("sweep.zip.setpoint", f"[{x * 1e3:.4g} mm]"),
        ("sweep.zip.bias", f"[{P / 1e3:.4f} kPa]"),
        ("sweep.zip.load", f"[{load}]"),
        ("trial.open_loop.amplitude", amplitude),
        ("trial.pressure", "[20 kPa, 550 kPa]"),
        ("prepare.precondition.cycles", "0"),
    ]
    prepared = prepare("ultimate-gain-open-loop", bench, SPECIMEN[bench], settings)
    devices = tuple(replace(d, options={**d.options, **options}) for d in prepared.mounted.bench.devices)
    mounted = replace(prepared.mounted, bench=replace(prepared.mounted.bench, devices=devices))
    outcome = run_plan(prepared.plan, mounted, ConfirmedBeforehand(), out=out)
    assert outcome.status == "finished", outcome.why
    return open_run(outcome.folder)


def found(analysis: Analysis) -> dict[str, Any]:
    return {e.symbol: e for e in analysis.estimates if e.method == "open-loop"}


CASES = [
    ("mock", 0.03, "0 kg", 0.0955, FREE),
    ("mock-serres2009", 0.045, "0 kg", 0.0955, FREE),
]
MORE = [
    ("mock", 0.03, "0 kg", 0.22, {"friction": 0}),
    ("mock", 0.01, "0 kg", 0.0955, FREE),
    ("mock", 0.05, "0 kg", 0.0955, {"friction": 0}),
    ("mock", 0.03, "11 kg", 0.0955, FREE),
    ("mock", 0.02, "31 kg", 0.05, FREE),
    ("mock-serres2009", 0.025, "0 kg", 0.0955, {"friction": 0, "seed": 5}),
    ("mock-serres2009", 0.04, "21 kg", 0.15, {**FREE, "noise": 3}),
]


@pytest.mark.parametrize(
    ("bench", "x", "load", "lag", "options"), [*CASES, *(pytest.param(*case, marks=pytest.mark.study) for case in MORE)]
)
def test_steps_give_the_phase_equations_values(
    tmp_path: Path, bench: str, x: float, load: str, lag: float, options: dict[str, Any]
) -> None:
    kilograms = float(load.partition(" ")[0])
    P, K_u, T_u = at(bench, x, kilograms * 9.81, kilograms + 2.0, lag, "b_relax" in options)
    run = recorded(tmp_path, bench, x, P, load, regulator_lag=lag, **options)
    assert run.trials[0].point["load"] == pytest.approx(kilograms * 9.81)
    assert run.trials[0].point["mass"] == kilograms + 2.0
    analysis = reduce([run])
    reported = found(analysis)
    assert reported["K_u"].value == pytest.approx(K_u, rel=0.02)
    assert reported["T_u"].value == pytest.approx(T_u, rel=0.02)
    for symbol, truth in (("K_u", K_u), ("T_u", T_u)):
        low, high = reported[symbol].ci95
        assert low < truth < high
        assert high - low < 0.1 * truth
        assert reported[symbol].at["setpoint"] == pytest.approx(x)
    assert "friction" not in texts(analysis, "doubt")
    (loop,) = analysis.facts["loops"]
    assert loop["dead_time"] == pytest.approx(0.041, abs=1e-3)
    assert loop["lags"][0] == pytest.approx(lag, rel=0.02)
    assert {entry["rule"] for entry in analysis.facts["tuning"]} >= {"Ziegler-Nichols PI", "SIMC PI", "SIMC PID"}


def test_friction_gives_no_number_and_its_size(tmp_path: Path) -> None:
    """10 N to break away, 6 N while it moves, of plant 5.1, where 1 kPa is worth 1.08 N less 30 mm times K's slope."""
    P, _, _ = at("mock", 0.03, 0.0, 2.0, 0.0955, False)
    run = recorded(tmp_path, "mock", 0.03, P)
    analysis = reduce([run])
    assert found(analysis)["K_u"].value is None
    assert "stiction: rests reached from above and from below" in texts(analysis, "fault")
    assert analysis.facts["tuning"] == []
    friction = examine(run, run.trials[0]).friction
    assert friction is not None
    per_pascal = (paper0(P + 50)[0] - paper0(P - 50)[0] - 0.03 * (paper0(P + 50)[1] - paper0(P - 50)[1])) / 100
    assert friction.balance.coulomb * per_pascal == pytest.approx(6.0, rel=0.05)
    assert friction.balance.tau == pytest.approx([paper0(P)[2] / paper0(P)[1], paper0(P)[3] / paper0(P)[1]], rel=0.05)


@pytest.fixture(scope="module")
def free(tmp_path_factory: pytest.TempPathFactory) -> RunData:
    return recorded(tmp_path_factory.mktemp("free"), "mock", 0.03, at("mock", 0.03, 0.0, 2.0, 0.0955, True)[0], **FREE)


def test_a_set_point_next_to_the_bias_is_taken_by_the_curve_or_refused(free: RunData) -> None:
    trial = free.trials[0]
    near = reduce([replace(free, trials=(replace(trial, point={**trial.point, "setpoint": 0.032}),))])
    _, K_u, T_u = at("mock", 0.032, 0.0, 2.0, 0.0955, True)
    assert found(near)["K_u"].value == pytest.approx(K_u, rel=0.02)
    assert found(near)["T_u"].value == pytest.approx(T_u, rel=0.02)
    far = reduce([replace(free, trials=(replace(trial, point={**trial.point, "setpoint": 0.05}),))])
    assert found(far)["K_u"].value is None
    assert "not through the set-point of 50 mm; try a bias of" in texts(far, "fault")


def test_what_cannot_be_used_gives_a_reason(free: RunData) -> None:
    trial = free.trials[0]
    still = {name: np.full_like(column, column.mean()) for name, column in trial.channels.items()}
    few = tuple(command for command in trial.commands if command.t < trial.t[0] + 25.0)
    dry = {name: column for name, column in trial.channels.items() if name != "pressure"}
    for changed, reason in (
        (replace(trial, channels=still), "not to be seen above the noise"),
        (replace(trial, commands=few), "whole cycles of steps, 3 are needed"),
        (replace(trial, channels=dry), "the pressure is not recorded"),
        (
            replace(trial, channels={**trial.channels, "displacement": -trial.channels["displacement"]}),
            "does not contract",
        ),
        (replace(trial, flags=np.full_like(trial.flags, 2 + 1)), "not sampled"),
    ):
        analysis = reduce([replace(free, trials=(changed,))])
        assert reason in analysis.dropped[0].reason
        assert all(e.value is None for e in analysis.estimates)


def test_the_line_after_a_trial_shows_the_same(free: RunData) -> None:
    reported, doubts = measure(free, free.trials[0], None, Quick())
    assert doubts == []
    found_there = examine(free, free.trials[0])
    assert found_there.loop is not None
    assert [one.value for one in reported] == [ultimate(found_there.loop).gain, ultimate(found_there.loop).period]


def test_tune_prints_the_settings_of_recorded_steps(free: RunData) -> None:
    reported = CliRunner().invoke(main, ["tune", "--steps", free.path])
    assert reported.exit_code == 0, reported.output
    line = reported.stdout.splitlines()[0]
    assert re.match(
        r"at setpoint 30 mm, load 0 N, bias .* kPa, mass 2 kg: K_u = 60\.\d+ kPa/mm \+- .* \(open-loop\)", line
    )
    for column in ("Ziegler-Nichols PI", "SIMC PID", "phase margin"):
        assert column in " ".join(reported.stdout.split())
    data = json.loads(CliRunner().invoke(main, ["tune", "--steps", free.path, "--rule", "SIMC", "--json"]).stdout)
    assert {row["form"] for row in data["settings"]} == {"PI", "PID"}
    assert all(row["margins"]["M_s"] < 2.0 for row in data["settings"])
    assert [e["symbol"] for e in data["ultimate"]] == ["K_u", "T_u"]


def test_tune_refuses_runs_without_steps(free: RunData, tmp_path: Path) -> None:
    for args, says, code in (
        (["--steps"], "--steps takes runs", 2),
        ([free.path], "--steps takes runs", 2),
        (["--steps", free.path, "--ku", "7 bar/cm"], "--steps takes runs and nothing else", 2),
        (["--steps", str(tmp_path)], "", 3),
        (["--ku", "7.1 bar/cm", "--tu", "9 s", "--rule", "SIMC"], "SIMC needs the loop itself", 2),
    ):
        reported = CliRunner().invoke(main, ["tune", *args])
        assert reported.exit_code == code, reported.output
        assert says in " ".join(reported.output.split())


@pytest.mark.parametrize("late", [-0.4e-3, 0.4e-3])
def test_a_muscle_without_inertia_is_neither_slower_nor_faster_than_it_is(late: float):
    """Lags of 0.1 s and 0.25 s in closed form, the displacement `late` [s]: what is not in the lags has a sign."""
    t = np.arange(0.0, 31.0, 2e-3)
    heights = (20e3, -20e3, -20e3, 20e3) * 3
    values = np.cumsum(heights)
    steps = [Step(1.0 + 2.5 * i, float(v), h) for i, (v, h) in enumerate(zip(values, heights, strict=True))]

    def after(s: np.ndarray, of: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        return sum(step.height * np.where(s > step.t, of(np.maximum(s - step.t, 0.0)), 0.0) for step in steps)

    P = after(t - 0.03, lambda s: 1 - np.exp(-s / 0.1))
    x = 0.15e-6 * after(t - 0.03 - late, lambda s: 1 - (0.25 * np.exp(-s / 0.25) - 0.1 * np.exp(-s / 0.1)) / 0.15)
    found = fit(t, 30e-3 + x, P, steps, 0.0)
    assert not isinstance(found, str)
    assert found[1].beta == 0.0
    assert found[1].late == pytest.approx(late, abs=0.02e-3)
    assert found[1].tau == pytest.approx((0.25, 0.25), abs=1e-3)
