"""Runs as the engine would record them, made from pmabench.model: contraction-relaxation and static-load; for tests.

Noise comes from numpy, with the sizes of the preset; `quantised` rounds to the counts of the mock bench's calibrations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.optimize import brentq

from pmabench.model.muscle import Muscle
from pmabench.model.plant import Plant
from pmabench.model.presets import Setup, preset
from pmabench.model.regulator import Wave, constant, ramp
from pmabench.store.records import Array, ChannelInfo, Command, RunData, TrialData

RATE = 500.0
G = 9.81
LOADS = tuple(58.86 + 49.05 * i for i in range(11))
"""6, 11 .. 56 kg as weights [N]."""
PRESSURES = tuple(1e3 * p for p in range(150, 501, 50))
UNITS = {
    "pressure": ("pressure", "Pa", 1e6 / 65535, 1500.0),
    "displacement": ("length", "m", 0.1 / 200000, 20e-6),
    "force": ("force", "N", 2000.0 / 65535, 1.0),
    "pressure_command": ("pressure", "Pa", 1e6 / 65535, 0.0),
}
"""Channel -> quantity, unit, one count [SI], expanded offset uncertainty (calibrations of the mock bench)."""


@dataclass(frozen=True)
class Rig:
    """A simulated bench: plant, how loads act, what is recorded."""

    setup: Setup
    hanging: bool = True
    cell: bool = True
    quantised: bool = True
    uncertainty: bool = False
    """The calibrations' uncertainties are given to the reduction."""

    @property
    def muscle(self) -> Muscle:
        return self.setup.muscle

    def mass(self, load: float) -> float:
        """Moving mass [kg] of a load [N]: a weight with its carriage, or 0.5 kg."""
        return load / G + 2.0 if self.hanging else 0.5


def rig(plant: str = "paper0", kind: str = "bench", **changes: Any) -> Rig:
    """The mock bench of a preset; `ideal` has pure forces, no counts."""
    real = kind == "bench"
    return replace(Rig(preset(plant, kind), hanging=real, quantised=real), **changes)


def steps(pressure: float, by: float = 100e3) -> list[tuple[float, float, float, str]]:
    """Commands of one trial: time [s], value [Pa], before [Pa], phase."""
    commands = [(0.2, pressure, 0.0, "contract")]
    t, value = 10.2, pressure
    while value - by > 1e-6:
        commands.append((t, value - by, value, "relax"))
        t, value = t + 4.0, value - by
    commands.append((t, 0.0, value, "vent"))
    return commands


def contraction_run(
    bench: Rig,
    cells: Sequence[tuple[float, float]] | None = None,
    repeats: int = 1,
    seed: int = 1,
    name: str = "r1",
) -> RunData:
    """A contraction-relaxation run over `cells` of (load [N], pressure [Pa]); None: all 88."""
    if cells is None:
        cells = [(load, pressure) for load in LOADS for pressure in PRESSURES]
    noise = np.random.default_rng(seed)
    trials = []
    start = 5.0
    motions = [_contract(bench, load, pressure) for load, pressure in cells]
    for repeat in range(repeats):
        for (load, pressure), (t, clean) in zip(cells, motions, strict=True):
            point = {"load": load, "mass": bench.mass(load), "pressure": pressure}
            commands = tuple(
                Command(start + at, "pressure", "set", value, before, phase)
                for at, value, before, phase in steps(pressure)
            )
            trials.append(_trial(bench, noise, name, len(trials), point, repeat, start + t, clean, commands, {}))
            start += float(t[-1]) + 1.0
    return _run("contraction-relaxation", bench, trials, name)


def static_run(
    bench: Rig, loads: Sequence[float] = LOADS, repeats: int = 5, seed: int = 1, name: str = "s1", moved: float = 20e-6
) -> RunData:
    """A static-load run: lift and set-down searched as protocols/static-load.yaml does, at 2 kPa/s."""
    noise = np.random.default_rng(seed)
    rate, window = 2e3, 5
    trials = []
    found: dict[str, Mapping[str, float]]
    for load in loads:
        near = brentq(lambda P, load=load: bench.muscle.F_ce(P) - load, 0.0, 1e6)
        low = max(0.0, near - 25e3)
        plant = Plant(bench.muscle, bench.setup.regulator, force=load, mass=bench.mass(load))
        plant.command(constant(0.0, low))
        rise = 70e3 / rate
        plant.command(ramp(2.0, low, low + 70e3, rate))
        plant.command((Wave(2.0 + rise + 2.0, low + 70e3, slope=-rate),))
        t = np.arange(0.0, 4.0 + 2 * rise, 1 / RATE)
        motion = plant.advance(float(t[-1]), t)
        clean = {"pressure": motion.P, "displacement": motion.x, "force": motion.F, "pressure_command": motion.P_set}
        for repeat in range(repeats):
            point = {"load": load, "mass": bench.mass(load)}
            trial = _trial(bench, noise, name, len(trials), point, repeat, t, clean, (), {})
            found = {}
            for phase, part in (("lift", t < 2.0 + rise), ("set-down", t >= 4.0 + rise)):
                x = trial.channels["displacement"]
                beyond = (x > moved if phase == "lift" else x < moved) & part
                runs = np.convolve(beyond, np.ones(window), mode="full")[: len(x)] >= window
                if runs.any():
                    hit = int(np.argmax(runs))
                    rows = slice(hit - window + 1, hit + 1)
                    means = {key: float(np.mean(column[rows])) for key, column in trial.channels.items()}
                    found[phase] = {"found": True, "t": float(t[hit]), **means}
                else:
                    found[phase] = {"found": False, "reason": "displacement did not cross before the end of the range"}
            trials.append(replace(trial, found=found))
    return _run("static-load", bench, trials, name)


@lru_cache(maxsize=64)
def _contract(bench: Rig, load: float, pressure: float) -> tuple[Array, dict[str, Array]]:
    """Noise-free samples of one trial."""
    commands = steps(pressure)
    plant = Plant(bench.muscle, bench.setup.regulator, force=load, mass=bench.mass(load))
    waves = tuple(wave for at, value, _, _ in commands for wave in constant(at, value))
    plant.command(waves)
    t = np.arange(round((commands[-1][0] + 6.0) * RATE) + 1) / RATE
    motion = plant.advance(float(t[-1]), t)
    return t, {"pressure": motion.P, "displacement": motion.x, "force": motion.F, "pressure_command": motion.P_set}


def _trial(
    bench: Rig,
    noise: np.random.Generator,
    run: str,
    index: int,
    point: Mapping[str, float],
    repeat: int,
    t: Array,
    clean: Mapping[str, Array],
    commands: tuple[Command, ...],
    found: Mapping[str, Mapping[str, Any]],
) -> TrialData:
    channels = {}
    for name, values in clean.items():
        if name == "force" and not bench.cell:
            continue
        sigma = getattr(bench.setup.noise, name, 0.0)
        measured = values + sigma * noise.standard_normal(len(values)) if sigma else values
        count = UNITS[name][2]
        channels[name] = np.rint(measured / count) * count if bench.quantised else measured
    flags = np.zeros(len(t), dtype=np.uint16)
    return TrialData(run, index, dict(point), repeat, False, "finished", t, channels, flags, commands, found)


def _run(kind: str, bench: Rig, trials: Sequence[TrialData], name: str) -> RunData:
    infos = {}
    for channel in trials[0].channels:
        quantity, unit, _, uncertainty = UNITS[channel]
        offset = uncertainty if bench.uncertainty else 0.0
        infos[channel] = ChannelInfo(channel, quantity, unit, 1.0, 0.0, -np.inf, np.inf, offset_uncertainty=offset)
    return RunData(
        id=name, path="", kind=kind, status="finished", simulated=True, manifest={}, plan={}, events=(),
        channels=infos, rate=RATE, trials=tuple(trials),
    )  # fmt: skip


__all__ = ["LOADS", "PRESSURES", "Rig", "contraction_run", "rig", "static_run", "steps"]
