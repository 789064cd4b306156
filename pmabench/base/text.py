"""Texts of others on a terminal."""


def printable(text: object) -> str:
    """One line without signs that a terminal would obey: what others wrote is text."""
    return "".join(sign if sign.isprintable() else " " for sign in str(text))
