"""Many runs: `many`, which works out only what has changed (`many_cache`), one by one (`processed`); `many_table`."""
