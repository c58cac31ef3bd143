"""From a scene file to its elements, which know their lines.

The file is parsed as a stream, and only a part of its tree is ever held: the root's children are
handed on some at a time.  All that is read is held against the limits below, so that no file can
exhaust memory or time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn, Protocol
from xml.parsers import expat

from tracer.messages import quoted, short
from tracer.scene.remedies import SCENE, malformed

__all__ = [
    "MAX_BYTES",
    "MAX_NESTING",
    "MAX_TOKEN",
    "BinaryFile",
    "Element",
    "GiveUp",
    "Parser",
]

MAX_BYTES = 1 << 28
"""Largest scene file: 256 MiB, about two million objects."""
MAX_TOKEN = 1 << 20
"""Longest tag, comment or text, in bytes or characters."""
MAX_NESTING = 64
"""Deepest nesting, and most children of anything but the scene."""

# Bytes parsed at a time, and what is kept of those before, to find remedies.
_CHUNK, _TAIL = 1 << 14, 1 << 12

# Elements that hold elements, and no text.
_CONTAINERS = frozenset(("scene", "camera", "light", "shader", "surface"))


class BinaryFile(Protocol):
    """A file object to read bytes from."""

    def read(self, size: int, /) -> bytes: ...


class GiveUp(Exception):  # noqa: N818 - it tells a fault, and that no other will be found
    """A fault after which the rest of the file is not worth reading: the line or 0, and words."""


class Element(list["Element"]):
    """A sequence of its children.  Who makes it sets the slots: faster than a constructor."""

    __slots__ = ("attrib", "line", "tag", "text")
    tag: str
    attrib: dict[str, str]
    line: int
    text: str


class Parser:
    """Makes elements of a file, and hands them to its three first methods, which are for others."""

    def __init__(self) -> None:
        self.root = Element()
        self.open: list[Element] = []
        # Where stray text since the last tag is noted already: a long one comes in pieces.
        self.strayed: Element | None = None

    def begin(self, root: Element) -> None:
        """Take the root, which has no children yet."""
        raise NotImplementedError

    def take(self, elements: Sequence[Element]) -> None:
        """Take children of the root."""
        raise NotImplementedError

    def note(self, line: int, tag: str, message: str) -> None:
        """Note a fault."""
        raise NotImplementedError

    def parse(self, file: BinaryFile) -> None:
        """Read a file to its end; raise `GiveUp` where it is no longer XML, or passes a limit."""
        self.parser = parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._text
        parser.StartDoctypeDeclHandler = self._doctype
        start = latest = b""
        given = 0
        try:
            while chunk := file.read(_CHUNK):
                if not isinstance(chunk, bytes):
                    raise TypeError("a scene is read from a binary file, not from text")
                start, latest = start or chunk[:2], latest[-_TAIL:] + chunk
                given += len(chunk)
                parser.Parse(chunk)
                # Versions of expat before 2.6 take quadratic time over one token.
                if given - parser.CurrentByteIndex > MAX_TOKEN:
                    self._refuse(
                        f"a tag or comment of more than {MAX_TOKEN} bytes; make it shorter"
                    )
                if given > MAX_BYTES:
                    raise GiveUp(0, f"has more than {MAX_BYTES} bytes, which are allowed")
            if not given:
                raise GiveUp(0, f"is empty; {SCENE}")
            parser.Parse(b"", True)
        except expat.ExpatError as error:
            message = expat.ErrorString(error.code)
            if message == expat.errors.XML_ERROR_NO_MEMORY:
                raise MemoryError from None
            at = max(0, parser.ErrorByteIndex - given + len(latest))
            around = latest[:at][-_TAIL:], (latest + file.read(_CHUNK))[at : at + 256]
            opened = [(element.tag, element.line) for element in self.open]
            right = malformed(message, error.lineno, around, start, opened)
            wrong = f"not XML: {message} at column {error.offset + 1}; {right}"
            raise GiveUp(error.lineno, wrong) from None
        except (LookupError, ValueError, Warning):  # of the codec that the file asks for
            raise GiveUp(1, "not XML: unknown encoding; save the file as UTF-8") from None
        finally:
            del self.parser  # it holds this object by its handlers: a cycle

    def ended(self) -> list[Element]:
        """Children of the root that have ended, and were not taken."""
        return self.root[:-1] if len(self.open) > 1 else self.root

    def _refuse(self, message: str) -> NoReturn:
        raise GiveUp(self.parser.CurrentLineNumber, message)

    def _doctype(self, _name: str, system: str | None, _public: str | None, declares: bool) -> None:
        # Nested entities grow exponentially, and declared attributes take quadratic time.
        if declares:
            self._refuse("DOCTYPE: declarations are not allowed; write out what entities stand for")
        # That file would not be read, and entities it defines be skipped, some in silence.
        if system is not None:
            self._refuse(
                "DOCTYPE: declarations in another file are not allowed; remove the DOCTYPE"
            )

    def _start(self, tag: str, attrib: dict[str, str]) -> None:
        element = Element()
        element.tag = tag
        element.attrib = attrib
        element.line = self.parser.CurrentLineNumber
        element.text = ""
        self.strayed = None
        opened = self.open
        if opened:
            parent = opened[-1]
            parent.append(element)
            if len(opened) == MAX_NESTING or len(parent) > MAX_NESTING:
                wrong = f"{short(parent.tag)}: more than {MAX_NESTING} elements in another"
                raise GiveUp(element.line, wrong)
        else:
            self.begin(element)
            self.root = element
        opened.append(element)

    def _end(self, _tag: str) -> None:
        self.open.pop()
        # So few at a time that they stay in cache.
        if len(self.root) == MAX_NESTING and len(self.open) == 1:
            self.take(self.root)
            self.root.clear()

    def _text(self, text: str) -> None:
        element = self.open[-1]
        if text.isspace() and not element.text:
            return
        if element.tag not in _CONTAINERS:
            element.text += text
            if len(element.text) > MAX_TOKEN:
                wrong = f"{short(element.tag)}: more than {MAX_TOKEN} characters; make it shorter"
                raise GiveUp(element.line, wrong)
        elif self.strayed is not element:
            # The event comes where the text ends; the fault is where it begins.
            text = text.lstrip()
            line = self.parser.CurrentLineNumber - text.count("\n")
            self.note(line, element.tag, f"stray text {quoted(text.rstrip())}; remove it")
            self.strayed = element
