"""Which loads a stack of weights can make: the hanger with any of its plates; pure arithmetic."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

TOLERANCE = 1e-3
"""A load counts as made when the stack comes so near [kg]."""
MOST_SUMS = 200_000
"""Most different stacks that are looked at."""
_GRID = 1e-4
"""Stacks nearer to each other are one [kg]."""


@dataclass(frozen=True)
class Stack:
    """A hanger and its plates."""

    hanger: float
    """[kg]"""
    plates: Sequence[tuple[int, float]]
    """How many of which mass [kg]; empty: not known, anything from the hanger on is believed."""

    @cached_property
    def _sums(self) -> dict[int, tuple[int, int]]:
        """Mass of plates on the grid -> the mass without the last plate, and which plate that was.

        Plate by plate from the heaviest; each mass is kept as it was first made, so no plate is used too often.
        """
        sums = {0: (0, -1)}
        for number, (count, each) in enumerate(self._heaviest_first):
            step = round(each / _GRID)
            edge = list(sums) if step > 0 else []
            for _ in range(count):
                edge = [mass for mass in edge if mass + step not in sums]
                sums.update((mass + step, (mass, number)) for mass in edge)
                edge = [mass + step for mass in edge]
                if not edge or len(sums) > MOST_SUMS:
                    break
            if len(sums) > MOST_SUMS:
                break
        return sums

    @cached_property
    def _heaviest_first(self) -> list[tuple[int, float]]:
        return sorted(self.plates, key=lambda plate: -plate[1])

    @cached_property
    def _loads(self) -> list[float]:
        """Every load that can be made [kg], ascending: nothing at all, the hanger, the hanger with plates."""
        return sorted({0.0, *(self.hanger + mass * _GRID for mass in self._sums)})

    def around(self, mass: float) -> list[float]:
        """The nearest loads [kg] that can be made, below and above `mass`; one where `mass` can be made."""
        if not self.plates:
            return [mass] if mass == 0 or mass >= self.hanger - TOLERANCE else [0.0, self.hanger]
        loads = self._loads
        place = bisect_left(loads, mass)
        near = loads[max(place - 1, 0) : place + 1]
        hit = [load for load in near if abs(load - mass) <= TOLERANCE]
        return hit[:1] or near

    def can_make(self, mass: float) -> bool:
        """Whether `mass` [kg] is one of the loads."""
        near = self.around(mass)
        return len(near) == 1 and abs(near[0] - mass) <= TOLERANCE

    def why_not(self, mass: float, shown: Callable[[float], str] = "{:g} kg".format) -> str:
        """Why a load cannot be made, with the nearest ones, as `shown` says masses [kg]; empty where it can."""
        if self.can_make(mass):
            return ""
        near = " or ".join(shown(load) for load in self.around(mass))
        return f"{shown(mass)} cannot be made with the weights of this bench ({self}); nearest: {near}"

    def text(self, mass: float) -> str:
        """What makes a load that can be made, for instance `hanger 1 kg + 1 x 5 kg + 1 x 2.5 kg = 8.5 kg`."""
        if mass <= 0 or not self.plates:
            return ""
        left = min(self._sums, key=lambda plates: abs(self.hanger + plates * _GRID - mass))
        used: dict[int, int] = {}
        while left:
            left, number = self._sums[left]
            used[number] = used.get(number, 0) + 1
        chosen = [f"{used[number]} x {self._heaviest_first[number][1]:g} kg" for number in sorted(used)]
        return " + ".join([f"hanger {self.hanger:g} kg", *chosen]) + (f" = {mass:g} kg" if chosen else " alone")

    def __str__(self) -> str:
        """The stack in words."""
        plates = " + ".join(f"{count} x {each:g} kg" for count, each in self._heaviest_first)
        return f"hanger {self.hanger:g} kg" + (f" and plates {plates}" if plates else "")
