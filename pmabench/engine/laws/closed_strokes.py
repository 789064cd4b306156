"""Law `closed-strokes`: a valve shuts the air in, the driven end goes there and back, the valve opens again.

The valve is shut by its safe state, so whatever ends the run leaves it as it is. Knows no devices and no files.
"""

from __future__ import annotations

from typing import Any

from pmabench.base.errors import LimitTripped
from pmabench.engine.moves import Moves


def closed_strokes(
    moves: Moves, *, valve: str, start: float, to: float, rate: float, rest: float, cycles: int
) -> dict[str, Any]:
    """Shut `valve`, move the output `cycles` times from `start` to `to` [SI] and back at `rate` [SI/s], open it.

    It rests for `rest` [s] after the valve has shut, at both ends of each stroke, and before it opens again. Result:
    bench times [s] at which it was shut and opened.

    Raises
    ------
    LimitTripped
        Where it takes longer than the step's limit: the end is not where the plan believes, and air is shut in.
    """
    shut = moves.valve(valve, safe=True)
    moves.wait(shut + rest)
    for _ in range(cycles):
        for origin, target in ((start, to), (to, start)):
            there = moves.ramp(origin, target, rate)
            moves.wait(there + rest)
            if moves.clock.now() < there + rest - 1e-6:
                raise LimitTripped(f"the strokes with {valve} shut took longer than {moves.step.limit:g} s")
    opened = moves.valve(valve, safe=False)
    return {"found": True, "command": start, "shut": shut, "opened": opened}
