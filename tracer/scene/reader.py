"""Read a scene file into a :class:`~tracer.scene.model.Scene`.

The elements of the file become rows of tables, one table for each dataclass; the numbers in the
tables are validated at the end, in arrays.  Each error is reported in a line of its own, as
``FILE:LINE: element: what is wrong; suggested fix``.  Reading ends early if the file stops being
XML, exceeds a limit, or has `MAX_ERRORS`.
"""

from __future__ import annotations

import os
import re
from array import array
from collections.abc import Collection, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import IO, Any, cast
from unicodedata import normalize

import numpy as np

from tracer.messages import printable, quoted, shortened
from tracer.scene import model
from tracer.scene.elements import Element, FatalError, Parser, open_scene
from tracer.scene.hints import closest_name, name_remedy, number_remedy, tag_remedy
from tracer.scene.model import Scene, Surfaces
from tracer.scene.schema import SceneError
from tracer.scene.tables import Table, parse_numbers

MAX_ERRORS = 1_000
"""Maximum number of errors in a file; the reader reports no more."""

# Maximum number of undefined shaders for which a similar name is searched: milliseconds for each.
_MAX_SEARCHES = 32

# Maximum number of words that are checked one by one in an element with a wrong number of words.
_MAX_CHECKED_WORDS = 64

_SCENE_TAGS = "camera", "image", "light", "shader", "surface"


class SceneFileError(SceneError):
    """A scene file with errors; the message has a line for each error, in the file's order.

    The lines are ``FILE:LINE: element: what is wrong; suggested fix``, or ``FILE: ...`` for errors
    without a line number.
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
    scene : Scene

    Raises
    ------
    SceneFileError
        If the file cannot be read or contains an error; the message has a line for each error.
    """
    reader, given = _Reader(), cast(Any, source)
    is_stream = hasattr(given, "read")
    name = getattr(given, "name", None) if is_stream else os.fsdecode(given)
    if not isinstance(name, str):
        name = "<stream>"
    try:
        with nullcontext(given) if is_stream else open_scene(name) as file:
            reader.read(file)
    except FatalError as error:
        reader.errors.append(error.args)
    except OSError as error:
        reason = error.strerror or str(error)
        reader.errors.append((0, f"cannot be read: {reason}; check the path and its permissions"))
    if not reader.errors:
        return reader.scene()
    # Text from the file must not break a message into lines, or reach the terminal as controls.
    raise SceneFileError(
        printable(f"{name or repr(name)}{f':{line}' if line else ''}: {message}")
        for line, message in sorted(reader.errors, key=lambda error: error[0])
    )


class _Reader:
    """Collects the elements of a file in tables, and computes the scene from them.

    Attributes
    ----------
    errors : list of tuple
        Line and message of each error so far.
    unique : dict of Element
        The root, the camera and the image, by their tags.
    misspelt : set of (str or None)
        Tags that unknown children of the scene probably stand for.  They do not count as missing.
    empty : Scene
        A scene of the right size, without content.
    cameras, lights : Table
    shaders, surfaces : dict of Table
        Tables by the value of the attribute `type`.
    surface_count : int
        Number of surfaces so far, in all tables.
    shader_indices : dict of int
        Indices of the shaders that have names.  A shader gets its index when the name first occurs,
        in a reference or in a definition.
    definition_lines : array of int
        For each shader, the line that defines it; 0 if no definition has been read yet.  Shader 0
        is the default, white.
    reference_lines, reference_shaders : array of int
        For each reference to a shader that was undefined at the time, its line and the shader.
    """

    def __init__(self) -> None:
        self.errors: list[tuple[int, str]] = []
        self.unique: dict[str, Element] = {}
        self.misspelt: set[str | None] = set()
        self.empty = Scene(width=1, height=1)
        self.cameras, self.lights = Table(model.Camera), Table(model.PointLight)
        self.shaders = {made.__name__: Table(made) for made in (model.Lambertian, model.Phong)}
        self.surfaces = {made.__name__: Table(made) for made in (model.Sphere, model.Box)}
        self.surface_count = 0
        self.shader_indices: dict[str, int] = {}
        self.definition_lines = array("i", [1])
        self.reference_lines, self.reference_shaders = array("i"), array("i")

    def report_at(self, line: int, tag: str, message: str) -> None:
        """Report an error in an element with this tag; raise `FatalError` for one too many."""
        if len(self.errors) == MAX_ERRORS:
            last = max(line for line, _ in self.errors)
            raise FatalError(last, f"{MAX_ERRORS} errors so far; fix these first")
        self.errors.append((line, f"{shortened(tag)}: {message}"))

    def report(self, element: Element, message: str) -> None:
        """Report an error in an element."""
        self.report_at(element.line, element.tag, message)

    def read(self, file: IO[bytes]) -> None:
        """Read a file, and report its errors up to the place where it stops being XML."""
        try:
            Parser(self.read_child, self.report_at).parse(file)
        finally:
            typed = (*self.shaders.values(), *self.surfaces.values())
            for table in (self.cameras, self.lights, *typed):
                for error in table.errors():
                    self.report_at(*error)
        self.report_missing()
        self.report_undefined_shaders()

    def read_child(self, element: Element) -> None:
        """Read the root, or a child of the root."""
        tag = element.tag
        if tag == "surface" and self.unique:
            self.read_surface(element)
        elif not self.unique:
            self.read_root(element)
        elif tag == "shader":
            self.read_shader(element)
            if "name" not in element.attrib and closest_name("name", element.attrib) is None:
                self.report(element, 'has no name; add one, as in name="white"')
        elif tag == "light":
            self.read_row(self.lights, element)
        elif tag in ("camera", "image"):
            if self.unique.setdefault(tag, element) is not element:
                self.report_duplicate(element, self.unique[tag])
            self.read_row(self.cameras, element) if tag == "camera" else self.read_image(element)
        else:
            remedy, intended = tag_remedy(tag, _SCENE_TAGS)
            self.report(element, f"unknown in scene; {remedy}")
            self.misspelt.add(intended)

    def read_root(self, element: Element) -> None:
        """Read the root; raise `FatalError` if it is not that of a scene file."""
        if element.tag != "scene":
            raise FatalError(element.line, f"{shortened(element.tag)}: the root must be <scene>")
        if "version" in element.attrib:
            message = "scene: has a version, so it is Mitsuba's; name the scene it was made from"
            raise FatalError(element.line, message)
        self.report_attributes(element)
        self.unique["scene"] = element

    def read_image(self, element: Element) -> None:
        """Read the size of the picture."""
        self.report_parts(element)
        word = r"\s*([-+]?\d{1,18})"
        match = re.fullmatch(rf"{word}\s{word}\s*", element.text, re.ASCII)
        if match is None:
            text = element.text.strip()
            needed = "needs two whole numbers, width and height, as in 640 480"
            message = f"{needed}; has {quoted(text)}" if text.isascii() else number_remedy(text)
            self.report(element, message)
            return
        try:
            self.empty = Scene(width=int(match[1]), height=int(match[2]))
        except SceneError as error:
            for line in error.lines:
                self.report(element, line)

    def read_surface(self, element: Element) -> None:
        """Read a surface as a row of the table of its type."""
        table = self.surfaces.get(element.attrib.get("type", ""))
        if table is None:
            # The children of an unknown surface are unknown, too, but they may define shaders.
            self.report_type(element, self.surfaces)
            for child in element:
                if child.tag == "shader":
                    self.read_shader_or_reference(child)
            return
        table.index.append(self.surface_count)
        self.surface_count += 1
        shader = self.read_row(table, element, "type").get("shader")
        index = 0 if shader is None else self.read_shader_or_reference(shader)
        table.shader_index.append(index)
        if shader is not None and not self.definition_lines[index]:
            self.reference_lines.append(shader.line)
            self.reference_shaders.append(index)

    def read_shader(self, element: Element) -> int:
        """Read a shader as a row of the table of its type; return the shader's index."""
        table = self.shaders.get(element.attrib.get("type", ""))
        name = element.attrib.get("name")
        index = self.shader_index(name)
        if name is not None and self.definition_lines[index]:
            earlier = f"the shader in line {self.definition_lines[index]}"
            self.report(element, f"the name {quoted(name)} is taken by {earlier}; choose another")
        else:
            self.definition_lines[index] = element.line
        if table is None:
            self.report_type(element, self.shaders, "name")
        else:
            table.index.append(index)
            self.read_row(table, element, "name", "type")
        return index

    def read_shader_or_reference(self, element: Element) -> int:
        """Read a surface's shader, or a reference to a shader; return the shader's index."""
        name = element.attrib.get("ref")
        if name is not None:
            if len(element.attrib) > 1 or element:
                self.report_parts(element, "ref")
        elif "name" in element.attrib and "type" not in element.attrib and not element:
            name = element.attrib["name"]
            remedy = f'to refer to a shader, write ref="{shortened(name)}"'
            self.report(element, f"has a name, but no type; {remedy}")
        else:
            return self.read_shader(element)
        return self.shader_index(name)

    def shader_index(self, name: str | None) -> int:
        """Return the index of the shader with this name; a new index if it has none yet."""
        new = len(self.definition_lines)
        index = new if name is None else self.shader_indices.setdefault(name, new)
        if index == new:
            self.definition_lines.append(0)
        return index

    def read_row(self, table: Table, element: Element, *attributes: str) -> dict[str, Element]:
        """Read an element as a row of a table, and report what is wrong with it.

        Parameters
        ----------
        table : Table
            The table, which gets a new row.
        element : Element
        *attributes : str
            Names of the attributes that the element may have.

        Returns
        -------
        children : dict of Element
            Children of the element by the names of their fields.
        """
        misspelt: set[str | None] = set()
        if not all(map(attributes.__contains__, element.attrib)):
            misspelt = self.report_attributes(element, attributes, table.field_of_tag)
        children: dict[str, Element] = {}
        for child in element:
            name = table.field_of_tag.get(child.tag)
            if name is None:
                misspelt.add(self.report_unknown(child, element, table.field_of_tag))
            elif name in children:
                self.report_duplicate(child, children[name])
            else:
                children[name] = child
        table.lines.append(element.line)
        for name, column in table.columns.items():
            given = children.get(name)
            if given is not None:
                column.append(self.read_numbers(given, column.count), given.line, given.tag)
                continue
            column.append_default()
            if column.is_required and (tag := column.tags[0]) not in misspelt:
                self.report(element, f"has no {tag}; add <{tag}>x y z</{tag}>")
        return children

    def read_numbers(self, element: Element, count: int) -> Sequence[float]:
        """Return the numbers that an element contains; after an error, `count` times NaN."""
        if element or element.attrib:
            self.report_parts(element)
        numbers = parse_numbers(element.text, count)
        if numbers:
            return numbers
        words = re.findall("[^ \t\r\n]+", element.text)  # str.split() knows more white space
        wrong = [word for word in words[:_MAX_CHECKED_WORDS] if not parse_numbers(word, 1)]
        for word in wrong:
            self.report(element, number_remedy(word))
        if not wrong and not element:
            self.report(element, f"needs {count} number{'s' * (count > 1)}, has {len(words)}")
        return (np.nan,) * count

    # Errors in elements and attributes

    def report_type(self, element: Element, tables: Mapping[str, Table], *attributes: str) -> None:
        """Report that the `type` of a shader or surface is missing or unknown.

        Parameters
        ----------
        element : Element
            The shader or surface.
        tables : mapping of Table
            Tables by the types that the element may have.
        *attributes : str
            Names of the attributes that the element may have besides `type`.
        """
        misspelt = self.report_attributes(element, (*attributes, "type"))
        name = element.attrib.get("type")
        if name is not None:
            remedy = name_remedy(tables, closest_name(name, tables))
            self.report(element, f"unknown type {quoted(name)}; {remedy}")
        elif "type" not in misspelt:
            choice = " or ".join(f'type="{name}"' for name in tables)
            self.report(element, f"has no type; add {choice}")

    def report_unknown(
        self, element: Element, parent: Element, tags: Collection[str]
    ) -> str | None:
        """Report an unknown child of `parent`.

        Returns
        -------
        intended : str or None
            Which of the known `tags` the child probably stands for, if that is clear.
        """
        if element.tag in _SCENE_TAGS:
            remedy, intended = f"close the {parent.tag} of line {parent.line} first", None
        else:
            remedy, intended = tag_remedy(element.tag, tags)
        place = shortened(parent.attrib.get("type", parent.tag))
        self.report(element, f"unknown in {place}; {remedy}")
        return intended

    def report_duplicate(self, element: Element, earlier: Element) -> None:
        """Report that an element repeats an earlier one, which may have another tag."""
        given = "given" if earlier.tag == element.tag else f"{earlier.tag} is given"
        self.report(element, f"{given} already, in line {earlier.line}; keep one of the two")

    def report_attributes(
        self, element: Element, known: Sequence[str] = (), child_tags: Collection[str] = ()
    ) -> set[str | None]:
        """Report all attributes of an element that are unknown.

        Parameters
        ----------
        element : Element
        known : sequence of str
            Names of the attributes that it may have.
        child_tags : collection of str
            Tags of the children that it may have, which may be given as attributes by mistake.

        Returns
        -------
        intended : set of (str or None)
            Names in `known` and `child_tags` that the unknown attributes probably stand for.
        """
        intended: set[str | None] = set()
        for name, value in element.attrib.items():
            if name in known:
                continue
            match = closest_name(name, known)
            remedy = name_remedy(known, match)
            if child_tags:
                element_remedy, match = tag_remedy(name, child_tags)
                if match == "shader":
                    remedy = f'write <shader ref="{shortened(value)}"/> in it'
                elif match in child_tags:
                    remedy = f"write <{match}>{shortened(value)}</{match}> in it"
                elif match is not None:
                    remedy = element_remedy
            intended.add(match)
            self.report(element, f"unknown attribute {quoted(name)}; {remedy}")
        return intended

    def report_parts(self, element: Element, *known: str) -> None:
        """Report all attributes of an element but those `known`, and all its children."""
        self.report_attributes(element, known)
        for child in element:
            message = f"no element may stand in it; remove <{shortened(child.tag)}>"
            self.report_at(child.line, element.tag, message)

    # From tables to a scene

    def report_missing(self) -> None:
        """Report that the file has no camera or no image."""
        for tag in ("camera", "image"):
            if tag not in self.unique and tag not in self.misspelt:
                self.report(self.unique["scene"], f"has no {tag}; add <{tag}> ... </{tag}>")

    def report_undefined_shaders(self) -> None:
        """Report each reference to a shader that the file does not define."""
        lines = self.definition_lines
        undefined = {k: name for name, k in self.shader_indices.items() if not lines[k]}
        if not undefined:
            return
        defined = {name: lines[k] for name, k in self.shader_indices.items() if lines[k]}
        twins = {normalize("NFC", name): name for name in defined}
        remedies: dict[int, str] = {}
        for line, k in zip(self.reference_lines, self.reference_shaders, strict=True):
            name = undefined.get(k)
            if name is None:
                continue
            if k not in remedies:
                match = closest_name(name, defined) if len(remedies) < _MAX_SEARCHES else None
                remedies[k] = name_remedy(defined, match) if defined else "define it"
                if twin := twins.get(normalize("NFC", name)):
                    remedies[k] = (
                        f"the name in line {defined[twin]} looks the same, but has other Unicode"
                        " characters (one is composed, one decomposed); copy it from there"
                    )
            self.report_at(line, "shader", f"no shader is named {quoted(name)}; {remedies[k]}")

    def scene(self) -> Scene:
        """Return the scene of a file without errors."""
        shaders: list[model.Shader] = [model.Lambertian()] * len(self.definition_lines)
        for table in self.shaders.values():
            for index, shader in zip(table.index, table.objects(), strict=True):
                shaders[index] = shader
        tables = self.surfaces.values()
        columns = {name: c.array() for table in tables for name, c in table.columns.items()}
        surfaces = Surfaces(
            **columns | {"radius": columns["radius"][:, 0]},
            shader_index=np.concatenate([table.shader_index for table in tables]),
            file_index=np.concatenate([table.index for table in tables]),
            shaders=tuple(shaders),
            line=np.concatenate([table.lines for table in tables]),
        )
        (camera,), lights = self.cameras.objects(), tuple(self.lights.objects())
        return replace(self.empty, camera=camera, lights=lights, surfaces=surfaces)
