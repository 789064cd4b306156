"""Tuning rules: controller settings from an ultimate gain and period, or from the loop itself; a file for each author.

- `record`: what a rule is; `registry` finds them here and in packages that bring one
- `ziegler_nichols`, `tyreus_luyben`, `simc`: each has its rules in a table `RULES`
"""
