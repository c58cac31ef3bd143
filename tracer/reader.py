"""From a scene file to a :class:`~tracer.scene.Scene`: the only module that knows tags.

The file is parsed as a stream, and of its tree only a piece is ever held: the
children of `scene` are turned into numbers as they end, and surfaces go
straight into flat arrays.

Every fault of a file is found and told in a line of its own, as
``FILE:LINE: element: what is wrong; what would be right``.  Line numbers take
time, so a large file is read without them first, and again from its start if
it has any fault.  The reader holds against the limits below whatever it is
given, so that no file can exhaust the memory or the reader's patience.
"""

from __future__ import annotations

import os
import re
import stat
from array import array
from bisect import bisect_left
from collections.abc import Callable, Collection, Iterable, Mapping
from itertools import islice
from typing import IO, TYPE_CHECKING, Any, NoReturn, TypeAlias, TypeVar
from xml.parsers import expat

import numpy as np

from tracer.scene import (
    MAX_PIXELS,
    Camera,
    Lambertian,
    Phong,
    PointLight,
    Scene,
    SceneError,
    Shader,
    Sphere,
    Surfaces,
)

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

__all__ = ["SceneFileError", "load_scene"]

MAX_BYTES = 1 << 28
"""Largest scene file: 256 MiB, about two million objects."""
MAX_TOKEN = 1 << 20
"""Longest tag, comment or text, in bytes or characters."""
MAX_NESTING = 64
"""Deepest nesting, and most children of anything but the scene."""
MAX_FAULTS = 1_000
"""How many faults are told before the reader gives up on a file."""

# What is held of a tree of this size stays in the processor's cache.
_CHUNK = 1 << 14

# From this size on, what a reading without line numbers saves is more than its imports take.
_LARGE = 1 << 17

# What holds numbers: tag -> parameter of the dataclass, how many numbers.
_Fields = Mapping[str, tuple[str, int]]
_CAMERA: _Fields = {
    "viewPoint": ("view_point", 3),
    "viewDir": ("view_dir", 3),
    "viewUp": ("view_up", 3),
    "projNormal": ("proj_normal", 3),
    "projDistance": ("proj_distance", 1),
    "viewWidth": ("view_width", 1),
    "viewHeight": ("view_height", 1),
}
# The specification says color, the published scenes say intensity.
_LIGHT: _Fields = {
    "position": ("position", 3),
    "intensity": ("intensity", 3),
    "color": ("intensity", 3),
}
_LAMBERTIAN: _Fields = {"diffuseColor": ("diffuse", 3)}
_PHONG: _Fields = {
    **_LAMBERTIAN,
    "specularColor": ("specular", 3),
    "exponent": ("exponent", 1),
}
_SHADERS = {"Lambertian": _LAMBERTIAN, "Phong": _PHONG}
# A shader holds no number of its own; it yields its place among the shaders.
_SPHERE: _Fields = {"shader": ("shader", 0), "center": ("center", 3), "radius": ("radius", 1)}
_BOX: _Fields = {"shader": ("shader", 0), "minPt": ("min_pt", 3), "maxPt": ("max_pt", 3)}
_SURFACES = {"Sphere": _SPHERE, "Box": _BOX}

_SCENE = ("camera", "image", "light", "shader", "surface")
_CONTAINERS = frozenset(("scene", "camera", "light", "shader", "surface"))

_UNIT_SPHERE = Sphere()
_NAN = float("nan")
_CODES = expat.errors.codes

_Made = TypeVar("_Made")


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


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene file.

    Parameters
    ----------
    path : str or path-like
        An XML file of at most `MAX_BYTES`.

    Returns
    -------
    Scene

    Raises
    ------
    SceneFileError
        If the file cannot be read, or is anything but a faultless scene.
    """
    reader = _Reader()
    try:
        with reader.opened(path) as file:
            scene = _without_lines(file)
            if scene is None:
                reader.read(file)
                scene = reader.scene()
        if scene is not None:
            return scene
    except _GiveUp:
        pass
    except OSError as error:
        reason = error.strerror or str(error)
        reader.faults.append(
            (None, f"cannot be read: {reason}; check the path and its permissions")
        )
    name = printable(os.fspath(path))
    raise SceneFileError(
        f"{name}: {message}" if line is None else f"{name}:{line}: {message}"
        for line, message in sorted(reader.faults, key=lambda fault: fault[0] or 0)
    )


def printable(text: str) -> str:
    """`text` in one line that any terminal can show: a new line becomes ``\\n``."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def _short(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."


def _quoted(text: str) -> str:
    return repr(_short(text))


def _nearest(name: str, known: Iterable[str]) -> str:
    """What would have been right in place of `name`."""
    from difflib import get_close_matches  # imported after a fault only: it takes milliseconds

    names = sorted(islice(known, 256))
    if not names:
        return "remove it"
    folded = {word.lower(): word for word in names}
    for match in get_close_matches(_short(name).lower(), folded, n=1):
        return f"did you mean {_quoted(folded[match])}?"
    return f"known: {', '.join(map(_short, names[:9]))}{', ...' * (len(names) > 9)}"


def _words(text: str) -> list[str]:
    """Split at XML's white space; str.split() knows more kinds."""
    return re.findall("[^ \t\r\n]+", text)


def _is_plain(text: str) -> bool:
    """Whether nothing but decimal numbers in `text` would satisfy float().

    It also takes 1_0, nan, inf and infinity, and the digits and spaces of all scripts.
    """
    return text.isascii() and "_" not in text and "n" not in text and "N" not in text


def _is_decimal(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return _is_plain(word)


class _GiveUp(Exception):  # noqa: N818 - not an error: the faults are noted already
    """The rest of the file is not worth reading."""


class _LineElement(list["_LineElement"]):
    """Like an `Element` of `xml.etree`, a sequence of its children; and the line it starts in."""

    __slots__ = ("attrib", "line", "tag", "text")

    def __init__(self, tag: str, attrib: dict[str, str], line: int) -> None:
        self.tag = tag
        self.attrib = attrib
        self.line = line
        self.text = ""

    def keys(self) -> Collection[str]:
        return self.attrib.keys()


_Element: TypeAlias = "Element | _LineElement"


def _line(element: _Element) -> int:
    return element.line if isinstance(element, _LineElement) else 0


def _giving(parameter: str, element: _Element, fields: _Fields) -> _Element:
    """The child that gives a parameter of an element; itself where none does."""
    tags = [tag for tag, field in fields.items() if field[0] == parameter]
    return next((child for child in element if child.tag in tags), element)


def _unread(values: Iterable[float]) -> bool:
    return any(value != value for value in values)


class _Rows:
    """All spheres or all boxes, in flat arrays: two fields, with their lines, and a shader."""

    __slots__ = ("first", "index", "lines", "parameters", "second", "shader")

    def __init__(self, *parameters: str) -> None:
        self.parameters = parameters
        self.first = array("d")
        self.second = array("d")
        self.shader = array("q")
        self.index = array("q")
        self.lines = array("q")


class _Reader:
    """Takes the parser's events; holds the scene so far, and the faults."""

    notes_lines = True

    def __init__(self) -> None:
        self.faults: list[tuple[int | None, str]] = []
        self.parser = expat.ParserCreate()
        self.open: list[_LineElement] = []
        self.root_line = 1
        self.seen: dict[str, _Element] = {}
        self.camera = Camera()
        self.size = (1, 1)
        self.lights: list[PointLight] = []
        # A name gets its place from whoever comes first, a reference or the definition.
        self.places: dict[str, int] = {}
        self.shaders: list[Shader | None] = []
        self.definitions: dict[str, int] = {}
        # Of each place, the lines that refer to it.
        self.references: dict[int, array[int]] = {}
        self.white: int | None = None
        self.spheres = _Rows("center", "radius")
        self.boxes = _Rows("min_pt", "max_pt")
        self.surface_count = 0

    def fault(self, at: _Element | int, message: str) -> None:
        """Note a fault, of an element or in a line; at the `MAX_FAULTS`-th raise `_GiveUp`."""
        line = at if isinstance(at, int) else _line(at)
        self.faults.append((line, message))
        if len(self.faults) == MAX_FAULTS:
            self.give_up(line, f"{MAX_FAULTS} faults so far; mend these first")

    def give_up(self, line: int | None, message: str) -> NoReturn:
        """Note a last fault; raise `_GiveUp`."""
        self.faults.append((line, message))
        raise _GiveUp

    def opened(self, path: str | os.PathLike[str]) -> IO[bytes]:
        """Open a regular file: a pipe or a device may block, or never end."""
        try:
            status = os.stat(path)
        except ValueError:
            self.give_up(None, "no path has a NUL in it; check the path")
        if stat.S_ISDIR(status.st_mode):
            self.give_up(None, "is a folder; name a scene file in it")
        if not stat.S_ISREG(status.st_mode):
            self.give_up(None, "is not a regular file; save the scene to one")
        if status.st_size == 0:
            self.give_up(None, "is empty; a scene file holds <scene> ... </scene>")
        if status.st_size > MAX_BYTES:
            self.give_up(None, f"has {status.st_size} bytes; at most {MAX_BYTES} are allowed")
        return open(path, "rb")

    # The parser's events

    def read(self, file: IO[bytes]) -> None:
        """Parse the file to its end, or to where it is no longer XML."""
        parser = self.parser
        parser.buffer_text = True
        parser.StartElementHandler = self.start
        parser.EndElementHandler = self.end
        parser.CharacterDataHandler = self.text
        parser.StartDoctypeDeclHandler = self.doctype
        parser.SkippedEntityHandler = self.skipped
        given = 0
        try:
            while chunk := file.read(_CHUNK):
                parser.Parse(chunk)
                given += len(chunk)
                # Versions of expat before 2.6 take quadratic time over one token.
                if given - parser.CurrentByteIndex > MAX_TOKEN:
                    self.give_up(
                        parser.CurrentLineNumber,
                        f"a tag or comment of more than {MAX_TOKEN} bytes; make it shorter",
                    )
            parser.Parse(b"", True)
        except expat.ExpatError as error:
            self.give_up(
                error.lineno,
                f"not XML: {expat.ErrorString(error.code)} at column {error.offset + 1};"
                f" {self.remedy(error.code, file)}",
            )
        except (LookupError, ValueError):  # of the codec that the file asks for
            self.give_up(1, "not XML: unknown encoding; save the file as UTF-8")
        finally:
            del self.parser  # it holds this reader by its handlers: a cycle

    def remedy(self, code: int, file: IO[bytes]) -> str:
        """What would make it XML."""
        index = self.parser.ErrorByteIndex
        file.seek(max(0, index - 64))
        before = file.read(min(64, index)).rstrip()
        at = file.read(1)
        if before.endswith(b"=") and at.isalnum():
            return 'put the value of an attribute in quotes, as in type="Sphere"'
        if at >= b"\x80":
            return "save the file as UTF-8"
        if code == _CODES[expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT]:
            return "nothing may follow </scene>"
        if code == _CODES[expat.errors.XML_ERROR_INVALID_TOKEN]:
            return "in text, < is written &lt; and & is written &amp;"
        if code == _CODES[expat.errors.XML_ERROR_UNDEFINED_ENTITY]:
            return "write out what the entity stands for"
        if code == _CODES[expat.errors.XML_ERROR_DUPLICATE_ATTRIBUTE]:
            return "keep one of the two"
        if self.open:
            return f"close <{_short(self.open[-1].tag)}> of line {self.open[-1].line}"
        return "a scene file holds <scene> ... </scene>"

    def doctype(self, _name: str, _system: object, _public: object, declares: bool) -> None:
        # Entities may stand for a thousand others each; attributes take quadratic time.
        if declares:
            self.give_up(
                self.parser.CurrentLineNumber,
                "DOCTYPE: declarations are not allowed; write out what entities stand for",
            )

    def skipped(self, entity: str, _is_parameter: int) -> None:
        self.fault(
            self.parser.CurrentLineNumber,
            f"entity {_quoted(entity)}: is not defined; write out what it stands for",
        )

    def start(self, tag: str, attrib: dict[str, str]) -> None:
        element = _LineElement(tag, attrib, self.parser.CurrentLineNumber)
        depth = len(self.open)
        if depth > 1:
            parent = self.open[-1]
            parent.append(element)
            if depth == MAX_NESTING or len(parent) == MAX_NESTING:
                self.give_up(
                    element.line,
                    f"{_short(parent.tag)}: more than {MAX_NESTING} elements in another",
                )
        elif depth == 0:
            if tag != "scene":
                self.give_up(element.line, f"{_short(tag)}: the root must be <scene>")
            self.root_line = element.line
            self.no_attributes(element)
        self.open.append(element)

    def text(self, text: str) -> None:
        element = self.open[-1]
        if element.tag not in _CONTAINERS:
            element.text += text
            if len(element.text) > MAX_TOKEN:
                self.give_up(
                    element.line,
                    f"{_short(element.tag)}: more than {MAX_TOKEN} characters; make it shorter",
                )
        elif not text.isspace():
            # The event comes where the text ends; the fault is where it begins.
            text = text.lstrip()
            self.fault(
                self.parser.CurrentLineNumber - text.count("\n"),
                f"{element.tag}: stray text {_quoted(text.rstrip())}; remove it",
            )

    def end(self, _tag: str) -> None:
        element = self.open.pop()
        if len(self.open) == 1:
            self.take(element)

    # The children of scene

    def take(self, element: _Element) -> None:
        tag = element.tag
        if tag == "surface":
            self.surface(element)
        elif tag == "shader":
            self.shader(element, nested=False)
        elif tag == "light":
            self.light(element)
        elif tag in ("camera", "image"):
            earlier = self.seen.setdefault(tag, element)
            if earlier is not element:
                self.repeated(element, earlier)
            self.no_attributes(element)
            if tag == "camera":
                self.camera = self.made(Camera, element, _CAMERA) or Camera()
            else:
                self.image(element)
        else:
            self.unknown(element, "scene", _SCENE)

    def image(self, element: _Element) -> None:
        self.no_children(element)
        text = element.text or ""
        words = _words(text)
        if len(words) != 2 or not all(re.fullmatch("[-+]?[0-9]+", word) for word in words):
            self.fault(
                element,
                "image: needs two whole numbers, width and height, as in 640 480;"
                f" has {_quoted(text.strip())}",
            )
        elif max(map(len, words)) > 100:  # int() refuses thousands of digits
            self.fault(
                element,
                f"image: {_quoted(' '.join(words))} is out of range;"
                f" from 1 to {MAX_PIXELS} pixels are allowed",
            )
        else:
            self.size = (int(words[0]), int(words[1]))

    def light(self, element: _Element) -> None:
        self.no_attributes(element)
        light = self.made(PointLight, element, _LIGHT, ("position",))
        if light is not None:
            self.lights.append(light)

    def shader(self, element: _Element, *, nested: bool) -> int:
        """Take in a shader or a reference to one; return its place."""
        attributes = element.attrib
        if nested and "ref" in attributes:
            if len(attributes) > 1:
                self.no_attributes(element, ("ref",))
            if len(element):
                self.no_children(element)
            place = self.place(attributes["ref"])
            if self.notes_lines:
                self.references.setdefault(place, array("q")).append(_line(element))
            return place
        kind = self.type_of(element, _SHADERS, ("type", "name"))
        shader: Shader | None = None
        if kind == "Lambertian":
            shader = self.made(Lambertian, element, _LAMBERTIAN)
        elif kind == "Phong":
            shader = self.made(Phong, element, _PHONG)
        else:
            self.values(element, _PHONG)
        name = attributes.get("name")
        if name is None:
            if not nested:
                self.fault(element, 'shader: has no name; add one, as in name="white"')
            self.shaders.append(shader)
            return len(self.shaders) - 1
        place = self.place(name)
        if name in self.definitions:
            self.fault(
                element,
                f"shader: the name {_quoted(name)} is taken by the shader in line"
                f" {self.definitions[name]}; choose another",
            )
        else:
            self.definitions[name] = _line(element)
            self.shaders[place] = shader
        return place

    def place(self, name: str) -> int:
        """Where the shader of this name is, or will be, among `shaders`."""
        place = self.places.get(name)
        if place is None:
            place = self.places[name] = len(self.shaders)
            self.shaders.append(None)
        return place

    def surface(self, element: _Element) -> None:
        kind = self.type_of(element, _SURFACES, ("type",))
        if kind == "Sphere":
            rows, fields = self.spheres, _SPHERE
            values = self.values(element, fields)
            rows.first.fromlist(values.get("center", [*_UNIT_SPHERE.center]))
            rows.second.fromlist(values.get("radius", [_UNIT_SPHERE.radius]))
        elif kind == "Box":
            rows, fields = self.boxes, _BOX
            values = self.values(element, fields, ("minPt", "maxPt"))
            rows.first.fromlist(values["min_pt"])
            rows.second.fromlist(values["max_pt"])
        else:
            self.values(element, {**_SPHERE, **_BOX})
            return
        rows.index.append(self.surface_count)
        self.surface_count += 1
        if "shader" in values:
            rows.shader.fromlist(values["shader"])
        else:
            if self.white is None:
                self.white = len(self.shaders)
                self.shaders.append(Lambertian())
            rows.shader.append(self.white)
        if self.notes_lines:
            # They are checked later, all at once.
            for parameter in rows.parameters:
                rows.lines.append(_line(_giving(parameter, element, fields)))

    # What elements have in common

    def values(
        self, element: _Element, fields: _Fields, required: tuple[str, ...] = ()
    ) -> dict[str, list[Any]]:
        """What the children of an element say, by parameter of its dataclass: lists of numbers.

        Numbers that cannot be read stand in as NaN, which no file can hold: what validation
        says about those is dropped, for it was said already.
        """
        values: dict[str, list[Any]] = {}
        for child in element:
            field = fields.get(child.tag)
            if field is None:
                self.unknown(child, element.attrib.get("type", element.tag), fields)
                continue
            parameter, count = field
            if parameter in values:
                self.repeated(child, _giving(parameter, element, fields))
            elif count:
                values[parameter] = self.numbers(child, count)
            else:
                values[parameter] = [self.shader(child, nested=True)]
        for tag in required:
            parameter, count = fields[tag]
            if parameter not in values:
                self.fault(element, f"{element.tag}: has no {tag}; add <{tag}>x y z</{tag}>")
                values[parameter] = [_NAN] * count
        return values

    def numbers(self, element: _Element, count: int) -> list[float]:
        """The numbers that an element holds, or NaN for each after a fault."""
        text = element.text or ""
        words = text.split()
        if len(words) == count and _is_plain(text) and not (element.keys() or len(element)):
            try:
                return [*map(float, words)]
            except ValueError:
                pass
        self.no_attributes(element)
        self.no_children(element)
        words = _words(text)
        for word in words:
            if not _is_decimal(word):
                self.fault(
                    element,
                    f"{element.tag}: {_quoted(word)} is no decimal number;"
                    " write it as 2, -.5 or 1e-3",
                )
        if len(words) != count and len(element) == 0:
            self.fault(
                element,
                f"{element.tag}: needs {count} number{'s' * (count > 1)}, has {len(words)}",
            )
        return [_NAN] * count

    def made(
        self,
        make: Callable[..., _Made],
        element: _Element,
        fields: _Fields,
        required: tuple[str, ...] = (),
    ) -> _Made | None:
        """The dataclass of an element, or None after a fault."""
        values = self.values(element, fields, required)
        single = {parameter for parameter, count in fields.values() if count == 1}
        try:
            return make(**{name: v[0] if name in single else v for name, v in values.items()})
        except SceneError as error:
            for fault in error.faults:
                parameter, _ = fields[fault.field]
                child = _giving(parameter, element, fields)
                if not _unread(values.get(parameter, ())):
                    tag = fault.field if child is element else child.tag
                    self.fault(child, f"{tag}: {fault.message}")
        return None

    def type_of(self, element: _Element, known: Collection[str], allowed: tuple[str, ...]) -> str:
        """The `type` of a shader or surface; what is not `known` is a fault."""
        attributes = element.attrib
        kind = attributes.get("type")
        if len(attributes) > 1 or kind is None:
            self.no_attributes(element, allowed)
        if kind is None:
            choice = " or ".join(f'type="{name}"' for name in known)
            self.fault(element, f"{element.tag}: has no type; add {choice}")
            return ""
        if kind not in known:
            self.fault(
                element,
                f"{element.tag}: unknown type {_quoted(kind)}; {_nearest(kind, known)}",
            )
        return kind

    def unknown(self, element: _Element, of: str, known: Iterable[str]) -> None:
        self.fault(
            element,
            f"{_short(element.tag)}: unknown in {_short(of)}; {_nearest(element.tag, known)}",
        )

    def repeated(self, element: _Element, earlier: _Element) -> None:
        given = "given" if earlier.tag == element.tag else f"{earlier.tag} is given"
        self.fault(
            element,
            f"{element.tag}: {given} already, in line {_line(earlier)}; keep one of the two",
        )

    def no_attributes(self, element: _Element, known: tuple[str, ...] = ()) -> None:
        for name in element.attrib:
            if name not in known:
                self.fault(
                    element,
                    f"{_short(element.tag)}: unknown attribute {_quoted(name)};"
                    f" {_nearest(name, known)}",
                )

    def no_children(self, element: _Element) -> None:
        for child in element:
            self.fault(
                child,
                f"{element.tag}: no element may stand in it; remove <{_short(child.tag)}>",
            )

    # The end

    def scene(self) -> Scene | None:
        """The scene, or None after a fault."""
        for tag in ("camera", "image"):
            if tag not in self.seen:
                self.fault(self.root_line, f"scene: has no {tag}; add <{tag}> ... </{tag}>")
        for name, place in self.places.items():
            if name not in self.definitions:
                remedy = _nearest(name, self.definitions) if self.definitions else "define it"
                for line in self.references.get(place, (0,)):
                    self.fault(line, f"shader: no shader is named {_quoted(name)}; {remedy}")
        surfaces = self.all_surfaces()
        try:
            scene = Scene(
                camera=self.camera,
                width=self.size[0],
                height=self.size[1],
                lights=tuple(self.lights),
                surfaces=surfaces,
            )
        except SceneError as error:
            for fault in error.faults:
                self.fault(self.seen["image"], str(fault))
        return None if self.faults else scene

    def all_surfaces(self) -> Surfaces:
        """All surfaces, checked whole; none after a fault."""
        spheres, boxes = self.spheres, self.boxes
        try:
            return Surfaces(
                center=np.asarray(spheres.first),
                radius=np.asarray(spheres.second),
                sphere_shader=np.asarray(spheres.shader),
                sphere_index=np.asarray(spheres.index),
                min_pt=np.asarray(boxes.first),
                max_pt=np.asarray(boxes.second),
                box_shader=np.asarray(boxes.shader),
                box_index=np.asarray(boxes.index),
                shaders=tuple(shader or Lambertian() for shader in self.shaders),
            )
        except SceneError as error:
            for fault in error.faults:
                rows, fields = (spheres, _SPHERE) if fault.field in _SPHERE else (boxes, _BOX)
                parameter, count = fields[fault.field]
                row = bisect_left(rows.index, fault.index or 0)
                which = rows.parameters.index(parameter)
                values = (rows.first, rows.second)[which][row * count : (row + 1) * count]
                if not _unread(values):
                    line = rows.lines[2 * row + which] if self.notes_lines else 0
                    self.fault(line, f"{fault.field}: {fault.message}")
        return Surfaces()


# The beginning of a file in UTF-8: nothing in it is hidden from a search for bytes.
_PLAIN = (
    rb"(?i)(\xef\xbb\xbf)?"
    rb"(<\?xml version=[\"']1\.0[\"']( encoding=[\"']utf-8[\"'])? ?\?>|(?!<\?xml))[^\0]*\Z"
)


class _Unclear(Exception):  # noqa: N818 - not an error: whatever it is, the other reader tells it
    """The file is not for the reader without lines."""


class _LinelessReader(_Reader):
    """Reads a faultless file in half the time: its tree is made in C, which knows no lines."""

    notes_lines = False

    def fault(self, at: _Element | int, message: str) -> None:
        raise _Unclear

    def give_up(self, line: int | None, message: str) -> NoReturn:
        raise _Unclear

    def read(self, file: IO[bytes]) -> None:
        """Parse the file to its end; raise `_Unclear` unless it is faultless so far."""
        from xml.etree.ElementTree import (  # takes some milliseconds
            ParseError,
            TreeBuilder,
            XMLParser,
        )

        builder = TreeBuilder()
        document = builder.start("", {})
        parser = XMLParser(target=builder)
        end, given, taken = b"", 0, 0
        try:
            while chunk := file.read(_CHUNK):
                # Declarations stand before the root, and this parser would obey them.
                if not given and (not re.match(_PLAIN, chunk) or b"<!DOCTYPE" in chunk):
                    raise _Unclear
                # It swallows the attributes of this name.
                if b"xmlns" in end + chunk:
                    raise _Unclear
                end = chunk[-8:]
                given += len(chunk)
                parser.feed(chunk)
                if not len(document):
                    raise _Unclear
                # The last child may not have ended, nor the text after it.
                if self.take_children(document[0], len(document[0]) - 1):
                    taken = given
                if given - taken > MAX_TOKEN:
                    raise _Unclear
            parser.close()
            self.take_children(document[0], len(document[0]))
        except (ParseError, LookupError, ValueError):
            raise _Unclear from None

    def take_children(self, scene: Element, count: int) -> bool:
        """Take in the first children of the scene, and delete them; whether there are any."""
        if scene.tag != "scene" or scene.attrib:
            raise _Unclear
        texts = {element.tail for element in scene.iter()}
        texts.update(element.text for element in scene.iter() if element.tag in _CONTAINERS)
        if any(text and not text.isspace() for text in texts):
            raise _Unclear
        for element in scene[:count]:
            self.take(element)
        del scene[:count]
        return count > 0


def _without_lines(file: IO[bytes]) -> Scene | None:
    """The scene in a large file without faults; None for any other, at its start again."""
    if os.fstat(file.fileno()).st_size < _LARGE:
        return None
    try:
        reader = _LinelessReader()
        reader.read(file)
        return reader.scene()
    except _Unclear:
        file.seek(0)
        return None
