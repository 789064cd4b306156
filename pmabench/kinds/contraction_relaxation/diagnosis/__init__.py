"""Why a contraction test does not fit the straight form, what can be corrected, and what is left open.

Rows of the fit -> candidates (`columns`, `corrections`) -> rounds of competing explanations (`search`, `rounds`, by the
tests of `held_out`) -> verdict (`verdict`, in the words of `words`), after the force cell was compared with its weights
(`cell`). Intervals of corrected values: `spread`; what is too small to be seen: `hiding`; all steps: `examination`.
"""
