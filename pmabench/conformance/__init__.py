"""What every driver must keep, tried against the driver's own emulator; for shipped drivers and for those of others.

`suite` is the table of checks and runs them on a device of a bench file; it looks at the class alone,
`samples`, `commands` and `following` at an open device, `broken_wire` at what it does when the wire is bad. `rig`
starts emulator and driver, and measures how long calls take; between the two is a `relay` (TCP or serial) that damages
bytes. `truth` asks emulator or simulation what plant and device really do.

Nothing is ever tried on a device that does not say over its wire that it is emulated.
"""

from pmabench.conformance.rig import FAILED, NOT_APPLICABLE, NOT_CHECKED, PASSED, Result
from pmabench.conformance.suite import Subject, run, subject, subjects

__all__ = ["FAILED", "NOT_APPLICABLE", "NOT_CHECKED", "PASSED", "Result", "Subject", "run", "subject", "subjects"]
