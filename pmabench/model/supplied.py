"""What all plants share: a muscle behind a regulator, and moments that can be gone back to; knows no motion."""

from __future__ import annotations

import copy
from typing import Any

from pmabench.model.regulator import Regulated, Wave


class Supplied:
    """A muscle at `time` [s] whose pressure comes from `supply`; a snapshot holds copies of `parts`."""

    time: float
    supply: Regulated
    parts: tuple[str, ...] = ("supply",)

    @property
    def pressure(self) -> float:
        """Gauge pressure in the muscle at this moment [Pa]."""
        return self.supply.value(self.time)

    def command(self, waves: tuple[Wave, ...]) -> None:
        """Command pressure [Pa] along `waves`, the first of which starts now or later."""
        self.supply.command(waves)

    def shut(self, *, shut: bool) -> None:
        """From now on a valve keeps the regulator from the muscle's air, or no longer; without a chamber no matter."""

    def snapshot(self) -> dict[str, Any]:
        """Everything that `restore` needs to come back to this moment."""
        return {**self.__dict__, **self._copies()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go back to the moment of a snapshot; it can be used again."""
        self.__dict__.update(snapshot)
        self.__dict__.update(self._copies())

    def _copies(self) -> dict[str, Any]:
        return {name: copy.copy(getattr(self, name)) for name in self.parts}


class Loaded(Supplied):
    """A muscle whose free end carries F_L = `force` [N] and moves with `mass` [kg]."""

    force: float
    mass: float

    def load(self, force: float, mass: float) -> None:
        """From now on the free end carries F_L = `force` [N >= 0] and moves with `mass` [kg > 0]."""
        if not force >= 0 or not mass > 0:
            raise ValueError(f"a load needs a force of at least 0 and a mass above 0, not {force} N and {mass} kg")
        self.force, self.mass = force, mass
