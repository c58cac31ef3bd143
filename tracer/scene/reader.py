"""From a scene file to a :class:`~tracer.scene.model.Scene`.

The file is parsed as a stream, and only a part of its tree is ever held: each
child of the root is taken in, and dropped, once it has ended.

Each fault of a file is told in a line of its own, as ``FILE:LINE: element: what
is wrong; what would be right``, up to the place where the file is no longer XML
or passes a limit, or has `MAX_FAULTS` of :mod:`tracer.scene.contents`.  Line numbers take
time, so a large file is read without them first, and again from its start if
it has any fault.  All that is read is held against the limits below, so that
no file can exhaust memory or time.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterable
from typing import IO, TYPE_CHECKING, Any
from xml.parsers import expat

from tracer.messages import printable, quoted, short
from tracer.scene.contents import CONTAINERS, Contents, Faults, GiveUp, LineElement
from tracer.scene.model import Scene

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

__all__ = ["MAX_BYTES", "MAX_NESTING", "MAX_TOKEN", "SceneFileError", "load_scene"]

MAX_BYTES = 1 << 28
"""Largest scene file: 256 MiB, about two million objects."""
MAX_TOKEN = 1 << 20
"""Longest tag, comment or text, in bytes or characters."""
MAX_NESTING = 64
"""Deepest nesting, and most children of anything but the scene."""

# Bytes parsed at a time: so few that the part of the tree they make stays in cache.
_CHUNK = 1 << 14

# From this many bytes on, reading without line numbers saves more time than its imports take.
_LARGE = 1 << 17


class SceneFileError(ValueError):
    """A scene file with faults; the message is a line for each, in file order.

    Attributes
    ----------
    lines : tuple of str
        ``FILE:LINE: element: what is wrong; what would be right``, or
        ``FILE: ...`` where there is no line.
    """

    def __init__(self, lines: Iterable[str]) -> None:
        self.lines = tuple(lines)
        super().__init__("\n".join(self.lines))

    def __reduce__(self) -> tuple[Any, ...]:
        # By default an exception is copied as cls(*args), and `args` holds only the message.
        return type(self), (self.lines,), self.__dict__


def load_scene(path: str | bytes | os.PathLike[str] | os.PathLike[bytes]) -> Scene:
    """Read a scene file.

    Parameters
    ----------
    path : str, bytes or path-like
        An XML file of at most 256 MiB; its format is described in the README.

    Returns
    -------
    Scene

    Raises
    ------
    SceneFileError
        If the file cannot be read, or has any fault; the message has a line for each.
    """
    path = os.fsdecode(path)
    faults = Faults()
    try:
        with _opened(path, faults) as file:
            scene = _without_lines(file) or _LineReader(faults).read(file)
        if scene is not None:
            return scene
    except GiveUp:
        pass
    except OSError as error:
        reason = error.strerror or str(error)
        faults.told.append((None, f"cannot be read: {reason}; check the path and its permissions"))
    name = printable(path) or "''"
    raise SceneFileError(
        f"{name}: {message}" if line is None else f"{name}:{line}: {message}"
        for line, message in sorted(faults.told, key=lambda fault: fault[0] or 0)
    )


def _opened(path: str, faults: Faults) -> IO[bytes]:
    """Open a regular file: a pipe or a device may block, or never end."""
    try:
        status = os.stat(path)
    except UnicodeEncodeError:
        faults.give_up(None, "no path has half of a surrogate pair in it; check the path")
    except ValueError:
        faults.give_up(None, "no path has a NUL in it; check the path")
    if stat.S_ISDIR(status.st_mode):
        faults.give_up(None, "is a folder; name a scene file in it")
    if not stat.S_ISREG(status.st_mode):
        faults.give_up(None, "is not a regular file; save the scene to one")
    if status.st_size == 0:
        faults.give_up(None, "is empty; a scene file holds <scene> ... </scene>")
    if status.st_size > MAX_BYTES:
        faults.give_up(None, f"has {status.st_size} bytes; at most {MAX_BYTES} are allowed")
    return open(path, "rb")


class _LineReader:
    """Makes elements that know their lines from the parser's events."""

    def __init__(self, faults: Faults) -> None:
        self.faults = faults
        self.contents = Contents(faults)
        self.parser = expat.ParserCreate()
        self.open: list[LineElement] = []
        # Whether stray text since the last tag is noted already: a long one comes in pieces.
        self.strayed = False

    def read(self, file: IO[bytes]) -> Scene | None:
        """Parse the file to its end, or to where it is no longer XML; None after a fault."""
        parser = self.parser
        parser.buffer_text = True
        parser.StartElementHandler = self.start
        parser.EndElementHandler = self.end
        parser.CharacterDataHandler = self.text
        parser.StartDoctypeDeclHandler = self.doctype
        given = 0
        try:
            while chunk := file.read(_CHUNK):
                parser.Parse(chunk)
                given += len(chunk)
                # Versions of expat before 2.6 take quadratic time over one token.
                if given - parser.CurrentByteIndex > MAX_TOKEN:
                    self.faults.give_up(
                        parser.CurrentLineNumber,
                        f"a tag or comment of more than {MAX_TOKEN} bytes; make it shorter",
                    )
            parser.Parse(b"", True)
        except expat.ExpatError as error:
            from tracer.scene.malformed import remedy  # after a fault only

            message = expat.ErrorString(error.code)
            right = remedy(message, error.lineno, parser.ErrorByteIndex, self.open, file)
            where = f"at column {error.offset + 1}"
            self.faults.give_up(error.lineno, f"not XML: {message} {where}; {right}")
        except (LookupError, ValueError, Warning):  # of the codec that the file asks for
            self.faults.give_up(1, "not XML: unknown encoding; save the file as UTF-8")
        finally:
            del self.parser  # it holds this reader by its handlers: a cycle
        return self.contents.scene()

    def doctype(self, _name: str, system: str | None, _public: str | None, declares: bool) -> None:
        # Nested entities grow exponentially, and declared attributes take quadratic time.
        if declares:
            self.faults.give_up(
                self.parser.CurrentLineNumber,
                "DOCTYPE: declarations are not allowed; write out what entities stand for",
            )
        # That file would not be read, and entities it defines be skipped, some in silence.
        if system is not None:
            self.faults.give_up(
                self.parser.CurrentLineNumber,
                "DOCTYPE: declarations in another file are not allowed; remove the DOCTYPE",
            )

    def start(self, tag: str, attrib: dict[str, str]) -> None:
        self.strayed = False
        element = LineElement(tag, attrib, self.parser.CurrentLineNumber)
        depth = len(self.open)
        if depth > 1:
            parent = self.open[-1]
            parent.append(element)
            if depth == MAX_NESTING or len(parent) > MAX_NESTING:
                self.faults.give_up(
                    element.line,
                    f"{short(parent.tag)}: more than {MAX_NESTING} elements in another",
                )
        elif depth == 0:
            self.contents.root(element)
        self.open.append(element)

    def text(self, text: str) -> None:
        element = self.open[-1]
        if element.tag not in CONTAINERS:
            element.text += text
            if len(element.text) > MAX_TOKEN:
                self.faults.give_up(
                    element.line,
                    f"{short(element.tag)}: more than {MAX_TOKEN} characters; make it shorter",
                )
        elif not (self.strayed or text.isspace()):
            # The event comes where the text ends; the fault is where it begins.
            text = text.lstrip()
            self.faults.note(
                self.parser.CurrentLineNumber - text.count("\n"),
                f"{element.tag}: stray text {quoted(text.rstrip())}; remove it",
            )
            self.strayed = True

    def end(self, _tag: str) -> None:
        self.strayed = False
        element = self.open.pop()
        if len(self.open) == 1:
            self.contents.take([element])


# The beginning of a file that is surely UTF-8, where a search for ASCII bytes misses nothing.
_PLAIN = (
    rb"(?i)(\xef\xbb\xbf)?"
    rb"(<\?xml version=[\"']1\.0[\"']( encoding=[\"']utf-8[\"'])? ?\?>|(?!<\?xml))[^\0]*\Z"
)


def _without_lines(file: IO[bytes]) -> Scene | None:
    """The scene of a large file without faults; or None, with the file at its start again.

    This takes less than half of the time of `_LineReader`: the tree is made in C, without lines.
    """
    if os.fstat(file.fileno()).st_size < _LARGE:
        return None
    try:
        contents = Contents(Faults(lined=False))
        _parse(file, contents)
        return contents.scene()
    except GiveUp:
        file.seek(0)
        return None


def _parse(file: IO[bytes], contents: Contents) -> None:
    """Take in a file to its end; raise `GiveUp` as soon as it may have a fault."""
    # Takes some milliseconds.
    from xml.etree.ElementTree import ParseError, TreeBuilder, XMLParser

    builder = TreeBuilder()
    document = builder.start("", {})
    parser = XMLParser(target=builder)
    end, given, taken = b"", 0, 0
    try:
        while chunk := file.read(_CHUNK):
            # A DOCTYPE stands before the root, and this parser would obey its declarations.
            if not given and (not re.match(_PLAIN, chunk) or b"<!DOCTYPE" in chunk):
                raise GiveUp
            # This parser swallows attributes of this name, which are a fault.
            if b"xmlns" in end + chunk:
                raise GiveUp
            end = chunk[-8:]
            given += len(chunk)
            parser.feed(chunk)
            if not len(document):
                raise GiveUp
            # The last child may not have ended, nor the text after it.
            if _take_children(contents, document[0], len(document[0]) - 1):
                taken = given
            if given - taken > MAX_TOKEN:
                raise GiveUp
        parser.close()
        _take_children(contents, document[0], len(document[0]))
    except (ParseError, LookupError, ValueError):
        raise GiveUp from None


def _take_children(contents: Contents, scene: Element, count: int) -> bool:
    """Take in the first `count` children of the root, and delete them; whether there are any."""
    contents.root(scene)
    texts = {element.tail for element in scene.iter()}
    for tag in CONTAINERS:
        texts.update([element.text for element in scene.iter(tag)])
    if any(text and not text.isspace() for text in texts):
        raise GiveUp
    contents.take(scene[:count])
    del scene[:count]
    return count > 0
