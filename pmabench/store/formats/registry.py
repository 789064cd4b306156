"""Which formats can be imported: those of this folder and those of other packages, by name."""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from importlib.metadata import entry_points
from pkgutil import iter_modules

from pmabench.base.errors import invalid
from pmabench.store import formats as folder
from pmabench.store.formats import text
from pmabench.store.formats.record import Format

GROUP = "pmabench.formats"
"""Group of entry points; each is called as its format and names a `Format`."""


@lru_cache(maxsize=1)
def formats() -> dict[str, Format]:
    """Every format by its name; a package cannot replace one that is here already.

    Raises InvalidFile where an entry point names no `Format`, or one with another name.
    """
    modules = [each.name for each in iter_modules(folder.__path__, f"{folder.__name__}.") if not each.ispkg]
    records = [getattr(import_module(name), "FORMAT", None) for name in modules]
    known = {record.name: record for record in records if record is not None}
    for point in entry_points(group=GROUP):
        try:
            found = point.load()
        except Exception as error:  # a package of somebody else may raise anything
            raise invalid(point.value, f'the format "{point.name}" cannot be loaded: {error}') from error
        if not isinstance(found, Format) or found.name != point.name:
            raise invalid(point.value, f'is not the record of the format "{point.name}" that its package announces')
        known.setdefault(point.name, found)
    return known


def format_of(content: bytes) -> Format:
    """The format of a file by its first bytes; text where no format recognises them."""
    return next((each for each in formats().values() if each.recognise(content)), text.FORMAT)
