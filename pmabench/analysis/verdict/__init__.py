"""What speaks for or against a result, and results beside each other.

- beside its residual: `checks`; limits of a protocol: `acceptance`
- independent tests of one specimen against each other: `agreement`, by what each kind says, `offers`
- two analyses coefficient by coefficient (`compare`): `comparison`; what recalibration changed: `changes`
- open questions of imports, kept files that changed, doubts about a bench, as the runs store them: `record`
- a specimen over its runs (`history`): `life`, `control_chart`
"""
