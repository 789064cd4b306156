"""Where samples and events go: a run folder, or nowhere; and a recorder whose failure stops nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import RecordError


class Recorder(Protocol):
    """Where samples and events go: a run folder, or nowhere when a plan is only tried."""

    def append(
        self,
        stream: str,
        time_ns: NDArray[np.int64],
        columns: Mapping[str, Any],
        flags: NDArray[np.uint16],
        host_ns: int | None = None,
    ) -> None:
        """Samples as the device gave them; `host_ns` is when the newest was here [ns, bench time]."""
        ...

    def event(self, kind: str, t: float, **data: Any) -> None:
        """Something that happened at bench time `t` [s]."""
        ...


class NoRecord:
    """A recorder that keeps nothing but the events."""

    def __init__(self) -> None:
        self.events: list[tuple[str, float, dict[str, Any]]] = []

    def append(
        self, stream: str, time_ns: Any, columns: Mapping[str, Any], flags: Any, host_ns: int | None = None
    ) -> None:
        """Nothing is kept."""

    def event(self, kind: str, t: float, **data: Any) -> None:
        """Kept in memory."""
        self.events.append((kind, t, data))


class Forgiving:
    """Passes everything to another recorder; when that fails, notes it once and goes on without it."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self.lost: RecordError | None = None

    def append(
        self, stream: str, time_ns: Any, columns: Mapping[str, Any], flags: Any, host_ns: int | None = None
    ) -> None:
        """As the other one, while it can."""
        self._attempt(lambda: self._recorder.append(stream, time_ns, columns, flags, host_ns))

    def event(self, kind: str, t: float, **data: Any) -> None:
        """As the other one, while it can."""
        self._attempt(lambda: self._recorder.event(kind, t, **data))

    def _attempt(self, write: Callable[[], None]) -> None:
        try:
            write()
        except RecordError as error:
            self.lost = self.lost or error
