"""How long a session takes, before it is held: what its bench file declares, added up; commands nothing."""

from __future__ import annotations

from dataclasses import dataclass

from pmabench.bench.compile import Mounted
from pmabench.protocol.plan import HANDS_OUT, VENTED_WITHIN
from pmabench.session.self_test import LEAK
from pmabench.session.stepping import REST, SPEED, VALVE, WAY
from pmabench.session.zeros import STEADY, STEADY_WITHIN


@dataclass(frozen=True)
class Length:
    """Shortest and longest duration [s], without the operator's time; how often hands are needed at most; its parts."""

    shortest: float
    longest: float
    hands: int
    parts: tuple[str, ...]


def session_length(mounted: Mounted) -> Length | None:
    """What the session of a bench takes; None where its file declares none."""
    declared = mounted.session
    if declared is None:
        return None
    weights = mounted.bench_file.weights is not None
    shortest, perhaps, hands = 0.0, 0.0, 0
    parts = []
    test = declared.self_test
    if test is not None:
        parts.append("self-test")
        shortest += REST + (2 * len(test.points) + 4) * test.settle
        shortest += VALVE if any(valve.safe == "open" for valve in mounted.bench.valves) else 0.0
        if any(output.name == "displacement" for output in mounted.bench.outputs):
            shortest += 2 * (WAY / SPEED + 2 * REST)
        isolation = mounted.bench_file.air.isolation_valve
        if any(valve.name == isolation and valve.safe == "closed" for valve in mounted.bench.valves):
            shortest += 2 * test.settle + 1.0 + LEAK
        if weights:
            loaded = test.load is not None
            hands += 2 + loaded
            shortest += REST * (1 + loaded) - HANDS_OUT
            perhaps = HANDS_OUT + REST + 2 * test.settle  # the hanger alone, where the load did not leave its support
    if declared.warm_up is not None:
        parts.append("warm-up")
        shortest += declared.warm_up.duration
    if declared.zeros:
        parts.append("zeros")
        shortest += STEADY * len(declared.zeros)
        hands += sum(name != "pressure" for name in declared.zeros)
    shortest += HANDS_OUT * hands
    slack = VENTED_WITHIN * hands + STEADY_WITHIN * (len(declared.zeros) + 1)
    return Length(shortest, shortest + perhaps + slack, hands, tuple(parts))
