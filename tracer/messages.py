"""Prepare text for messages: escape it, shorten it, put it in quotes, or name an element.

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


def name_element(kind: str, index: int, line: int | None) -> str:
    """Return a name for a light or a surface, such as "light 0 (line 12)".

    `line` is its line in the scene file.  If it does not come from a file (None), the name is
    "light 0".
    """
    return f"{kind} {index}" if line is None else f"{kind} {index} (line {line})"
