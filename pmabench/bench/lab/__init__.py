"""A lab's files from its answers. Uses no terminal.

`questions` holds the questions, answers and limits, `reading` parses what is typed, `files` writes bench, specimen,
simulated muscle, calibrations and protocol.
"""
