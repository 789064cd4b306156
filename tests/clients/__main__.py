"""Runs the clients and prints what came of every call; `--write` puts it into docs/clients.md.

`python -m tests.clients [--write] [--keep FOLDER] [NAME ...]`; all clients where none is named. FOLDER keeps the
environments for the next time.
"""

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

from tests.clients.harness import AGREES, DISAGREES, run
from tests.clients.page import written
from tests.clients.table import CLIENTS


def main(arguments):
    """Exit code 1 where a call disagrees, 2 where there is no such client."""
    parser = argparse.ArgumentParser(prog="python -m tests.clients", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--write", action="store_true", help="put the results into docs/clients.md")
    parser.add_argument("--keep", type=Path, help="folder for the environments")
    parser.add_argument("names", nargs="*")
    given = parser.parse_args(arguments)
    known = {client.name: client for client in CLIENTS}
    if unknown := [name for name in given.names if name not in known]:
        print(f"no client {', '.join(unknown)}; there are: {', '.join(known)}", file=sys.stderr)
        return 2
    bad = False
    with tempfile.TemporaryDirectory() as temporary:
        for name in given.names or known:
            client, folder = known[name], given.keep or Path(temporary)
            if client.program and shutil.which(client.program) is None:
                print(f"{name}: not run: no {client.program}")
                continue
            results = run(client, folder)
            for result in results:
                print(f"{name:<14} {result.call:<52} {result.state:<9} {result.why}", flush=True)
            print(f"{name:<14} {sum(result.state == AGREES for result in results)} of {len(results)} agree", flush=True)
            bad |= any(result.state == DISAGREES for result in results)
            if given.write:
                written(client, results)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
