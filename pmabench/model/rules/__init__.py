"""Tuning rules: controller settings from an ultimate gain and period, or from the loop itself.

- `record`: what a rule is; `all_rules` finds them here and in packages that bring one
- `ultimate_gain`, `simc`: each has its rules in a table `RULES`
"""
