"""Remedies: what would make a malformed file XML, and the name that was meant."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Any
from xml.parsers.expat import errors

from tracer.messages import quoted, short

SCENE = "a scene file holds <scene> ... </scene>"

_INVALID, _UNCLOSED = errors.XML_ERROR_INVALID_TOKEN, errors.XML_ERROR_UNCLOSED_TOKEN
_QUOTED = 'put the value of an attribute in quotes, as in type="Sphere"'
_TAGS = 'tags are written like <shader name="red" type="Phong">, </shader>, <shader ref="red"/>'

# What the text before a fault ends with, and how it goes on; expat's message, or "" for any.
# The first that fits tells the remedy.
_TEXTS = (
    ("", rb"", rb".?\0", "save the file as UTF-8, and without a NUL"),
    (_INVALID, rb"\A[^<]*", rb"[^<]", SCENE),  # it may be a picture
    ("", rb"", rb"[\x80-\xc1\xf5-\xff]|[\xc2-\xf4](?![\x80-\xbf])", "save the file as UTF-8"),
    (_UNCLOSED, rb"", rb"<!--", "end it with -->"),
    (_UNCLOSED, rb"", rb"<\?", "end it with ?>"),
    (_UNCLOSED, rb"", rb"<", "end it with >"),
    ("", rb"<!--(?:(?!-->).)*--", rb"", "in a comment, write - in place of --"),
    ("", rb"=\s*", rb"\w", _QUOTED),
    ("", rb"", rb"\xe2\x80[\x98\x99\x9c\x9d]", 'write straight quotes, as in type="Sphere"'),
    ("", rb"", rb"[\x01-\x08\x0e-\x1f]", "remove the control character"),
    ("", rb"", rb"[\x80-\xff]", "write a plain character in place of {odd!r} (U+{number:04X})"),
    ("", rb"<[a-zA-Z/][^<>]*", rb"<", "end the tag of line {line} with >"),
    ("", rb'<[a-zA-Z/][^<"]*(?:"[^<"]*"[^<"]*)*"[^<"]*', rb"<", "close the quotes of line {line}"),
    ("", rb"<[a-zA-Z/][^<']*(?:'[^<']*'[^<']*)*'[^<']*", rb"<", "close the quotes of line {line}"),
    (_INVALID, rb"<", rb"", "in text, < is written &lt;, and a tag has its name right after <"),
    (_INVALID, rb"<![^<>\"']*", rb"", "a comment is written <!-- ... -->"),
    (_INVALID, rb"""<(?:[^<>"']|"[^<>"]*"|'[^<>']*')*""", rb"", _TAGS),
    (_INVALID, rb"", rb"", "in text, < is written &lt; and & is written &amp;"),
)

# For other errors the parser's message alone tells what would be right.
_ERRORS = {
    errors.XML_ERROR_BAD_CHAR_REF: "no character of XML has this number; remove it",
    errors.XML_ERROR_DUPLICATE_ATTRIBUTE: "keep one of the two",
    errors.XML_ERROR_INCORRECT_ENCODING: "save the file as UTF-8, and declare no other",
    errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT: "nothing may follow </scene>",
    errors.XML_ERROR_MISPLACED_XML_PI: "nothing may stand before <?xml ... ?>",
    errors.XML_ERROR_UNCLOSED_CDATA_SECTION: "end it with ]]>",
    errors.XML_ERROR_UNDEFINED_ENTITY: "write out what the entity stands for",
    errors.XML_ERROR_UNKNOWN_ENCODING: "save the file as UTF-8",
    errors.XML_ERROR_XML_DECL: 'write it as <?xml version="1.0"?>, or leave it out',
}


def malformed(message: str, line: int, before: bytes, after: bytes, opened: Sequence[Any]) -> str:
    """Say what would make a file XML.

    Given are the parser's message and line, the text right before that place and after it, and the
    elements that have not ended there, from the root on.
    """
    last = f"<{short(opened[-1].tag)}> of line {opened[-1].line}" if opened else None
    for error, ends, begins, remedy in _TEXTS:
        text = re.search(rb"(?s:%b)\Z" % ends, before) if error in ("", message) else None
        if text and re.match(begins, after):
            begun, odd = line - text[0].count(b"\n"), after.decode(errors="replace")[:1] or " "
            return remedy.format(line=begun, odd=odd, number=ord(odd))
    if message == errors.XML_ERROR_TAG_MISMATCH:
        name = re.split(rb"[\s>]", after)[0].decode(errors="ignore")
        if all(name != element.tag for element in opened):
            return f"only {last} can be closed here: no <{short(name)}> is open"
    return _ERRORS.get(message) or (f"close {last}" if last else SCENE)


def nearest(name: str, known: Iterable[str]) -> str:
    """Say what to write for an unknown `name`: the most similar one, or all that are known."""
    from difflib import get_close_matches  # imported after a fault only: it takes milliseconds

    # Each takes some 30 us to compare.
    names = sorted(islice(known, 256))
    if not names:
        return "remove it"
    folded = {word.lower(): word for word in names}
    for match in get_close_matches(short(name).lower(), folded, n=1):
        return f"did you mean {quoted(folded[match])}?"
    return f"known: {', '.join(map(short, names[:9]))}{', ...' * (len(names) > 9)}"
