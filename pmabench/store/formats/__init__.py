"""Formats of other programs' files: each module defines a record `FORMAT`, which `record.formats` finds.

Other packages add formats by an entry point of the group `pmabench.formats` that names their record. `record` has what
such a module needs. `text` describes the layout of text files, `text_reader` reads them.
"""
