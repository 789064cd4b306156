"""The run's side of its display, and the link between both: JSON lines over a socket that never blocks either of them.

Starts the display process, talks to it, and is never held up by it. Standard library only.

    display = Display()
    display.start(writer.folder)                            # at once; the screen appears half a second later
    ...
    asked = display.ask("Put 6 kg on the free end.", words=("clear",))
    while waiting:                                   # several times a second, as long as the run lasts
        display.live({"pressure": 312.0})            # values [SI] while nothing is recorded
        for message in display.poll():
            if message.get("answer", {}).get("id") == asked:
                ...                                  # message["answer"]["text"] is one of the words
            if message.get("key") == "v":
                ...                                  # "r" repeat this trial, "p" pause or continue, "v" vent now
            if "note" in message:
                ...                                  # a line that was typed
        if not display.alive:
            ...                                      # it died or was never possible: prompts cannot be answered there
    display.close()

Ctrl-C reaches the run itself, as without a display. Text printed to the terminal meanwhile damages the screen until
its next line changes.
"""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pmabench.base import terminal

MOST = 1 << 16
"""Most bytes waiting to be sent, and longest message."""


class Link:
    """One end of the link. A message that the other end cannot take is dropped, and `send` returns False."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._socket = end
        self._out = bytearray()
        self._in = bytearray()
        self.closed = False
        """Whether the other end is closed."""

    def fileno(self) -> int:
        """The file descriptor, for `select`."""
        return self._socket.fileno()

    @property
    def waiting(self) -> bool:
        """Whether data wait to be sent."""
        return bool(self._out)

    def send(self, message: Mapping[str, Any]) -> bool:
        """Queue a message and send what the other end accepts now; the rest follows in later calls. False: dropped."""
        self.flush()
        line = json.dumps(message, default=str).encode() + b"\n"
        if self.closed or len(self._out) + len(line) > MOST:
            return False
        self._out += line
        self.flush()
        return not self.closed

    def flush(self) -> None:
        """Send waiting data, as far as the other end accepts them."""
        try:
            while self._out and not self.closed:
                del self._out[: self._socket.send(self._out)]
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            self.closed = True

    def receive(self) -> list[dict[str, Any]]:
        """Messages received since the last call; lines that are no JSON objects are left out."""
        try:
            while len(self._in) < 4 * MOST:
                piece = self._socket.recv(MOST)
                if not piece:
                    self.closed = True
                    break
                self._in += piece
        except (BlockingIOError, InterruptedError):
            pass
        except OSError:
            self.closed = True
        *lines, rest = bytes(self._in).split(b"\n")
        self._in = bytearray(rest if len(rest) <= MOST else b"")
        return [message for message in map(_parsed, lines) if message is not None]

    def close(self) -> None:
        """Close this end; may be called again."""
        self.closed = True
        self._socket.close()


def _parsed(line: bytes) -> dict[str, Any] | None:
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None


LEAVE = b"\x1b[0m\x1b[?25h\x1b[?1049l"
"""Reset colours, show the cursor, leave the alternate screen."""


class Display:
    """A display process and the link to it. Only `close` may block."""

    def __init__(self, *, color: bool = True) -> None:
        self._color = color
        self._process: subprocess.Popen[bytes] | None = None
        self._link: Link | None = None
        self._before: terminal.Attributes | None = None
        self._asked: dict[str, Any] | None = None
        self._sent = True
        self._count = 0
        self._lost = False

    def start(self, folder: Path) -> None:
        """Start the process for a run's folder.

        It draws on standard error and reads keys from standard input, where these are a terminal.
        Raises OSError if no process can be started.
        """
        ours, theirs = socket.socketpair()
        self._before = terminal.attributes(0)
        try:
            command = [sys.executable, "-P", "-m", "pmabench.display.console", str(folder)]
            command += ["--link", str(theirs.fileno())]
            command += [] if self._color else ["--no-color"]
            self._process = subprocess.Popen(command, pass_fds=[theirs.fileno()], stdout=subprocess.DEVNULL)
        except OSError:
            ours.close()
            raise
        finally:
            theirs.close()
        self._link = Link(ours)

    @property
    def alive(self) -> bool:
        """Whether the process is running and connected."""
        if self._process is None or self._link is None or self._process.poll() is not None or self._link.closed:
            self._leave()
            return False
        return True

    def ask(self, text: str, words: Sequence[str] = ("clear",)) -> int:
        """Show a question until it is answered by one of the words; returns its number, which the answer contains."""
        self._count += 1
        self._asked = {"id": self._count, "text": text, "words": list(words)}
        self._sent = False
        self._push()
        return self._count

    def withdraw(self) -> None:
        """Remove the question from the display."""
        self._asked, self._sent = None, False
        self._push()

    def live(self, values: Mapping[str, float]) -> None:
        """Values [SI] by channel while nothing is recorded; dropped if older ones still wait."""
        if self._link is not None and not self._link.waiting:
            self._link.send({"live": dict(values)})

    def poll(self) -> list[dict[str, Any]]:
        """Messages of the display: `answer` {id, text}, `key`, `note`. Answers to other questions are left out."""
        if self._link is None:
            return []
        self._link.flush()
        self._push()
        return [message for message in self._link.receive() if self._counts(message)]

    def _push(self) -> None:
        if not self._sent and self._link is not None:
            self._sent = self._link.send({"ask": self._asked})

    def _counts(self, message: Mapping[str, Any]) -> bool:
        """Whether a message is valid; a valid answer ends its question."""
        answer = message.get("answer")
        if answer is None:
            return isinstance(message.get("key"), str) or isinstance(message.get("note"), str)
        asked = self._asked
        if asked is None or not isinstance(answer, dict):
            return False
        if answer.get("id") != asked["id"] or answer.get("text") not in asked["words"]:
            return False
        self._asked = None
        return True

    def close(self, within: float = 3.0) -> None:
        """End the display and restore the terminal; after `within` [s] by force. May be called again."""
        process, link = self._process, self._link
        if process is None or link is None:
            return
        link.send({"end": {}})
        for force in (None, process.terminate, process.kill):
            if force is not None:
                force()
            with suppress(subprocess.TimeoutExpired):
                process.wait(within)
                break
        link.close()
        self._leave()

    def _leave(self) -> None:
        """Restore the terminal after a display that died before it could; done once, and without waiting."""
        process = self._process
        if process is None or self._lost or process.poll() is None:
            return
        self._lost = True
        terminal.restore(0, self._before)
        if process.returncode != 0 and terminal.in_front(2) and select.select([], [2], [], 0)[1]:
            with suppress(OSError):
                os.write(2, LEAVE)
