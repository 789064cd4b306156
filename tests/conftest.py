"""Generated cases are the same at every run, so that no test is red today and green tomorrow."""

from hypothesis import settings

import pmabench.cli.main  # noqa: F401  (first: it sets the number of BLAS threads, as for a user)

settings.register_profile("same", derandomize=True, deadline=None, print_blob=True)
settings.load_profile("same")
