"""Remedies: what would make a malformed file XML, and which name or number was meant."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Iterable, Sequence
from itertools import islice
from typing import Any
from xml.parsers.expat import errors

from tracer.messages import quoted, short

SCENE = "a scene file holds <scene> ... </scene>"

_INVALID, _UNCLOSED = errors.XML_ERROR_INVALID_TOKEN, errors.XML_ERROR_UNCLOSED_TOKEN
_QUOTED = 'put the value of an attribute in quotes, as in type="Sphere"'
_TAGS = 'tags are written like <shader name="red" type="Phong">, </shader>, <shader ref="red"/>'

# Expat's message, or "" for any; patterns for the text before and after the error; the remedy.
# The first row that matches counts.
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

# Remedies of other errors, by expat's message alone.
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

# Elements of other dialects of the course, in lower case, and what they are here: the first that
# the element around them may hold, or "" for what this format does not have.
_DIALECTS = {
    **dict.fromkeys(("position", "eye", "from"), ("viewPoint", "center")),
    **dict.fromkeys(("direction", "gaze"), ("viewDir",)),
    "up": ("viewUp",),
    "imageplane": ("projDistance, viewWidth and viewHeight", ""),
    **dict.fromkeys(("exposure", "samples", "background", "ambient", "integrator"), ("",)),
    **{name.lower(): (f'<surface type="{name}">',) for name in ("Sphere", "Box")},
    **{name.lower(): (f'<shader type="{name}">',) for name in ("Lambertian", "Phong")},
}


def malformed(
    message: str, line: int, before: bytes, after: bytes, opened: Sequence[Any], encoding: str
) -> str:
    """Say what would make a file XML.

    Parameters
    ----------
    message, line
        What the parser reports, and where.
    before, after
        The file around that position, some KiB at most.
    opened
        Elements that have not ended there, the root first.
    encoding
        As the file declares it; "" if it does not.
    """
    # UTF-8 in a file that declares another encoding; expat does not know "utf8".
    if encoding.lower() not in ("", "utf-8") and re.match(rb"[\xc2-\xf4][\x80-\xbf]", after):
        return f'write encoding="UTF-8" in the first line, not {quoted(encoding)}'
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


def meant(name: str, known: Iterable[str]) -> str | None:
    """Return which of the `known` names is most similar; None if none is similar."""
    from difflib import get_close_matches  # imported after a fault only: it takes milliseconds

    # Each takes some 30 us to compare.
    folded = {short(word).lower(): word for word in islice(known, 256)}
    matches = get_close_matches(short(name).lower(), folded, n=1)
    return folded[matches[0]] if matches else None


def suggestion(known: Iterable[str], match: str | None) -> str:
    """Say what to write for an unknown name: the `match`, or else any that is known."""
    names = sorted(islice(known, 256))
    if match is not None:
        return f"did you mean {quoted(match)}?"
    if not names:
        return "remove it"
    return f"known: {', '.join(map(short, names[:9]))}{', ...' * (len(names) > 9)}"


def unknown_tag(tag: str, known: Collection[str]) -> tuple[str, str | None]:
    """Say what to write for an unknown element, and return the tag that was meant, if any."""
    for here in _DIALECTS.get(tag.lower(), ()):
        if not here:
            return "remove it", None
        if here.startswith("<") or here.split(",")[0] in known:
            return f"write {here}", here
    match = meant(tag, known)
    return suggestion(known, match), match


def not_a_number(word: str) -> str:
    """Say why a word is not a number, and what to write."""
    odd = next((c for c in word if not c.isascii()), None)
    if odd is not None:
        category, right = unicodedata.category(odd), "write a plain character in its place"
        if category == "Cf":
            right = "remove it"
        elif category.startswith("Z"):
            right = "write a plain space in its place"
        elif category == "Pd" or odd == "\N{MINUS SIGN}":
            right = "write - in its place"
        return f"{quoted(word)} contains U+{ord(odd):04X}, {unicodedata.name(odd, '?')}; {right}"
    if "," in word:
        return f"{quoted(word)} contains a comma; separate numbers by spaces, and write 1.5 for 1,5"
    return f"{quoted(word)} is not a decimal number; write it as 2, -.5 or 1e-3"
