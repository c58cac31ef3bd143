"""What the elements of a scene file say: here tags and text become a scene.

Surfaces go straight into flat arrays, the numbers of many at a time, and are checked all at once
at the end.
Every fault is noted, in words and with its line, and reading goes on after it.
"""

from __future__ import annotations

import re
from array import array
from bisect import bisect_left
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import chain, islice
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias, TypeVar

from tracer.arrays import Vector
from tracer.messages import character, quoted, short
from tracer.scene.model import (
    Camera,
    Lambertian,
    Phong,
    PointLight,
    Scene,
    Shader,
    Sphere,
    Surfaces,
)
from tracer.scene.schema import MAX_PIXELS, Fault, SceneError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

__all__ = ["CONTAINERS", "MAX_FAULTS", "Contents", "Faults", "GiveUp", "LineElement"]

MAX_FAULTS = 1_000
"""How many faults are told before the reader gives up on a file."""

# How many undefined shaders get a suggestion: each search among many names takes milliseconds.
_SUGGESTIONS = 30

# The children of an element: tag -> (parameter of its dataclass, how many numbers it holds).
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
_SHADERS: Mapping[str, tuple[Callable[..., Shader], _Fields]] = {
    "Lambertian": (Lambertian, _LAMBERTIAN),
    "Phong": (Phong, _PHONG),
}
# A shader holds no numbers: 0 says that the parameter is its place among the shaders.
_SPHERE: _Fields = {"shader": ("shader", 0), "center": ("center", 3), "radius": ("radius", 1)}
_BOX: _Fields = {"shader": ("shader", 0), "minPt": ("min_pt", 3), "maxPt": ("max_pt", 3)}

# Where the two differ, the tag of each parameter.
_TAGS = {
    parameter: tag
    for fields in (_CAMERA, _PHONG, _BOX)
    for tag, (parameter, _) in fields.items()
    if tag != parameter
}

_SCENE = ("camera", "image", "light", "shader", "surface")
# Elements that hold elements, and no text.
CONTAINERS = frozenset(("scene", "camera", "light", "shader", "surface"))

_NAN = float("nan")

# What numbers copied from a page or a program come with, and what to write in its place.
_COPIED = str.maketrans(
    dict.fromkeys("\u2010\u2011\u2013\u2212", "-")
    | dict.fromkeys("\u00a0\u2009\u202f\u3000()[]{}", " ")
    | dict.fromkeys("\u200b\u2060\ufeff", "")
    | {chr(0xFEE0 + ord(c)): c for c in "0123456789+-.,eE"}  # full width
)

_Made = TypeVar("_Made")


class GiveUp(Exception):  # noqa: N818 - not an error: what is to be told is noted already
    """The rest of the file is not worth reading, or not in this way."""


class Faults:
    """The faults of a file so far.

    Attributes
    ----------
    told : list of (int or None, str)
        The line, if there is one, and what is wrong there.
    lined : bool
        Whether elements know their lines; without these, any fault is one too many.
    """

    def __init__(self, *, lined: bool = True) -> None:
        self.lined = lined
        self.told: list[tuple[int | None, str]] = []

    def note(self, at: _Element | int, message: str) -> None:
        """Note a fault, of an element or in a line; raise `GiveUp` if it is one too many."""
        line = at if isinstance(at, int) else _line(at)
        if not self.lined:
            raise GiveUp
        self.told.append((line, message))
        if len(self.told) == MAX_FAULTS:
            self.give_up(line, f"{MAX_FAULTS} faults so far; mend these first")

    def give_up(self, line: int | None, message: str) -> NoReturn:
        """Note a last fault; raise `GiveUp`."""
        self.told.append((line, message))
        raise GiveUp


class LineElement(list["LineElement"]):
    """Like an `Element` of `xml.etree` a sequence of its children; it also knows its line."""

    __slots__ = ("attrib", "line", "tag", "text")

    def __init__(self, tag: str, attrib: dict[str, str], line: int) -> None:
        self.tag = tag
        self.attrib = attrib
        self.line = line
        self.text = ""

    def keys(self) -> Collection[str]:
        return self.attrib.keys()


_Element: TypeAlias = "Element | LineElement"


class _Column:
    """One parameter of all spheres or of all boxes: the numbers, and the line of each surface's.

    `default` is what stands for a parameter that is not given.
    """

    __slots__ = ("default", "lines", "numbers", "unread")

    def __init__(self, default: Vector | tuple[float]) -> None:
        self.default = default
        self.numbers = array("d")
        self.lines = array("q")
        # Of the surfaces whose numbers come next, the elements that hold them.
        self.unread: list[_Element | None] = []


class _Rows:
    """All spheres or all boxes: what their elements may hold, and what these say, in columns."""

    __slots__ = ("columns", "fields", "index", "required", "shader")

    def __init__(
        self,
        fields: _Fields,
        required: tuple[str, ...] = (),
        **defaults: Vector | tuple[float],
    ) -> None:
        self.fields = fields
        self.required = required
        self.columns = {name: _Column(default) for name, default in defaults.items()}
        self.shader = array("q")
        self.index = array("q")


class Contents:
    """Takes elements in; holds the scene so far."""

    def __init__(self, faults: Faults) -> None:
        self.faults = faults
        self.fault = faults.note
        self.root_line = 1
        self.seen: dict[str, _Element] = {}
        self.camera = Camera()
        self.size = (1, 1)
        self.lights: list[PointLight] = []
        # A name gets its place in `shaders` when it first occurs, referred to or defined.
        self.places: dict[str, int] = {}
        self.shaders: list[Shader | None] = []
        self.definitions: dict[str, int] = {}
        # Of each place, the lines that refer to it.
        self.references: dict[int, array[int]] = {}
        self.white: int | None = None
        unit = Sphere()
        self.spheres = _Rows(_SPHERE, center=unit.center, radius=(unit.radius,))
        missing = (_NAN, _NAN, _NAN)
        self.boxes = _Rows(_BOX, ("minPt", "maxPt"), min_pt=missing, max_pt=missing)
        self.rows = {"Sphere": self.spheres, "Box": self.boxes}
        self.surface_count = 0

    def root(self, element: _Element) -> None:
        """Check the root's tag and attributes; its children may be still to come."""
        self.root_line = _line(element)
        if element.tag != "scene":
            self.faults.give_up(self.root_line, f"{short(element.tag)}: the root must be <scene>")
        if "version" in element.attrib:
            message = "scene: has a version, so it is Mitsuba's; name the scene it was made from"
            self.faults.give_up(self.root_line, message)
        self.no_attributes(element)

    def take(self, elements: Iterable[_Element]) -> None:
        """Take in children of the root."""
        for element in elements:
            tag = element.tag
            if tag == "surface":
                self.surface(element)
            elif tag == "shader":
                self.shader(element)
                if "name" not in element.attrib:
                    self.fault(element, 'shader: has no name; add one, as in name="white"')
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
        self.numbers_of_surfaces()

    def image(self, element: _Element) -> None:
        self.no_children(element)
        text = element.text or ""
        words = _words(text)
        if len(words) != 2 or not all(re.fullmatch("[-+]?[0-9]+", word) for word in words):
            self.fault(
                element,
                "image: needs two whole numbers, width and height, as in 640 480;"
                f" has {quoted(text.strip())}",
            )
        elif max(map(len, words)) > 100:  # int() refuses thousands of digits
            self.fault(
                element,
                f"image: {quoted(' '.join(words))} is out of range;"
                f" from 1 to {MAX_PIXELS} pixels are allowed",
            )
        else:
            self.size = (int(words[0]), int(words[1]))

    def light(self, element: _Element) -> None:
        self.no_attributes(element)
        light = self.made(PointLight, element, _LIGHT, ("position",))
        if light is not None:
            self.lights.append(light)

    def shader(self, element: _Element) -> int:
        """Take in a shader; return its place."""
        kind = self.type_of(element, _SHADERS, ("type", "name"))
        shader: Shader | None = None
        if kind in _SHADERS:
            shader = self.made(_SHADERS[kind][0], element, _SHADERS[kind][1])
        name = element.attrib.get("name")
        if name is None:
            self.shaders.append(shader)
            return len(self.shaders) - 1
        place = self.place(name)
        if name in self.definitions:
            self.fault(
                element,
                f"shader: the name {quoted(name)} is taken by the shader in line"
                f" {self.definitions[name]}; choose another",
            )
        else:
            self.definitions[name] = _line(element)
            self.shaders[place] = shader
        return place

    def shader_or_ref(self, element: _Element) -> int:
        """Take in a surface's shader, or a reference to one; return its place."""
        attributes = element.attrib
        if "ref" in attributes:
            if len(attributes) > 1:
                self.no_attributes(element, ("ref",))
            if len(element):
                self.no_children(element)
            place = self.place(attributes["ref"])
            if self.faults.lined:
                self.references.setdefault(place, array("q")).append(_line(element))
            return place
        name = attributes.get("name")
        if name is not None and "type" not in attributes and not len(element):
            message = "shader: has a name, but no type; to refer to a shader, write"
            self.fault(element, f'{message} ref="{short(name)}"')
            return self.place(name)
        return self.shader(element)

    def place(self, name: str) -> int:
        """Where the shader of this name is, or will be, among `shaders`."""
        place = self.places.get(name)
        if place is None:
            place = self.places[name] = len(self.shaders)
            self.shaders.append(None)
        return place

    def surface(self, element: _Element) -> None:
        """Take in all but the numbers: these are read later, those of many surfaces at once."""
        kind = self.type_of(element, self.rows, ("type",))
        rows = self.rows.get(kind)
        if rows is None:  # what else it holds cannot be judged, but shaders may be defined there
            for child in element:
                if child.tag == "shader":
                    self.shader_or_ref(child)
            return
        parts = self.parts(element, rows.fields, rows.required)
        for parameter, column in rows.columns.items():
            column.unread.append(parts.get(parameter))
        rows.index.append(self.surface_count)
        self.surface_count += 1
        shader = parts.get("shader")
        if shader is not None:
            rows.shader.append(self.shader_or_ref(shader))
        else:
            if self.white is None:
                self.white = len(self.shaders)
                self.shaders.append(Lambertian())
            rows.shader.append(self.white)

    def numbers_of_surfaces(self) -> None:
        """Read the numbers of the surfaces taken in since the last call."""
        for rows in self.rows.values():
            for column in rows.columns.values():
                default, count, unread = column.default, len(column.default), column.unread
                numbers = _numbers(unread, count)
                if numbers is None:  # one by one
                    each = (default if e is None else self.numbers(e, count) for e in unread)
                    numbers = [*chain.from_iterable(each)]
                column.numbers.fromlist(numbers)
                if self.faults.lined:
                    # For faults found when all surfaces are checked at once, in `all_surfaces`.
                    column.lines.extend(0 if e is None else _line(e) for e in unread)
                unread.clear()

    # What elements have in common

    def parts(
        self, element: _Element, fields: _Fields, required: tuple[str, ...] = ()
    ) -> dict[str, _Element]:
        """The children of an element, by parameter of its dataclass."""
        parts: dict[str, _Element] = {}
        for child in element:
            field = fields.get(child.tag)
            if field is None:
                self.unknown(child, element.attrib.get("type", element.tag), fields)
            elif field[0] in parts:
                self.repeated(child, parts[field[0]])
            else:
                parts[field[0]] = child
        for tag in required:
            if fields[tag][0] not in parts:
                self.fault(element, f"{element.tag}: has no {tag}; add <{tag}>x y z</{tag}>")
        return parts

    def numbers(self, element: _Element, count: int) -> list[float]:
        """The numbers that an element holds, or NaN for each after a fault."""
        numbers = _numbers([element], count)
        if numbers is not None:
            return numbers
        self.no_attributes(element)
        self.no_children(element)
        text = element.text or ""
        words = _words(text)
        wrong = [word for word in words if not _is_decimal(word)]
        if wrong and (right := _mended(text, count)):
            self.fault(element, f"{element.tag}: has {_odd(text)}; write it as {quoted(right)}")
        elif wrong:
            remedy = "write it as 2, -.5 or 1e-3"
            for word in wrong:
                self.fault(element, f"{element.tag}: {quoted(word)} is no decimal number; {remedy}")
        elif len(words) != count and len(element) == 0:
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
        parts, counts = self.parts(element, fields, required), dict(fields.values())
        # NaN, which no file can hold, stands for numbers that could not be read: what validation
        # says about it is dropped, as that fault is noted already.
        values = {name: self.numbers(child, counts[name]) for name, child in parts.items()}
        for tag in required:
            parameter, count = fields[tag]
            values.setdefault(parameter, [_NAN] * count)
        try:
            return make(**{name: v[0] if counts[name] == 1 else v for name, v in values.items()})
        except SceneError as error:
            for fault in error.faults:
                child = parts.get(fault.field)
                if not _unread(values.get(fault.field, ())):
                    if child is None:
                        self.fault(element, _in_tags(fault))
                    else:
                        self.fault(child, _in_tags(fault._replace(field=child.tag)))
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
                f"{element.tag}: unknown type {quoted(kind)}; {_nearest(kind, known)}",
            )
        return kind

    def unknown(self, element: _Element, of: str, known: Iterable[str]) -> None:
        remedy = _nearest(element.tag, known)
        for tag, kinds in (("surface", self.rows), ("shader", _SHADERS)):
            for kind in kinds:
                if kind.lower() == element.tag.lower():
                    remedy = f'write <{tag} type="{kind}">'
        self.fault(element, f"{short(element.tag)}: unknown in {short(of)}; {remedy}")

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
                    f"{short(element.tag)}: unknown attribute {quoted(name)};"
                    f" {_nearest(name, known)}",
                )

    def no_children(self, element: _Element) -> None:
        for child in element:
            self.fault(
                child,
                f"{element.tag}: no element may stand in it; remove <{short(child.tag)}>",
            )

    # The end

    def scene(self) -> Scene | None:
        """The scene, or None after a fault."""
        for tag in ("camera", "image"):
            if tag not in self.seen:
                self.fault(self.root_line, f"scene: has no {tag}; add <{tag}> ... </{tag}>")
        undefined = [name for name in self.places if name not in self.definitions]
        for count, name in enumerate(undefined):
            suggest = self.definitions and count < _SUGGESTIONS
            remedy = _nearest(name, self.definitions) if suggest else "define it"
            for line in self.references.get(self.places[name], (0,)):
                self.fault(line, f"shader: no shader is named {quoted(name)}; {remedy}")
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
                self.fault(self.seen["image"], f"image: {fault}")
        return None if self.faults.told else scene

    def all_surfaces(self) -> Surfaces:
        """All surfaces, checked whole; none after a fault."""
        spheres, boxes = self.spheres, self.boxes
        columns = {**spheres.columns, **boxes.columns}
        try:
            return Surfaces(
                **{name: column.numbers for name, column in columns.items()},
                sphere_shader=spheres.shader,
                sphere_index=spheres.index,
                box_shader=boxes.shader,
                box_index=boxes.index,
                shaders=tuple(shader or Lambertian() for shader in self.shaders),
            )
        except SceneError as error:
            for fault in error.faults:
                rows = spheres if fault.field in spheres.columns else boxes
                column = columns[fault.field]
                row, count = bisect_left(rows.index, fault.surface or 0), len(column.default)
                if not _unread(column.numbers[row * count : (row + 1) * count]):
                    line = column.lines[row] if self.faults.lined else 0
                    self.fault(line, _in_tags(fault))
        return Surfaces()


def _in_tags(fault: Fault) -> str:
    """A fault in the words of a scene file: tags stand for parameters."""
    told = re.sub(r"\w+_\w+", lambda word: _TAGS.get(word[0], word[0]), fault.message)
    return f"{_TAGS.get(fault.field, fault.field)}: {told}"


def _nearest(name: str, known: Iterable[str]) -> str:
    """The remedy for an unknown `name`: the most similar one, or all that are known."""
    from difflib import get_close_matches  # imported after a fault only: it takes milliseconds

    names = sorted(islice(known, 256))
    if not names:
        return "remove it"
    folded = {word.lower(): word for word in names}
    for match in get_close_matches(short(name).lower(), folded, n=1):
        return f"did you mean {quoted(folded[match])}?"
    return f"known: {', '.join(map(short, names[:9]))}{', ...' * (len(names) > 9)}"


def _unread(values: Iterable[float]) -> bool:
    """Whether any is NaN, which stands for a number that could not be read."""
    return any(value != value for value in values)


def _numbers(elements: Sequence[Any], count: int) -> list[float] | None:
    """The numbers in all `elements`; None unless each is there and surely holds `count`."""
    try:
        if any(map(len, elements)) or any(element.keys() for element in elements):
            return None
        # One text for all: to read each by itself takes longer than to make a number of it.
        text = " ; ".join([element.text for element in elements])
        words = text.split()
        between = words[count :: count + 1]
        del words[count :: count + 1]
        if (
            len(words) == count * len(elements)
            and between == [";"] * (len(elements) - 1)
            and _is_plain(text)
        ):
            return [*map(float, words)]
    except (TypeError, ValueError):  # of None, and of a word that is no number
        pass
    return None


def _words(text: str) -> list[str]:
    """Split at XML's white space; str.split() knows more kinds."""
    return re.findall("[^ \t\r\n]+", text)


def _is_plain(text: str) -> bool:
    """Whether a word of `text` that float() accepts is surely a decimal number.

    float() also accepts 1_0, nan, inf and infinity, and the digits and spaces of all scripts.
    """
    return text.isascii() and "_" not in text and "n" not in text and "N" not in text


def _is_decimal(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return _is_plain(word)


def _mended(text: str, count: int) -> str | None:
    """`count` decimal numbers, if replacing commas and what is `_COPIED` makes them of `text`."""
    for comma in " .":
        words = _words(text.translate(_COPIED).replace(",", comma))
        if len(words) == count and all(map(_is_decimal, words)):
            return " ".join(words)
    return None


def _odd(text: str) -> str:
    """In words, what `_mended` replaces in `text`."""
    found = [c for c in dict.fromkeys(text) if c == "," or ord(c) in _COPIED]
    if found == [","]:
        return "commas"
    return " and ".join(map(character, found))


def _line(element: _Element) -> int:
    return element.line if isinstance(element, LineElement) else 0
