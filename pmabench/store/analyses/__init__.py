"""Analyses as files: `results` is the record of what was found, `folder` writes and reads it, `made_from` says of what.

`made_from` decides whether analyses of the last time can be used again.
"""
