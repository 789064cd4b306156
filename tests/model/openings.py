"""A platform whose valves open and close at set times, in whole steps of its own."""

from dataclasses import dataclass
from itertools import pairwise

from pmabench.model.many.platform import LEVEL


@dataclass(frozen=True)
class Opening:
    """Opening of a valve from `begin` to `end` [s]; `kind` is fill or exhaust, `muscle` counts from 0."""

    kind: str
    muscle: int
    begin: float
    end: float


def simulate(platform, openings, at, state=LEVEL):
    """States at increasing times `at` [s], from `state` at 0, with these valve openings."""
    cuts = sorted({0.0, *at, *(t for one in openings for t in (one.begin, one.end))})
    wanted, found = set(at), []
    if 0.0 in wanted:
        found.append(state)
    for begin, end in pairwise(cuts):
        if len(found) == len(wanted):
            break
        middle = 0.5 * (begin + end)
        now = [one for one in openings if one.begin <= middle < one.end]
        filled, emptied = (
            [any(one.kind == kind and one.muscle == i for one in now) for i in range(3)] for kind in ("fill", "exhaust")
        )
        state = platform.advance(state, end - begin, filled, emptied)
        if end in wanted:
            found.append(state)
    return found
