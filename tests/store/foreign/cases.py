"""All foreign files, and those that are not handled right yet."""

from dataclasses import replace

from tests.store.foreign import clocks, damage, layouts, scales

KNOWN: dict[str, str] = {}
"""Name of a case -> why it fails; the test fails when one of them no longer does."""
CASES = tuple(
    replace(case, known=KNOWN.get(case.name, ""))
    for case in (*damage.cases(), *scales.cases(), *clocks.cases(), *layouts.cases())
)
