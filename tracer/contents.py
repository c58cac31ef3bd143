"""What the elements of a scene file say: here tags and text become a scene.

Surfaces go straight into flat arrays, and are checked all at once at the end.
Every fault is noted, in words and with its line, and reading goes on after it.
"""

from __future__ import annotations

import re
from array import array
from bisect import bisect_left
from collections.abc import Callable, Collection, Iterable, Mapping
from itertools import islice
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias, TypeVar

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

__all__ = [
    "CONTAINERS",
    "MAX_FAULTS",
    "Contents",
    "Faults",
    "GiveUp",
    "LineElement",
    "quoted",
    "short",
]

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
_SURFACES = {"Sphere": _SPHERE, "Box": _BOX}

_SCENE = ("camera", "image", "light", "shader", "surface")
# Elements that hold elements, and no text.
CONTAINERS = frozenset(("scene", "camera", "light", "shader", "surface"))

_UNIT_SPHERE = Sphere()
_NAN = float("nan")

_Made = TypeVar("_Made")


def short(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."


def quoted(text: str) -> str:
    return repr(short(text))


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


def _line(element: _Element) -> int:
    return element.line if isinstance(element, LineElement) else 0


def _giving(parameter: str, element: _Element, fields: _Fields) -> _Element:
    """The child of `element` that gives a parameter; `element` itself if none does."""
    tags = [tag for tag, field in fields.items() if field[0] == parameter]
    return next((child for child in element if child.tag in tags), element)


def _unread(values: Iterable[float]) -> bool:
    """Whether any is NaN, which stands for a number that could not be read."""
    return any(value != value for value in values)


class GiveUp(Exception):  # noqa: N818 - not an error: the faults are noted already
    """The rest of the file is not worth reading."""


class Faults:
    """The faults of a file so far.

    Attributes
    ----------
    told : list of (int or None, str)
        The line, if there is one, and what is wrong there.
    lined : bool
        Whether elements know their lines.
    """

    lined = True

    def __init__(self) -> None:
        self.told: list[tuple[int | None, str]] = []

    def note(self, at: _Element | int, message: str) -> None:
        """Note a fault, of an element or in a line; at the `MAX_FAULTS`-th raise `GiveUp`."""
        line = at if isinstance(at, int) else _line(at)
        self.told.append((line, message))
        if len(self.told) == MAX_FAULTS:
            self.give_up(line, f"{MAX_FAULTS} faults so far; mend these first")

    def give_up(self, line: int | None, message: str) -> NoReturn:
        """Note a last fault; raise `GiveUp`."""
        self.told.append((line, message))
        raise GiveUp


class _Rows:
    """All spheres or all boxes, in flat arrays: two parameters, their lines, shader and index."""

    __slots__ = ("first", "index", "lines", "parameters", "second", "shader")

    def __init__(self, *parameters: str) -> None:
        self.parameters = parameters
        self.first = array("d")
        self.second = array("d")
        self.shader = array("q")
        self.index = array("q")
        self.lines = array("q")


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
        self.spheres = _Rows("center", "radius")
        self.boxes = _Rows("min_pt", "max_pt")
        self.surface_count = 0

    def root(self, element: _Element) -> None:
        """Check the root's tag and attributes; its children may be still to come."""
        if element.tag != "scene":
            message = f"{short(element.tag)}: the root must be <scene>"
            self.faults.give_up(_line(element), message)
        if "version" in element.attrib:
            message = "scene: has a version, so it is Mitsuba's; name the scene it was made from"
            self.faults.give_up(_line(element), message)
        self.root_line = _line(element)
        self.no_attributes(element)

    def take(self, element: _Element) -> None:
        """Take in a child of the root."""
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

    def shader(self, element: _Element, *, nested: bool) -> int:
        """Take in a shader or a reference to one; return its place."""
        attributes = element.attrib
        if nested and "ref" in attributes:
            if len(attributes) > 1:
                self.no_attributes(element, ("ref",))
            if len(element):
                self.no_children(element)
            place = self.place(attributes["ref"])
            if self.faults.lined:
                self.references.setdefault(place, array("q")).append(_line(element))
            return place
        kind = self.type_of(element, _SHADERS, ("type", "name"))
        shader: Shader | None = None
        if kind in _SHADERS:
            shader = self.made(_SHADERS[kind][0], element, _SHADERS[kind][1])
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
                f"shader: the name {quoted(name)} is taken by the shader in line"
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
        if self.faults.lined:
            # For faults found when all surfaces are checked at once, in `all_surfaces`.
            for parameter in rows.parameters:
                rows.lines.append(_line(_giving(parameter, element, fields)))

    # What elements have in common

    def values(
        self, element: _Element, fields: _Fields, required: tuple[str, ...] = ()
    ) -> dict[str, list[Any]]:
        """What the children of an element say, by parameter of its dataclass: lists of numbers.

        NaN, which no file can hold, stands for numbers that could not be read: what validation
        says about it is dropped, as that fault is noted already.
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
                    f"{element.tag}: {quoted(word)} is no decimal number;"
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
                f"{element.tag}: unknown type {quoted(kind)}; {_nearest(kind, known)}",
            )
        return kind

    def unknown(self, element: _Element, of: str, known: Iterable[str]) -> None:
        self.fault(
            element,
            f"{short(element.tag)}: unknown in {short(of)}; {_nearest(element.tag, known)}",
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
                self.fault(self.seen["image"], str(fault))
        return None if self.faults.told else scene

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
                row = bisect_left(rows.index, fault.surface or 0)
                which = rows.parameters.index(parameter)
                values = (rows.first, rows.second)[which][row * count : (row + 1) * count]
                if not _unread(values):
                    line = rows.lines[2 * row + which] if self.faults.lined else 0
                    self.fault(line, f"{fault.field}: {fault.message}")
        return Surfaces()
