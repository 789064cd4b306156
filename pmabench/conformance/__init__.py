"""What every driver must keep, tried against the driver's own emulator; for shipped drivers and for those of others.

`suite` is the table of checks and runs them on a `subject`, a device of a bench file. `unopened` looks at the class
alone, `behaviour` at an open device, `broken_wire` and `hostile` at what it does when the wire is bad. `rig` starts
emulator and driver, and measures how long calls take; between the two is a `relay` (TCP or serial) that does to the
bytes what `damage` says.

Nothing is ever tried on a device that does not say over its wire that it is emulated.
"""

from pmabench.conformance.subject import Subject, subject, subjects
from pmabench.conformance.suite import run
from pmabench.conformance.verdict import FAILED, NOT_APPLICABLE, NOT_CHECKED, PASSED, Result

__all__ = ["FAILED", "NOT_APPLICABLE", "NOT_CHECKED", "PASSED", "Result", "Subject", "run", "subject", "subjects"]
