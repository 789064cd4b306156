"""A folder of runs behind the server of the live view, for tests: written here, read there."""

from contextlib import contextmanager

from pmabench.display.web.server import start

TOKEN = "a-token-of-the-tests-1234567"


@contextmanager
def served(root, **options):
    """A server of the runs in `root` while the block lasts."""
    server = start(root, TOKEN, **options)
    try:
        yield server
    finally:
        server.stop()
