"""What a person sees of a run: a separate process that reads what the run writes, and can neither stop nor slow it.

- `follow`: the run folder, read on from where reading stopped; `kept`: samples for curves and trials
- `channel`: values against limits; `progress`: where the plan is; `state`: all that is known now
- `expected`, `verdicts`: what the specimen file predicts; the line of a finished trial; `quantities`: its numbers, as
  its kind of test reads them
- `wording`, `plot`, `view`: words, curves and the whole picture as text; `lines`: the trials; `plain`: for pipes
- `console`: the loop that draws and reads keys; `link`: messages between it and the run; `child`: the run's side
"""
