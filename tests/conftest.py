"""Generated cases are the same at every run, so that no test is red today and green tomorrow."""

from hypothesis import settings

import pmabench.cli.main  # noqa: F401  (sets the number of BLAS threads before numpy is loaded, as for a user)

settings.register_profile("same", derandomize=True, deadline=None, print_blob=True)
settings.load_profile("same")
