"""Parse a scene file into elements with line numbers.

The file is parsed as a stream, and only a part of its tree is in memory at any time: each child of
the root is handed on when it ends.  The limits below keep any file from exhausting memory or time.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from typing import IO, Any
from xml.parsers import expat

from tracer.messages import quoted, short
from tracer.scene.hints import SCENE, malformed

MAX_BYTES = 1 << 28
"""Largest scene file: 256 MiB, about two million objects."""
MAX_TOKEN = 1 << 20
"""Longest tag, comment or text, in bytes or characters."""
MAX_NESTING = 64
"""Deepest nesting, and most children of anything but the scene."""

# Bytes parsed at a time, and how many before them are kept to find the cause of an error.
_READ_BYTES, _TAIL_BYTES = 1 << 14, 1 << 12

# Elements that hold elements, and no text.
_CONTAINERS = frozenset(("scene", "camera", "light", "shader", "surface"))


class FatalFault(Exception):  # noqa: N818 - a fault of the file, not of the program
    """A fault that ends the reading of a file: its line, or 0 for none, and the message."""


class Element(list["Element"]):
    """An element, a list of its children.  The parser sets the slots: faster than `__init__`."""

    __slots__ = ("attrib", "line", "tag", "text")
    tag: str
    attrib: dict[str, str]
    line: int
    text: str


def opened(path: str) -> IO[bytes]:
    """Open a regular file: a pipe or a device may block, or never end."""
    try:
        status = os.stat(path)
    except ValueError:
        wrong = "a path cannot hold a NUL or half of a surrogate pair; check the path"
        raise FatalFault(0, wrong) from None
    if stat.S_ISDIR(status.st_mode):
        raise FatalFault(0, "is a folder; name a scene file in it")
    if not stat.S_ISREG(status.st_mode):
        raise FatalFault(0, "is not a regular file; save the scene to one")
    if status.st_size > MAX_BYTES:
        raise FatalFault(0, f"has {status.st_size} bytes; at most {MAX_BYTES} are allowed")
    return open(path, "rb")


def parse(
    file: IO[bytes],
    read_child: Callable[[Element], None],
    report_at: Callable[[int, str, str], None],
) -> None:
    """Parse a scene file: `read_child` gets the root when it begins, each child when it ends.

    `report_at` gets stray text: its line, the tag around it, and the message.

    Raises
    ------
    FatalFault
        Where the file stops being XML or exceeds a limit; children that end before have been read.
    """
    opened: list[Element] = []
    # Stray text since the last tag is reported already if this holds it: long texts come in pieces.
    strayed: Element | None = None
    encoding = ""

    def start(tag: str, attrib: dict[str, str]) -> None:
        nonlocal strayed
        strayed = None
        element = Element()
        element.tag = tag
        element.attrib = attrib
        element.line = parser.CurrentLineNumber
        element.text = ""
        if len(opened) > 1:
            parent = opened[-1]
            parent.append(element)
            if len(opened) == MAX_NESTING or len(parent) > MAX_NESTING:
                wrong = f"{short(parent.tag)}: more than {MAX_NESTING} elements in another"
                raise FatalFault(element.line, wrong)
        elif not opened:
            read_child(element)
        opened.append(element)

    def end(_tag: str) -> None:
        element = opened.pop()
        if len(opened) == 1:
            read_child(element)

    def text(text: str) -> None:
        nonlocal strayed
        element = opened[-1]
        if text.isspace() and not element.text:
            return
        if element.tag not in _CONTAINERS:
            element.text += text
            if len(element.text) > MAX_TOKEN:
                wrong = f"{short(element.tag)}: more than {MAX_TOKEN} characters; make it shorter"
                raise FatalFault(element.line, wrong)
        elif strayed is not element:
            # The event comes where the text ends; the fault is where it begins.
            strayed, text = element, text.lstrip()
            line = parser.CurrentLineNumber - text.count("\n")
            report_at(line, element.tag, f"stray text {quoted(text.rstrip())}; remove it")

    def declaration(_version: str, declared: str | None, _standalone: int) -> None:
        nonlocal encoding
        encoding = declared or ""

    def doctype(_name: str, system: str | None, _public: str | None, declares: bool) -> None:
        # Entities in others grow exponentially; those of another file would be skipped.
        if declares or system is not None:
            wrong = "are not allowed; write out what entities stand for"
            if not declares:
                wrong = "in another file are not allowed; remove the DOCTYPE"
            raise FatalFault(parser.CurrentLineNumber, f"DOCTYPE: declarations {wrong}")

    parser: Any = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text
    parser.XmlDeclHandler = declaration
    parser.StartDoctypeDeclHandler = doctype
    given, latest, chunk = 0, b"", None
    try:
        while chunk != b"":
            chunk = file.read(_READ_BYTES)
            if not isinstance(chunk, bytes):
                raise TypeError("a scene is read from a binary file, not from text")
            latest = latest[-_TAIL_BYTES:] + chunk
            given += len(chunk)
            if not given:
                raise FatalFault(0, f"is empty; {SCENE}")
            try:
                parser.Parse(chunk, not chunk)
            except expat.ExpatError as error:
                message = expat.ErrorString(error.code)
                if message == expat.errors.XML_ERROR_NO_MEMORY:
                    raise MemoryError from None
                at = max(0, parser.ErrorByteIndex - given + len(latest))
                after = (latest + file.read(_READ_BYTES))[at : at + 256]
                right = malformed(message, error.lineno, latest[:at], after, opened, encoding)
                wrong = f"not XML: {message} at column {error.offset + 1}; {right}"
                raise FatalFault(error.lineno, wrong) from None
            except (LookupError, ValueError, Warning):
                if opened:
                    raise
                # Raised by the codec that the file names.
                raise FatalFault(1, "not XML: unknown encoding; save the file as UTF-8") from None
            # Versions of expat before 2.6 take quadratic time over one token.
            if given - parser.CurrentByteIndex > MAX_TOKEN:
                wrong = f"a tag or comment of more than {MAX_TOKEN} bytes; make it shorter"
                raise FatalFault(parser.CurrentLineNumber, wrong)
            if given > MAX_BYTES:
                raise FatalFault(0, f"has more than {MAX_BYTES} bytes, which are allowed")
    finally:
        parser = None  # breaks the cycle of the parser and its handlers
