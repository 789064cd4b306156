"""An operator who answers line by line at a terminal; the bench is watched while they think. For guided commands."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Mapping, Sequence

from pmabench.base.errors import Interrupted
from pmabench.cli.common import rewrite, say

Wait = Callable[[], None]


class AtLines:
    """A person at standard input. `realtime`: bench time passes while they think; else it waits."""

    def __init__(self, *, realtime: bool) -> None:
        self._realtime = realtime
        self._typed = b""

    def poll(self, measured: Mapping[str, float]) -> Sequence[tuple[str, str]]:
        """No keys; lines are answers."""
        return ()

    def ask(self, text: str, measured: Mapping[str, float], wait: Wait) -> str:
        """Ask until the word is `clear`."""
        if sys.stderr.isatty():
            rewrite()
        say(text)
        while True:
            pressure = measured.get("pressure")
            shown = "not measured" if pressure is None else f"{pressure / 1e3:.1f} kPa"
            prompt = f'Measured pressure: {shown}. Type "clear" when it is done and hands are out: '
            if self.line(prompt, wait).lower() == "clear":
                return "clear"

    def line(self, prompt: str, wait: Wait) -> str:
        """The next line that is typed; raises Interrupted at the end of the input."""
        sys.stderr.write(prompt)
        sys.stderr.flush()
        descriptor = sys.stdin.fileno()
        while b"\n" not in self._typed:
            if select.select([descriptor], [], [], 0.0 if self._realtime else None)[0]:
                read = os.read(descriptor, 4096)
                if not read:
                    raise Interrupted("end of input at the prompt", 130)
                self._typed += read
            elif self._realtime:
                wait()
        line, _, self._typed = self._typed.partition(b"\n")
        return line.decode("utf-8", "replace").strip()
