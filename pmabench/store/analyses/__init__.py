"""Analyses as files: `results` is the record of what was found; `folder` writes and reads it, and says of what it was made.

By that it decides whether analyses of the last time can be used again.
"""
