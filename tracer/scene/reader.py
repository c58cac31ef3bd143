"""From a scene file to a :class:`~tracer.scene.model.Scene`.

Elements are taken in as rows of tables, one table for each dataclass that they make.  Numbers are
converted and checked many at a time.

Each fault is reported in a line of its own, as ``FILE:LINE: element: what is wrong; what would be
right``, up to the place where the file is no longer XML or passes a limit, or has `MAX_FAULTS`.
"""

from __future__ import annotations

import os
import re
import stat
from array import array
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import IO, Any, cast

import numpy as np

from tracer.arrays import Floats
from tracer.messages import printable, quoted, short
from tracer.scene import objects
from tracer.scene.elements import MAX_BYTES, Element, GiveUp, parse
from tracer.scene.model import Scene, Surfaces
from tracer.scene.remedies import nearest
from tracer.scene.schema import SceneError, order_faults
from tracer.scene.table import Table, numbers

__all__ = ["MAX_FAULTS", "SceneFileError", "load_scene"]

MAX_FAULTS = 1_000
"""How many faults are reported before the reader gives up on a file."""

# After so many faults undefined shaders get no suggestion: each search takes milliseconds.
_SUGGESTIONS = 30

# How many elements of a kind are converted at once.
_BATCH = 1024


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
        super().__init__(self.lines)

    def __str__(self) -> str:
        return "\n".join(self.lines)


def load_scene(
    source: str | bytes | os.PathLike[str] | os.PathLike[bytes] | IO[bytes],
) -> Scene:
    """Read a scene file.

    Parameters
    ----------
    source : str, bytes, path-like or binary file object
        An XML file of at most 256 MiB; its format is described in the README.

    Returns
    -------
    Scene

    Raises
    ------
    SceneFileError
        If the file cannot be read, or has any fault; the message has a line for each.
    """
    reader, given = _Reader(), cast(Any, source)
    try:
        if hasattr(given, "read"):
            name = given.name if isinstance(getattr(given, "name", None), str) else "<stream>"
            reader.read(given)
        else:
            name = os.fsdecode(given)
            with _opened(name) as file:
                reader.read(file)
    except GiveUp as fault:
        reader.faults.append(fault.args)
    except OSError as error:
        reason = error.strerror or str(error)
        reader.faults.append((0, f"cannot be read: {reason}; check the path and its permissions"))
    if not reader.faults:
        return reader.scene()
    # Whatever text comes from the file, a message is one line that any terminal can show.
    raise SceneFileError(
        printable(f"{name or repr(name)}{f':{line}' if line else ''}: {message}")
        for line, message in sorted(reader.faults, key=lambda fault: fault[0])
    )


def _opened(path: str) -> IO[bytes]:
    """Open a regular file: a pipe or a device may block, or never end."""
    try:
        status = os.stat(path)
    except ValueError:
        wrong = "no path has a NUL or half of a surrogate pair in it; check the path"
        raise GiveUp(0, wrong) from None
    if stat.S_ISDIR(status.st_mode):
        raise GiveUp(0, "is a folder; name a scene file in it")
    if not stat.S_ISREG(status.st_mode):
        raise GiveUp(0, "is not a regular file; save the scene to one")
    if status.st_size > MAX_BYTES:
        raise GiveUp(0, f"has {status.st_size} bytes; at most {MAX_BYTES} are allowed")
    return open(path, "rb")


class _Reader:
    """Takes elements in, as rows of tables; makes these into a scene."""

    def __init__(self) -> None:
        self.faults: list[tuple[int, str]] = []
        self.seen: dict[str, Element] = {}
        self.camera = objects.Camera()
        self.size = (1, 1)
        self.lights = Table(objects.PointLight)
        self.shaders = {made.__name__: Table(made) for made in (objects.Lambertian, objects.Phong)}
        self.surfaces = {made.__name__: Table(made) for made in (objects.Sphere, objects.Box)}
        self.surface_count = 0
        # A named shader gets its place among all when its name first occurs, referred to or
        # defined.  Of each place, the line that defines it, or 0; place 0 is white.
        self.places: dict[str, int] = {}
        self.defined = array("i", [1])
        # References to shaders that were not yet defined: their lines, and the shaders' places.
        self.referring, self.referred = array("i"), array("i")

    def note(self, line: int, tag: str, message: str) -> None:
        """Note a fault; raise `GiveUp` if it is one too many."""
        self.faults.append((line, f"{short(tag)}: {message}"))
        if len(self.faults) == MAX_FAULTS:
            last = max(line for line, _ in self.faults)
            raise GiveUp(last, f"{MAX_FAULTS} faults so far; mend these first")

    def fault(self, element: Element, message: str) -> None:
        """Note a fault of an element."""
        self.note(element.line, element.tag, message)

    def read(self, file: IO[bytes]) -> None:
        """Take in a file; note all faults, as far as it can be read."""
        whole = False
        try:
            parse(file, self.take, self.note)
            whole = True
        except GiveUp as fault:
            self.faults.append(fault.args)
        if len(self.faults) <= MAX_FAULTS:
            for table in (self.lights, *self.shaders.values(), *self.surfaces.values()):
                if table.lines:
                    self.convert(table)
            if whole:
                self.check_whole()

    def root(self, element: Element) -> None:
        """Check the root."""
        if element.tag != "scene":
            raise GiveUp(element.line, f"{short(element.tag)}: the root must be <scene>")
        if "version" in element.attrib:
            message = "scene: has a version, so it is Mitsuba's; name the scene it was made from"
            raise GiveUp(element.line, message)
        self.no_attributes(element)
        self.seen["scene"] = element

    def take(self, element: Element) -> None:
        """Take in the root, which comes first, or a child of it."""
        tag = element.tag
        if not self.seen:
            self.root(element)
        elif tag == "surface":
            self.surface(element)
        elif tag == "shader":
            self.shader(element)
            if "name" not in element.attrib:
                self.fault(element, 'has no name; add one, as in name="white"')
        elif tag == "light":
            self.no_attributes(element, parts=self.lights.names)
            self.row(self.lights, element)
        elif tag in ("camera", "image"):
            if self.seen.setdefault(tag, element) is not element:
                self.repeated(element, self.seen[tag])
            self.take_camera(element) if tag == "camera" else self.take_image(element)
        else:
            self.unknown(element, "scene", ("camera", "image", "light", "shader", "surface"))

    def take_camera(self, element: Element) -> None:
        table = Table(objects.Camera)
        self.no_attributes(element, parts=table.names)
        parts = self.row(table, element)
        counts = {name: column.kind.count for name, column in table.columns.items()}
        given: dict[str, Any] = {
            name: self.numbers_of(part, counts[name]) for name, part in parts.items()
        }
        try:
            self.camera = objects.Camera(**given)
        except SceneError as error:
            for name, message, _ in error.faults:
                if np.nan not in given.get(name, ()):  # which is noted already
                    line = parts.get(name, element).line
                    self.note(line, _in_tags(name), _in_tags(message))

    def take_image(self, element: Element) -> None:
        self.no_attributes(element)
        self.no_children(element)
        found = re.fullmatch(r"\s*([-+]?\d+)\s+([-+]?\d+)\s*", element.text, re.ASCII)
        if found is None:
            wrong = "needs two whole numbers, width and height, as in 640 480"
            self.fault(element, f"{wrong}; has {quoted(element.text.strip())}")
            return
        # What is too large for an int is too large for a picture.
        width, height = (int(min(max(float(word), -1e18), 1e18)) for word in found.groups())
        self.size = (width, height)
        try:
            Scene(width=width, height=height)
        except SceneError as error:
            for fault in str(error).splitlines():
                self.fault(element, fault)

    def surface(self, element: Element) -> None:
        table = self.type_of(element, self.surfaces)
        if table is None:  # what else it holds cannot be judged, but shaders may be defined there
            for child in element:
                if child.tag == "shader":
                    self.shader_or_reference(child)
            return
        table.index.append(self.surface_count)
        self.surface_count += 1
        shader = self.row(table, element).get("shader")
        place = 0 if shader is None else self.shader_or_reference(shader)
        table.shaders.append(place)
        if shader is not None and not self.defined[place]:
            self.referring.append(shader.line)
            self.referred.append(place)

    def shader(self, element: Element) -> int:
        """Take in a shader; return its place."""
        table = self.type_of(element, self.shaders, ("name",))
        place = self.place(element.attrib.get("name"))
        if self.defined[place]:
            taken = f"is taken by the shader in line {self.defined[place]}; choose another"
            self.fault(element, f"the name {quoted(element.attrib['name'])} {taken}")
        else:
            self.defined[place] = element.line
        if table is not None:
            table.index.append(place)
            self.row(table, element)
        return place

    def shader_or_reference(self, element: Element) -> int:
        """Take in a surface's shader, or a reference to one; return its place."""
        attributes = element.attrib
        name = attributes.get("ref")
        if name is not None:
            if len(attributes) > 1 or element:
                self.no_attributes(element, ("ref",))
                self.no_children(element)
        elif "name" in attributes and "type" not in attributes and not element:
            name = attributes["name"]
            right = f'to refer to a shader, write ref="{short(name)}"'
            self.fault(element, f"has a name, but no type; {right}")
        else:
            return self.shader(element)
        return self.place(name)

    def place(self, name: str | None) -> int:
        """Return the place of the shader of this name among all, or a new one."""
        new = len(self.defined)
        place = new if name is None else self.places.setdefault(name, new)
        if place == new:
            self.defined.append(0)
        return place

    def row(self, table: Table, element: Element) -> dict[str, Element]:
        """Take in an element, whose numbers are converted later; return the parts it has."""
        parts: dict[str, Element] = {}
        for child in element:
            name = table.names.get(child.tag)
            if name is None:
                self.unknown(child, element.attrib.get("type", element.tag), table.names)
            elif name in parts:
                self.repeated(child, parts[name])
            else:
                parts[name] = child
        for name, column in table.columns.items():
            part, tag = parts.get(name), column.tag
            column.unread.append(part)
            if part is None and column.required and tag not in element.attrib:
                self.fault(element, f"has no {tag}; add <{tag}>x y z</{tag}>")
        table.lines.append(element.line)
        if len(table.lines) % _BATCH == 0:
            self.convert(table)
        return parts

    def convert(self, table: Table) -> None:
        """Read and check the numbers of the elements that were taken in since the last call."""
        batch: dict[str, Floats] = {}
        for name, column in table.columns.items():
            given = [each for each in column.unread if each is not None]
            count, odd = column.kind.count, any(each or each.attrib for each in given)
            found = None if odd else numbers([each.text for each in given], count)
            if found is None:
                found = [x for each in given for x in self.numbers_of(each, count)]
            values = np.reshape(found, (-1, count))
            for i, message in column.kind.faults(values):
                if not np.isnan(values[i]).any():  # which is noted already
                    self.fault(given[i], message)
            batch[name] = np.full((len(column.unread), count), column.default)
            batch[name][[each is not None for each in column.unread]] = values
            column.numbers.frombytes(batch[name].tobytes())
        if table.made is objects.Box:
            for i, message in order_faults(batch["min_pt"], batch["max_pt"]):
                self.fault(table.columns["min_pt"].unread[i], _in_tags(message))
        for column in table.columns.values():
            column.unread.clear()

    def numbers_of(self, element: Element, count: int) -> list[float]:
        """The numbers that an element holds, or NaN for each after a fault."""
        self.no_attributes(element)
        self.no_children(element)
        if found := numbers([element.text], count):
            return found
        words = re.findall("[^ \t\r\n]+", element.text)  # str.split() knows more white space
        wrong = [word for word in words if not numbers([word], 1)]
        for word in wrong:
            self.fault(element, f"{quoted(word)} is no decimal number; write it as 2, -.5 or 1e-3")
        if not wrong and not element:
            self.fault(element, f"needs {count} number{'s' * (count > 1)}, has {len(words)}")
        return [np.nan] * count

    def type_of(
        self, element: Element, tables: Mapping[str, Table], allowed: tuple[str, ...] = ()
    ) -> Table | None:
        """The table that the `type` of a shader or surface names, if any."""
        kind = element.attrib.get("type")
        table = tables.get(kind or "")
        if len(element.attrib) > 1 or kind is None:
            self.no_attributes(element, (*allowed, "type"), table.names if table else ())
        if kind is None:
            choice = " or ".join(f'type="{name}"' for name in tables)
            self.fault(element, f"has no type; add {choice}")
        elif table is None:
            self.fault(element, f"unknown type {quoted(kind)}; {nearest(kind, tables)}")
        return table

    def unknown(self, element: Element, parent: str, known: Iterable[str]) -> None:
        remedy = nearest(element.tag, known)
        for kind in (*self.surfaces, *self.shaders):
            if kind.lower() == element.tag.lower():
                tag = "surface" if kind in self.surfaces else "shader"
                remedy = f'write <{tag} type="{kind}">'
        self.fault(element, f"unknown in {short(parent)}; {remedy}")

    def repeated(self, element: Element, earlier: Element) -> None:
        given = "given" if earlier.tag == element.tag else f"{earlier.tag} is given"
        self.fault(element, f"{given} already, in line {earlier.line}; keep one of the two")

    def no_attributes(
        self, element: Element, known: Sequence[str] = (), parts: Collection[str] = ()
    ) -> None:
        """Note all attributes but those `known`; some stand in place of elements, of its parts."""
        for name in [name for name in element.attrib if name not in known]:
            value = short(element.attrib[name])
            right = f'<shader ref="{value}"/>' if name == "shader" else f"<{name}>{value}</{name}>"
            remedy = f"write {right} in it" if name in parts else nearest(name, known)
            self.fault(element, f"unknown attribute {quoted(name)}; {remedy}")

    def no_children(self, element: Element) -> None:
        for child in element:
            wrong = f"no element may stand in it; remove <{short(child.tag)}>"
            self.note(child.line, element.tag, wrong)

    # From tables to a scene

    def check_whole(self) -> None:
        """Note what is missing in a whole file: camera, image, and shaders that are referred to."""
        for tag in ("camera", "image"):
            if tag not in self.seen:
                self.fault(self.seen["scene"], f"has no {tag}; add <{tag}> ... </{tag}>")
        names = {place: name for name, place in self.places.items()}
        known = [name for name, place in self.places.items() if self.defined[place]]
        for line, place in zip(self.referring, self.referred, strict=True):
            if not self.defined[place]:
                suggest = known and len(self.faults) < _SUGGESTIONS
                remedy = nearest(names[place], known) if suggest else "define it"
                self.note(line, "shader", f"no shader is named {quoted(names[place])}; {remedy}")

    def scene(self) -> Scene:
        """Make the scene of a file without faults."""
        shaders: list[objects.Shader] = [objects.Lambertian()] * len(self.defined)
        for table in self.shaders.values():
            for place, shader in zip(table.index, table.objects(), strict=True):
                shaders[place] = shader
        spheres, boxes = self.surfaces.values()
        columns = (spheres.columns | boxes.columns).items()
        surfaces = Surfaces(
            **{name: column.given() for name, column in columns},
            sphere_shader=spheres.shaders,
            sphere_index=spheres.index,
            box_shader=boxes.shaders,
            box_index=boxes.index,
            shaders=tuple(shaders),
            line=np.concatenate([spheres.lines, boxes.lines]),
        )
        width, height = self.size
        lights = self.lights.objects()
        return Scene(
            width=width, height=height, camera=self.camera, lights=lights, surfaces=surfaces
        )


def _in_tags(text: str) -> str:
    """A text in the words of a scene file: tags stand for parameters, viewDir for view_dir."""
    return re.sub("_([a-z])", lambda found: found[1].upper(), text)
