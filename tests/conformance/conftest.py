"""The whole suite takes few of the tests here that wait in real time, by the hash of the commit; all by name."""

import subprocess
from pathlib import Path

import pytest

SHARES = {"test_in_a_shipped_driver_it_is_found": 72}
"""One in so many, where it is not one in `SHARE`."""
SHARE = 12


def pytest_collection_modifyitems(config, items):
    if config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return
    asked = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    )
    commit = int(asked.stdout.strip() or "0", 16)
    left_out = set()
    for share in (SHARE, *SHARES.values()):
        waiting = [
            item
            for item in items
            if "tests/conformance/" in item.nodeid
            and item.get_closest_marker("realtime")
            and SHARES.get(item.originalname, SHARE) == share
        ]
        left_out |= {item for place, item in enumerate(waiting) if place % share != commit % share}
    config.hook.pytest_deselected(items=list(left_out))
    items[:] = [item for item in items if item not in left_out]
