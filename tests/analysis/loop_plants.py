"""Loops at random about the project's own plants, for studies of many seeds: muscle, mass, set-point, regulator, noise.

They are none of those on which thresholds were set: those are plant 5.1 of `loop_rig` and seeds below 10,000.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from pmabench.engine.laws.gain_steps import GainSteps
from pmabench.engine.laws.relay import Relay
from pmabench.kinds.ultimate_gain.reduction import reduce
from pmabench.model.plant import Plant
from pmabench.model.presets import Overrides, preset
from pmabench.model.regulator import constant
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import Command, TrialData
from tests.analysis.loop_rig import TS, as_run, as_trial
from tests.analysis.test_ultimate_gain import theory

BENT = {"paper0": (), "serres2009": (150e3, 314e3, 372e3)}
"""Pressures [Pa] where a coefficient has a kink; a loop that swings over one is not linear."""


@dataclass
class Case:
    """One plant at rest at its set-point."""

    seed: int
    friction: float = 0.0
    """Kinetic friction [N]; the static one is 10/6 of it."""
    muscle: str = ""
    """One of `BENT` with `setpoint` [m], in place of one at random; kinks are then not avoided."""
    setpoint: float = 0.0

    def __post_init__(self) -> None:
        self.random = r = random.Random(self.seed)
        while True:
            name = self.muscle or r.choice(list(BENT))
            self.same = r.random() < 0.5
            self.lag, self.dead_time = r.uniform(0.05, 0.25), r.uniform(0.02, 0.06)
            self.mass, self.x, self.noise = (
                r.choice([2.0, 7.0, 12.0]),
                r.uniform(0.012, 0.05),
                r.choice([0.5, 1.0, 2.0]),
            )
            self.x = self.setpoint or self.x
            change = Overrides(
                F_s=self.friction / 0.6, F_c=self.friction, regulator_lag=self.lag, dead_time=self.dead_time,
                b_relax="b_contract" if self.same else None,
            )  # fmt: skip
            self.setup = preset(name, "bench", change)
            self.load = (self.mass - 2.0) * 9.81
            if self._balance(6e4) < 0 < self._balance(4.8e5):
                self.P = float(brentq(self._balance, 6e4, 4.8e5))
                if self.setpoint or all(abs(self.P - kink) > 5e4 for kink in BENT[name]):
                    break
        F, K, B_c, B_r = (self._at(symbol, self.P) for symbol in ("F_ce", "K", "B_c", "B_r"))
        slope = [(self._at(symbol, self.P + 100) - self._at(symbol, self.P - 100)) / 200 for symbol in ("F_ce", "K")]
        assert F > 0
        self.gain, B = (slope[0] - slope[1] * self.x) / K, (B_c + B_r) / 2
        root = (B * B - 4 * self.mass * K) ** 0.5
        pair = [(B + root) / (2 * K), (B - root) / (2 * K)]
        self.K_u, self.T_u = theory(self.gain, self.dead_time + TS / 2, self.lag, *pair)

    def _at(self, symbol: str, P: float) -> float:
        return float(getattr(self.setup.muscle, symbol).values(np.array(P)))

    def _balance(self, P: float) -> float:
        return self._at("F_ce", P) - self.load - self._at("K", P) * self.x

    def plant(self) -> Plant:
        """At rest at the bias after 10 s."""
        plant = Plant(self.setup.muscle, self.setup.regulator, force=self.load, mass=self.mass)
        plant.command(constant(0.0, self.P))
        plant.advance(10.0)
        return plant

    @property
    def point(self) -> dict[str, float]:
        return {"setpoint": self.x, "load": self.load, "mass": self.mass, "bias": self.P}

    def swung(self, law: Any, limit: float = 200.0) -> Analysis:
        """A law around the plant, sample by sample."""
        plant, rows, sent = self.plant(), [], self.P
        start = t = plant.time
        k = 0
        while not law.done and t < start + limit:
            values = {
                "displacement": plant.x + self.random.gauss(0, 2e-6 * self.noise),
                "pressure": plant.pressure + self.random.gauss(0, 500.0 * self.noise),
            }
            command = law.update(t, values)
            rows.append((t, values["displacement"], values["pressure"], command))
            if command != sent:
                plant.command(constant(t, command))
                sent = command
            k += 1
            t = start + TS * k
            plant.reach(t)
        columns = dict(zip(("t", "displacement", "pressure", "pressure_command"), np.array(rows).T, strict=True))
        trial = as_trial(columns, {"ultimate-gain": law.result()}, **self.point)
        return reduce([as_run("ultimate-gain", [trial])])

    def relay(self, amplitude: float | None = None) -> Analysis:
        """Relay at two amplitudes, the hysteresis about 3 % of what the smaller one would move it."""
        d = amplitude or min(self.random.choice([1e4, 2e4, 3e4]), (self.P - 2e4) / 2)
        h = max(0.034 * self.gain * d, 8e-6 * self.noise)
        return self.swung(
            Relay(
                setpoint=self.x, bias=self.P, low=max(0.0, self.P - 2.5 * d), high=self.P + 2.5 * d,
                amplitudes=[d, 2 * d], hysteresis=[h, 2 * h], periods=12, level_time=20.0, settle=4.0, window=0.03,
            )
        )  # fmt: skip

    def ramp(self) -> Analysis:
        """A gain that rises by 6 % a level from about half of the ultimate one."""
        reach = min(2e5, self.P)
        return self.swung(
            GainSteps(
                setpoint=self.x, bias=self.P, start=self.random.uniform(0.5, 0.7) * self.K_u, low=self.P - reach,
                high=self.P + reach, noise=2e-6 * self.noise, factor=1.06,
            )
        )  # fmt: skip

    def stepped(self, amplitude: float = 2e4, hold: float = 2.5, cycles: int = 6) -> Analysis:
        """Open-loop steps as the shipped protocol makes them."""
        plant = self.plant()
        t, before, commands, columns = plant.time + 1.0, self.P, [], []
        t0 = plant.time
        for value in (self.P + amplitude, self.P, self.P - amplitude, self.P) * cycles:
            columns.append(self._until(plant, t))
            plant.command(constant(t, value))
            commands.append(Command(t, "pressure", "set", value, before, "open-loop"))
            before, t = value, t + hold
        columns.append(self._until(plant, t))
        x, P = np.hstack(columns)
        noise = np.random.default_rng(self.seed)
        x = x + noise.normal(0, 2e-6 * self.noise, len(x))
        P = P + noise.normal(0, 500.0 * self.noise, len(P))
        samples = {"t": t0 + TS * np.arange(1, len(x) + 1), "displacement": x, "pressure": P}
        trial: TrialData = as_trial(samples, {}, **self.point)
        object.__setattr__(trial, "commands", tuple(commands))
        return reduce([as_run("ultimate-gain", [trial])])

    def _until(self, plant: Plant, t: float) -> np.ndarray:
        """Displacement [m] and pressure [Pa] every sample period up to `t` [s]."""
        times = plant.time + TS * np.arange(1, round((t - plant.time) / TS) + 1)
        motion = plant.advance(t, times)
        return np.vstack([motion.x, motion.P])
