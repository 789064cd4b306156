"""Runs and their analyses as a package for a repository of research data.

- `about`: what only a person knows: authors, licence, date; checked
- `crate`: the RO-Crate, which says what each file is and where each number comes from
- `package`: the folder or zip with all of it; DataCite, CITATION.cff, Data Package and README, for those who catalogue
  and read it
"""
