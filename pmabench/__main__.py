"""`python -m pmabench`."""

import sys

if __name__ == "__main__":
    if not sys.flags.safe_path:  # Python put the current folder first; a bench file must not import what lies there
        del sys.path[0]
    from pmabench.cli.main import main

    main(prog_name="pmabench")
