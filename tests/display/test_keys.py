"""Keys are read while a trial is evaluated."""

import time
from threading import Timer
from types import SimpleNamespace

from pmabench.display.console import Console


class Keys:
    """A keyboard on which `v` is pressed once, after a time."""

    fd = 0

    def __init__(self, after):
        self.waiting = []
        Timer(after, self.waiting.append, "v").start()

    def read(self):
        waiting, self.waiting[:] = list(self.waiting), []
        return waiting


class Link:
    closed = False

    def __init__(self):
        self.sent = []

    def send(self, message):
        self.sent.append((time.monotonic(), message))
        return True

    def receive(self):
        return ()


def test_vent_now_does_not_wait_until_a_trial_is_evaluated(tmp_path, monkeypatch):
    """An evaluation took 2.5 s of a processor, and `v` was read after it."""
    console = Console(tmp_path, None, link=Link())
    console._keys = Keys(0.3)
    begun = time.monotonic()

    def evaluate():
        while time.monotonic() < begun + 1.5:
            sum(range(1000))
        console._over = True
        return 0

    monkeypatch.setattr(console.state, "poll", evaluate)
    monkeypatch.setattr("pmabench.display.console.screen", lambda *_: [])
    console._run_drawn(SimpleNamespace(size=lambda: (80, 24), draw=lambda *_: None))
    ((sent, message),) = console.link.sent
    assert message == {"key": "v"}
    assert sent - begun < 1.2
