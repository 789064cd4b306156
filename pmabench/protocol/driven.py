"""What kinds of test with a driven end share: what the actuator can do, and the force that is believed to come."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import cos, pi, sin

from pmabench.base.quantities import show
from pmabench.bench.files.specimen import ExpectedFile
from pmabench.files.document import Location
from pmabench.protocol.common import Compilation
from pmabench.protocol.plan import Hold, Ramp, Set, Step

ARRIVED = 1.0
"""Rest after the approach [s]."""
VENT_HOLD = 3.0
"""Time after the last vent [s]."""


@dataclass(frozen=True)
class Believed:
    """What is believed of the specimen at one pressure: F_ce [N], K [N/m], B_c and B_r [N.s/m], F_c [N]."""

    F_ce: float
    K: float
    B_c: float
    B_r: float
    F_c: float

    def force(self, x: float, v: float) -> float:
        """F_ce - K x - B x' - F_c sign(x') [N] at contraction x [m] and its rate v [m/s] (paper 0)."""
        return self.F_ce - self.K * x - (self.B_c if v > 0 else self.B_r) * v - (self.F_c if v > 0 else -self.F_c)


def believed(expected: ExpectedFile, pressure: float) -> Believed:
    """The specimen's expected coefficients at a pressure [Pa], on straight lines; beyond the points, the last one."""
    points = sorted(expected.points, key=lambda point: point.pressure)
    below = max((p for p in points if p.pressure <= pressure), key=lambda p: p.pressure, default=points[0])
    above = min((p for p in points if p.pressure >= pressure), key=lambda p: p.pressure, default=points[-1])
    span = above.pressure - below.pressure
    share = (pressure - below.pressure) / span if span > 0 else 0.0
    f_ce, k, b_c, b_r = (
        getattr(below, name) + share * (getattr(above, name) - getattr(below, name))
        for name in ("F_ce", "K", "B_c", "B_r")
    )
    return Believed(f_ce, k, b_c, b_r, expected.F_c)


def along_sine(mean: float, amplitude: float, frequency: float) -> list[tuple[float, float]]:
    """Contractions [m] and their rates [m/s] over one period."""
    phases = [2 * pi * step / 720 for step in range(720)]
    return [(mean + amplitude * sin(p), 2 * pi * frequency * amplitude * cos(p)) for p in phases]


def predicted_force(
    expected: ExpectedFile, pressure: float, mean: float, amplitude: float, frequency: float
) -> tuple[float, float]:
    """Lowest and highest force [N] over one period of a sine (paper 0)."""
    muscle = believed(expected, pressure)
    forces = [muscle.force(x, v) for x, v in along_sine(mean, amplitude, frequency)]
    return min(forces), max(forces)


def not_too_fast(c: Compilation, speed: float, where: Location, what: str) -> None:
    """Check a speed [m/s] against the actuator's."""
    actuator = c.mounted.bench_file.actuator
    if actuator is not None and speed > actuator.speed * (1 + 1e-9):
        c.fault(where, f"{what} at {show(speed, 'speed')}; the actuator at most at {show(actuator.speed, 'speed')}")


def bearable(c: Compilation, pressure: float, path: Iterable[tuple[float, float]], where: Location, lower: str) -> None:
    """Check the force predicted along `path` (contraction [m], rate [m/s]) against slack and the actuator's force.

    `lower` names what may be lowered. Nothing is predicted where the specimen file expects nothing.
    """
    actuator, expected = c.mounted.bench_file.actuator, c.mounted.specimen_file.expected
    if actuator is None or expected is None:
        return
    muscle = believed(expected, pressure)
    forces = [muscle.force(x, v) for x, v in path]
    if min(forces) < c.mounted.bench.slack_below:
        c.fault(
            where,
            f"at {show(pressure, 'pressure')} the force is predicted to fall to {min(forces):.0f} N: the specimen goes "
            f"slack (raise the pressure, or lower {lower})",
        )
    if max(forces) > actuator.force:
        c.fault(
            where, f"the force is predicted to reach {max(forces):.0f} N; the actuator bears {actuator.force:.0f} N"
        )


def arrive(pressure: float, place: float, settle: float, approach: float, back_from: float | None) -> list[Step]:
    """Back to 0 from where the last pressure left off, then the new pressure, and on to `place` [m]."""
    back: Sequence[Step] = [] if back_from is None else [Ramp("return", "displacement", back_from, 0.0, approach)]
    return [
        *back,
        Set("pressurise", "pressure", pressure),
        Hold("pressurise", settle),
        Ramp("approach", "displacement", 0.0, place, approach),
        Hold("approach", ARRIVED),
    ]


def leave(back_from: float, approach: float) -> list[Step]:
    """Back to 0 and vented."""
    back: Sequence[Step] = [Ramp("return", "displacement", back_from, 0.0, approach)] if approach > 0 else []
    return [*back, Set("vent", "pressure", 0.0), Hold("vent", VENT_HOLD)]
