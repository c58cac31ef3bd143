"""Make names and texts fit for messages: printable, short and quoted."""

from __future__ import annotations


def printable(text: str) -> str:
    """Return a text with its unprintable characters escaped: a line break becomes ``\\n``.

    The result is a single line without control characters, so it is safe to show in a terminal.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in text)


def shortened(text: str) -> str:
    """Limit a text to 40 characters: the end of a longer text is replaced by "..."."""
    return text if len(text) <= 40 else text[:37] + "..."


def quoted(text: str) -> str:
    """Return a text in quotes, limited to 40 characters, with unprintable characters escaped."""
    return repr(shortened(text))
