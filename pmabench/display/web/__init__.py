"""The live view in a browser: a server on this computer that reads run folders, and one page; it commands nothing.

- `buckets`: least and greatest values over time, at several widths, so that hours are drawn from a few hundred numbers
- `loop`: pressure, displacement and force of the trial under way, for its loop
- `picture`: what is known of a run as plain data for the page; `feed`: one run, kept up to date for its viewers
- `room`: which run an address of the page means; the feeds of all viewers, and the thread that reads
- `page`: the one file that a browser loads, with the hashes of its policy
- `server`: requests, who may ask, streams, and the vent button, where bench file and command line allow it
"""
