"""Why a contraction test does not fit the straight form, what can be corrected, and what remains uncertain.

`cell` compares the force cell with its weights. Then rows of the fit -> candidates (`columns`, `corrections`) -> rounds
of competing explanations (`search`, with the tests of `held_out`) -> verdict and all steps (`verdict`), intervals of
corrected values (`held_out`). Departures too small to be seen: `hiding`.
"""
