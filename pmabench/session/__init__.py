"""What is done on the armed bench before runs and between them; each is a run under the same guard.

- `session`: before the first run, and again when it has expired: self-test, warm-up, zeros; entry point `ensure`.
  Also the results stored in the folder of the bench, and what a session consists of, for `check`
- `self_test`: the start check; made of `checks` (lines of the table; noise and supply at rest; which wire explains the
  broken claims), `stepping` (small steps, one as in ISO 10094, delays), `wiring` (properties of correct wiring)
- `calibration`: guided calibration of a channel or of the regulator; `calibration_line`: its line and its file
- `guided`: plans and operator requests of these runs; reading a bench that is not armed; pressure and actuator by
  hand, inside the set-up pressure
"""

from pmabench.session.session import ensure

__all__ = ["ensure"]
