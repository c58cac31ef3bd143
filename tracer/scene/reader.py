"""Read a scene file into a :class:`~tracer.scene.model.Scene`.

The elements of the file become rows of tables, one table for each dataclass.  The numbers in the
tables are validated at the end, in arrays.  Each error is reported in a separate line, as
``FILE:LINE: element: what is wrong; suggested fix``.  Reading ends early at a syntax error, at a
limit, or after `MAX_ERRORS` errors.
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
"""Maximum number of errors that are reported for a file."""

# Maximum number of undefined shaders for which a similar name is searched: milliseconds for each.
_MAX_SEARCHES = 32

# Maximum number of words that are checked one by one in an element with a wrong number of words.
_MAX_CHECKED_WORDS = 64

_SCENE_TAGS = "camera", "image", "light", "shader", "surface"


class SceneFileError(SceneError):
    """Raised if a scene file is invalid or cannot be read.

    The message has a line for each error in the file, in the order of the file:
    ``FILE:LINE: element: what is wrong; suggested fix``, or ``FILE: what is wrong; suggested fix``
    for errors without a line number.
    """


def load_scene(
    source: str | bytes | os.PathLike[str] | os.PathLike[bytes] | IO[bytes],
) -> Scene:
    """Read a scene file.

    Parameters
    ----------
    source : str, bytes, path-like or binary file object
        Path of the file, or an open file.  It contains XML of at most 256 MiB, in the format that
        the README describes.

    Returns
    -------
    scene : Scene
        The scene.

    Raises
    ------
    SceneFileError
        If the file cannot be read, or contains errors.  The message has a line for each error.
    TypeError
        If `source` is an open file, but not a binary one.
    """
    reader, source_object = _Reader(), cast(Any, source)
    is_stream = hasattr(source_object, "read")
    name = getattr(source_object, "name", None) if is_stream else os.fsdecode(source_object)
    if not isinstance(name, str):
        name = "<stream>"
    try:
        with nullcontext(source_object) if is_stream else open_scene(name) as file:
            reader.read(file)
    except FatalError as error:
        reader.errors.append(error.args)
    except OSError as error:
        reason = error.strerror or str(error)
        reader.errors.append((0, f"cannot be read: {reason}; check the path and its permissions"))
    if not reader.errors:
        return reader.make_scene()
    # Text from the file must not break a message into lines, or send control characters to the
    # terminal.
    raise SceneFileError(
        printable(f"{name or repr(name)}{f':{line}' if line else ''}: {message}")
        for line, message in sorted(reader.errors, key=lambda error: error[0])
    )


class _Reader:
    """A reader of one scene file: it collects XML elements in tables, and makes a scene of them.

    Attributes
    ----------
    errors : list of (int, str)
        Line and message of each error so far; line 0 if the error concerns the whole file.
    unique : dict of Element
        The elements that a file contains only once: the key is "scene" (the root), "camera" or
        "image".
    intended_tags : set of (str or None)
        Tags that were probably meant by unknown children of the scene.  An element with such a tag
        is not reported as missing.
    empty : Scene
        A scene with the size of the picture, but without content.
    cameras, lights : Table
        The cameras, of which a valid file has one, and the lights.
    shaders, surfaces : dict of Table
        The shaders and surfaces.  The key is the value of the attribute `type`, such as "Sphere".
    surface_count : int
        Number of surfaces so far, in all tables.
    shader_indices : dict of int
        For each name of a shader, the shader's index.  A shader gets its index when the name first
        occurs, in a reference or in a definition.
    definition_lines : array of int
        For each shader, the line that defines it; 0 if no definition has been read yet.  Shader 0
        is the default shader, white.
    reference_lines, reference_shaders : array of int
        For each reference to a shader that was not defined before it, the line of the reference and
        the index of the shader.
    """

    def __init__(self) -> None:
        self.errors: list[tuple[int, str]] = []
        self.unique: dict[str, Element] = {}
        self.intended_tags: set[str | None] = set()
        self.empty = Scene(width=1, height=1)
        self.cameras, self.lights = Table(model.Camera), Table(model.PointLight)
        self.shaders = {kind.__name__: Table(kind) for kind in (model.Lambertian, model.Phong)}
        self.surfaces = {kind.__name__: Table(kind) for kind in (model.Sphere, model.Box)}
        self.surface_count = 0
        self.shader_indices: dict[str, int] = {}
        self.definition_lines = array("i", [1])
        self.reference_lines, self.reference_shaders = array("i"), array("i")

    def report_at(self, line: int, tag: str, message: str) -> None:
        """Add an error to the list of errors.

        Parameters
        ----------
        line : int
            Line of the error in the file.
        tag : str
            Tag of the element that contains the error.
        message : str
            What is wrong, and a suggested fix.

        Raises
        ------
        FatalError
            If there are already `MAX_ERRORS` errors.
        """
        if len(self.errors) == MAX_ERRORS:
            last_line = max(line for line, _ in self.errors)
            raise FatalError(last_line, f"{MAX_ERRORS} errors so far; fix these first")
        self.errors.append((line, f"{shortened(tag)}: {message}"))

    def report(self, element: Element, message: str) -> None:
        """Add an error to the list of errors, at the line where an element begins.

        Parameters
        ----------
        element : Element
            The element that contains the error.
        message : str
            What is wrong, and a suggested fix.
        """
        self.report_at(element.line, element.tag, message)

    def read(self, file: IO[bytes]) -> None:
        """Read a scene file, fill the tables, and collect the errors.

        Parameters
        ----------
        file : binary file
            The scene file, open for reading.

        Raises
        ------
        FatalError
            If the file is not XML, exceeds a limit, or has more than `MAX_ERRORS` errors.  Errors
            that were found before are in `errors`.
        """
        try:
            Parser(self.read_child, self.report_at).parse(file)
        finally:
            typed_tables = (*self.shaders.values(), *self.surfaces.values())
            for table in (self.cameras, self.lights, *typed_tables):
                for error in table.find_errors():
                    self.report_at(*error)
        self.report_missing()
        self.report_undefined_shaders()

    def read_child(self, element: Element) -> None:
        """Check the root of the file, or add the content of a child of the root to the tables.

        Parameters
        ----------
        element : Element
            At the first call, the root without its children; at each later call, the next child of
            the root, with all its descendants.

        Raises
        ------
        FatalError
            If the root is not that of a scene file, or if there are too many errors.  Other errors
            are added to the list of errors.
        """
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
            self.intended_tags.add(intended)

    def read_root(self, element: Element) -> None:
        """Check that the root element is that of a scene file, and store it.

        Parameters
        ----------
        element : Element
            The root, without children.

        Raises
        ------
        FatalError
            If the tag is not "scene", or if there is an attribute `version`, as in Mitsuba files.
        """
        if element.tag != "scene":
            raise FatalError(element.line, f"{shortened(element.tag)}: the root must be <scene>")
        if "version" in element.attrib:
            message = "scene: has a version, so it is Mitsuba's; name the scene it was made from"
            raise FatalError(element.line, message)
        self.report_attributes(element)
        self.unique["scene"] = element

    def read_image(self, element: Element) -> None:
        """Read the size of the picture from the element <image>, and store it in `empty`.

        Errors are added to the list of errors, and then the size is not stored.
        """
        self.report_parts(element)
        number = r"\s*([-+]?\d{1,18})"
        match = re.fullmatch(rf"{number}\s{number}\s*", element.text, re.ASCII)
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
        """Add a surface to the table of its type, and its shader to the table of the shader's type.

        A reference to a shader that is not defined yet is stored, and checked at the end.  Errors
        are added to the list of errors.

        Parameters
        ----------
        element : Element
            The surface.
        """
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
        shader_index = 0 if shader is None else self.read_shader_or_reference(shader)
        table.shader_index.append(shader_index)
        if shader is not None and not self.definition_lines[shader_index]:
            self.reference_lines.append(shader.line)
            self.reference_shaders.append(shader_index)

    def read_shader(self, element: Element) -> int:
        """Add a shader to the table of its type, and report errors in its definition.

        Parameters
        ----------
        element : Element
            The definition of the shader.

        Returns
        -------
        index : int
            Index of the shader among all shaders.
        """
        table = self.shaders.get(element.attrib.get("type", ""))
        name = element.attrib.get("name")
        index = self.find_shader(name)
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
        """Read the element <shader> of a surface: a definition, or a reference by name.

        Parameters
        ----------
        element : Element
            The element.  It is a reference if it has the attribute `ref`.

        Returns
        -------
        index : int
            Index of the shader among all shaders.
        """
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
        return self.find_shader(name)

    def find_shader(self, name: str | None) -> int:
        """Return the index of the shader with the given name; reserve a new index if it has none.

        Parameters
        ----------
        name : str or None
            The name; None for a shader without a name, which always gets a new index.

        Returns
        -------
        index : int
            Index of the shader among all shaders.
        """
        new_index = len(self.definition_lines)
        index = new_index if name is None else self.shader_indices.setdefault(name, new_index)
        if index == new_index:
            self.definition_lines.append(0)
        return index

    def read_row(self, table: Table, element: Element, *attributes: str) -> dict[str, Element]:
        """Add a row with the numbers of an element to a table, and report errors in the element.

        Parameters
        ----------
        table : Table
            The table that gets the new row.
        element : Element
            A camera, light, shader or surface.
        *attributes : str
            Names of the attributes that are allowed in the element.

        Returns
        -------
        children : dict of Element
            The known children of the element.  The key is the name of the dataclass field that the
            child gives.
        """
        intended: set[str | None] = set()
        if not all(map(attributes.__contains__, element.attrib)):
            intended = self.report_attributes(element, attributes, table.field_of_tag)
        children: dict[str, Element] = {}
        for child in element:
            name = table.field_of_tag.get(child.tag)
            if name is None:
                intended.add(self.report_unknown(child, element, table.field_of_tag))
            elif name in children:
                self.report_duplicate(child, children[name])
            else:
                children[name] = child
        table.lines.append(element.line)
        for name, column in table.columns.items():
            source = children.get(name)
            if source is not None:
                column.append(self.read_numbers(source, column.count), source.line, source.tag)
                continue
            column.append_default()
            if column.is_required and (tag := column.tags[0]) not in intended:
                self.report(element, f"has no {tag}; add <{tag}>x y z</{tag}>")
        return children

    def read_numbers(self, element: Element, count: int) -> Sequence[float]:
        """Parse the numbers in an element such as <center>, and report errors in the element.

        Parameters
        ----------
        element : Element
            The element.
        count : int
            Required number of numbers.

        Returns
        -------
        numbers : sequence of float
            The numbers; after an error, NaN repeated `count` times.
        """
        if element or element.attrib:
            self.report_parts(element)
        numbers = parse_numbers(element.text, count)
        if numbers:
            return numbers
        words = re.findall("[^ \t\r\n]+", element.text)  # str.split() knows more white space
        invalid_words = [word for word in words[:_MAX_CHECKED_WORDS] if not parse_numbers(word, 1)]
        for word in invalid_words:
            self.report(element, number_remedy(word))
        if not invalid_words and not element:
            self.report(element, f"needs {count} number{'s' * (count > 1)}, has {len(words)}")
        return (np.nan,) * count

    # Errors in elements and attributes

    def report_type(self, element: Element, tables: Mapping[str, Table], *attributes: str) -> None:
        """Report that the attribute `type` of a shader or surface is missing or unknown.

        Unknown attributes of the element are reported, too.

        Parameters
        ----------
        element : Element
            The shader or surface.
        tables : mapping of Table
            The keys are the known types.
        *attributes : str
            Names of the attributes that are allowed in the element, in addition to `type`.
        """
        intended = self.report_attributes(element, (*attributes, "type"))
        unknown_type = element.attrib.get("type")
        if unknown_type is not None:
            remedy = name_remedy(tables, closest_name(unknown_type, tables))
            self.report(element, f"unknown type {quoted(unknown_type)}; {remedy}")
        elif "type" not in intended:
            choice = " or ".join(f'type="{known_type}"' for known_type in tables)
            self.report(element, f"has no type; add {choice}")

    def report_unknown(
        self, element: Element, parent: Element, tags: Collection[str]
    ) -> str | None:
        """Report a child element whose tag is unknown.

        Parameters
        ----------
        element : Element
            The child.
        parent : Element
            The element that contains the child.
        tags : collection of str
            Tags of the children that are allowed there.

        Returns
        -------
        intended : str or None
            The tag that was probably meant; None if this is unclear.
        """
        if element.tag in _SCENE_TAGS:
            remedy, intended = f"close the {parent.tag} of line {parent.line} first", None
        else:
            remedy, intended = tag_remedy(element.tag, tags)
        place = shortened(parent.attrib.get("type", parent.tag))
        self.report(element, f"unknown in {place}; {remedy}")
        return intended

    def report_duplicate(self, element: Element, earlier: Element) -> None:
        """Report that an element repeats what an earlier element has already given.

        Parameters
        ----------
        element : Element
            The later element.
        earlier : Element
            The earlier element.  Its tag can differ, because two tags have the same meaning.
        """
        given = "given" if earlier.tag == element.tag else f"{earlier.tag} is given"
        self.report(element, f"{given} already, in line {earlier.line}; keep one of the two")

    def report_attributes(
        self, element: Element, allowed: Sequence[str] = (), child_tags: Collection[str] = ()
    ) -> set[str | None]:
        """Report all unknown attributes of an element.

        Parameters
        ----------
        element : Element
            The element.
        allowed : sequence of str
            Names of the attributes that are allowed in the element.
        child_tags : collection of str
            Tags of the children that are allowed in the element.  An unknown attribute with a
            similar name is probably such a child, written as an attribute by mistake.

        Returns
        -------
        intended : set of (str or None)
            The attribute names or child tags that were probably meant by the unknown attributes;
            contains None if this is unclear for some of them.
        """
        intended: set[str | None] = set()
        for name, value in element.attrib.items():
            if name in allowed:
                continue
            meant = closest_name(name, allowed)
            remedy = name_remedy(allowed, meant)
            if child_tags:
                element_remedy, meant = tag_remedy(name, child_tags)
                if meant == "shader":
                    remedy = f'write <shader ref="{shortened(value)}"/> in it'
                elif meant in child_tags:
                    remedy = f"write <{meant}>{shortened(value)}</{meant}> in it"
                elif meant is not None:
                    remedy = element_remedy
            intended.add(meant)
            self.report(element, f"unknown attribute {quoted(name)}; {remedy}")
        return intended

    def report_parts(self, element: Element, *allowed: str) -> None:
        """Report all children and all unknown attributes of an element that must have no children.

        Parameters
        ----------
        element : Element
            The element.
        *allowed : str
            Names of the attributes that are allowed in the element.
        """
        self.report_attributes(element, allowed)
        for child in element:
            message = f"no element may stand in it; remove <{shortened(child.tag)}>"
            self.report_at(child.line, element.tag, message)

    # From tables to a scene

    def report_missing(self) -> None:
        """Report that the file has no camera or no image, unless one is probably misspelt."""
        for tag in ("camera", "image"):
            if tag not in self.unique and tag not in self.intended_tags:
                self.report(self.unique["scene"], f"has no {tag}; add <{tag}> ... </{tag}>")

    def report_undefined_shaders(self) -> None:
        """Report each reference to a shader that the file does not define, with a suggested fix."""
        # A shader is identified by its index k.
        lines = self.definition_lines
        undefined_name = {k: name for name, k in self.shader_indices.items() if not lines[k]}
        if not undefined_name:
            return
        line_of_name = {name: lines[k] for name, k in self.shader_indices.items() if lines[k]}
        name_of_normalized = {normalize("NFC", name): name for name in line_of_name}
        remedies: dict[int, str] = {}
        for line, k in zip(self.reference_lines, self.reference_shaders, strict=True):
            name = undefined_name.get(k)
            if name is None:
                continue
            if k not in remedies:
                match = closest_name(name, line_of_name) if len(remedies) < _MAX_SEARCHES else None
                remedies[k] = name_remedy(line_of_name, match) if line_of_name else "define it"
                if lookalike := name_of_normalized.get(normalize("NFC", name)):
                    remedies[k] = (
                        f"the name in line {line_of_name[lookalike]} looks the same, but has other"
                        " Unicode characters (one is composed, one decomposed); copy it from there"
                    )
            self.report_at(line, "shader", f"no shader is named {quoted(name)}; {remedies[k]}")

    def make_scene(self) -> Scene:
        """Create the scene from the tables.  Call this only after `read` has found no errors."""
        shaders: list[model.Shader] = [model.Lambertian()] * len(self.definition_lines)
        for table in self.shaders.values():
            for index, shader in zip(table.index, table.objects(), strict=True):
                shaders[index] = shader
        tables = self.surfaces.values()
        columns = [item for table in tables for item in table.columns.items()]
        numbers = {name: column.array() for name, column in columns}
        surfaces = Surfaces(
            **numbers | {"radius": numbers["radius"][:, 0]},
            shader_index=np.concatenate([table.shader_index for table in tables]),
            file_index=np.concatenate([table.index for table in tables]),
            shaders=tuple(shaders),
            line=np.concatenate([table.lines for table in tables]),
        )
        (camera,), lights = self.cameras.objects(), tuple(self.lights.objects())
        return replace(self.empty, camera=camera, lights=lights, surfaces=surfaces)
