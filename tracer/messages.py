"""How names and texts stand in messages."""

from __future__ import annotations


def printable(text: str) -> str:
    """`text` in one line that any terminal can show: a new line becomes ``\\n``."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def short(text: str) -> str:
    """At most 40 characters of a name or text."""
    return text if len(text) <= 40 else text[:37] + "..."


def quoted(text: str) -> str:
    """The same in quotes, on one line that any terminal can show."""
    return repr(short(text))
