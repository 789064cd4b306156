"""A lab's files from its answers: `questions` with `reading` of what is typed, `answers` with limits, the files' text.

Files: `bench_text`, and `files` for the others (specimen, simulated muscle, protocols). Knows no terminal.
"""
