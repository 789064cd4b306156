"""The `accept` section of a protocol: limits that results must keep to be accepted; knows no analysis.

A limit is judged by `process`, which ends with exit code 6 where one is not kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import AfterValidator, Field

from pmabench.base.quantities import show
from pmabench.files.document import Location, Strict
from pmabench.files.quantity import Ratio, ShareOrForce

if TYPE_CHECKING:
    from pmabench.protocol.common import Compilation

Coefficient = Literal["F_ce", "K", "B_c", "B_r", "B", "F_c", "K_u", "T_u"]
CheckName = Literal["repeat_spread", "first_repeat", "drift", "free_run", "held_out", "other_direction"]
COEFFICIENTS, CHECKS = get_args(Coefficient), get_args(CheckName)
OF_TRIALS = ("repeat_spread", "first_repeat", "drift")
"""Checks of every kind of test that has one value per trial."""
OF_FIT = ("free_run", "held_out", "other_direction")
"""Checks of the fit to contraction and relaxation."""
IN_EXPECTED = ("F_ce", "K", "B_c", "B_r", "F_c")
"""What a specimen file can expect."""


def _above_zero(expected: str) -> AfterValidator:
    """A share, or a value with its quantity, above 0; the message ends with what is `expected`."""

    def check(limit: Any) -> Any:
        quantity, value = limit if isinstance(limit, tuple) else ("ratio", limit)
        if not value > 0:
            raise ValueError(f"{show(value, quantity)}: {expected}")
        return limit

    return AfterValidator(check)


Limit = Annotated[Ratio, _above_zero('a limit is above 0 %, for instance "5 %"')]
StaticLimit = Annotated[ShareOrForce, _above_zero('a limit is above 0, for instance "3 %" or "15 N"')]


class Accept(Strict):
    """Limits of one coefficient, of one check, or of R2."""

    relative_interval: Annotated[Ratio, _above_zero('an interval must be > 0 %, for instance "5 %"')] | None = None
    """Widest 95 % interval of a coefficient, of its value."""
    of_specimen: Limit | None = None
    """How far a coefficient may be from what the specimen file expects, of that."""
    of_static: StaticLimit | None = None
    """How far F_ce may be from that of the specimen's static-load test, of that or in N."""
    static_E_n: Annotated[float, Field(gt=0, le=100)] | None = None
    """Largest E_n number of that difference: the difference by the root of the sum of squares of both intervals."""
    at_most: Limit | None = None
    """Largest size of a check."""
    at_least: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Least R2 of a coefficient over pressure."""


Acceptance = dict[Coefficient | CheckName | Literal["R2"], Accept]


def measures_of(name: str) -> tuple[str, ...]:
    """Which limits a name of the section can have."""
    if name in COEFFICIENTS:
        return ("relative_interval", "of_specimen", *(("of_static", "static_E_n") if name == "F_ce" else ()))
    return ("at_least",) if name == "R2" else ("at_most",)


def find_faults(
    c: Compilation, accept: Acceptance, gives: tuple[str, ...], checks: tuple[str, ...], *, with_static: bool
) -> None:
    """Note what cannot be judged: what the kind of test does not give, and limits that do not fit.

    `with_static`: whether its F_ce can be compared with that of static load.
    """
    kind = c.document.data.get("kind")
    for name, limits in accept.items():
        able = gives if name in COEFFICIENTS else (*checks, *(("R2",) if gives and checks else ()))
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
        for measure in ("of_static", "static_E_n"):
            if measure in measures and name == "F_ce" and not with_static:
                wrong = f'compares F_ce with that of static load; "{kind}" has no such comparison'
                c.fault(("accept", name, measure), wrong, key=True)
        if "of_specimen" in measures and name in COEFFICIENTS:
            _needs_expected(c, name)


def _needs_expected(c: Compilation, name: str) -> None:
    place: Location = ("accept", name, "of_specimen")
    if name not in IN_EXPECTED:
        c.fault(place, f"a specimen file does not give {name}; it can give {', '.join(IN_EXPECTED)}")
    elif c.mounted.specimen_file.expected is None:
        c.fault(place, 'the specimen file has no "expected" section to compare with')


def for_plan(c: Compilation, accept: Acceptance) -> dict[str, Any]:
    """The section as the plan holds it: widest relative intervals by coefficient, and all `limits`; empty for none."""
    if not accept:
        return {}
    widest = {str(name): limits.relative_interval for name, limits in accept.items()}
    widest = {name: interval for name, interval in widest.items() if interval is not None}
    return {**widest, "limits": list(_limits(c, accept))}


def _limits(c: Compilation, accept: Acceptance) -> Iterator[dict[str, Any]]:
    """Every limit: `what`, `measure`, `limit`, its `place` in the protocol, and what is `expected`.

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
            if measure == "of_static":
                quantity, entry["limit"] = limit
                entry["measure"] = "of_static" if quantity == "ratio" else "of_static_by"
            expected = c.mounted.specimen_file.expected
            if measure == "of_specimen" and expected is not None and name in IN_EXPECTED:
                points = [(point.pressure, getattr(point, name)) for point in expected.points if name != "F_c"]
                entry["expected"] = sorted(points) or expected.F_c
            yield entry
