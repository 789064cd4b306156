"""The live view in a browser: a server on this computer that reads run folders, and one page; it commands nothing.

- `series`: minima and maxima over time, in buckets of several widths, so that hours are drawn from a few hundred
  numbers; and pressure, displacement and force of the current trial, for its loop
- `picture`: the state of a run as plain data for the page
- `feeds`: one run, kept up to date for its viewers; the run of an address, and the reading thread
- `server`: requests, access control, the page with its policy, streams, and the vent button, if bench file and command
  line allow it
"""
