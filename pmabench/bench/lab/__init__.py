"""A lab's files from its answers: `questions` with `reading` of what is typed, `answers`, and the text of the files.

Files: `bench_text`, `muscle_text` (specimen, simulated muscle), `protocol_text`; `daqs` is what can measure.
Knows no terminal.
"""
