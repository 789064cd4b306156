"""A platform in time behind its valves: pulses, shut-off, dumps, an accelerometer, and parts that fail.

The motion is that of `platform.Platform`; this adds what a program that controls it can switch and measure.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from typing import Any

from pmabench.model.many.platform import LEVEL, G, Platform, State

DELAY = 2e-3
"""From the command of a valve to its opening, and to its shutting [s]."""
DUMP = 4.0
"""How wide a dump is, an exhaust valve being 1."""
MUSCLES = (0, 1, 2)


class PlatformPlant:
    """Three muscles, six valves, a shut-off in the supply and a dump at each muscle; all numbers SI.

    Parameters
    ----------
    height : of the accelerometer above the joint [m]
    noise : standard deviation of each of its axes [m/s2]
    seed : of the noise
    """

    def __init__(
        self, platform: Platform | None = None, *, state: State = LEVEL, height: float = 0.02, noise: float = 0.02,
        seed: int = 0,
    ) -> None:  # fmt: skip
        self.platform = platform or Platform()
        self.state, self.time = state, 0.0
        self.supply, self.dump = True, False
        """Whether the shut-off lets air to the fill valves, and whether the dumps are open."""
        self.stuck: dict[tuple[str, int], bool] = {}
        """Valves that do not move any more, as (`fill` or `exhaust`, muscle from 0): whether they are open."""
        self.holes = [0.0] * 3
        """How wide each muscle has burst, an exhaust valve being 1."""
        self.shows_level = False
        """Whether the accelerometer shows what a level platform would, with its noise."""
        self.blocked: tuple[int, ...] = ()
        """Muscles, from 0, whose dump does not open."""
        self.openings = {(kind, i): 0 for kind in ("fill", "exhaust") for i in MUSCLES}
        """How often each valve was opened."""
        self._open: dict[tuple[str, int], list[tuple[float, float]]] = {key: [] for key in self.openings}
        self._height, self._noise, self._chance = height, noise, random.Random(seed)

    def pulse(self, kind: str, muscle: int, seconds: float) -> None:
        """Open a valve for so long from now on; one that is open stays open until the later end."""
        begin, end = self.time + DELAY, self.time + DELAY + seconds
        mine = self._open[kind, muscle] = [one for one in self._open[kind, muscle] if one[1] > self.time - 1e-9]
        if mine and mine[-1][1] >= begin - 1e-9:
            mine[-1] = (mine[-1][0], max(end, mine[-1][1]))
            return
        mine.append((begin, end))
        self.openings[kind, muscle] += 1

    def shut(self, kind: str, muscle: int) -> None:
        """End the pulse of a valve; one that is open shuts after its delay."""
        mine = self._open[kind, muscle]
        self._open[kind, muscle] = [(a, min(b, self.time + DELAY)) for a, b in mine if a < self.time + DELAY]

    def advance(self, until: float) -> None:
        """Go on to `until` [s]."""
        while until - self.time > 1e-12:
            cuts = [t for mine in self._open.values() for one in mine for t in one if self.time + 1e-12 < t < until]
            end = min(cuts, default=until)
            middle = 0.5 * (self.time + end)
            filled = [float(self.supply and self._is_open("fill", i, middle)) for i in MUSCLES]
            dumps = [DUMP * (self.dump and i not in self.blocked) for i in MUSCLES]
            emptied = [self._is_open("exhaust", i, middle) + dumps[i] + self.holes[i] for i in MUSCLES]
            self.state = self.platform.advance(self.state, end - self.time, filled, emptied)
            self.time = end

    def _is_open(self, kind: str, muscle: int, t: float) -> bool:
        stuck = self.stuck.get((kind, muscle))
        return any(a <= t < b for a, b in self._open[kind, muscle]) if stuck is None else stuck

    def measure(self) -> dict[str, float]:
        """Three gauge pressures [Pa] and three specific forces [m/s2] now, by the names of their channels."""
        found = {f"pressure_{i + 1}": self.state[4 + i] for i in MUSCLES}
        return found | dict(zip(("acceleration_x", "acceleration_y", "acceleration_z"), self._felt(), strict=True))

    def _felt(self) -> tuple[float, float, float]:
        """What the accelerometer shows."""
        x, y, z = (0.0, 0.0, G) if self.shows_level else self._specific_force()
        if not self._noise:
            return x, y, z
        noise = self._chance.gauss
        return x + noise(0.0, self._noise), y + noise(0.0, self._noise), z + noise(0.0, self._noise)

    def _specific_force(self) -> tuple[float, float, float]:
        """Without noise, along the platform's own axes, of a sensor on the z axis.

        Its acceleration is h (w' x e_z + w x (w x e_z)), from the angular speed w and its rate w'.
        """
        phi, psi, turn, tip = self.state[:4]
        _, _, turning, tipping = self.platform.rates(self.state, (0.0,) * 3, (0.0,) * 3)[:4]
        sin, cos = math.sin(psi), math.cos(psi)
        w = (turn * cos, tip, turn * sin)
        faster = (turning * cos - turn * tip * sin, tipping)
        h = self._height
        return (
            -G * math.cos(phi) * sin + h * (faster[1] + w[0] * w[2]),
            G * math.sin(phi) + h * (-faster[0] + w[1] * w[2]),
            G * math.cos(phi) * cos - h * (w[0] ** 2 + w[1] ** 2),
        )

    def turns(self) -> tuple[float, float]:
        """Angular speeds about the platform's own x and y axes [rad/s], as a gyroscope shows them."""
        return self.state[2] * math.cos(self.state[1]), self.state[3]

    def snapshot(self) -> dict[str, Any]:
        """Everything that `restore` needs to come back to this moment."""
        chance = self._chance.getstate() if self._noise else None
        opened = {key: tuple(mine) for key, mine in self._open.items()}
        kept = self.state, self.time, self.supply, self.dump, self.shows_level, self.blocked
        return {"kept": kept, "open": opened, "stuck": dict(self.stuck), "holes": list(self.holes),
                "openings": dict(self.openings), "chance": chance}  # fmt: skip

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Go back to the moment of a snapshot; it can be used again."""
        self.state, self.time, self.supply, self.dump, self.shows_level, self.blocked = snapshot["kept"]
        self._open = {key: list(mine) for key, mine in snapshot["open"].items()}
        self.stuck, self.holes = dict(snapshot["stuck"]), list(snapshot["holes"])
        self.openings = dict(snapshot["openings"])
        if snapshot["chance"] is not None:
            self._chance.setstate(snapshot["chance"])
