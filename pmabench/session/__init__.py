"""What is done on the armed bench before runs and between them; each is a run under the same guard.

- `session`: before the first run, again when it has run out: self-test, warm-up, zeros; `ensure` is its face. Also what
  is kept of it in the folder of the bench, and how long it takes, for `check`
- `self_test`: the start check; made of `checks` (lines of the table; noise and supply at rest; which wire explains what
  is not kept), `stepping` (small steps, one as in ISO 10094, delays), `wiring` (what readings of a right bench satisfy)
- `calibration`: guided calibration of a channel or of the regulator; `calibration_file` has its fit and its file
- `jog`: pressure and actuator by hand, inside the set-up pressure
- shared: `guided` (their plan, what is asked for, looking without arming, listening)
"""

from pmabench.session.session import ensure

__all__ = ["ensure"]
