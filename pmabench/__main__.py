"""`python -m pmabench`."""

from pmabench.cli.main import main

if __name__ == "__main__":
    main(prog_name="pmabench")
