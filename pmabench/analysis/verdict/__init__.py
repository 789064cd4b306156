"""Checks of results, their acceptance, and results compared with each other.

- next to its residual, and open questions of its runs: `checks`; limits of a protocol: `acceptance`
- independent tests of one specimen against each other, by what each kind offers, several muscles as one: `agreement`
- two analyses coefficient by coefficient (`compare`), and what a recalibration changed: `comparison`
- runs of several sessions in one analysis: `sessions`; a specimen over its runs (`history`): `life`
"""
