"""Text files as labs' loggers write them, damaged or odd, made in code; imports nothing of the project.

`cases.CASES` holds them all, each with what a right importer makes of it.
"""
