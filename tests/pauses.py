"""A test that waits in real time says nothing of the program where the machine stood still: it is run again.

Such tests assert that something happens within some hundred milliseconds, and a machine that several users share may
give a process no time for as long as that. So a process that does nothing else notes when it was woken late or could not
write; a test in real time that fails is run again only where there was such a pause while it ran, twice at most, and the
end of the log lists it. One that fails without a pause, or each time, fails.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol

LONG = 0.1
"""A pause from which on a test that failed is run again [s]; a machine that is only busy gives pauses of 0.02 s."""
ATTEMPTS = 3
NOTED = "the machine paused"
_WATCH = """
import os, sys, time
late, ours = open(sys.argv[1], "a", buffering=1), os.getppid()
scratch = os.open(sys.argv[1] + ".scratch", os.O_WRONLY | os.O_CREAT)
before = time.monotonic()
while os.getppid() == ours:
    time.sleep(0.01)
    os.pwrite(scratch, b"x", 0)
    now = time.monotonic()
    if now - before > float(sys.argv[2]):
        late.write(f"{before} {now}\\n")
    before = now
"""


class Pauses:
    """A process that notes when it got no time, for as long as the tests of this process last."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="pmabench-pauses-")
        self._late = Path(self._folder.name) / "late"
        self._late.touch()
        self.watcher = subprocess.Popen([sys.executable, "-I", "-S", "-c", _WATCH, self._late, str(LONG)])

    def longest(self, since: float) -> float:
        """The longest pause that ended after `since` [s, monotonic]; 0 where there was none of `LONG`."""
        time.sleep(0.05)  # the watcher may be woken after this process
        pauses = [[float(word) for word in line.split()] for line in self._late.read_text().splitlines()]
        return max((end - begin for begin, end in pauses if end > since), default=0.0)

    def end(self) -> None:
        """No more is noted."""
        self.watcher.kill()
        self.watcher.wait()
        self._folder.cleanup()


_KEPT = pytest.StashKey[Pauses]()


def _pauses(config: pytest.Config) -> Pauses:
    """Of this process; begun with its first test in real time."""
    if _KEPT not in config.stash:
        config.stash[_KEPT] = pauses = Pauses()
        config.add_cleanup(pauses.end)
    return config.stash[_KEPT]


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a test in real time once, or again where it failed in a pause of the machine."""
    if item.get_closest_marker("realtime") is None:
        return None
    pauses = _pauses(item.config)
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for attempt in range(ATTEMPTS):
        began = time.monotonic()
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        if attempt == ATTEMPTS - 1 or not any(report.failed for report in reports):
            break
        if not (pause := pauses.longest(began)):
            break
        why = next(str(report.longrepr) for report in reports if report.failed).strip().rpartition("\n")[2]
        item.user_properties.append(
            (NOTED, f"{pause:.2f} s in run {attempt + 1} of {item.nodeid}, which failed at {why}")
        )
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Which tests were run again, and why."""
    noted = {
        text
        for reports in terminalreporter.stats.values()
        for report in reports
        for name, text in getattr(report, "user_properties", ())
        if name == NOTED
    }
    if noted:
        terminalreporter.section(f"run again, for {NOTED}")
        for text in sorted(noted):
            terminalreporter.line(text)
