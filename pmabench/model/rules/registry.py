"""Which tuning rules there are: every file of this package, and entry points of the group `pmabench.rules`."""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from importlib.metadata import entry_points
from pkgutil import iter_modules

from pmabench.model import rules
from pmabench.model.rules.record import Rule

GROUP = "pmabench.rules"
FIRST = "ziegler_nichols"
"""Its rules come first, as in lists and tables."""


@lru_cache(maxsize=1)
def all_rules() -> tuple[Rule, ...]:
    """Every rule; those that need the loop itself come last."""
    names = [module.name for module in iter_modules(rules.__path__) if module.name not in ("record", "registry")]
    found: list[Rule] = []
    for name in sorted(names, key=lambda name: (name != FIRST, name)):
        found += import_module(f"{rules.__name__}.{name}").RULES
    for point in entry_points(group=GROUP):
        brought = point.load()
        found += [brought] if isinstance(brought, Rule) else brought
    return tuple(sorted(found, key=lambda rule: rule.from_loop is not None))


def find(name: str, form: str) -> Rule | None:
    """The rule of a name for a form of controller (`P`, `PI`, `PID`); None where it has none for that."""
    return next((rule for rule in all_rules() if (rule.name, rule.form) == (name, form)), None)
