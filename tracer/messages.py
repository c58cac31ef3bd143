"""Make names and texts printable for messages."""

from __future__ import annotations


def printable(text: str) -> str:
    """Return a text as one line that any terminal can show: a line break becomes ``\\n``."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def shortened(text: str) -> str:
    """Return a name or text, with its end replaced by "..." if it exceeds 40 characters."""
    return text if len(text) <= 40 else text[:37] + "..."


def quoted(text: str) -> str:
    """Return a name or text shortened, in quotes, as one line that any terminal can show."""
    return repr(shortened(text))
