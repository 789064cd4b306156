"""Files of other programs, reduced as they were recorded.

- isometric, recorded-pull: `isometric`; recorded-step: `recorded_steps`, with `driven_motion`; recorded-sine:
  `recorded_sines`, with `sweep_bandwidth`
- what imports say beside their samples: `imported`
"""
