"""Exchanges on a wire as text files: made against the emulators, replayed byte by byte in front of the drivers.

`python -m tests.captures [NAME ...]` makes the files of fixtures/captures anew; look at the difference before you keep it.
"""
