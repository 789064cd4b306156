"""A lab's files from its answers. Knows no terminal.

`questions` with the answers and limits, `reading` of what is typed, `files`: bench, specimen, simulated muscle,
calibrations, protocol.
"""
