"""Many runs: `many` works out what has changed, run by run, and writes one table over all of them."""
