"""What a person sees of a run: a separate process that reads what the run writes, and can neither stop nor slow it.

- `follow`: the run folder, read on from where reading stopped, its samples, and the run that comes after it
- `channel`: values against limits, and a bench without a run
- `progress`: where the plan is; `state`: all that is known now
- `verdicts`: the line of a finished trial, compared with the specimen file and with repeats
- `wording`, `lines`, `view`: words, trials, and the picture with its curves as text
- `web`: the same run in a browser
- `console`: the loop that draws and reads keys; `child`: the run's side, and the messages between both
"""
