"""Checks, acceptance and comparison of results.

- checks besides the residual, open questions of runs, scatter between sessions: `checks`; limits of a protocol:
  `acceptance`
- channels that repeat one reading: `repeated`
- agreement of independent tests of one specimen, several muscles as one: `agreement`
- differences of two analyses (`compare`), and changes by a recalibration: `comparison`
- a specimen over all its runs (`history`): `life`
"""
