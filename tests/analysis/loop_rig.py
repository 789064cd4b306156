"""A small loop for tests: plant 5.1 behind a lagging regulator, stepped by hand, in closed loop with a law.

Written apart from pmabench/model, so that the two can be compared.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmabench.store.records import ChannelInfo, RunData, TrialData

TS = 0.002


def F_ce(P: float) -> float:
    return max(0.0, 1.08e-3 * P - 49.0)


def K_of(P: float) -> float:
    return 5600.0 + 1.0e-3 * P + 9.7e-9 * P * P


def B_c_of(P: float) -> float:
    return 1200.0 + 1.6e-3 * P


def B_r_of(P: float) -> float:
    return 1100.0 + 3.4e-3 * P


@dataclass
class Plant51:
    """B x' = F_ce(P) - K(P) x - F_L - friction, with P behind a dead time and a first-order lag."""

    regulator_lag: float = 0.0955
    dead_time: float = 0.04
    same_B: bool = True
    F_s: float = 0.0
    F_c: float = 0.0
    load: float = 0.0
    noise: tuple[float, float] = (2e-6, 500.0)
    P: float = 0.0
    x: float = 0.0
    v: float = 0.0
    substeps: int = 4

    def __post_init__(self) -> None:
        self.random = random.Random(7)
        self.queue: deque[float] = deque()

    def rest_at(self, x: float) -> float:
        """Put the plant to rest at contraction x [m]; returns the pressure there."""
        low, high = 0.0, 7e5
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if F_ce(middle) - K_of(middle) * x < self.load else (low, middle)
        self.P, self.x = low, x
        self.queue = deque([low] * round(self.dead_time / TS))
        return low

    def step(self, command: float) -> None:
        self.queue.append(command)
        u = self.queue.popleft()
        h = TS / self.substeps
        for _ in range(self.substeps):
            self.P += h / self.regulator_lag * (u - self.P)
            push = F_ce(self.P) - K_of(self.P) * self.x - self.load
            hold = self.F_c if self.v != 0.0 else self.F_s
            B = B_c_of(self.P) if push > 0 or self.same_B else B_r_of(self.P)
            sign = 1.0 if push > 0 else -1.0
            v = (push - sign * hold) / B if abs(push) > hold else 0.0
            self.v = 0.0 if self.v * v < 0 else v
            self.x += h * self.v

    def read(self) -> dict[str, float]:
        return {
            "displacement": self.x + self.random.gauss(0, self.noise[0]),
            "pressure": self.P + self.random.gauss(0, self.noise[1]),
        }


@dataclass
class LinearPlant:
    """Gain, dead time and lags around an operating point; x = 0 at command 0."""

    gain: float
    dead_time: float
    lags: tuple[float, ...]
    noise: tuple[float, float] = (2e-6, 500.0)
    ts: float = TS

    def __post_init__(self) -> None:
        self.random = random.Random(7)
        self.state = [0.0] * len(self.lags)
        self.queue: deque[float] = deque([0.0] * round(self.dead_time / self.ts))

    def step(self, command: float) -> None:
        self.queue.append(command)
        u = self.queue.popleft()
        for _ in range(8):
            value = u
            for i, lag in enumerate(self.lags):
                self.state[i] += self.ts / 8 / lag * (value - self.state[i])
                value = self.state[i]

    def read(self) -> dict[str, float]:
        return {
            "displacement": self.gain * self.state[-1] + self.random.gauss(0, self.noise[0]),
            "pressure": self.state[0] + self.random.gauss(0, self.noise[1]),
        }


def close_loop(plant: Any, law: Any, limit: float, ts: float = TS, start: float = 5.0) -> dict[str, np.ndarray]:
    """Run `law` on `plant` until it is done or `limit` [s] is over; samples from `start` [s] on."""
    rows = []
    k, command = 0, getattr(law, "bias", 0.0)
    while not law.done and k * ts < limit:
        t = start + k * ts
        values = plant.read()
        command = law.update(t, values)
        rows.append((t, values["displacement"], values["pressure"], command))
        plant.step(command)
        k += 1
    t, x, P, u = np.array(rows).T
    return {"t": t, "displacement": x, "pressure": P, "pressure_command": u}


def as_trial(samples: Mapping[str, np.ndarray], found: Mapping[str, Any], index: int = 0, **point: float) -> TrialData:
    channels = {name: column for name, column in samples.items() if name != "t"}
    flags = np.zeros(len(samples["t"]), dtype=np.uint16)
    return TrialData(
        run="r1", index=index, point=point, repeat=index, reference=False, status="finished", t=samples["t"],
        channels=channels, flags=flags, commands=(), found=dict(found),
    )  # fmt: skip


def as_run(kind: str, trials: Sequence[TrialData], settings: Mapping[str, Any] | None = None, **info: Any) -> RunData:
    channels = {
        name: ChannelInfo(name, quantity, unit, 1.0, 0.0, -1e9, 1e9, gain_uncertainty=info.get("gain_uncertainty", 0.0))
        for name, quantity, unit in (
            ("displacement", "length", "m"),
            ("pressure", "pressure", "Pa"),
            ("pressure_command", "pressure", "Pa"),
            ("force", "force", "N"),
        )
    }
    return RunData(
        id="r1", path="", kind=kind, status="finished", simulated=True, manifest={},
        plan={"settings": dict(settings or {})}, events=(), channels=channels, rate=1 / TS, trials=tuple(trials),
    )  # fmt: skip
