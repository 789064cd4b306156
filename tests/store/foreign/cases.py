"""All foreign files, and those that are not handled right yet."""

from dataclasses import replace

from tests.store.foreign import clocks, damage, layouts, scales

KNOWN = {
    "counts labelled N": "the doubt that these are counts is printed, but the slope is neither withheld nor refused",
    "MPa labelled bar": "a note names the inner diameter that the slope suits, and nothing is asked or refused",
    "seconds labelled ms": "filled within 12 ms at 100,000 rows a second, which raises nothing; the slope is right",
    "time with a comma, numbers with a point": "asks for a period as if there were no time, not about the mixed signs",
}
"""Name of a case -> why it fails; the test fails when one of them no longer does."""
CASES = tuple(
    replace(case, known=KNOWN.get(case.name, ""))
    for case in (*damage.cases(), *scales.cases(), *clocks.cases(), *layouts.cases())
)
