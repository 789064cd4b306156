"""All foreign files, and those that are not handled right yet."""

from dataclasses import replace

from tests.store.foreign import clocks, damage, layouts, scales

KNOWN = {
    "counts labelled N": "the doubt that these are counts is printed, but the slope is neither withheld nor refused",
    "MPa labelled bar": "a note names the inner diameter that the slope suits, and nothing is asked or refused",
}
"""Name of a case -> why it fails; the test fails when one of them no longer does."""
CASES = tuple(
    replace(case, known=KNOWN.get(case.name, ""))
    for case in (*damage.cases(), *scales.cases(), *clocks.cases(), *layouts.cases())
)
