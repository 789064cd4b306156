"""`python -m pmabench.guard`: the guard of one bench as a process."""

from pmabench.guard.process import main

main()
