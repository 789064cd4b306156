"""Campaigns of the independent simulators as runs of the project: lengths without load, held lengths, steps, loops."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pmabench.engine.laws.gain_steps import GainSteps
from pmabench.engine.laws.relay import Relay
from pmabench.kinds.arm_angle import reduction as arm_angle
from pmabench.kinds.closed_volume import reduction as closed_volume
from pmabench.kinds.free_contraction import reduction as free_contraction
from pmabench.kinds.isobaric_ramp import reduction as isobaric_ramp
from pmabench.kinds.isometric_pressurisation import reduction as isometric_pressurisation
from pmabench.kinds.joint_step import reduction as joint_step
from pmabench.kinds.joint_sweep import reduction as joint_sweep
from pmabench.kinds.joint_torque import reduction as joint_torque
from pmabench.kinds.platform_step import reduction as platform_step
from pmabench.kinds.positioning import reduction as positioning
from pmabench.kinds.recorded_sine import reduction as recorded_sine
from pmabench.kinds.recorded_step import reduction as recorded_step
from pmabench.kinds.relaxation import reduction as relaxation
from pmabench.kinds.step_displacement import reduction as step_displacement
from pmabench.kinds.ultimate_gain import reduction as ultimate_gain
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import ChannelInfo, ClockInfo, Command, Event, RunData, TrialData
from tests.judge import (
    arm,
    closed,
    displaced,
    filled,
    free,
    held,
    loop,
    pair,
    placed,
    relaxing,
    rung,
    servo,
    sines,
    swept,
    tilted,
)
from tests.judge.record import Trial, Truth

CHANNELS = {
    "pressure": ("pressure", "Pa"),
    "displacement": ("length", "m"),
    "force": ("force", "N"),
    "pressure_command": ("pressure", "Pa"),
    "angle": ("angle", "rad"),
    "torque": ("torque", "N m"),
    "pressure_1": ("pressure", "Pa"),
    "pressure_2": ("pressure", "Pa"),
    "flow": ("mass flow", "kg/s"),
    "pressure_3": ("pressure", "Pa"),
    **dict.fromkeys((f"acceleration_{axis}" for axis in "xyz"), ("acceleration", "m/s2")),
}
SPECIMEN = {"nominal_length": 0.25}


def as_run(
    kind: str, trials: Sequence[TrialData], rate: float, settings: dict[str, object],
    known: Mapping[str, Mapping[str, Any]] | None = None, late: Mapping[str, float] | None = None,
) -> RunData:  # fmt: skip
    """A run as `store` would load it; `known` of channels, and what streams' clocks are known to [s]."""
    names = {name for trial in trials for name in trial.channels} & set(CHANNELS)
    channels = {name: ChannelInfo(name, *CHANNELS[name], 1.0, 0.0, -np.inf, np.inf) for name in sorted(names)}
    channels |= {name: replace(channels[name], **facts) for name, facts in (known or {}).items()}
    clocks = {name: ClockInfo(uncertainty=bound, how="host arrivals") for name, bound in (late or {}).items()}
    return RunData(
        id="judged", path="", kind=kind, status="finished", simulated=True, manifest={"specimen": SPECIMEN},
        plan={"settings": settings}, events=(), channels=channels, rate=rate, trials=tuple(trials), clocks=clocks,
    )  # fmt: skip


def as_trials(trials: Sequence[Trial], found: Mapping[str, Mapping[str, object]] | None = None) -> list[TrialData]:
    """The trials as `store` would load them; `found` is what a search said."""
    return [
        TrialData(
            "judged", number, trial.point, trial.repeat, False, "finished", trial.t, dict(trial.channels),
            np.zeros(len(trial.t), dtype=np.uint16),
            tuple(Command(c.t, c.output, "ramp", c.value, c.before, c.phase, {"rate": c.rate}) for c in trial.commands),
            dict(found or {}),
        )
        for number, trial in enumerate(trials)
    ]  # fmt: skip


def free_contraction_of(cause: str, size: float, seed: int) -> Analysis:
    run = as_run("free-contraction", as_trials(free.campaign(cause, size, seed)), free.RATE,
                 {"nominal_length": free.LENGTH, "compare": "nothing"})  # fmt: skip
    return free_contraction.reduce([run])


def closed_volume_of(cause: str, size: float, seed: int) -> Analysis:
    trials, settings = closed.campaign(cause, size, seed)
    run = as_run("closed-volume", as_trials(trials, {"closed": {"found": True}}), closed.RATE,
                 {**settings, "by": "volume"})  # fmt: skip
    return closed_volume.reduce([run])


def sines_of(cause: str, size: float, seed: int) -> Analysis:
    return recorded_sine.reduce([as_run("recorded-sine", as_trials(sines.campaign(cause, size, seed)), sines.RATE, {})])


def rung_of(cause: str, size: float, seed: int) -> Analysis:
    trials = as_trials(rung.campaign(cause, size, seed))
    steps = [replace(one, commands=tuple(replace(c, kind="set") for c in one.commands)) for one in trials]
    return recorded_step.reduce([as_run("recorded-step", steps, rung.RATE, {})])


def arm_of(cause: str, size: float, seed: int) -> Analysis:
    run = as_run("arm-angle", as_trials(arm.campaign(cause, size, seed)), arm.RATE,
                 {"preload": arm.PRELOAD, "angle": "measured", "compare": "nothing"})  # fmt: skip
    return arm_angle.reduce([run])


def placed_of(cause: str, size: float, seed: int) -> Analysis:
    trials = []
    for one, record in zip(as_trials(found := placed.campaign(cause, size, seed)), found, strict=True):
        begin, setpoint = float(record.t[0]) + placed.BEFORE, record.point["setpoint"]
        law = {"t0": begin, "t1": begin + placed.HOLD, "ended": "time", "setpoint": setpoint}
        trials.append(replace(one, found={"position": law}))
    settings: dict[str, object] = {"window": list(placed.WINDOW), "band": placed.BAND}
    return positioning.reduce([as_run("positioning", trials, placed.RATE, settings)])


def isometric_of(cause: str, size: float, seed: int) -> Analysis:
    run = as_run("isometric-pressurisation", as_trials(held.campaign(cause, size, seed)), held.RATE, {})
    return isometric_pressurisation.reduce([run])


def filled_of(cause: str, size: float, seed: int) -> Analysis:
    run = as_run("isometric-pressurisation", as_trials(filled.campaign(cause, size, seed)), filled.RATE,
                 {"flow": filled.settings()})  # fmt: skip
    return isometric_pressurisation.reduce([run])


def steps_of(cause: str, size: float, seed: int) -> Analysis:
    run = as_run("step-displacement", as_trials(displaced.campaign(cause, size, seed)), displaced.RATE, {"discard": 1})
    return step_displacement.reduce([run])


def relaxing_of(cause: str, size: float, seed: int) -> Analysis:
    run = as_run("relaxation", as_trials(relaxing.campaign(cause, size, seed)), relaxing.RATE, {"begin": 5.0})
    return relaxation.reduce([run])


def swept_of(one: swept.Swept) -> Callable[[str, float, int], Analysis]:
    kind, reduce = (
        ("joint-sweep", joint_sweep.reduce) if one is swept.JOINT else ("isobaric-ramp", isobaric_ramp.reduce)
    )

    def reduced(cause: str, size: float, seed: int) -> Analysis:
        settings: dict[str, object] = {"discard": swept.DISCARD}
        return reduce([as_run(kind, as_trials(swept.campaign(one, cause, size, seed)), one.rate, settings)])

    return reduced


def pair_of(cause: str, size: float, seed: int) -> Analysis:
    settings: dict[str, object] = {"angles": list(pair.ANGLES)}
    run = as_run("joint-torque", as_trials(pair.campaign(cause, size, seed)), pair.RATE, settings)
    return joint_torque.reduce([run])


def servo_of(cause: str, size: float, seed: int) -> Analysis:
    found = servo.campaign(cause, size, seed)
    laws = [law for _, law in found]
    trials = [
        replace(one, found={"hold": law}) for one, law in zip(as_trials([t for t, _ in found]), laws, strict=True)
    ]
    settings, declared = {"band": servo.BAND, "begin": servo.BASELINE}, servo.declared(cause, size)
    steps = as_run("joint-step", [one for one in trials if "frequency" not in one.point], servo.RATE,
                   {**settings, "window": list(servo.WINDOW)}, *declared)  # fmt: skip
    sines = as_run("joint-step", [one for one in trials if "frequency" in one.point], servo.RATE,
                   {**settings, "window": [servo.SINES_FROM, servo.SINE_HOLD]}, *declared)  # fmt: skip
    return joint_step.reduce([steps, sines])


def tilted_of(cause: str, size: float, seed: int) -> Analysis:
    found = tilted.campaign(cause, size, seed)
    trials = [replace(one, found={"step": law}) for one, (_, law, _) in
              zip(as_trials([trial for trial, _, _ in found]), found, strict=True)]  # fmt: skip
    events = tuple(
        Event(n, trial.t[0], "steered", {"pulses": pulses, "aims": []}) for n, (trial, _, pulses) in enumerate(found)
    )
    settings = {"level": tilted.LEVEL, "hold": tilted.HOLD, "chain": "reference", "height": tilted.ABOVE}
    run = as_run("platform-step", trials, tilted.RATE, settings, *tilted.declared(cause, size))
    return platform_step.reduce([replace(run, events=events)])


def swept_truth(one: swept.Swept, key: str) -> Callable[[str, float], Truth]:
    return lambda cause, size: swept.truth(one, cause, size)[key]


def _swung(law: GainSteps | Relay, plant: loop.Plant) -> Analysis:
    rows = []
    while not law.done and plant.time < 300.0:
        t, values = plant.time, plant.read()
        command = law.update(t, values)
        rows.append((t, values["displacement"], values["pressure"], command))
        plant.step(command)
    t, x, P, u = np.array(rows).T
    return _loop(t, {"displacement": x, "pressure": P, "pressure_command": u}, (), {"ultimate-gain": law.result()})


def _loop(t: np.ndarray, channels: dict[str, np.ndarray], commands: tuple[Command, ...], found: dict) -> Analysis:
    point = {"setpoint": loop.SETPOINT, "load": 0.0, "bias": loop.BIAS}
    flags = np.zeros(len(t), dtype=np.uint16)
    trial = TrialData("judged", 0, point, 0, False, "finished", t, channels, flags, commands, found)
    return ultimate_gain.reduce([as_run("ultimate-gain", [trial], loop.RATE, {})])


def gain_steps_of(cause: str, size: float, seed: int) -> Analysis:
    K_u = loop.truth("clean", 0.0)[0]
    law = GainSteps(
        setpoint=loop.SETPOINT, bias=loop.BIAS, start=0.6 * K_u, low=50e3, high=450e3, noise=2e-6, factor=1.06
    )
    return _swung(law, loop.Plant(cause, size, seed))


def relay_of(cause: str, size: float, seed: int) -> Analysis:
    law = Relay(
        setpoint=loop.SETPOINT, bias=loop.BIAS, low=50e3, high=450e3, amplitudes=[20e3, 40e3],
        hysteresis=[0.1e-3, 0.2e-3], periods=12, level_time=20.0, settle=4.0, window=0.03,
    )  # fmt: skip
    return _swung(law, loop.Plant(cause, size, seed))


def open_loop_of(cause: str, size: float, seed: int) -> Analysis:
    plant, hold = loop.Plant(cause, size, seed), 2.5
    values = (20e3, 0.0, -20e3, 0.0) * 6
    at = 1.0 + hold * np.arange(len(values))
    commands = tuple(
        Command(t, "pressure", "set", loop.BIAS + value, loop.BIAS + before, "open-loop")
        for t, value, before in zip(at.tolist(), values, (0.0, *values[:-1]), strict=True)
    )
    rows = []
    for number in range(round((at[-1] + hold) * loop.RATE)):
        t = number / loop.RATE
        read = plant.read()
        rows.append((t, read["displacement"], read["pressure"]))
        step = int(np.searchsorted(at, t + 1e-9, side="right"))
        plant.step(loop.BIAS + (values[step - 1] if step else 0.0))
    t, x, P = np.array(rows).T
    return _loop(t, {"displacement": x, "pressure": P}, commands, {})


def _loop_truth(cause: str, size: float) -> Truth:
    ends = [loop.truth(cause, size, at=at) for at in ((0.0, 120.0) if cause == "gain-drift" else (0.0,))]
    return {
        (symbol, "", 0.0): (min(values), max(values))
        for symbol, values in zip(("K_u", "T_u"), zip(*ends, strict=True), strict=True)
    }


SMALL_STEPS = {cause: size for cause, size in loop.FULL.items() if cause != "slew"}
"""Steps of 20 kPa through the regulator's lag rise by 200 kPa/s: its limit of 300 kPa/s never acts."""


@dataclass(frozen=True)
class Kind:
    """One kind of test with its judge."""

    reduced: Callable[[str, float, int], Analysis]
    truth: Callable[..., Truth]
    full: dict[str, float]
    key: str | Callable[[Mapping[str, float]], float]
    """Name of the coordinate by which values are told apart, or a number for each of them."""
    methods: tuple[str, ...] = ()
    """Those that are judged; all where empty."""
    seeded: bool = False
    """Whether the truth is that of the very trials, and needs the seed."""


KINDS = {
    "closed-volume": Kind(closed_volume_of, closed.truth, closed.FULL, "contraction"),
    "free-contraction": Kind(free_contraction_of, free.truth, free.FULL, "pressure"),
    "isometric-pressurisation": Kind(isometric_of, held.truth, held.FULL, ""),
    "mass-flow": Kind(
        filled_of, filled.truth, filled.FULL, "contraction", ("mass flow, filling", "mass flow, mean while filling")
    ),
    "step-displacement": Kind(steps_of, displaced.truth, displaced.FULL, "step"),
    "recorded-sine": Kind(sines_of, sines.truth, sines.FULL, "frequency"),
    "recorded-step": Kind(rung_of, rung.truth, rung.FULL, "from"),
    "arm-angle": Kind(arm_of, arm.truth, arm.FULL, "tip_mass"),
    "positioning": Kind(placed_of, placed.truth, placed.FULL, "setpoint"),
    "relaxation": Kind(relaxing_of, relaxing.truth, relaxing.FULL, "pressure"),
    "joint-sweep": Kind(swept_of(swept.JOINT), swept_truth(swept.JOINT, "pressure_1"), swept.JOINT.full, "pressure_1"),
    "joint-torque": Kind(pair_of, pair.truth, pair.FULL, pair.place),
    "joint-step": Kind(servo_of, servo.truth, servo.FULL, servo.place, seeded=True),
    "platform-step": Kind(tilted_of, tilted.truth, tilted.FULL, tilted.place, seeded=True),
    "isobaric-gap": Kind(
        swept_of(swept.MUSCLE), swept_truth(swept.MUSCLE, "speed"), swept.MUSCLE.full, "speed", ("loop-gap",)
    ),
    "isobaric-line": Kind(
        swept_of(swept.MUSCLE),
        swept_truth(swept.MUSCLE, "pressure"),
        swept.MUSCLE.full,
        "pressure",
        ("loop-gap", "mean-curve"),
    ),
    "open-loop": Kind(open_loop_of, _loop_truth, SMALL_STEPS, "none"),
    "relay": Kind(relay_of, _loop_truth, loop.FULL, "none", ("relay-fit",)),
    "gain-steps": Kind(gain_steps_of, _loop_truth, loop.FULL, "none"),
}


@dataclass(frozen=True)
class Value:
    """One value against the truth; `score` is its distance from the nearest right one in half widths."""

    name: str
    value: float
    low: float
    high: float
    half: float

    @property
    def score(self) -> float:
        error = max(self.low - self.value, self.value - self.high, 0.0)
        if error <= 1e-9 * abs(self.value):
            return 0.0
        return error / self.half if self.half else np.inf


def judged(kind: str, cause: str, size: float, seed: int) -> tuple[list[Value], list[str]]:
    """Values with an interval that the truth knows, and what is withheld or dropped and why; a bound is 0 +- it."""
    one = KINDS[kind]
    analysis = one.reduced(cause, size, seed)
    right = one.truth(cause, size, seed) if one.seeded else one.truth(cause, size)
    values, withheld = [], [one.reason for one in analysis.dropped]
    for e in analysis.estimates:
        if one.methods and e.method not in one.methods:
            continue
        place = one.key(e.at) if callable(one.key) else e.at.get(one.key) if one.key else next(iter(e.at.values()), 0.0)
        coordinate = e.coordinate
        if kind == "step-displacement":
            coordinate = coordinate or (
                {"step, relaxed": "relaxed", "step, peak": "peak"}.get(e.method, "") if e.symbol == "K" else ""
            )
        name = f"{e.symbol} {coordinate} {e.method} {place}"
        if e.withheld:
            withheld.append(f"{name}: {e.note}")
        near = [span for (symbol, of, at), span in right.items()
                if (symbol, of) == (e.symbol, coordinate) and abs(at - (place or 0.0)) < 1e-3 * max(1e-3, abs(at))]  # fmt: skip
        if e.bound is not None and near:
            values.append(Value(name, 0.0, *near[0], e.bound))
        if e.value is not None and e.parts.combined is not None and near:
            values.append(Value(name, e.value, *near[0], e.parts.combined))
    return values, withheld
