"""Imports with what each kind of test needs of a file, as the command `import` hands it over."""

from pmabench.kinds.registry import importable
from pmabench.store.importers import importing, map_rules
from pmabench.store.importers.guess import guess

KINDS = importable()


def import_files(files, map_path, out, answers=(), *, unresolved=False):
    """Runs of files, as `importing.import_files` makes them."""
    return importing.import_files(files, map_path, out, KINDS, answers, unresolved=unresolved)


def read_map(path, answers=(), *, unresolved=False):
    """A map, as `map_rules.read_map` reads it."""
    return map_rules.read_map(path, KINDS, answers, unresolved=unresolved)


def guess_files(files):
    """What files seem to hold, as `guess.guess_files` finds it."""
    return guess.guess_files(files, KINDS)
