"""Parse a scene file into elements with line numbers.

The problem is to read files of up to 256 MiB in little memory.  Expat parses the file as a stream.
Each child of the root is complete when its end tag is parsed; it is then passed on and forgotten,
so that at most one child is in memory.  Limits on the bytes of a file, on the length of a token,
and on the elements in one child bound the memory and time that any file can take.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from typing import IO, Any
from xml.parsers import expat

from tracer.messages import quoted, shortened
from tracer.scene.hints import SCENE, syntax_remedy

MAX_BYTES = 1 << 28
"""Maximum size of a scene file: 256 MiB, about two million objects."""
MAX_TOKEN_BYTES = 1 << 20
"""Maximum length of a tag, a comment or a text, in bytes or characters."""
MAX_DESCENDANTS = 64
"""Maximum number of elements inside one child of the scene, and of attributes of one element."""

# Bytes that are parsed together, and bytes before these that are kept to diagnose a syntax error.
_CHUNK_BYTES, _KEPT_BYTES = 1 << 14, 1 << 12

# Bytes after a syntax error that are enough to diagnose it.
_LOOKAHEAD_BYTES = 256

# Elements that contain other elements, and no text.
_CONTAINERS = frozenset(("scene", "camera", "light", "shader", "surface"))


class FatalError(Exception):
    """An error that ends the reading of a file.

    Its `args` are the line of the file, or 0 if the error has none; and the message, which contains
    a suggested fix.
    """


class Element(list["Element"]):
    """An element of the file: a list of its children, with its tag, attributes, line and text."""

    # The parser sets the slots one by one, which takes less time than a call of `__init__`.
    __slots__ = ("attrib", "line", "tag", "text")
    tag: str
    attrib: dict[str, str]
    line: int
    text: str


def open_scene(path: str) -> IO[bytes]:
    """Open a scene file, provided that it is a regular file of at most `MAX_BYTES`.

    Other files, such as pipes and devices, may block or never end.

    Raises
    ------
    FatalError
        If the path does not name such a file.
    OSError
        If the file cannot be opened.
    """
    try:
        status = os.stat(path)
    except ValueError:
        message = "a path cannot hold a NUL or half of a surrogate pair; check the path"
        raise FatalError(0, message) from None
    if not stat.S_ISREG(status.st_mode):
        message = "is not a regular file; save the scene to one"
        if stat.S_ISDIR(status.st_mode):
            message = "is a folder; name a scene file in it"
        raise FatalError(0, message)
    if status.st_size > MAX_BYTES:
        raise FatalError(0, f"has {status.st_size} bytes; at most {MAX_BYTES} are allowed")
    return open(path, "rb")


class Parser:
    """Parses one scene file, and passes its elements on as they are completed.

    Parameters
    ----------
    read_child : callable
        Called with the root when its start tag is parsed, without children.  Then called with each
        child of the root when its end tag is parsed; the child contains all its descendants.
    report_at : callable
        Called for each text where no text may stand, with (1) the line of the text, (2) the tag of
        the element around it and (3) the error message.

    Attributes
    ----------
    open_elements : list of Element
        Elements whose end tags have not been parsed yet, the root first.
    descendant_count : int
        Number of elements so far inside the current child of the root.
    stray_element : Element or None
        The last element in which stray text has been reported.  Long texts come in several events,
        of which only the first is reported.
    encoding : str
        Encoding that the XML declaration names; "" if it names none.
    parsed : int
        Number of bytes passed to expat.
    kept : bytes
        The last bytes passed to expat: the current chunk, and up to `_KEPT_BYTES` before it.
    """

    def __init__(
        self, read_child: Callable[[Element], None], report_at: Callable[[int, str, str], None]
    ) -> None:
        self.read_child, self.report_at = read_child, report_at
        self.open_elements: list[Element] = []
        self.stray_element: Element | None = None
        self.descendant_count, self.encoding, self.parsed, self.kept = 0, "", 0, b""
        self.expat: Any = expat.ParserCreate()
        self.expat.buffer_text = True
        self.expat.StartElementHandler = self._start
        self.expat.EndElementHandler = self._end
        self.expat.CharacterDataHandler = self._text
        self.expat.XmlDeclHandler = self._declare
        self.expat.StartDoctypeDeclHandler = self._refuse_entities

    def parse(self, file: IO[bytes]) -> None:
        """Parse a binary file to its end.

        Raises
        ------
        FatalError
            If the file stops being XML, or exceeds a limit.  The children that are completed before
            have been passed on.
        """
        try:
            chunk = file.read(_CHUNK_BYTES)
            if not isinstance(chunk, bytes):
                raise TypeError("a scene is read from a binary file, not from text")
            if not chunk:
                raise FatalError(0, f"is empty; {SCENE}")
            while chunk:
                self._parse_chunk(chunk, file)
                chunk = file.read(_CHUNK_BYTES)
            self._parse_chunk(b"", file)
        finally:
            # The expat parser and its handlers refer to each other; this breaks the cycle.
            self.expat = None

    def _parse_chunk(self, chunk: bytes, file: IO[bytes]) -> None:
        """Parse a part of a file; an empty chunk ends the file."""
        self.kept = self.kept[-_KEPT_BYTES:] + chunk
        self.parsed += len(chunk)
        try:
            self.expat.Parse(chunk, not chunk)
        except expat.ExpatError as error:
            raise self._diagnosed(error, file.read(_LOOKAHEAD_BYTES)) from None
        except (LookupError, ValueError, Warning):
            if self.open_elements:
                raise
            # Raised by the codec that the XML declaration names.
            raise FatalError(1, "not XML: unknown encoding; save the file as UTF-8") from None
        # Versions of expat before 2.6 take quadratic time over one token.
        if self.parsed - self.expat.CurrentByteIndex > MAX_TOKEN_BYTES:
            message = f"a tag or comment of more than {MAX_TOKEN_BYTES} bytes; make it shorter"
            raise FatalError(self.expat.CurrentLineNumber, message)
        if self.parsed > MAX_BYTES:
            raise FatalError(0, f"has more than {MAX_BYTES} bytes, which are allowed")

    def _diagnosed(self, error: expat.ExpatError, following: bytes) -> FatalError:
        """Return the error to raise for a syntax error, with a suggested fix.

        Parameters
        ----------
        error : ExpatError
            What expat reports.
        following : bytes
            The beginning of the next chunk.
        """
        message = expat.ErrorString(error.code)
        if message == expat.errors.XML_ERROR_NO_MEMORY:
            raise MemoryError from None
        position = max(0, self.expat.ErrorByteIndex - self.parsed + len(self.kept))
        before, after = self.kept[:position], self.kept[position:] + following
        remedy = syntax_remedy(
            message, error.lineno, before, after, self.open_elements, self.encoding
        )
        column = error.offset + 1
        return FatalError(error.lineno, f"not XML: {message} at column {column}; {remedy}")

    def _start(self, tag: str, attrib: dict[str, str]) -> None:
        """Handle a start tag."""
        element = Element()
        element.tag = tag
        element.attrib = attrib
        element.line = self.expat.CurrentLineNumber
        element.text = ""
        open_elements = self.open_elements
        open_elements.append(element)
        if len(open_elements) > 2:
            open_elements[-2].append(element)
            self.descendant_count += 1
        elif len(open_elements) == 1:
            self.read_child(element)
        else:
            self.descendant_count = 0
        if self.descendant_count > MAX_DESCENDANTS or len(attrib) > MAX_DESCENDANTS:
            child = open_elements[:2][-1]
            remedy = f"close <{shortened(child.tag)}> of line {child.line} earlier, or remove it"
            message = f"more than {MAX_DESCENDANTS} elements or attributes in it; {remedy}"
            raise FatalError(element.line, f"{shortened(child.tag)}: {message}")

    def _end(self, _tag: str) -> None:
        """Handle an end tag."""
        open_elements = self.open_elements
        element = open_elements.pop()
        if len(open_elements) == 1:
            self.read_child(element)

    def _text(self, text: str) -> None:
        """Handle text between two tags, or a part of a long one."""
        element = self.open_elements[-1]
        if text.isspace() and not element.text:
            return
        if element.tag not in _CONTAINERS:
            element.text += text
            if len(element.text) > MAX_TOKEN_BYTES:
                message = f"more than {MAX_TOKEN_BYTES} characters; make it shorter"
                raise FatalError(element.line, f"{shortened(element.tag)}: {message}")
        elif self.stray_element is not element:
            # The event occurs at the end of the text, but the error is at its beginning.
            self.stray_element, text = element, text.lstrip()
            line = self.expat.CurrentLineNumber - text.count("\n")
            self.report_at(line, element.tag, f"stray text {quoted(text.rstrip())}; remove it")

    def _declare(self, _version: str, encoding: str | None, _standalone: int) -> None:
        """Handle the XML declaration."""
        self.encoding = encoding or ""

    def _refuse_entities(self, _name: str, system: str | None, *others: object) -> None:
        """Handle a DOCTYPE: refuse declarations, in the file or in another one.

        Entities in entities grow exponentially; those that another file declares would be skipped.
        """
        has_declarations = others[-1]
        if has_declarations or system is not None:
            remedy = "remove the DOCTYPE, and write out what entities stand for"
            message = f"DOCTYPE: declarations are not allowed; {remedy}"
            raise FatalError(self.expat.CurrentLineNumber, message)
