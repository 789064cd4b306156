"""The `accept` section of a protocol: limits that results must meet.

`process` applies the limits, and ends with exit code 6 where one is not met.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import AfterValidator

from pmabench.base.quantities import show
from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Ratio

if TYPE_CHECKING:
    from pmabench.protocol.common import Compilation

Coefficient = Literal["F_ce", "K", "B_c", "B_r", "B", "F_c", "K_u", "T_u"]
CheckName = Literal["repeat_spread", "first_repeat", "drift", "free_run", "held_out", "other_direction"]
COEFFICIENTS, CHECKS = get_args(Coefficient), get_args(CheckName)
OF_TRIALS = ("repeat_spread", "first_repeat", "drift")
"""Checks for kinds of test with one value per trial."""
OF_FIT = ("free_run", "held_out", "other_direction")
"""Checks of the fit to contraction and relaxation."""
IN_EXPECTED = ("F_ce", "K", "B_c", "B_r", "F_c")
"""Coefficients whose expected values a specimen file can give."""


def _above_zero(expected: str) -> AfterValidator:
    """Validator: a share must be above 0; `expected` ends the message."""

    def check(limit: float) -> float:
        if not limit > 0:
            raise ValueError(f"{show(limit, 'ratio')}: {expected}")
        return limit

    return AfterValidator(check)


Limit = Annotated[Ratio, _above_zero('a limit is above 0 %, for instance "5 %"')]


class Accept(Strict):
    """Limits of one coefficient, or of one check."""

    relative_interval: Annotated[Ratio, _above_zero('an interval must be > 0 %, for instance "5 %"')] | None = None
    """Largest half width of a coefficient's 95 % interval, as a share of its value."""
    of_specimen: Limit | None = None
    """Largest deviation of a coefficient from the specimen file's expected value, as a share of that."""
    at_most: Limit | None = None
    """Largest size of a check."""


Acceptance = dict[Coefficient | CheckName, Accept]


def measures_of(name: str) -> tuple[str, ...]:
    """Limits that an entry of the section can have."""
    return ("relative_interval", "of_specimen") if name in COEFFICIENTS else ("at_most",)


def find_faults(c: Compilation, accept: Acceptance, gives: tuple[str, ...], checks: tuple[str, ...]) -> None:
    """Note limits that cannot be applied: results that the kind of test does not give, and unsuitable limits."""
    kind = c.document.data.get("kind")
    for name, limits in accept.items():
        able = gives if name in COEFFICIENTS else checks
        if name not in able:
            nothing = f"gives nothing of the kind; it gives {', '.join(gives) or ', '.join(checks)}"
            wrong = f"does not give {name}; it gives {', '.join(able)}" if able else nothing
            c.fault(("accept", name), f'"{kind}" {wrong}', key=True)
            continue
        fitting = measures_of(name)
        expected = f"expected {' or '.join(fitting)}"
        measures = [measure for measure in Accept.model_fields if getattr(limits, measure) is not None]
        if not measures:
            c.fault(("accept", name), f"says no limit; {expected}", key=True)
        for measure in measures:
            if measure not in fitting:
                c.fault(("accept", name, measure), f"{name} has no {measure}; {expected}", key=True)
        if "of_specimen" in measures and name in COEFFICIENTS:
            _needs_expected(c, name)


def _needs_expected(c: Compilation, name: str) -> None:
    place: Location = ("accept", name, "of_specimen")
    if name not in IN_EXPECTED:
        c.fault(place, f"a specimen file does not give {name}; it can give {', '.join(IN_EXPECTED)}")
    elif c.mounted.specimen_file.expected is None:
        c.fault(place, 'the specimen file has no "expected" section to compare with')


def for_plan(c: Compilation, accept: Acceptance) -> dict[str, Any]:
    """The section for the plan: largest relative interval by coefficient, and all `limits`; empty without a section."""
    if not accept:
        return {}
    widest = {str(name): limits.relative_interval for name, limits in accept.items()}
    widest = {name: interval for name, interval in widest.items() if interval is not None}
    return {**widest, "limits": list(_limits(c, accept))}


def _limits(c: Compilation, accept: Acceptance) -> Iterator[dict[str, Any]]:
    """Every limit: `what`, `measure`, `limit`, its `place` in the protocol, for `of_specimen` also `expected`.

    `expected` is a list of (pressure [Pa], value [SI]), or a single value without a pressure.
    """
    for name, limits in accept.items():
        for measure in Accept.model_fields:
            limit = getattr(limits, measure)
            if limit is None:
                continue
            where = c.document.problem(("accept", name, measure), "", key=True)
            place = f"{Path(where.path).name}:{where.line}" if where.line else Path(where.path).name
            entry = {"what": name, "measure": measure, "limit": limit, "place": place}
            expected = c.mounted.specimen_file.expected
            if measure == "of_specimen" and expected is not None and name in IN_EXPECTED:
                points = [(point.pressure, getattr(point, name)) for point in expected.points if name != "F_c"]
                entry["expected"] = sorted(points) or expected.F_c
            yield entry
