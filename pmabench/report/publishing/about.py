"""What only a person knows of a publication: who made it, under which licence, when; no file is read."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import date
from functools import reduce

from pmabench.base.errors import UsageError

LICENCES = {
    "CC-BY-4.0": ("Creative Commons Attribution 4.0 International", "https://creativecommons.org/licenses/by/4.0/"),
    "CC-BY-SA-4.0": (
        "Creative Commons Attribution Share Alike 4.0 International",
        "https://creativecommons.org/licenses/by-sa/4.0/",
    ),
    "CC0-1.0": ("Creative Commons Zero v1.0 Universal", "https://creativecommons.org/publicdomain/zero/1.0/"),
    "ODC-By-1.0": ("Open Data Commons Attribution License v1.0", "https://opendatacommons.org/licenses/by/1-0/"),
    "ODbL-1.0": ("Open Data Commons Open Database License v1.0", "https://opendatacommons.org/licenses/odbl/1-0/"),
}
"""SPDX identifier of a licence for data -> its name and address."""
_ORCID = re.compile(r"(?:https://orcid\.org/)?(\d{4}-\d{4}-\d{4}-\d{3}[\dX])")
_DOI = re.compile(r"(?:https://doi\.org/)?(10\.\d{4,9}/[-._;()/:A-Za-z0-9]+)")


@dataclass(frozen=True)
class Place:
    """An organisation: a laboratory, a university, a repository."""

    name: str
    url: str = ""
    """Its page, or its address at ror.org; empty: not known."""

    @classmethod
    def read(cls, text: str) -> Place:
        """An organisation written as `Name https://address`; the address may be left out."""
        name, _, url = text.rpartition(" ")
        return cls(name.strip(), url) if name.strip() and url.startswith(("https://", "http://")) else cls(text.strip())


@dataclass(frozen=True)
class Author:
    """A person who made the data."""

    family: str
    given: str
    orcid: str = ""
    """16 digits in groups of four; empty: not known."""
    affiliation: Place | None = None

    @property
    def name(self) -> str:
        """As catalogues sort it: `Family, Given`."""
        return f"{self.family}, {self.given}"

    @classmethod
    def read(cls, text: str) -> Author:
        """An author written as `Family, Given; ORCID; affiliation`; the last two may be left out. Raises UsageError."""
        name, *rest = (part.strip() for part in text.split(";"))
        family, comma, given = (part.strip() for part in name.partition(","))
        if not (comma and family and given) or len(rest) > 2:
            raise UsageError(f'author "{text}": write "Family, Given; ORCID; affiliation", the last two where known')
        ids = [part for part in rest if _ORCID.fullmatch(part)]
        others = [part for part in rest if part and part not in ids]
        orcid = _ORCID.sub(r"\1", ids[0]) if ids else ""
        if len(ids) > 1 or len(others) > 1 or (orcid and not _checked(orcid)):
            raise UsageError(f'author "{text}": the ORCID is wrong; it looks like 0000-0002-1825-0097')
        return cls(family, given, orcid, Place.read(others[0]) if others else None)


def _checked(orcid: str) -> bool:
    """Whether the last sign of an ORCID is its check digit (ISO 7064, 11-2)."""
    total = reduce(lambda found, digit: (found + int(digit)) * 2, orcid.replace("-", "")[:-1], 0)
    return "0123456789X"[(12 - total % 11) % 11] == orcid[-1]


@dataclass(frozen=True)
class About:
    """What is said of a publication as a whole; raises UsageError for a date or DOI that is none."""

    authors: tuple[Author, ...]
    licence: str
    """A key of `LICENCES`."""
    published: str
    """Date, `2026-11-28`."""
    publisher: Place
    title: str = ""
    """Empty: made of the specimen."""
    doi: str = ""
    """Empty: not given yet; the repository adds it."""

    def __post_init__(self) -> None:
        """Check the form of what is given."""
        try:
            date.fromisoformat(self.published)
        except ValueError as error:
            raise UsageError(f'date "{self.published}": write it as 2026-11-28') from error
        if self.doi and not _DOI.fullmatch(self.doi):
            raise UsageError(f'DOI "{self.doi}": it looks like 10.5281/zenodo.1234567')
        object.__setattr__(self, "doi", _DOI.sub(r"\1", self.doi))
