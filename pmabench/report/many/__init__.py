"""Many runs: `many` works out what has changed, run by run, and writes their table; `many_cache` keeps the rest."""
