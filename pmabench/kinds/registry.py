"""The kinds of test: every folder of this package, and entry points of the group `pmabench.kinds`.

Another installed package adds a kind by an entry point whose value is its record `KIND`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from importlib import import_module
from pkgutil import iter_modules

from pmabench import kinds
from pmabench.base.errors import did_you_mean
from pmabench.base.kind import Imported, Kind
from pmabench.base.system import registered

GROUP = "pmabench.kinds"


@lru_cache(maxsize=1)
def all_kinds() -> Mapping[str, Kind]:
    """Every kind by its name, in the order of reports; ValueError where two have the same name."""
    records = [
        import_module(f"pmabench.kinds.{module.name}").KIND for module in iter_modules(kinds.__path__) if module.ispkg
    ]
    records += [point.load() for point in registered(GROUP)]
    found: dict[str, Kind] = {}
    every = [kind for record in records for kind in (record, *record.also)]
    for kind in sorted(every, key=lambda kind: (kind.order, kind.name)):
        if kind.name in found:
            raise ValueError(f'two packages bring a kind of test called "{kind.name}"; uninstall one of them')
        found[kind.name] = kind
    return found


def find(name: str) -> Kind | None:
    """The kind with a name; None where it is unknown, as in a run of a newer version."""
    return all_kinds().get(name)


def kind_of(name: str) -> Kind:
    """The kind of a name; ValueError with the nearest name where it is not known."""
    known = all_kinds()
    if name not in known:
        raise ValueError(f'unknown kind of test "{name}"{did_you_mean(name, known)}')
    return known[name]


def with_part(name: str) -> dict[str, Kind]:
    """The kinds that have a part of `Kind.parts`."""
    return {kind.name: kind for kind in all_kinds().values() if name in kind.parts}


def with_results(*symbols: str) -> dict[str, Kind]:
    """The kinds that give all of these coefficients."""
    return {kind.name: kind for kind in all_kinds().values() if {*symbols} <= {r.symbol for r in kind.results}}


def options_for(asked: Mapping[str, object]) -> dict[str, dict[str, object]]:
    """Kind -> those of the user's options that its reduction has."""
    found = {}
    for kind in all_kinds().values():
        if mine := {name: value for name, value in asked.items() if value and name in kind.options}:
            found[kind.name] = mine
    return found


def importable() -> dict[str, Imported]:
    """Kind -> what it needs from files of other programs, for kinds that can be imported."""
    return {name: kind.imported for name, kind in all_kinds().items() if kind.imported is not None}


def loops() -> tuple[str, ...]:
    """The kinds whose runs cannot be recalibrated."""
    return tuple(name for name, kind in all_kinds().items() if kind.loop)


def protocols() -> dict[str, Kind]:
    """The kinds that a protocol file can have."""
    return {name: kind for name, kind in all_kinds().items() if kind.protocol}


def title_of(name: str) -> str:
    """Heading for a kind; made from its name where the kind is unknown."""
    kind = find(name)
    return kind.title if kind else name.replace("-", " ").capitalize() or "Unnamed test"
