"""Read a scene file into a :class:`~tracer.scene.model.Scene`.

Elements become rows of tables, one table for each dataclass; numbers are validated at the end, in
arrays.

Each fault is reported in a line of its own, as ``FILE:LINE: element: what is wrong; what would be
right``, until the file stops being XML, exceeds a limit, or has `MAX_FAULTS`.
"""

from __future__ import annotations

import os
import re
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import MISSING, Field, fields, replace
from itertools import repeat
from typing import IO, Any, cast
from unicodedata import normalize

import numpy as np

from tracer.messages import printable, quoted, short
from tracer.scene import model, schema
from tracer.scene.elements import Element, FatalFault, opened, parse
from tracer.scene.hints import meant, not_a_number, suggestion, unknown_tag
from tracer.scene.model import Scene, Surfaces
from tracer.scene.schema import Floats, SceneError, construct_unchecked

MAX_FAULTS = 1_000
"""How many faults are reported before the reader gives up on a file."""

# Of so many unknown shaders the most similar name is sought, which takes milliseconds each.
_MAX_SEARCHES = 32

# So many words of an element that holds too many are judged one by one.
_MAX_WORDS = 64


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
        with nullcontext(given) if stream else opened(name) as file:
            reader.read(file)
    except FatalFault as fault:
        reader.faults.append(fault.args)
    except OSError as error:
        reason = error.strerror or str(error)
        reader.faults.append((0, f"cannot be read: {reason}; check the path and its permissions"))
    if not reader.faults:
        return reader.scene()
    # Text from the file must not break a message into lines, or reach the terminal as controls.
    raise SceneFileError(
        printable(f"{name or repr(name)}{f':{line}' if line else ''}: {message}")
        for line, message in sorted(reader.faults, key=lambda fault: fault[0])
    )


# What float() accepts beyond that is not a number of this format: 1_0, nan, infinity.
_decimal = re.compile(r"[-+.0-9eE\s]*", re.ASCII).fullmatch


def _numbers(text: str, count: int) -> Sequence[float]:
    """The `count` numbers that a text consists of; none if it is anything else."""
    words = text.split()
    try:
        return [*map(float, words)] if len(words) == count and _decimal(text) else ()
    except ValueError:
        return ()


class _Column:
    """A field's numbers in all rows of a table, and the lines of the elements that hold them."""

    def __init__(self, field: Field[Any]) -> None:
        self.validator, self.tags = field.metadata.values()
        self.default: Any = field.default
        self.required = self.default is MISSING
        unknown = self.required or self.default is None
        default: Any = np.nan if unknown else self.default
        self.missing = np.broadcast_to(default, self.validator.count).tolist()
        # The line is negative for the second of two tags, and 0 in rows without such an element.
        self.numbers, self.lines = array("d"), array("i")

    def array(self) -> Floats:
        """The numbers (n, count)."""
        return np.reshape(self.numbers, (-1, self.validator.count))

    def values(self) -> Iterable[Any]:
        """The field's value in the object of each row."""
        if not any(self.lines):
            return repeat(self.default, len(self.lines))  # one tuple for all
        rows = self.array().T.tolist()
        return zip(*rows, strict=True) if len(rows) > 1 else rows[0]


class _Table:
    """All elements that make a dataclass, in rows, as its fields' metadata describe them."""

    def __init__(self, made: type[schema.Checked]) -> None:
        self.made, numeric = made, schema.numeric(made)
        tagged = [field for field in fields(cast(Any, made)) if field.metadata]
        self.tags = {tag: field.name for field in tagged for tag in field.metadata["tags"]}
        self.columns = {field.name: _Column(field) for field in tagged if field.name in numeric}
        # Of each row: the line, the index among all shaders or surfaces, a surface's shader.
        self.lines, self.index, self.shaders = array("i"), array("i"), array("i")

    def faults(self) -> Iterator[tuple[int, str, str]]:
        """Find invalid numbers: the line, the tag, and the message."""
        numbers = {name: column.array() for name, column in self.columns.items()}
        for row, name, wrong in schema.faults(self.made, numbers):
            line, tags = self.columns[name].lines[row], self.columns[name].tags
            if not np.isnan(numbers[name][row]).any():  # else it is reported already
                yield abs(line) or self.lines[row], tags[line < 0], _in_tags(wrong)

    def objects(self) -> Iterator[Any]:
        """Make the dataclass of each row, from numbers without faults."""
        values = {name: column.values() for name, column in self.columns.items()}
        if self.made is model.PointLight:
            values["line"] = self.lines
        for row in zip(*values.values(), strict=True):
            yield construct_unchecked(self.made, **dict(zip(values, row, strict=True)))


class _Reader:
    """Reads elements into rows of tables, and makes a scene of these."""

    def __init__(self) -> None:
        self.faults: list[tuple[int, str]] = []
        self.seen: dict[str, Element] = {}
        # Tags of the scene's children that are misspelt: these are not missing.
        self.misspelt = set[str | None]()
        self.empty = Scene(width=1, height=1)
        self.cameras, self.lights = _Table(model.Camera), _Table(model.PointLight)
        self.shaders = {made.__name__: _Table(made) for made in (model.Lambertian, model.Phong)}
        self.surfaces = {made.__name__: _Table(made) for made in (model.Sphere, model.Box)}
        self.surface_count = 0
        # A named shader gets its index when the name first occurs, in a reference or a definition.
        # `defined` holds the line of each definition, or 0; shader 0 is the default, white.
        self.indices: dict[str, int] = {}
        self.defined = array("i", [1])
        # Line and shader of each reference to a shader that was not defined yet.
        self.references = array("i")

    def report_at(self, line: int, tag: str, message: str) -> None:
        """Report a fault at a line; raise `FatalFault` if it is one too many."""
        if len(self.faults) == MAX_FAULTS:
            last = max(line for line, _ in self.faults)
            raise FatalFault(last, f"{MAX_FAULTS} faults so far; mend these first")
        self.faults.append((line, f"{short(tag)}: {message}"))

    def report(self, element: Element, message: str) -> None:
        """Report a fault of an element."""
        self.report_at(element.line, element.tag, message)

    def read(self, file: IO[bytes]) -> None:
        """Read a file; report all faults, as far as it is XML."""
        try:
            parse(file, self.read_child, self.report_at)
        finally:
            typed = (*self.shaders.values(), *self.surfaces.values())
            for table in (self.cameras, self.lights, *typed):
                for fault in table.faults():
                    self.report_at(*fault)
        self.check_whole()

    def read_child(self, element: Element) -> None:
        """Handle the root element, then each of its children."""
        tag = element.tag
        if tag == "surface" and self.seen:
            self.surface(element)
        elif not self.seen:
            self.root(element)
        elif tag == "shader":
            self.shader(element)
            tags = "name", "type"
            if "name" not in {tag if tag in tags else meant(tag, tags) for tag in element.attrib}:
                self.report(element, 'has no name; add one, as in name="white"')
        elif tag == "light":
            self.row(self.lights, element)
        elif tag in ("camera", "image"):
            if self.seen.setdefault(tag, element) is not element:
                self.repeated(element, self.seen[tag])
            self.row(self.cameras, element) if tag == "camera" else self.read_image(element)
        else:
            known = "camera", "image", "light", "shader", "surface"
            self.misspelt.add(self.unknown(element, "scene", known))

    def root(self, element: Element) -> None:
        if element.tag != "scene":
            raise FatalFault(element.line, f"{short(element.tag)}: the root must be <scene>")
        if "version" in element.attrib:
            message = "scene: has a version, so it is Mitsuba's; name the scene it was made from"
            raise FatalFault(element.line, message)
        self.no_attributes(element)
        self.seen["scene"] = element

    def read_image(self, element: Element) -> None:
        self.no_parts(element)
        word = r"\s*([-+]?\d{1,18})"
        found = re.fullmatch(rf"{word}\s{word}\s*", element.text, re.ASCII)
        text = element.text.strip()
        if found is None:
            wrong = f"needs two whole numbers, width and height, as in 640 480; has {quoted(text)}"
            self.report(element, wrong if text.isascii() else not_a_number(text))
            return
        try:
            self.empty = Scene(width=int(found[1]), height=int(found[2]))
        except SceneError as error:
            for line in error.lines:
                self.report(element, line)

    def surface(self, element: Element) -> None:
        table = self.surfaces.get(element.attrib.get("type", ""))
        if table is None:  # its other children cannot be judged, but shaders may be defined there
            self.untyped(element, self.surfaces)
            for child in element:
                if child.tag == "shader":
                    self.shader_or_reference(child)
            return
        table.index.append(self.surface_count)
        self.surface_count += 1
        shader = self.row(table, element, "type").get("shader")
        index = 0 if shader is None else self.shader_or_reference(shader)
        table.shaders.append(index)
        if shader is not None and not self.defined[index]:
            self.references.extend((shader.line, index))

    def shader(self, element: Element) -> int:
        """Read a shader; return its index."""
        table = self.shaders.get(element.attrib.get("type", ""))
        name = element.attrib.get("name")
        index = self.shader_index(name)
        if name is not None and self.defined[index]:
            wrong = f"is taken by the shader in line {self.defined[index]}; choose another"
            self.report(element, f"the name {quoted(name)} {wrong}")
        else:
            self.defined[index] = element.line
        if table is None:
            self.untyped(element, self.shaders, "name")
        else:
            table.index.append(index)
            self.row(table, element, "name", "type")
        return index

    def shader_or_reference(self, element: Element) -> int:
        """Read a surface's shader, or a reference to one; return the shader's index."""
        name = element.attrib.get("ref")
        if name is not None:
            if len(element.attrib) > 1 or element:
                self.no_parts(element, "ref")
        elif "name" in element.attrib and "type" not in element.attrib and not element:
            name = element.attrib["name"]
            right = f'to refer to a shader, write ref="{short(name)}"'
            self.report(element, f"has a name, but no type; {right}")
        else:
            return self.shader(element)
        return self.shader_index(name)

    def shader_index(self, name: str | None) -> int:
        """Return the index of the shader of this name, a new one if there is none yet."""
        new = len(self.defined)
        index = new if name is None else self.indices.setdefault(name, new)
        if index == new:
            self.defined.append(0)
        return index

    def untyped(self, element: Element, tables: Mapping[str, _Table], *known: str) -> None:
        """Report that the `type` of a shader or surface names none of the tables."""
        misspelt = self.no_attributes(element, (*known, "type"))
        name = element.attrib.get("type")
        if name is not None:
            right = suggestion(tables, meant(name, tables))
            self.report(element, f"unknown type {quoted(name)}; {right}")
        elif "type" not in misspelt:
            choice = " or ".join(f'type="{name}"' for name in tables)
            self.report(element, f"has no type; add {choice}")

    def row(self, table: _Table, element: Element, *known: str) -> dict[str, Element]:
        """Read an element as a row; return its children by their fields.

        Report children without a field, and required fields without a child.
        """
        if not all(map(known.__contains__, element.attrib)):
            self.no_attributes(element, known, table.tags)
        parts: dict[str, Element] = {}
        misspelt = set[str | None]()
        for child in element:
            name = table.tags.get(child.tag)
            if name is None:
                parent = element.attrib.get("type", element.tag)
                misspelt.add(self.unknown(child, parent, table.tags))
            elif name in parts:
                self.repeated(child, parts[name])
            else:
                parts[name] = child
        table.lines.append(element.line)
        for name, column in table.columns.items():
            part, tag = parts.get(name), column.tags[0]
            if part is not None:
                column.numbers.extend(self.numbers(part, column.validator.count))
                column.lines.append(part.line if part.tag == tag else -part.line)
                continue
            column.numbers.extend(column.missing)
            column.lines.append(0)
            if column.required and tag not in element.attrib and tag not in misspelt:
                self.report(element, f"has no {tag}; add <{tag}>x y z</{tag}>")
        return parts

    def numbers(self, element: Element, count: int) -> Sequence[float]:
        """The numbers that an element holds, or NaN for each after a fault."""
        if element or element.attrib:
            self.no_parts(element)
        if found := _numbers(element.text, count):
            return found
        words = re.findall("[^ \t\r\n]+", element.text)  # str.split() knows more white space
        wrong = [word for word in words[:_MAX_WORDS] if not _numbers(word, 1)]
        for word in wrong:
            self.report(element, not_a_number(word))
        if not wrong and not element:
            self.report(element, f"needs {count} number{'s' * (count > 1)}, has {len(words)}")
        return (np.nan,) * count

    # Elements and attributes that are unknown, repeated or out of place

    def unknown(self, element: Element, parent: str, known: Collection[str]) -> str | None:
        """Report an unknown element; return the tag that was meant, if that is clear."""
        remedy, match = unknown_tag(element.tag, known)
        self.report(element, f"unknown in {short(parent)}; {remedy}")
        return match

    def repeated(self, element: Element, earlier: Element) -> None:
        given = "given" if earlier.tag == element.tag else f"{earlier.tag} is given"
        self.report(element, f"{given} already, in line {earlier.line}; keep one of the two")

    def no_attributes(
        self, element: Element, known: Sequence[str] = (), parts: Collection[str] = ()
    ) -> set[str | None]:
        """Report all attributes but those `known`; return which ones were meant.

        `parts` are the tags of an element's children, which may be given as attributes by mistake.
        """
        misspelt = set[str | None]()
        for name in element.attrib:
            if name in known:
                continue
            value = short(element.attrib[name])
            right = f'<shader ref="{value}"/>' if name == "shader" else f"<{name}>{value}</{name}>"
            match = meant(name, known)
            misspelt.add(match)
            remedy = f"write {right} in it" if name in parts else suggestion(known, match)
            self.report(element, f"unknown attribute {quoted(name)}; {remedy}")
        return misspelt

    def no_parts(self, element: Element, *known: str) -> None:
        """Report all attributes but those `known`, and all children."""
        self.no_attributes(element, known)
        for child in element:
            wrong = f"no element may stand in it; remove <{short(child.tag)}>"
            self.report_at(child.line, element.tag, wrong)

    # From tables to a scene

    def check_whole(self) -> None:
        """Report what a whole file lacks: camera, image, and shaders that it refers to."""
        for tag in ("camera", "image"):
            if tag not in self.seen and tag not in self.misspelt:
                self.report(self.seen["scene"], f"has no {tag}; add <{tag}> ... </{tag}>")
        undefined = {k: name for name, k in self.indices.items() if not self.defined[k]}
        known = {name: self.defined[k] for name, k in self.indices.items() if self.defined[k]}
        same = {normalize("NFC", name): name for name in known} if undefined else {}
        remedies = dict[int, str]()
        for line, k in zip(self.references[::2], self.references[1::2], strict=True):
            if (name := undefined.get(k)) is None:
                continue
            if k not in remedies:
                match = meant(name, known) if len(remedies) < _MAX_SEARCHES else None
                remedies[k] = suggestion(known, match) if known else "define it"
                if twin := same.get(normalize("NFC", name)):
                    remedies[k] = (
                        f"the name in line {known[twin]} looks the same, but has other Unicode"
                        " characters (one is composed, one decomposed); copy it from there"
                    )
            self.report_at(line, "shader", f"no shader is named {quoted(name)}; {remedies[k]}")

    def scene(self) -> Scene:
        """Make the scene of a file without faults."""
        shaders: list[model.Shader] = [model.Lambertian()] * len(self.defined)
        for table in self.shaders.values():
            for index, shader in zip(table.index, table.objects(), strict=True):
                shaders[index] = shader
        tables = self.surfaces.values()
        columns = {name: c.array() for table in tables for name, c in table.columns.items()}
        surfaces = Surfaces(
            **columns | {"radius": columns["radius"][:, 0]},
            shader_index=np.concatenate([table.shaders for table in tables]),
            file_index=np.concatenate([table.index for table in tables]),
            shaders=tuple(shaders),
            line=np.concatenate([table.lines for table in tables]),
        )
        (camera,), lights = self.cameras.objects(), tuple(self.lights.objects())
        return replace(self.empty, camera=camera, lights=lights, surfaces=surfaces)


def _in_tags(text: str) -> str:
    """Replace the names of parameters in a message by tags: view_dir by viewDir."""
    return re.sub("_([a-z])", lambda found: found[1].upper(), text)
