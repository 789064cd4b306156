"""Checks, acceptance and comparison of results.

- checks besides the residual, and open questions of runs: `checks`; limits of a protocol: `acceptance`
- agreement of independent tests of one specimen, several muscles as one: `agreement`
- differences of two analyses (`compare`), and changes by a recalibration: `comparison`
- scatter between sessions in one analysis: `sessions`; a specimen over all its runs (`history`): `life`
"""
