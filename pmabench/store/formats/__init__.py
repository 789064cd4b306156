"""Formats of files that other programs write: one module with one record `FORMAT` each, found by `registry`.

A package next to pmabench brings one by an entry point of the group `pmabench.formats` that names its record. `record`
has what such a module needs.
"""
