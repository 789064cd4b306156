"""The rules of Ziegler and Nichols for an ultimate gain and period."""

from pmabench.model.rules.record import Rule

NAME = "Ziegler-Nichols"
SOURCE = "Ziegler and Nichols, Trans. ASME 64 (1942) 759, ultimate-gain (second, closed-loop) method"
RULES = (
    Rule(NAME, "P", SOURCE, 0.5),
    Rule(NAME, "PI", SOURCE, 0.45, 1 / 1.2),
    Rule(NAME, "PID", SOURCE, 0.6, 1 / 2, 1 / 8),
)
