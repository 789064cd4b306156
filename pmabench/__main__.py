"""`python -m pmabench`."""

import sys

if __name__ == "__main__":
    if not sys.flags.safe_path:  # the first entry is the current folder; nothing in it may be imported
        del sys.path[0]
    from pmabench.cli.main import main

    main(prog_name="pmabench")
