"""From a scene file to a :class:`~tracer.scene.model.Scene`.

Elements become rows of tables, one for each dataclass; numbers are converted many at a time.

Each fault is reported in a line of its own, as ``FILE:LINE: element: what is wrong; what would be
right``, up to the place where the file is no longer XML or passes a limit, or has `MAX_FAULTS`.
"""

from __future__ import annotations

import os
import re
import stat
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import MISSING, Field, fields, replace
from itertools import repeat
from typing import IO, Any, cast

import numpy as np

from tracer.arrays import Floats
from tracer.messages import printable, quoted, short
from tracer.scene import model
from tracer.scene.elements import MAX_BYTES, Element, GiveUp, parse
from tracer.scene.model import Scene, Surfaces
from tracer.scene.remedies import nearest
from tracer.scene.schema import Numbers, SceneError, order_faults, unchecked

MAX_FAULTS = 1_000
"""How many faults are reported before the reader gives up on a file."""

# How many elements are converted at once.
_BATCH = 1024


class SceneFileError(SceneError):
    """A scene file with faults; the message is a line for each, in file order.

    Its `lines` are ``FILE:LINE: element: what is wrong; what would be right``, or ``FILE: ...``
    where there is no line.
    """


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
    stream = hasattr(given, "read")
    name = getattr(given, "name", None) if stream else os.fsdecode(given)
    if not isinstance(name, str):
        name = "<stream>"
    try:
        with nullcontext(given) if stream else _opened(name) as file:
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


class _Table:
    """All elements that make a dataclass, in rows, as its fields' metadata describe them."""

    def __init__(self, made: type) -> None:
        self.made = made
        tagged = [field for field in fields(made) if field.metadata]
        self.tags = {tag: field.name for field in tagged for tag in field.metadata["tags"]}
        self.numeric = [f for f in tagged if isinstance(f.metadata["kind"], Numbers)]
        required = [field for field in self.numeric if field.default is MISSING]
        self.required = {field.name: field.metadata["tags"][0] for field in required}
        self.columns = {field.name: array("d") for field in self.numeric}
        self.given: set[str] = set()  # fields that some row gives
        # Of each row the line, the place among all shaders or surfaces, and a surface's shader.
        self.lines, self.index, self.shaders = array("i"), array("i"), array("i")
        # Of each field, elements whose numbers are not converted yet; None where one is not given.
        self.unread: dict[str, list[Element | None]] = {name: [] for name in self.columns}

    def objects(self) -> Iterator[Any]:
        """Make the dataclass of each row, whose numbers are known to be right."""
        columns = {field.name: self._values(field) for field in fields(self.made)}
        for row in zip(*columns.values(), strict=True):
            yield unchecked(self.made, **dict(zip(columns, row, strict=True)))

    def _values(self, field: Field[Any]) -> Iterable[Any]:
        if field.name == "line":
            return self.lines
        if field.name not in self.given:
            return repeat(field.default, len(self.lines))  # one tuple for all
        rows = np.reshape(self.columns[field.name], (len(self.lines), -1)).T.tolist()
        return zip(*rows, strict=True) if len(rows) > 1 else rows[0]


def _numbers(texts: Sequence[str], count: int) -> list[float] | None:
    """The numbers in all `texts`; None unless each surely holds `count`, and nothing else.

    Some words that float() accepts are no numbers: 1_0, nan, infinity, and digits of other scripts.
    """
    # One text for all: to read each by itself takes longer than to make a number of it.
    text = " ; ".join(texts)
    found = text.split()
    between = found[count :: count + 1]
    del found[count :: count + 1]
    whole = len(found) == count * len(texts) and between == [";"] * (len(texts) - 1)
    if not whole or not text.isascii() or any(map(text.__contains__, "_nN")):
        return None
    try:
        return [*map(float, found)]
    except ValueError:
        return None


class _Reader:
    """Takes elements in, as rows of tables; makes these into a scene."""

    def __init__(self) -> None:
        self.faults: list[tuple[int, str]] = []
        self.seen: dict[str, Element] = {}
        self.empty = Scene(width=1, height=1)
        self.cameras, self.lights = _Table(model.Camera), _Table(model.PointLight)
        self.shaders = {made.__name__: _Table(made) for made in (model.Lambertian, model.Phong)}
        self.surfaces = {made.__name__: _Table(made) for made in (model.Sphere, model.Box)}
        self.surface_count = 0
        # A named shader gets its place among all when its name first occurs, referred to or
        # defined.  Of each place, the line that defines it, or 0; place 0 is white.
        self.places: dict[str, int] = {}
        self.defined = array("i", [1])
        # Of each reference to a shader that was not yet defined, its line and the shader's place.
        self.references = array("i")

    def note(self, line: int, tag: str, message: str) -> None:
        """Note a fault; raise `GiveUp` if it is one too many."""
        if len(self.faults) == MAX_FAULTS:
            last = max(line for line, _ in self.faults)
            raise GiveUp(last, f"{MAX_FAULTS} faults so far; mend these first")
        self.faults.append((line, f"{short(tag)}: {message}"))

    def fault(self, element: Element, message: str) -> None:
        """Note a fault of an element."""
        self.note(element.line, element.tag, message)

    def read(self, file: IO[bytes]) -> None:
        """Take in a file; note all faults, as far as it can be read."""
        try:
            parse(file, self.take, self.note)
        finally:
            typed = (*self.shaders.values(), *self.surfaces.values())
            for table in (self.cameras, self.lights, *typed):
                self.convert(table)
        self.check_whole()

    def take(self, element: Element) -> None:
        """Take in the root, which comes first, or a child of it."""
        tag = element.tag
        if tag == "surface" and self.seen:
            self.surface(element)
        elif not self.seen:
            self.root(element)
        elif tag == "shader":
            self.shader(element)
            if "name" not in element.attrib:
                self.fault(element, 'has no name; add one, as in name="white"')
        elif tag == "light":
            self.row(self.lights, element)
        elif tag in ("camera", "image"):
            if self.seen.setdefault(tag, element) is not element:
                self.repeated(element, self.seen[tag])
            self.row(self.cameras, element) if tag == "camera" else self.take_image(element)
        else:
            self.unknown(element, "scene", ("camera", "image", "light", "shader", "surface"))

    def root(self, element: Element) -> None:
        if element.tag != "scene":
            raise GiveUp(element.line, f"{short(element.tag)}: the root must be <scene>")
        if "version" in element.attrib:
            message = "scene: has a version, so it is Mitsuba's; name the scene it was made from"
            raise GiveUp(element.line, message)
        self.no_attributes(element)
        self.seen["scene"] = element

    def take_image(self, element: Element) -> None:
        self.no_parts(element)
        word = r"\s*([-+]?\d{1,18})"
        found = re.fullmatch(rf"{word}\s{word}\s*", element.text, re.ASCII)
        if found is None:
            wrong = "needs two whole numbers, width and height, as in 640 480"
            self.fault(element, f"{wrong}; has {quoted(element.text.strip())}")
            return
        try:
            self.empty = Scene(width=int(found[1]), height=int(found[2]))
        except SceneError as error:
            for line in error.lines:
                self.fault(element, line)

    def surface(self, element: Element) -> None:
        table = self.surfaces.get(element.attrib.get("type", ""))
        if table is None:  # what else it holds cannot be judged, but shaders may be defined there
            self.untyped(element, self.surfaces)
            for child in element:
                if child.tag == "shader":
                    self.shader_or_reference(child)
            return
        table.index.append(self.surface_count)
        self.surface_count += 1
        shader = self.row(table, element, "type").get("shader")
        place = 0 if shader is None else self.shader_or_reference(shader)
        table.shaders.append(place)
        if shader is not None and not self.defined[place]:
            self.references.extend((shader.line, place))

    def shader(self, element: Element) -> int:
        """Take in a shader; return its place."""
        table = self.shaders.get(element.attrib.get("type", ""))
        name = element.attrib.get("name")
        place = self.place(name)
        if name is not None and self.defined[place]:
            taken = f"is taken by the shader in line {self.defined[place]}; choose another"
            self.fault(element, f"the name {quoted(name)} {taken}")
        else:
            self.defined[place] = element.line
        if table is None:
            self.untyped(element, self.shaders, "name")
        else:
            table.index.append(place)
            self.row(table, element, "name", "type")
        return place

    def shader_or_reference(self, element: Element) -> int:
        """Take in a surface's shader, or a reference to one; return its place."""
        name = element.attrib.get("ref")
        if name is not None:
            if len(element.attrib) > 1 or element:
                self.no_parts(element, "ref")
        elif "name" in element.attrib and "type" not in element.attrib and not element:
            name = element.attrib["name"]
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

    def untyped(self, element: Element, tables: Mapping[str, _Table], *known: str) -> None:
        """Note that the `type` of a shader or surface names none of the tables."""
        self.no_attributes(element, (*known, "type"))
        kind = element.attrib.get("type")
        choice = " or ".join(f'type="{name}"' for name in tables)
        wrong = f"has no type; add {choice}"
        if kind is not None:
            wrong = f"unknown type {quoted(kind)}; {nearest(kind, tables)}"
        self.fault(element, wrong)

    def row(self, table: _Table, element: Element, *known: str) -> dict[str, Element]:
        """Take in an element, whose numbers are converted later; return its parts by their fields.

        Note what it has no field for, and what it lacks.
        """
        self.no_attributes(element, known, table.tags)
        parts: dict[str, Element] = {}
        for child in element:
            name = table.tags.get(child.tag)
            if name is None:
                self.unknown(child, element.attrib.get("type", element.tag), table.tags)
            elif name in parts:
                self.repeated(child, parts[name])
            else:
                parts[name] = child
        for name, column in table.unread.items():
            column.append(parts.get(name))
        for name, tag in table.required.items():
            if name not in parts and tag not in element.attrib:
                self.fault(element, f"has no {tag}; add <{tag}>x y z</{tag}>")
        table.lines.append(element.line)
        if len(table.lines) % _BATCH == 0:
            self.convert(table)
        return parts

    def convert(self, table: _Table) -> None:
        """Read and check the numbers of the elements that were taken in since the last call."""
        batch: dict[str, Floats] = {}
        faults = len(self.faults)
        for field in table.numeric:
            kind, unread = field.metadata["kind"], table.unread[field.name]
            given = [each for each in unread if each is not None]
            odd = any(each or each.attrib for each in given)
            found = None if odd else _numbers([each.text for each in given], kind.count)
            if found is None:
                found = [x for each in given for x in self.numbers_of(each, kind.count)]
            values = np.reshape(found, (-1, kind.count))
            for i, message in kind.faults(values):
                if not np.isnan(values[i]).any():  # which is noted already
                    self.fault(given[i], message)
            if given:
                table.given.add(field.name)
            default = np.nan if field.name in table.required else field.default
            batch[field.name] = np.full((len(unread), kind.count), default, dtype=np.float64)
            batch[field.name][[each is not None for each in unread]] = values
            table.columns[field.name].frombytes(batch[field.name].tobytes())
        if table.made is model.Box:
            for i, message in order_faults(batch["min_pt"], batch["max_pt"]):
                self.fault(cast(Element, table.unread["min_pt"][i]), _in_tags(message))
        elif table.made is model.Camera and table.lines and len(self.faults) == faults:
            for fault in next(table.objects()).misfits():
                self.fault(self.seen["camera"], _in_tags(fault))
        for unread in table.unread.values():
            unread.clear()

    def numbers_of(self, element: Element, count: int) -> list[float]:
        """The numbers that an element holds, or NaN for each after a fault."""
        self.no_parts(element)
        if found := _numbers([element.text], count):
            return found
        words = re.findall("[^ \t\r\n]+", element.text)  # str.split() knows more white space
        wrong = [word for word in words if not _numbers([word], 1)]
        for word in wrong:
            self.fault(element, f"{quoted(word)} is no decimal number; write it as 2, -.5 or 1e-3")
        if not wrong and not element:
            self.fault(element, f"needs {count} number{'s' * (count > 1)}, has {len(words)}")
        return [np.nan] * count

    # What stands where it may not

    def unknown(self, element: Element, parent: str, known: Iterable[str]) -> None:
        remedy = nearest(element.tag, known)
        for tag, kinds in (("surface", self.surfaces), ("shader", self.shaders)):
            for kind in kinds:
                if kind.lower() == element.tag.lower():
                    remedy = f'write <{tag} type="{kind}">'
        self.fault(element, f"unknown in {short(parent)}; {remedy}")

    def repeated(self, element: Element, earlier: Element) -> None:
        given = "given" if earlier.tag == element.tag else f"{earlier.tag} is given"
        self.fault(element, f"{given} already, in line {earlier.line}; keep one of the two")

    def no_attributes(
        self, element: Element, known: Sequence[str] = (), parts: Collection[str] = ()
    ) -> None:
        """Note all attributes but those `known`; some stand in place of elements, of its parts."""
        for name in element.attrib:
            if name in known:
                continue
            value = short(element.attrib[name])
            right = f'<shader ref="{value}"/>' if name == "shader" else f"<{name}>{value}</{name}>"
            remedy = f"write {right} in it" if name in parts else nearest(name, known)
            self.fault(element, f"unknown attribute {quoted(name)}; {remedy}")

    def no_parts(self, element: Element, *known: str) -> None:
        """Note all attributes but those `known`, and all elements, in one that holds none."""
        self.no_attributes(element, known)
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
        for line, place in zip(self.references[::2], self.references[1::2], strict=True):
            if not self.defined[place]:
                remedy = nearest(names[place], known) if known else "define it"
                self.note(line, "shader", f"no shader is named {quoted(names[place])}; {remedy}")

    def scene(self) -> Scene:
        """Make the scene of a file without faults."""
        shaders: list[model.Shader] = [model.Lambertian()] * len(self.defined)
        for table in self.shaders.values():
            for place, shader in zip(table.index, table.objects(), strict=True):
                shaders[place] = shader
        tables = self.surfaces.values()
        surfaces = Surfaces(
            **{name: column for table in tables for name, column in table.columns.items()},
            shader_index=np.concatenate([table.shaders for table in tables]),
            file_index=np.concatenate([table.index for table in tables]),
            shaders=tuple(shaders),
            line=np.concatenate([table.lines for table in tables]),
        )
        (camera,), lights = self.cameras.objects(), tuple(self.lights.objects())
        return replace(self.empty, camera=camera, lights=lights, surfaces=surfaces)


def _in_tags(text: str) -> str:
    """A text in the words of a scene file: tags stand for parameters, viewDir for view_dir."""
    return re.sub("_([a-z])", lambda found: found[1].upper(), text)
