"""Formats of files that other programs write: a module of each has the record `FORMAT`, found by `record.formats`.

A package next to pmabench brings one by an entry point of the group `pmabench.formats` that names its record. `record`
has what such a module needs. `text` says how text is laid out, `text_reader` reads it.
"""
