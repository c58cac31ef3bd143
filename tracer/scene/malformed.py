"""What would make a malformed file XML: the remedies for what the parser finds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import IO
from xml.parsers.expat import errors

from tracer.messages import character, short
from tracer.scene.contents import LineElement

__all__ = ["remedy"]

# How much of the file before a fault, and after it, is looked at: before it, as much as a tag or
# comment may take.
_BEFORE, _AFTER = 1 << 20, 256

# For errors where the parser's message alone tells what would be right.
_REMEDIES = {
    errors.XML_ERROR_BAD_CHAR_REF: "no character of XML has this number; remove it",
    errors.XML_ERROR_DUPLICATE_ATTRIBUTE: "keep one of the two",
    errors.XML_ERROR_INCORRECT_ENCODING: "save the file as UTF-8, and declare no other",
    errors.XML_ERROR_INVALID_TOKEN: "in text, < is written &lt; and & is written &amp;",
    errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT: "nothing may follow </scene>",
    errors.XML_ERROR_MISPLACED_XML_PI: "nothing may stand before <?xml ... ?>",
    errors.XML_ERROR_UNCLOSED_CDATA_SECTION: "end it with ]]>",
    errors.XML_ERROR_UNDEFINED_ENTITY: "write out what the entity stands for",
    errors.XML_ERROR_UNKNOWN_ENCODING: "save the file as UTF-8",
    errors.XML_ERROR_XML_DECL: 'write it as <?xml version="1.0"?>, or leave it out',
}

_TAGS = 'tags are written like <shader name="red" type="Phong">, </shader>, <shader ref="red"/>'

# How files in UTF-16 begin: with its mark, or with a tag.
_UTF16 = {
    b"\xff\xfe": "utf-16-le",
    b"<\0": "utf-16-le",
    b"\xfe\xff": "utf-16-be",
    b"\0<": "utf-16-be",
}

_SCENE = "a scene file holds <scene> ... </scene>"


def remedy(
    message: str, line: int, index: int, opened: Sequence[LineElement], file: IO[bytes]
) -> str:
    """What would be right.

    Parameters
    ----------
    message : str
        Expat's, of what is wrong.
    line, index : int
        Where: the line, and the byte.
    opened : sequence of LineElement
        The elements that have not ended there, from the root on.
    file : binary file
    """
    file.seek(0)
    encoding = _UTF16.get(file.read(2), "utf-8")
    start = max(0, index - _BEFORE)
    file.seek(start)
    around = file.read(index - start), file.read(_AFTER)
    if encoding != "utf-8":
        before, after = (text.decode(encoding, "replace").encode() for text in around)
    else:
        before, after = around
    if after.startswith(b"\0"):  # UTF-32, taken for UTF-16, has some as well
        return "save the file as UTF-8, and without a NUL"
    if index == 0 and not after.startswith(b"<"):  # a picture, say
        return _SCENE
    return (
        _of_character(message, before, after)
        or _of_tag(message, line, before, after)
        or _of_element(message, before, after, opened)
    )


def _of_character(message: str, before: bytes, after: bytes) -> str | None:
    """Where the fault is told by what stands right there."""
    if message == errors.XML_ERROR_UNCLOSED_TOKEN and after.startswith(b"<"):
        end = "-->" if after.startswith(b"<!--") else "?>" if after.startswith(b"<?") else ">"
        return f"end it with {end}"
    if before.endswith(b"--") and before.rfind(b"<!--") > before.rfind(b"-->"):
        return "in a comment, write - in place of --"
    if before.rstrip().endswith(b"=") and after[:1].isalnum():
        return 'put the value of an attribute in quotes, as in type="Sphere"'
    if after[:3].decode(errors="ignore") in tuple("\u201c\u201d\u2018\u2019"):
        return 'write straight quotes, as in type="Sphere"'
    if b"\0" < after[:1] < b" " and not after[:1].isspace():
        return "remove the control character"
    if after >= b"\x80":
        odd = after.decode(errors="replace")[0]
        if odd == "\ufffd":
            return "save the file as UTF-8"
        return f"write a plain character in place of {character(odd)}"
    return None


def _of_tag(message: str, line: int, before: bytes, after: bytes) -> str | None:
    """Where the fault is in a tag, or in one that has not ended."""
    tag = before[before.rfind(b"<") :]
    unclosed = tag.count(b'"') % 2 or tag.count(b"'") % 2
    if after.startswith(b"<") and (tag[1:2].isalpha() or tag.startswith(b"</")):
        line -= tag.count(b"\n")
        if b">" not in tag:
            return f"end the tag of line {line} with >"
        if unclosed:
            return f"close the quotes of line {line}"
    if message == errors.XML_ERROR_INVALID_TOKEN and b">" not in tag and not unclosed:
        if tag == b"<":
            return "in text, < is written &lt;, and a tag has its name right after <"
        if tag.startswith(b"<!"):
            return "a comment is written <!-- ... -->"
        if tag.startswith(b"<"):
            return _TAGS
    return None


def _of_element(message: str, before: bytes, after: bytes, opened: Sequence[LineElement]) -> str:
    """Where the fault is between tags."""
    last = f"<{short(opened[-1].tag)}> of line {opened[-1].line}" if opened else None
    if message == errors.XML_ERROR_TAG_MISMATCH:
        name = re.split(rb"[\s>]", after)[0].decode(errors="ignore")
        if all(name != element.tag for element in opened):
            return f"only {last} can be closed here: no <{short(name)}> is open"
    # Outside all elements and tags there is no text in which < or & could be escaped.
    outside = not opened and before.rfind(b"<") <= before.rfind(b">")
    if message in _REMEDIES and not (outside and message == errors.XML_ERROR_INVALID_TOKEN):
        return _REMEDIES[message]
    return f"close {last}" if last else _SCENE
