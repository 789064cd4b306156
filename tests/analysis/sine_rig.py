"""Driven sines of plant 5.1 in closed form, for tests: force along a displacement that follows its command late."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmabench.store.records import Command, TrialData

RATE = 500.0


@dataclass(frozen=True)
class Muscle51:
    """F = F_ce - K x - B x' - friction at 300 kPa; friction F_s at rest, F_c above 1 mm/s, straight between."""

    F_ce: float = 275.0
    K: float = 6773.0
    B_c: float = 1680.0
    B_r: float = 2120.0
    F_s: float = 0.0
    F_c: float = 0.0
    noise: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of displacement [m], force [N] and pressure [Pa]."""
    lag: float = 0.0
    """Of the actuator behind its command [s]."""
    skew: float = 0.0
    """Time by which the force is sampled late [s]."""
    drag: float = 0.0
    """Pressure [Pa] that swings with the displacement, per metre."""
    dF_dP: float = 1.01e-3
    bend: tuple[float, float] = (0.0, 0.0)
    """c [N/m2] and d [N/m3] of c u^2 + d u^3, u from the mean of the sine."""
    slip: tuple[float, float] = (0.0, 0.0)
    """Force [N] and way [m] of a friction that first has to be wound up: one spring that slips."""

    def trial(
        self,
        index: int,
        frequency: float,
        cycles: int,
        *,
        pressure: float = 3e5,
        mean: float = 0.01,
        amplitude: float = 0.005,
    ) -> TrialData:
        rng = np.random.default_rng(100 + index)
        n = int(cycles / frequency * RATE)
        t = np.arange(n) / RATE
        omega = 2 * np.pi * frequency
        a = 1.0 / self.lag if self.lag else 0.0

        def motion(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            if not self.lag:
                return mean + amplitude * np.sin(omega * time), amplitude * omega * np.cos(omega * time)
            size = amplitude * a / (a * a + omega * omega)
            y = size * (a * np.sin(omega * time) - omega * np.cos(omega * time) + omega * np.exp(-a * time))
            v = size * omega * (a * np.cos(omega * time) + omega * np.sin(omega * time) - a * np.exp(-a * time))
            return mean + y, v

        x, _ = motion(t)
        late_x, late_v = motion(np.maximum(t - self.skew, 0.0))
        swing = self.drag * (late_x - mean)
        friction = np.sign(late_v) * (self.F_c + (self.F_s - self.F_c) * np.clip(1 - np.abs(late_v) / 1e-3, 0, 1))
        F = self.F_ce - self.K * late_x - np.where(late_v > 0, self.B_c, self.B_r) * late_v - friction
        F = F + self.dF_dP * (pressure - 3e5 + swing)
        u = late_x - mean
        F = F + self.bend[0] * u**2 + self.bend[1] * u**3 - self._wound(late_x)
        channels = {
            "displacement": x + self.noise[0] * rng.standard_normal(n),
            "force": F + self.noise[1] * rng.standard_normal(n),
            "pressure": pressure + self.drag * (x - mean) + self.noise[2] * rng.standard_normal(n),
        }
        point = {
            "pressure": pressure,
            "frequency": frequency,
            "mean": mean,
            "amplitude": amplitude,
            "cycles": float(cycles),
        }
        start = 40.0 + 100.0 * index
        command = Command(
            start,
            "displacement",
            "sine",
            mean,
            mean,
            "sine",
            {"amplitude": amplitude, "frequency": frequency, "cycles": cycles},
        )
        return TrialData(
            run="r1", index=index, point=point, repeat=index // 4, reference=False, status="finished", t=t + start,
            channels=channels, flags=np.zeros(n, dtype=np.uint16), commands=(command,), found={},
        )  # fmt: skip

    def _wound(self, x: np.ndarray) -> np.ndarray:
        """Force of the spring that slips along a displacement [N]."""
        most, way = self.slip
        held, force = 0.0, np.zeros(len(x))
        for i in range(1, len(x) if most else 0):
            held = min(max(held + most / way * (x[i] - x[i - 1]), -most), most)
            force[i] = held
        return force

    def trials(self, repeats: int = 1, **point: Any) -> list[TrialData]:
        plan = [(0.1, 4), (0.5, 6), (1.0, 11), (3.0, 31)] * repeats
        return [self.trial(i, f, n, **point) for i, (f, n) in enumerate(plan)]


def value(analysis: Any, symbol: str, method: str, at: Mapping[str, float] | None = None) -> Any:
    wanted = dict(at or {})
    found = [
        e
        for e in analysis.estimates
        if e.symbol == symbol and e.method == method and all(e.at.get(k) == v for k, v in wanted.items())
    ]
    if "frequency" not in wanted:
        found = [e for e in found if "frequency" not in e.at]
    assert len(found) == 1, found
    return found[0]
