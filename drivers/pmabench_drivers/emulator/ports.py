"""Pseudo-terminals under a path of one's own, POSIX only; addresses that emulators may listen at."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import tty
from ipaddress import ip_address
from pathlib import Path

from pmabench.base.errors import UsageError
from pmabench_drivers.emulator.log import Tap


def host_of(address: str) -> str:
    """The host of `HOST:PORT` or `HOST`; empty where that is no IP address, as in a path."""
    host = address if address.count(":") != 1 and "]:" not in address else address.rpartition(":")[0]
    try:
        return str(ip_address("127.0.0.1" if host == "localhost" else host.strip("[]")))
    except ValueError:
        return ""


def bracketed(host: str) -> str:
    """A host as it is written in front of a port."""
    return f"[{host}]" if ":" in host else host


def listen(device: str, host: str, port: int) -> socket.socket:
    """A listening TCP socket; UsageError where there can be none."""
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise UsageError(f"cannot serve {device} at {bracketed(host)}:{port}: {error.strerror}") from None


def refuse_others(device: str, address: str) -> None:
    """UsageError where `address` names a host that is not this machine alone."""
    host = host_of(address)
    if host and not ip_address(host).is_loopback:
        raise UsageError(
            f"{device} is at {address}, where other machines could reach what is emulated; give it an address of this "
            'machine, as "127.0.0.1:0", or say --expose'
        )


def _no_tap(_kind: str, _data: bytes) -> None:
    """Nobody writes down what is exchanged."""


class Terminal:
    """A pseudo-terminal whose far end is reached by the symbolic link `path`; `tap` gets what goes through it."""

    def __init__(self, path: str, tap: Tap = _no_tap) -> None:
        self._link, self._tap = Path(path), tap
        if self._link.exists() and not self._link.is_symlink():
            raise UsageError(f"{path} is there and is no link of an emulator; give the device another address")
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        try:
            self._link.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(os.ttyname(self._far))
        except OSError as error:
            self._hang_up()
            raise UsageError(f"cannot make the link {path}: {error.strerror}") from None

    def read(self, wait: float) -> bytes | None:
        """What came within `wait` [s]; None when it is closed."""
        try:
            if not select.select([self._near], [], [], wait)[0]:
                return b""
            data = os.read(self._near, 4096)
        except (OSError, ValueError):
            return None
        self._tap("received", data)
        return data

    def write(self, data: bytes) -> None:
        """Send, as long as anybody takes it: what finds no room is lost, as on a wire without a listener."""
        if self._near >= 0 and select.select([], [self._near], [], 0)[1]:
            self._tap("sent", data[: os.write(self._near, data)])

    def close(self) -> None:
        """Hang up, and take the link away; harmless when repeated."""
        with contextlib.suppress(OSError):
            if self._link.is_symlink():
                self._link.unlink()
        self._hang_up()

    def _hang_up(self) -> None:
        near, far, self._near, self._far = self._near, self._far, -1, -1
        for end in (far, near):
            if end >= 0:
                with contextlib.suppress(OSError):
                    os.close(end)
