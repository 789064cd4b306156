"""The vent button: starts `pmabench vent BENCH` as a person would, and says whether that was confirmed.

The view holds nothing that could vent: the command finds the guard and its key in the user's own files.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

COMMAND = (sys.executable, "-P", "-m", "pmabench", "vent")
LONGEST = 90.0
"""The command has this long [s]; a guard says within a minute what came of its vent."""


def vent(bench: str, command: Sequence[str] = COMMAND) -> dict[str, Any]:
    """Vent a bench by its name: `confirmed` [bool], `result` in words, `actions` of the guard. Raises nothing."""
    whole = [*command, "--json", "--", bench]
    try:
        ended = subprocess.run(
            whole, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=LONGEST, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return _not_confirmed(f"pmabench vent could not be run: {error}")
    try:
        benches = json.loads(ended.stdout)["benches"]
        results = [str(item["result"]) for item in benches]
        actions = [str(action) for item in benches for action in item["actions"]]
    except (ValueError, KeyError, TypeError):
        last = ended.stderr.strip().splitlines()
        return _not_confirmed(last[-1] if last else f"pmabench vent ended with exit code {ended.returncode}")
    confirmed = ended.returncode == 0 and bool(results) and all(result == "confirmed" for result in results)
    return {"confirmed": confirmed, "result": ", ".join(results), "actions": actions}


def _not_confirmed(why: str) -> dict[str, Any]:
    return {"confirmed": False, "result": why, "actions": []}
