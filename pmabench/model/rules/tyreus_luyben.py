"""The rules of Tyreus and Luyben for an ultimate gain and period: slower, with less overshoot."""

from pmabench.model.rules.record import Rule

NAME = "Tyreus-Luyben"
SOURCE = "Tyreus and Luyben, Ind. Eng. Chem. Res. 31 (1992) 2625"
RULES = (Rule(NAME, "PI", SOURCE, 1 / 3.2, 2.2), Rule(NAME, "PID", SOURCE, 1 / 2.2, 2.2, 1 / 6.3))
