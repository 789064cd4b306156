"""Names in a file that may carry the number of a muscle: `pressure`, or `pressure_2` where a bench has several."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pmabench.base.errors import did_you_mean
from pmabench.base.quantities import MUSCLES, without_number


def among(alone: Sequence[str], of_a_muscle: Sequence[str]) -> Callable[[Any], str]:
    """A check that a value is one of these names, of which those `of_a_muscle` may carry a number from 1 on."""
    numbers = [f"_{number}" for number in range(1, MUSCLES + 1)]

    def check(value: Any) -> str:
        name, number = without_number(str(value))
        if value not in alone and not (name in of_a_muscle and number in numbers):
            raise ValueError(f'"{value}" is not known here{did_you_mean(str(value), alone)}')
        return str(value)

    return check


def schema_of(alone: Sequence[str], of_a_muscle: Sequence[str]) -> dict[str, Any]:
    """The same as a JSON schema."""
    both = "|".join(f"{name}(_[1-{MUSCLES}])?" if name in of_a_muscle else name for name in alone)
    return {"type": "string", "pattern": f"^({both})$"}
