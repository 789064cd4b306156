"""Analyses as files: `results` defines the data, `folder` writes and reads them.

`folder` also stores what an analysis was made from, to decide whether it can be reused.
"""
