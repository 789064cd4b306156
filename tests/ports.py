"""Ports for servers of tests; imports nothing of the project."""

import socket
from contextlib import suppress
from random import SystemRandom


def free_port() -> int:
    """A port that nobody listens at now, and that the system gives to nobody who asks for any (it gives those above)."""
    while True:
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", SystemRandom().randrange(20_000, 32_000)))
            return int(probe.getsockname()[1])
