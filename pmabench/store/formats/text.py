"""How text in rows and columns is laid out, as a map describes it: CSV and its many relatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from pmabench.store.formats.record import Layout

Name = Annotated[str, Field(min_length=1, max_length=120)]
Encoding = Literal[
    "utf-8", "latin-1", "cp1252", "utf-16", "utf-16-le", "utf-16-be", "shift_jis", "euc_jp", "gb18030", "big5", "euc_kr"
]
MARKS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|"}
"""Delimiters of one sign."""


class TextLayout(Layout):
    """How the text is laid out; nothing of it is guessed while it is read."""

    holds_texts: ClassVar[bool] = True
    format: Literal["text"] = "text"
    delimiter: Literal["comma", "semicolon", "tab", "blank", "bar"]
    """`blank`: any run of blanks and tabs."""
    quoted: bool = False
    """Numbers may be in quotation marks; a delimiter between such marks separates nothing."""
    header: Literal["first line", "none"]
    names: Annotated[list[Name], Field(max_length=200)] = []
    """Names of the columns in order, where the file does not give them."""
    decimal: Literal["point", "comma"] = "point"
    thousands: Literal["comma", "point", "blank", "apostrophe"] | None = None
    """Sign between groups of three digits, as in 1,234.5."""
    encoding: Encoding = "utf-8"
    blank_lines: Literal["refuse", "skip"] = "refuse"
    comment: Annotated[str, Field(min_length=1, max_length=8)] | None = None
    """Lines that begin so are left out."""
    skip_lines: Annotated[int, Field(ge=0, le=10_000)] = 0
    """Lines before the header, or before the data."""
    lines_below_header: Annotated[int, Field(ge=0, le=20)] = 0
    """Lines below the line of names that are no rows: units, or what the numbers are the mean of."""
    repeated_header: Literal["refuse", "new test", "page"] = "refuse"
    """What the line of names means where it is repeated further down: another test begins, which makes a run too; or
    the same test goes on, as on the next page of a print-out.
    """
    missing: Annotated[list[Annotated[str, Field(max_length=20)]], Field(max_length=20)] = []
    """Texts that mean "no value"; no other text may replace a number."""

    @property
    def given(self) -> Sequence[str]:
        """`names`: columns have no other ones."""
        return self.names

    @property
    def repeats(self) -> bool:
        """Whether a repeated line of names begins another test."""
        return self.repeated_header == "new test"

    @model_validator(mode="after")
    def _names(self) -> TextLayout:
        if (self.header == "none") != bool(self.names):
            raise ValueError('"header: none" needs "names", and "header: first line" has them already')
        if len(set(self.names)) != len(self.names):
            raise ValueError("two columns have the same name")
        if self.delimiter == "comma" and self.decimal == "comma" and not self.quoted:
            raise ValueError(
                'comma cannot be delimiter and decimal sign at once, but in quotation marks: "quoted: true"'
            )
        twice = self.thousands == self.decimal or (self.thousands == self.delimiter and not self.quoted)
        if self.thousands is not None and twice:
            raise ValueError(f"{self.thousands} cannot be the sign of thousands and of something else at once")
        if self.header == "none" and (self.lines_below_header or self.repeated_header != "refuse"):
            raise ValueError('"lines_below_header" and "repeated_header" need "header: first line"')
        if self.delimiter == "blank" and self.quoted:
            raise ValueError('"quoted: true" needs a delimiter that is no run of blanks')
        return self
