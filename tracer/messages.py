"""Prepare text for messages: escape it, shorten it, or put it in quotes.

Messages quote scene files, which may contain long lines and control characters.
"""

from __future__ import annotations


def make_printable(text: str) -> str:
    """Escape unprintable characters, such as line breaks, as in a Python string.

    The result is one line that cannot change the state of a terminal.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in text)


def shorten(text: str) -> str:
    """Shorten a string to at most 40 characters, which end in "..." if something is cut off."""
    return text if len(text) <= 40 else text[:37] + "..."


def quote(text: str) -> str:
    """Shorten a string to 40 characters, escape unprintable characters, and put it in quotes."""
    return repr(shorten(text))
