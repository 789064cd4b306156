"""Display of a run: a separate process that reads what the run writes, and can neither stop nor slow it.

- `follow`: incremental reading of the run folder and its samples
- `channel`: values against limits, and a bench without a run
- `state`: the present state of the run, and its position in the plan
- `verdicts`: the line of a finished trial, compared with the specimen file and with repeats
- `wording`, `lines`, `view`: words, trials, and the screen with its curves as text
- `web`: the same run in a browser
- `console`: the loop that draws and reads keys; `child`: the run's side, and the messages between both
"""
