"""Campaigns of the independent simulators `tests.judge` as runs of the project, with the limits of its protocol."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from pmabench.files.document import read_document
from pmabench.store.records import ChannelInfo, ClockInfo, Command, RunData, TrialData
from tests.judge import campaign as first
from tests.judge.second import campaign as second
from tests.judge.second.driven import AWAY, LEAD, SAMPLED, Record

Trial = first.Trial | second.Trial

PROTOCOL = Path(__file__).resolve().parents[2] / "protocols" / "contraction-relaxation.yaml"
EXACT = 1e-6
"""Uncertainty [m] of the displacement sensors of the simulated benches: they are straight, and have no backlash."""
CHANNELS = {"pressure": ("pressure", "Pa"), "displacement": ("length", "m"), "force": ("force", "N")}


@lru_cache(maxsize=1)
def accepted() -> dict[str, object]:
    """The limits of the shipped protocol, as a plan has them: K +- 2 %."""
    asked = read_document(PROTOCOL).data["accept"]
    return {
        "limits": [
            {"what": what, "measure": measure, "limit": float(str(limit).removesuffix("%")) / 100, "place": ""}
            for what, limits in asked.items()
            for measure, limit in limits.items()
        ]
    }


def as_run(trials: Sequence[Trial], name: str = "judged", sensor: float = EXACT) -> RunData:
    """The campaign as `store` would load it; every trial begins with its moment at rest, as own runs record it.

    `sensor` is the uncertainty of the displacement that its record states [m]; 0: none is stated.
    """
    return RunData(
        id=name, path="", kind="contraction-relaxation", status="finished", simulated=True, manifest={},
        plan={"accept": accepted()}, events=(), channels={
            channel: ChannelInfo(
                channel, quantity, unit, 1.0, 0.0, -np.inf, np.inf, sensor if channel == "displacement" else 0.0
            )
            for channel, (quantity, unit) in CHANNELS.items()
        }, rate=_rate(trials), trials=tuple(_trial(name, number, trial) for number, trial in enumerate(trials)),
    )  # fmt: skip


def polled(run: RunData, scatter: float, seed: int) -> RunData:
    """The run as a computer polls it, one device a channel: each sample is taken up to `scatter` [s] from its stamp."""
    random = np.random.default_rng([seed, 1000])

    def taken(trial: TrialData) -> TrialData:
        late = {name: random.uniform(-scatter, scatter, len(trial.t)) for name in CHANNELS}
        channels = {name: np.interp(trial.t + late[name], trial.t, trial.channels[name]) for name in CHANNELS}
        return replace(trial, channels={**trial.channels, **channels})

    return replace(
        run,
        trials=tuple(taken(trial) for trial in run.trials),
        channels={name: replace(channel, stream=name) for name, channel in run.channels.items()},
        clocks={name: ClockInfo(uncertainty=scatter / 2, how="stamped by the computer") for name in run.channels},
    )


def _rate(trials: Sequence[Trial]) -> float:
    return round(1.0 / float(np.mean(np.diff(trials[0].t))), 3)


def _trial(run: str, number: int, trial: Trial) -> TrialData:
    values = [0.0, *(value for _, value in trial.commands)]
    phases = ["contract", *["relax"] * (len(trial.commands) - 2), "vent"]
    commands = tuple(
        Command(at, "pressure", "set", value, before, phase)
        for (at, value), before, phase in zip(trial.commands, values[:-1], phases, strict=True)
    )
    command = np.zeros(len(trial.t))
    for at, value in trial.commands:
        command[trial.t >= at - 1e-9] = value
    channels = {name: getattr(trial, name) for name in CHANNELS} | {"pressure_command": command}
    point = {"load": trial.load, "mass": trial.mass, "pressure": trial.target}
    flags = np.zeros(len(trial.t), dtype=np.uint16)
    return TrialData(run, number, point, 0, False, "finished", trial.t, channels, flags, commands, {})


SLOW = {
    "isobaric-ramp": "isobaric-ramp",
    "isometric-pressurisation": "isometric-pressurisation",
    "step": "isometric-pressurisation",
    "sine": "sinusoidal-displacement",
    "hold": "sinusoidal-displacement",
    "random": "sinusoidal-displacement",
}
"""Test of the second muscle with a driven end -> the kind of test of the project that records the like."""


def as_slow_runs(records: Sequence[Record]) -> list[RunData]:
    """Tests with a driven end as runs, one a kind, whose trials follow each other as they were done."""
    runs: dict[str, list[tuple[float, Record]]] = {}
    begin = 0.0
    for record in records:
        runs.setdefault(SLOW[record.kind], []).append((begin, record))
        begin += float(record.t[-1]) + LEAD + AWAY
    channels = {name: ChannelInfo(name, quantity, unit, 1.0, 0.0, -np.inf, np.inf)
                for name, (quantity, unit) in CHANNELS.items()}  # fmt: skip

    def trial(run: str, number: int, begin: float, one: Record) -> TrialData:
        values = {name: getattr(one, name) for name in CHANNELS}
        values |= {"pressure_command": one.command, "displacement_command": one.way}
        point = {"contraction" if name == "displacement" else name: value for name, value in one.point.items()}
        flags = np.zeros(len(one.t), dtype=np.uint16)
        return TrialData(run, number, point, 0, False, "finished", begin + one.t, values, flags, (), {})

    return [
        RunData(
            id=kind, path="", kind=kind, status="finished", simulated=True, manifest={}, plan={}, events=(),
            channels=channels, rate=SAMPLED, trials=tuple(trial(kind, n, *one) for n, one in enumerate(mine)),
        )
        for kind, mine in runs.items()
    ]  # fmt: skip
