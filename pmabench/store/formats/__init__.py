"""Formats of files that other programs write: each module here has one record `FORMAT`, found by `record.formats`.

A package next to pmabench brings one by an entry point of the group `pmabench.formats` that names its record. `record`
has what such a module needs; what several formats share is in `shared`.
"""
