"""Why a contraction test does not fit the straight form, what can be corrected, and what is left open.

Rows of the fit -> candidates (`columns`, `corrections`) -> rounds of competing explanations (`search`, by the tests of
`held_out`) -> verdict and all steps (`verdict`), intervals of corrected values (`held_out`), after the force cell was
compared with its weights (`cell`). What is too small to be seen: `hiding`.
"""
