"""Prepare text for messages: escape it, shorten it, or put it in quotes."""

from __future__ import annotations


def make_printable(text: str) -> str:
    """Escape unprintable characters, so that the result is one line that is safe in a terminal."""
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in text)


def shorten(text: str) -> str:
    """Shorten a string to at most 40 characters, and replace what is cut off by "..."."""
    return text if len(text) <= 40 else text[:37] + "..."


def quote(text: str) -> str:
    """Shorten a string as `shorten` does, escape unprintable characters, and put it in quotes."""
    return repr(shorten(text))
