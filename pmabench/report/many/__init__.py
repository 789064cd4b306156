"""Many runs: `many`, which works out only what has changed, one by one (`processed`); `many_table`."""
