"""Parse a scene file into elements with line numbers.

Files of up to 256 MiB are read in little memory.  Expat parses the file as a stream.  When the end
tag of a child of the root has been parsed, the child is passed on and forgotten, so that at most
one child is in memory.  Limits on the bytes of a file, on the length of a token (a tag, a
comment or a piece of text), and on the elements in one child bound the memory and the time that any
file can take.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from typing import IO, Any, TypeAlias
from xml.parsers import expat

from tracer.messages import quote, shorten
from tracer.scene.hints import SCENE_REMEDY, suggest_syntax_fix

FileOrPath: TypeAlias = str | bytes | os.PathLike[str] | os.PathLike[bytes] | IO[bytes]
"""A binary file object, or the path of a file."""

MAX_BYTES = 1 << 28
"""Maximum size of a scene file: 256 MiB, about two million objects."""
MAX_TOKEN_LENGTH = 1 << 20
"""Maximum length of a token: of a text in characters, of any other in bytes."""
MAX_DESCENDANTS = 64
"""Maximum number of elements inside one child of the root."""
MAX_ATTRIBUTES = MAX_DESCENDANTS
"""Maximum number of attributes of one element; the error message states one number for both."""

# Number of bytes that are parsed together.
_CHUNK_BYTES = 1 << 14
# Number of bytes before a chunk that are kept to diagnose a syntax error.
_KEPT_BYTES = 1 << 12
# Number of bytes after a chunk that are read to diagnose a syntax error.
_LOOKAHEAD_BYTES = 256

# Elements that contain other elements, and no text.
_CONTAINERS = frozenset(("scene", "camera", "light", "shader", "surface"))


class FatalError(Exception):
    """An error after which the rest of a scene file is not read."""

    line: int  # line number in the file; 0 if the error concerns the whole file
    message: str  # what is wrong, and a suggested fix

    def __init__(self, line: int, message: str) -> None:
        super().__init__(line, message)
        self.line = line
        self.message = message


class Element(list["Element"]):
    """An XML element of a scene file, as the list of its child elements."""

    # The parser sets the attributes one by one, because this is faster than an `__init__`.
    __slots__ = ("attrib", "line", "tag", "text")
    tag: str
    attrib: dict[str, str]
    line: int  # where the element begins
    # The text inside the element.  In an element that must not contain text, it is only the first
    # piece of text, which was reported as an error.
    text: str


def open_scene(path: str) -> IO[bytes]:
    """Open a scene file for reading.

    Raise FatalError if the path is invalid, or does not name a regular file of at most `MAX_BYTES`.
    Pipes and devices are refused because reading them might never end.  Raise OSError if the file
    cannot be opened.
    """
    try:
        file_status = os.stat(path)
    except ValueError:
        message = "a path cannot contain a NUL or half of a surrogate pair; check the path"
        raise FatalError(0, message) from None
    if stat.S_ISDIR(file_status.st_mode):
        raise FatalError(0, "is a folder; name a scene file in it")
    if not stat.S_ISREG(file_status.st_mode):
        raise FatalError(0, "is not a regular file; save the scene to one")
    if file_status.st_size > MAX_BYTES:
        raise FatalError(0, f"has {file_status.st_size} bytes; at most {MAX_BYTES} are allowed")
    return open(path, "rb")


class Parser:
    """A streaming parser of one scene file.

    Parameters
    ----------
    on_element
        Called with the root as soon as its start tag has been parsed.  Then called with each child
        of the root when the child is complete.  The children are not added to the root.
    report_at
        Called for text in an element that must not contain text, with the line of the text, the tag
        of the element, and the error message.
    """

    open_elements: list[Element]  # elements whose end tag has not been parsed yet, the root first
    descendant_count: int  # elements parsed so far inside the current child of the root
    encoding: str  # given by the XML declaration, or ""
    byte_count: int  # bytes passed to expat
    recent_bytes: bytes  # the current chunk, and up to `_KEPT_BYTES` before it

    def __init__(
        self, on_element: Callable[[Element], None], report_at: Callable[[int, str, str], None]
    ) -> None:
        self.on_element = on_element
        self.report_at = report_at
        self.open_elements = []
        self.descendant_count = 0
        self.encoding = ""
        self.byte_count = 0
        self.recent_bytes = b""
        self.expat: Any = expat.ParserCreate()
        self.expat.buffer_text = True
        self.expat.StartElementHandler = self._handle_start_tag
        self.expat.EndElementHandler = self._handle_end_tag
        self.expat.CharacterDataHandler = self._handle_text
        self.expat.XmlDeclHandler = self._handle_declaration
        self.expat.StartDoctypeDeclHandler = self._handle_doctype

    def parse(self, file: IO[bytes]) -> None:
        """Parse a whole scene file.

        Raise FatalError if the file is empty, is not well-formed XML, or exceeds a limit.
        `on_element` has then been called for all elements before the error.  Raise TypeError if
        `file` is a text file.
        """
        try:
            chunk = file.read(_CHUNK_BYTES)
            if not isinstance(chunk, bytes):
                raise TypeError("a scene must be read from a binary file, not from a text file")
            if not chunk:
                raise FatalError(0, f"is empty; {SCENE_REMEDY}")
            while chunk:
                self._parse_chunk(chunk, file)
                chunk = file.read(_CHUNK_BYTES)
            self._parse_chunk(b"", file)
        finally:
            # The expat parser and its handlers refer to each other; this breaks the cycle.
            self.expat = None

    def _parse_chunk(self, chunk: bytes, file: IO[bytes]) -> None:
        """Parse the next bytes of the file; at its end, `chunk` is empty.

        After a syntax error, more bytes are read from `file` to diagnose the error.
        """
        self.recent_bytes = self.recent_bytes[-_KEPT_BYTES:] + chunk
        self.byte_count += len(chunk)
        try:
            self.expat.Parse(chunk, not chunk)
        except expat.ExpatError as error:
            raise self._diagnose_syntax_error(error, file.read(_LOOKAHEAD_BYTES)) from None
        except (LookupError, ValueError, Warning):
            if self.open_elements:
                raise
            # The codec named in the XML declaration failed.
            raise FatalError(1, "not XML: unknown encoding; save the file as UTF-8") from None
        # Versions of expat before 2.6 take quadratic time for a long token.
        if self.byte_count - self.expat.CurrentByteIndex > MAX_TOKEN_LENGTH:
            message = f"a tag or comment of more than {MAX_TOKEN_LENGTH} bytes; make it shorter"
            raise FatalError(self.expat.CurrentLineNumber, message)
        if self.byte_count > MAX_BYTES:
            raise FatalError(0, f"has more than the {MAX_BYTES} bytes allowed")

    def _diagnose_syntax_error(self, error: expat.ExpatError, next_bytes: bytes) -> FatalError:
        """Return an error, with a suggested fix, for a syntax error of expat.

        `next_bytes` follow the current chunk in the file.  Raise MemoryError if expat has run out
        of memory.
        """
        message = expat.ErrorString(error.code)
        if message == expat.errors.XML_ERROR_NO_MEMORY:
            raise MemoryError from None
        position = max(0, self.expat.ErrorByteIndex - self.byte_count + len(self.recent_bytes))
        before = self.recent_bytes[:position]
        after = self.recent_bytes[position:] + next_bytes
        line = error.lineno
        fix = suggest_syntax_fix(message, line, before, after, self.open_elements, self.encoding)
        return FatalError(line, f"not XML: {message} at column {error.offset + 1}; {fix}")

    def _handle_start_tag(self, tag: str, attrib: dict[str, str]) -> None:
        """Create an element, and add it to its parent; if it is the root, call `on_element`.

        Children of the root are not added to it, so that their memory can be freed.  Raise
        FatalError if the current child of the root contains more than `MAX_DESCENDANTS` elements,
        or the element has more than `MAX_ATTRIBUTES` attributes.
        """
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
            self.on_element(element)
        else:
            self.descendant_count = 0
        if self.descendant_count > MAX_DESCENDANTS or len(attrib) > MAX_ATTRIBUTES:
            container = open_elements[:2][-1]  # the child of the root, or the root itself
            container_tag = shorten(container.tag)
            message = f"contains more than {MAX_DESCENDANTS} elements or attributes"
            remedy = f"close the <{container_tag}> on line {container.line} sooner, or remove it"
            raise FatalError(element.line, f"{container_tag}: {message}; {remedy}")

    def _handle_end_tag(self, _tag: str) -> None:
        """Close the innermost open element; if it is a child of the root, call `on_element`."""
        element = self.open_elements.pop()
        if len(self.open_elements) == 1:
            self.on_element(element)

    def _handle_text(self, text: str) -> None:
        """Add text to the innermost open element.  Expat may split a text into several calls.

        Report an error for text, other than white space, in an element that must contain only
        elements, such as <camera>.  Only the first piece of such text is reported.
        """
        element = self.open_elements[-1]
        if text.isspace() and not element.text:
            return
        if element.tag not in _CONTAINERS:
            element.text += text
            if len(element.text) > MAX_TOKEN_LENGTH:
                message = f"more than {MAX_TOKEN_LENGTH} characters; make it shorter"
                raise FatalError(element.line, f"{shorten(element.tag)}: {message}")
        elif not element.text:
            element.text = text.lstrip()
            # Expat is now at the end of the text, but the error is at its beginning.
            line = self.expat.CurrentLineNumber - element.text.count("\n")
            message = f"stray text {quote(element.text.rstrip())}; remove it"
            self.report_at(line, element.tag, message)

    def _handle_declaration(self, _version: str, encoding: str | None, _standalone: int) -> None:
        self.encoding = encoding or ""

    def _handle_doctype(
        self, _name: str, system_id: str | None, _public_id: str | None, has_declarations: int
    ) -> None:
        """Refuse a DOCTYPE that contains declarations, or names another file by `system_id`.

        Declarations can define entities, which stand for pieces of text.  Nested entities can grow
        exponentially.  Entities defined in another file would silently be ignored.
        """
        if has_declarations or system_id is not None:
            remedy = "remove the DOCTYPE, and write out what entities stand for"
            message = f"DOCTYPE: declarations are not allowed; {remedy}"
            raise FatalError(self.expat.CurrentLineNumber, message)
