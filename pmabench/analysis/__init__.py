"""What reductions share: results, intervals, verdicts; pure functions over loaded runs. Knows no kind of test.

- what one trial says by itself: `trial`; a result is an `Analysis` of `store.analyses.results`
- `imported`: what imports say besides their samples; `tuning`: controller settings
- `many` works on many runs at once, here or on a Dask cluster
- a library model fitted to a table: `model_fit`, made of `model_problem`
- what speaks for or against a result, and results next to each other: `verdict`
- a muscle with hysteresis and creep, from all its slow tests: `surface`
- what further trials would add, and which to do next: `next_trial`
- parts of reductions: `shared`
"""
