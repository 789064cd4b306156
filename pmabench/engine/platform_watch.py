"""Monitors a platform of three muscles, sample by sample, for faults that no single channel shows.

It compares related channels: set-point and pressure, pulses and pressure, the three pressures and the attitude. A fault
ends the run with the whole platform vented. Knows no devices and no steps.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from pmabench.base.quantities import show
from pmabench.engine.laws import Orders, Pulse
from pmabench.model.many.platform import G, Inverse, Pair, contractions, described, pressure_rate, tilt

MUSCLES = (1, 2, 3)
AXES = ("acceleration_x", "acceleration_y", "acceleration_z")
EVERY = 0.1
"""How often the attitude is compared with the pressures [s]."""


@dataclass(frozen=True)
class PlatformLimits:
    """What counts as a fault, in SI; of a pair, the first number is the size, the second how long it must last [s]."""

    following: tuple[float, float] = (0.6e5, 0.25)
    """Difference of set-point and pressure [Pa]."""
    lost: tuple[float, float] = (2.0e5, 0.8)
    """Pressure missing compared with the pulses within this time [Pa]; motion alone causes 1.1 bar."""
    norm: tuple[float, float] = (3.0, 0.02)
    """Deviation of the specific force's magnitude from gravity [m/s2]."""
    frozen: float = 0.2
    """An accelerometer with unchanged readings for this long [s] does not measure."""
    disagrees: tuple[float, float] = (math.radians(7), 0.3)
    """Angle between the measured attitude and that of rest at the pressures [rad]; hysteresis alone causes 4.3 deg."""
    tilt: tuple[float, float] = (math.radians(22), 0.05)
    """Tilt [rad]; 2 deg below the mechanical stops."""
    lift: float = 1.5
    """Time to lift off a stop at the start [s], without limits on tilt and lost air."""


@dataclass
class PlatformWatch:
    """Checks each sample for faults of the platform."""

    numbers: Mapping[str, float] = field(default_factory=dict)
    """Geometry and muscles, as in `model.many.platform.described`."""
    limits: PlatformLimits = field(default_factory=PlatformLimits)

    def __post_init__(self) -> None:
        self.platform = described(self.numbers)
        self._inverse = Inverse(self.platform)
        self._aims: dict[int, float] = {}
        self._air = {i: _Air(self.limits.lost[1]) for i in MUSCLES}
        self._since: dict[str, float] = {}
        self._shown: tuple[tuple[float, ...], float] | None = None
        """Last readings of the accelerometer [m/s2], and since when they are unchanged [s]."""
        self._begun: float | None = None
        self._lifted = False
        self._compared = -math.inf
        self._at_rest: Pair = (0.0, 0.0)
        """Attitude of rest at the measured pressures (phi, psi) [rad]."""
        self._apart = 0.0

    def look(self, t: float, values: Mapping[str, float], orders: Orders) -> str:
        """Describe the first fault in the sample `values` [SI] at `t` [s]; empty where there is none.

        `orders` are the commands that followed this sample.
        """
        self._begun = t if self._begun is None else self._begun
        self._lifted = t - self._begun >= self.limits.lift
        forces = tuple(values[name] for name in AXES)
        attitude = tilt(*forces)
        found = self._accelerometer(t, forces) or self._attitude(t, attitude, values)
        for i in MUSCLES:
            found = found or self._muscle(t, i, values[f"pressure_{i}"])
        self._note(t, values, attitude, orders)
        return found

    def _accelerometer(self, t: float, forces: tuple[float, ...]) -> str:
        off = abs(math.hypot(*forces) - G)
        if self._lasts("norm", t, off > self.limits.norm[0], self.limits.norm[1]):
            return f"the accelerometer shows {math.hypot(*forces):.3g} m/s2 at {t:.3f} s, and gravity is {G:g} m/s2"
        if self._shown is None or self._shown[0] != forces:
            self._shown = forces, t
        if t - self._shown[1] >= self.limits.frozen - 1e-9:
            return f"the accelerometer has not changed for {self.limits.frozen:g} s at {t:.3f} s: it does not measure"
        return ""

    def _attitude(self, t: float, attitude: Pair, values: Mapping[str, float]) -> str:
        steep = math.acos(math.cos(attitude[0]) * math.cos(attitude[1]))
        if self._lasts("tilt", t, self._lifted and steep > self.limits.tilt[0], self.limits.tilt[1]):
            return f"the tilt of {show(steep, 'angle')} at {t:.3f} s is beyond {show(self.limits.tilt[0], 'angle')}"
        if t - self._compared >= EVERY - 1e-9:
            self._compared = t
            rest = self._inverse.rest((values["pressure_1"], values["pressure_2"], values["pressure_3"]), self._at_rest)
            self._at_rest = rest or (0.0, 0.0)
            self._apart = 0.0 if rest is None else math.dist(rest, attitude)
        size, delay = self.limits.disagrees
        if self._lasts("disagrees", t, self._apart > size, delay):
            there = ", ".join(show(angle, "angle") for angle in self._at_rest)
            shown = ", ".join(show(angle, "angle") for angle in attitude)
            return f"the accelerometer says ({shown}) at {t:.3f} s where the pressures hold the platform at ({there})"
        return ""

    def _muscle(self, t: float, i: int, P: float) -> str:
        aim = self._aims.get(i)
        size, delay = self.limits.following
        if self._lasts(f"following {i}", t, aim is not None and abs(aim - P) > size, delay):
            wanted, shown = show(aim or 0.0, "pressure"), show(P, "pressure")
            return f"pressure_{i} is at {shown} at {t:.3f} s where {wanted} is wanted: a valve does not do its work"
        lost = self._air[i].lost(t, P)
        if self._lifted and lost > self.limits.lost[0]:
            return (
                f"pressure_{i} lacks {show(lost, 'pressure')} at {t:.3f} s that pulses of {self.limits.lost[1]:g} s "
                "do not explain: it has burst, its exhaust valve stays open, or its fill valve does not open"
            )
        return ""

    def _lasts(self, name: str, t: float, outside: bool, delay: float) -> bool:
        """Whether something has been outside for `delay` [s]."""
        if not outside:
            self._since.pop(name, None)
            return False
        return t - self._since.setdefault(name, t) >= delay - 1e-9

    def _note(self, t: float, values: Mapping[str, float], attitude: Pair, orders: Orders) -> None:
        for i in MUSCLES:
            self._aims[i] = orders.aims.get(f"pressure_{i}", self._aims.get(i, values[f"pressure_{i}"]))
        if orders.pulses:
            eps = contractions(self.platform, attitude)
            for pulse in orders.pulses:
                self._expect(t, pulse, values, eps)

    def _expect(self, t: float, pulse: Pulse, values: Mapping[str, float], eps: tuple[float, ...]) -> None:
        """Note the expected change of the muscle's pressure by a pulse."""
        kind, _, muscle = pulse.valve.partition("_")
        i = int(muscle)
        rate = pressure_rate(self.platform, values[f"pressure_{i}"], eps[i - 1], fills=kind == "fill")
        # twice the calculated fall is allowed: valves and hoses differ from their description
        self._air[i].expect(t + pulse.seconds, rate * pulse.seconds * (1 if kind == "fill" else 2))


class _Air:
    """Pressure of one muscle over a sliding window, and the changes expected from pulses."""

    def __init__(self, window: float) -> None:
        self._window = window
        self._seen: deque[tuple[float, float]] = deque()
        self._due: deque[tuple[float, float]] = deque()

    def expect(self, t: float, change: float) -> None:
        """Note that a pulse changes the pressure by `change` [Pa] until `t` [s]."""
        self._due.append((t, change))

    def lost(self, t: float, P: float) -> float:
        """Pressure [Pa] missing at `t` [s] compared with the pulses of the last window; 0 before a window has passed.

        A filling pulse counts after its end, a venting pulse from its beginning.
        """
        self._seen.append((t, P))
        while self._seen[0][0] < t - self._window - 1e-9:
            self._seen.popleft()
        begin = self._seen[0][0]
        if t - begin < self._window - 1e-3:
            return 0.0
        while self._due and self._due[0][0] < begin - self._window:
            self._due.popleft()
        rise = sum(change for end, change in self._due if change > 0 and begin + SETTLES <= end <= t - SETTLES)
        fall = sum(change for end, change in self._due if change < 0 and end >= begin - SETTLES)
        return self._seen[0][1] + rise + fall - P


SETTLES = 0.01
"""Delay after a pulse until its effect is complete [s]: valves open and shut late."""
