"""Tuning rules for an ultimate gain and period: Ziegler and Nichols, and Tyreus and Luyben with less overshoot."""

from pmabench.model.rules.record import Rule

ZN, TL = "Ziegler-Nichols", "Tyreus-Luyben"
ZN_SOURCE = "Ziegler and Nichols, Trans. ASME 64 (1942) 759, ultimate-gain (second, closed-loop) method"
TL_SOURCE = "Tyreus and Luyben, Ind. Eng. Chem. Res. 31 (1992) 2625"
RULES = (
    Rule(ZN, "P", ZN_SOURCE, 0.5),
    Rule(ZN, "PI", ZN_SOURCE, 0.45, 1 / 1.2),
    Rule(ZN, "PID", ZN_SOURCE, 0.6, 1 / 2, 1 / 8),
    Rule(TL, "PI", TL_SOURCE, 1 / 3.2, 2.2),
    Rule(TL, "PID", TL_SOURCE, 1 / 2.2, 2.2, 1 / 6.3),
)
