"""All foreign files."""

from tests.store.foreign import clocks, damage, layouts, scales

CASES = (*damage.cases(), *scales.cases(), *clocks.cases(), *layouts.cases())
