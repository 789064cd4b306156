"""The live view in a browser: a server on this computer that reads run folders, and one page; it commands nothing.

- `series`: least and greatest values over time, at several widths, so that hours are drawn from a few hundred numbers;
  and pressure, displacement and force of the trial under way, for its loop
- `picture`: what is known of a run as plain data for the page
- `feeds`: one run, kept up to date for its viewers; which run an address of the page means, and the thread that reads
- `server`: requests, who may ask, the page with its policy, streams, and the vent button, where bench file and command
  line allow it
"""
