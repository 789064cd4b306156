"""What each method of the reductions does, in a sentence or two: as the kinds of test declare it."""

from __future__ import annotations

from pmabench.kinds import registry

_DIFFERENCE = "Difference of two independent tests of the same specimen; their intervals are added as squares."


def described(method: str) -> str:
    """What a method does; empty for one that is not known.

    What follows ` above ` is a limit of it; after `, ` the way of one side of a comparison.
    """
    known = {name: words for kind in registry.all_kinds().values() for name, words in kind.methods.items()}
    names = (method, method.partition(" above ")[0], method.partition(", ")[0])
    words = next((known[name] for name in names if name in known), "")
    return words or (_DIFFERENCE if " against " in method else "")
