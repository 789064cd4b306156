"""What reductions share, independent of the kind of test: pure functions over loaded runs.

- quantities of one trial: `trial`; a result is an `Analysis` of `store.analyses.results`
- `imported`: what imported runs hold besides samples; `tuning`: controller settings
- `many`: many runs in parallel, on this machine or on a Dask cluster
- fit of a library model to a table: `model_fit`, which uses `model_problem`
- checks of a result, and comparison of results: `verdict`
- model of a muscle with hysteresis and creep, fitted to all its slow tests: `surface`
- choice of the next trial by what it would add: `next_trial`
- parts of reductions: `shared`
"""
