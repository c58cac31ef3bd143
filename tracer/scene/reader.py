"""Read a scene file into a :class:`~tracer.scene.model.Scene`.

The elements of the file become rows of tables, one table for each dataclass.  The numbers in the
tables are validated at the end, in arrays.  Errors are collected, so that one message reports all
of them.  Reading ends early at a syntax error, at a limit, or after `MAX_ERRORS` errors.
"""

from __future__ import annotations

import os
import re
from array import array
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import replace
from itertools import count
from typing import IO, Any, cast
from unicodedata import normalize

import numpy as np

from tracer.messages import make_printable, quote, shorten
from tracer.scene import model
from tracer.scene.elements import Element, FatalError, FileOrPath, Parser, open_scene
from tracer.scene.errors import MAX_ERRORS, SCENE_TAGS, ErrorCollector
from tracer.scene.hints import (
    explain_invalid_number,
    explain_invalid_numbers,
    suggest_name,
)
from tracer.scene.model import Scene, Surfaces
from tracer.scene.schema import NumberValidator, SceneError
from tracer.scene.tables import ShaderTable, SurfaceTable, Table, parse_numbers

# Maximum number of undefined shaders for which a similar name is searched for.  A search takes
# milliseconds.
_MAX_SEARCHES = 32

# In an element with invalid numbers, at most this many words are checked one by one.
_MAX_CHECKED_WORDS = 64

# Matches a width and a height, with few enough digits for int().
_match_size = re.compile(r"\s*([-+]?\d{1,18})\s+([-+]?\d{1,18})\s*", re.ASCII).fullmatch

_LOOKALIKE_REMEDY = (
    "the name on line {} looks the same, but has other Unicode characters (one is composed, one"
    " decomposed); copy it from there"
)


class SceneFileError(SceneError):
    """Raised if a scene file is invalid or cannot be read.

    The message has one line per error, in the order of the file: ``FILE:LINE: element: what is
    wrong; suggested fix``, or ``FILE: what is wrong; suggested fix`` for errors that concern the
    whole file.
    """


def load_scene(source: FileOrPath) -> Scene:
    """Read a scene from a file.

    Parameters
    ----------
    source : str, bytes, path-like or binary file object
        Path of a scene file, or a scene file that is open for reading.  The file may contain
        at most 256 MiB of XML, in the format described in the README.

    Returns
    -------
    scene : Scene
        The surfaces, lights, camera and picture size defined in the file.

    Raises
    ------
    SceneFileError
        If the file cannot be read, or contains errors.  The message has one line per error.
    TypeError
        If `source` is neither a path nor a binary file.
    """
    reader = _Reader()
    source_object = cast(Any, source)
    is_stream = hasattr(source_object, "read")
    file_name = getattr(source_object, "name", None) if is_stream else os.fsdecode(source_object)
    if not isinstance(file_name, str):
        file_name = "<stream>"
    try:
        with nullcontext(source_object) if is_stream else open_scene(file_name) as file:
            reader.read(file)
    except FatalError as error:
        reader.errors.append((error.line, error.message))
    except OSError as error:
        reader.errors.append((0, _explain_unreadable_file(error, file_name)))
    if not reader.errors:
        return reader.make_scene()
    # `make_printable` escapes line breaks and control characters, which may come from the file.
    raise SceneFileError(
        make_printable(f"{file_name or repr(file_name)}{f':{line}' if line else ''}: {message}")
        for line, message in sorted(reader.errors, key=lambda error: error[0])
    )


def _explain_unreadable_file(error: OSError, path: str) -> str:
    """Return an error message, with a suggested fix, for a file that cannot be read."""
    remedy = "check the path and its permissions"
    if isinstance(error, FileNotFoundError) and os.path.isfile(f"{path}.xml"):
        remedy = f"did you mean {path}.xml?"
    return f"cannot be read: {error.strerror or str(error)}; {remedy}"


class _Reader(ErrorCollector):
    """A reader of one scene file.

    `read` collects the elements of the file in tables, and all errors in `errors`.  If there are no
    errors, `make_scene` then creates the scene.
    """

    # The root, the first <camera> and the first <image>, as far as they have been read, by their
    # tags.
    unique_elements: dict[str, Element]
    # Tags of the root's children that were probably meant by unknown tags, and None if the meaning
    # of one is unclear.  Elements with these tags are not reported as missing.
    intended_tags: set[str | None]
    empty_scene: Scene  # a scene without contents that has the size of the picture
    cameras: Table  # one row in a valid file
    lights: Table
    # Tables by the value of the attribute `type`, such as "Sphere".
    shader_tables: dict[str, ShaderTable]
    surface_tables: dict[str, SurfaceTable]
    surface_counter: Iterator[int]  # yields the index of the next surface
    shaders: _ShaderIndices

    def __init__(self) -> None:
        super().__init__()
        self.unique_elements = {}
        self.intended_tags = set()
        self.empty_scene = Scene(width=1, height=1)
        self.cameras = Table(model.Camera)
        self.lights = Table(model.PointLight)
        shader_classes = model.Lambertian, model.Phong
        self.shader_tables = {cls.__name__: ShaderTable(cls) for cls in shader_classes}
        self.surface_tables = {cls.__name__: SurfaceTable(cls) for cls in (model.Sphere, model.Box)}
        self.surface_counter = count()
        self.shaders = _ShaderIndices()

    def read(self, file: IO[bytes]) -> None:
        """Read a whole scene file into the tables, and add the errors that it contains to `errors`.

        Raise FatalError if the rest of the file cannot be read; `errors` then contains the errors
        before this place.
        """
        try:
            Parser(self.read_element, self.report_at).parse(file)
        finally:
            # After too many errors, the numbers are not checked: the last row may be incomplete.
            if len(self.errors) < MAX_ERRORS:
                self.report_invalid_numbers()
        self.report_missing_elements()
        self.report_undefined_shaders()

    def read_element(self, element: Element) -> None:
        """Read an element that `Parser` passes on: the root alone, or a child of the root.

        A camera, a light, a shader or a surface becomes a row of a table.  Raise FatalError if the
        root is not the root of a scene file.
        """
        tag = element.tag
        if tag == "surface" and self.unique_elements:
            self.read_surface(element)
        elif not self.unique_elements:  # the root has not been read yet
            self.read_root(element)
        elif tag == "shader":
            self.read_shader(element)
            if "name" not in element.attrib and not suggest_name("name", element.attrib).name:
                self.report(element, 'has no name; add one, as in name="white"')
        elif tag == "light":
            self.add_row(self.lights, element)
        elif tag == "camera":
            self.check_uniqueness(element)
            self.add_row(self.cameras, element)
        elif tag == "image":
            self.check_uniqueness(element)
            self.read_image(element)
        else:
            root = self.unique_elements["scene"]
            self.intended_tags.add(self.report_unknown_element(element, root, SCENE_TAGS))

    def read_root(self, element: Element) -> None:
        """Check and store the root; raise FatalError if it is not the root of a scene file."""
        if element.tag != "scene":
            raise FatalError(element.line, f"{shorten(element.tag)}: the root must be <scene>")
        if "version" in element.attrib:
            message = "scene: has a version, so this is a Mitsuba file; use the original scene"
            raise FatalError(element.line, message)
        self.report_unknown_attributes(element)
        self.unique_elements["scene"] = element

    def check_uniqueness(self, element: Element) -> None:
        """Report an error if the file contains an earlier element with this element's tag."""
        original = self.unique_elements.setdefault(element.tag, element)
        if original is not element:
            self.report_duplicate(element, original)

    def read_image(self, element: Element) -> None:
        """Read the size of the picture from <image>, and store it in `empty_scene`."""
        self.match_children(element, {})
        match = _match_size(element.text)
        if match is None:
            text = element.text.strip()
            message = f"needs two whole numbers, width and height, as in 640 480; has {quote(text)}"
            self.report(element, message if text.isascii() else explain_invalid_number(text))
            return
        try:
            self.empty_scene = Scene(width=int(match[1]), height=int(match[2]))
        except SceneError as error:
            for message in error.lines:
                self.report(element, message)

    def read_surface(self, element: Element) -> None:
        """Add a <surface> to the table for its type.

        The surface may contain a shader, or a reference to a shader that is defined later.
        """
        table = self.surface_tables.get(element.attrib.get("type", ""))
        if table is None:
            # The children are not checked, but shaders among them are still defined.
            self.report_invalid_type(element, self.surface_tables)
            for child in element:
                if child.tag == "shader":
                    self.read_shader_or_reference(child)
            return
        shader = self.add_row(table, element, "type").get("shader")
        if shader is None:
            table.append_indices(next(self.surface_counter), 0, 0)
        else:
            shader_index = self.read_shader_or_reference(shader)
            table.append_indices(next(self.surface_counter), shader_index, shader.line)

    def read_shader(self, element: Element) -> int:
        """Add the definition of a shader to the table for its type, and return its shader index.

        Report an error if the type is unknown, or an earlier shader has its name.
        """
        table = self.shader_tables.get(element.attrib.get("type", ""))
        name = element.attrib.get("name")
        index = self.shaders.find_or_add(name)
        definition_lines = self.shaders.definition_lines
        if name is not None and definition_lines[index]:
            owner = f"the shader on line {definition_lines[index]}"
            self.report(element, f"the name {quote(name)} is taken by {owner}; choose another")
        else:
            definition_lines[index] = element.line
        if table is None:
            self.report_invalid_type(element, self.shader_tables, "name")
        else:
            self.add_row(table, element, "name", "type")
            table.append_index(index)
        return index

    def read_shader_or_reference(self, element: Element) -> int:
        """Read the <shader> inside a surface, and return its shader index.

        The element is a definition, or a reference to the shader whose name is in the attribute
        `ref`.
        """
        name = element.attrib.get("ref")
        if name is not None:
            if len(element.attrib) > 1 or element:
                self.match_children(element, {}, "ref")
        elif "name" in element.attrib and "type" not in element.attrib and not element:
            name = element.attrib["name"]
            remedy = f'to refer to a shader, write ref="{shorten(name)}"'
            self.report(element, f"has a name, but no type; {remedy}")
        else:
            return self.read_shader(element)
        return self.shaders.find_or_add(name)

    def add_row(self, table: Table, element: Element, *attributes: str) -> dict[str, Element]:
        """Read a camera, a light, a shader or a surface into a new row of a table.

        `attributes` are the names of the attributes that the element may have.  Return a dict that
        maps each field that a child of the element defines to this child.
        """
        children, intended_names = self.match_children(element, table.field_of_tag, *attributes)
        table.begin_row(element.line)
        for field_name, column in table.columns.items():
            child = children.get(field_name)
            if child is not None:
                column.append(self.read_numbers(child, column.validator), child.line, child.tag)
                continue
            column.append_default()
            tag = column.tags[0]
            if column.is_required and tag not in intended_names:
                self.report(element, f"has no {tag}; add <{tag}>x y z</{tag}>")
        return children

    def match_children(
        self, element: Element, field_of_tag: Mapping[str, str], *attributes: str
    ) -> tuple[dict[str, Element], set[str | None]]:
        """Find which field of a dataclass each child of an element defines.

        Report unknown attributes, unknown children, and children that define the same field.

        Parameters
        ----------
        field_of_tag
            Maps the tag of a child to the name of the field that it defines.
        attributes
            The names of the attributes that the element may have.

        Returns
        -------
        children
            Maps the name of each field to the child that defines it.
        intended_names
            The names that were probably meant by unknown attributes and tags.  It contains None if
            the meaning of one is unclear.
        """
        intended_names: set[str | None] = set()
        if not all(map(attributes.__contains__, element.attrib)):
            intended_names = self.report_unknown_attributes(element, attributes, field_of_tag)
        children: dict[str, Element] = {}
        for child in element:
            field_name = field_of_tag.get(child.tag)
            if field_name is None:
                intended_names.add(self.report_unknown_element(child, element, field_of_tag))
            elif field_name in children:
                self.report_duplicate(child, children[field_name])
            else:
                children[field_name] = child
        return children, intended_names

    def read_numbers(self, element: Element, validator: NumberValidator) -> list[float]:
        """Read as many numbers as the validator needs from an element such as <center>.

        Report an error if a word is not a number, or the count is wrong; then return NaN for each
        number.  The validator's rules are checked later, by `report_invalid_numbers`.
        """
        if element or element.attrib:  # children and attributes are errors here
            self.match_children(element, {})
        numbers = parse_numbers(element.text, validator.number_count)
        if numbers:
            return numbers
        words = re.findall("[^ \t\r\n]+", element.text)  # str.split() accepts more white space
        invalid_words = [word for word in words[:_MAX_CHECKED_WORDS] if not parse_numbers(word, 1)]
        for message in explain_invalid_numbers(invalid_words):
            self.report(element, message)
        if not invalid_words and not element:
            self.report(element, f"{validator.requirement}, but has {len(words)}")
        return [np.nan] * validator.number_count

    # Called when no more elements are read

    def report_invalid_numbers(self) -> None:
        """Report invalid and contradictory numbers in all tables."""
        tables = self.cameras, self.lights, *(self.shader_tables | self.surface_tables).values()
        for table in tables:
            for line, tag, message in table.locate_errors():
                self.report_at(line, tag, message)

    def report_missing_elements(self) -> None:
        """Report a missing camera or image, unless its tag was probably misspelt."""
        for tag in ("camera", "image"):
            if tag not in self.unique_elements and tag not in self.intended_tags:
                message = f"has no {tag}; add <{tag}> ... </{tag}>"
                self.report(self.unique_elements["scene"], message)

    def report_undefined_shaders(self) -> None:
        """Report each reference to a shader that is defined nowhere in the file."""
        message_of_index = self.shaders.explain_undefined()
        if not message_of_index:
            return
        for table in self.surface_tables.values():
            for reference_line, index in zip(table.shader_lines, table.shader_indices, strict=True):
                if index in message_of_index:
                    self.report_at(reference_line, "shader", message_of_index[index])

    def make_scene(self) -> Scene:
        """Create the scene from the tables.  The whole file must have been read without errors."""
        shaders: list[model.Shader] = [model.Lambertian()] * len(self.shaders.definition_lines)
        for table in self.shader_tables.values():
            for index, shader in zip(table.indices, table.make_objects(), strict=True):
                shaders[index] = shader
        tables = self.surface_tables.values()
        surfaces = Surfaces.from_tables(
            {cast(model.Kind, table.dataclass): table.to_arrays() for table in tables},
            shader_index=np.concatenate([table.shader_indices for table in tables]),
            file_index=np.concatenate([table.indices for table in tables]),
            shaders=tuple(shaders),
            line=np.concatenate([table.lines for table in tables]),
        )
        (camera,) = self.cameras.make_objects()
        lights = tuple(self.lights.make_objects())
        return replace(self.empty_scene, camera=camera, lights=lights, surfaces=surfaces)


class _ShaderIndices:
    """The indices, names and lines of all shaders of a file.

    Shaders are numbered in the order in which the reader meets them: a named shader at its
    definition or at the first reference to it, whichever comes first.  Shader 0 is the default,
    white.
    """

    index_of_name: dict[str, int]
    # For each shader, the line of its definition, or 0 if that has not been read yet.  Shader 0
    # counts as defined on line 1.
    definition_lines: array[int]

    def __init__(self) -> None:
        self.index_of_name = {}
        self.definition_lines = array("i", [1])

    def find_or_add(self, name: str | None) -> int:
        """Return the index of the shader with this name.

        If the name has not occurred yet, or is None because the shader has no name, add a shader
        that is not defined yet.
        """
        new_index = len(self.definition_lines)
        index = new_index if name is None else self.index_of_name.setdefault(name, new_index)
        if index == new_index:
            self.definition_lines.append(0)
        return index

    def explain_undefined(self) -> dict[int, str]:
        """Return an error message, with a suggested fix, for each shader without a definition.

        The keys are the indices of these shaders.
        """
        if 0 not in self.definition_lines:
            return {}
        line_of_name = {
            name: self.definition_lines[index]
            for name, index in self.index_of_name.items()
            if self.definition_lines[index]
        }
        line_of_normal_form = {normalize("NFC", name): line for name, line in line_of_name.items()}
        message_of_index: dict[int, str] = {}
        for name, index in self.index_of_name.items():
            if name in line_of_name:
                continue
            remedy = "define it"
            lookalike_line = line_of_normal_form.get(normalize("NFC", name))
            if lookalike_line is not None:
                remedy = _LOOKALIKE_REMEDY.format(lookalike_line)
            elif line_of_name and len(message_of_index) < _MAX_SEARCHES:
                remedy = suggest_name(name, line_of_name).remedy
            message_of_index[index] = f"no shader is named {quote(name)}; {remedy}"
        return message_of_index
