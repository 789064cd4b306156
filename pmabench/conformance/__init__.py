"""Requirements for every driver, tested against the driver's own emulator; for shipped drivers and those of others.

`suite` is the table of checks and runs them on a device of a bench file. It tests the class alone;
`samples`, `commands` and `following` test an open device, `broken_wire` its behaviour on a faulty connection. `rig`
starts emulator and driver, measures the duration of calls, and asks the emulator for the actual state of plant and
device; between the two is a `relay` (TCP or serial) that damages bytes.

Nothing is ever commanded at a device that neither reports that it is emulated nor was asked through the relay.
"""

from pmabench.conformance.rig import FAILED, NOT_APPLICABLE, NOT_CHECKED, PASSED, Result
from pmabench.conformance.suite import Subject, run, subject, subjects

__all__ = ["FAILED", "NOT_APPLICABLE", "NOT_CHECKED", "PASSED", "Result", "Subject", "run", "subject", "subjects"]
