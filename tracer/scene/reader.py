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
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import MISSING, replace
from itertools import count
from typing import IO, Any, cast
from unicodedata import normalize

import numpy as np

from tracer.messages import make_printable, quote, shorten
from tracer.scene import model
from tracer.scene.elements import Element, FatalError, FileOrPath, Parser, open_scene
from tracer.scene.hints import explain_invalid_number, suggest_name, suggest_tag
from tracer.scene.model import Scene, Surfaces
from tracer.scene.schema import NumberValidator, SceneError
from tracer.scene.tables import Table, parse_numbers

MAX_ERRORS = 1_000
"""Maximum number of errors that are reported for a file."""

# Maximum number of undefined shaders for which similar names are searched: milliseconds for each.
_MAX_SEARCHES = 32

# Maximum number of words that are checked one by one in an element with invalid numbers.
_MAX_CHECKED_WORDS = 64

_LOOKALIKE_REMEDY = (
    "the name on line {} looks the same, but has other Unicode characters (one is composed, one"
    " decomposed); copy it from there"
)

_SCENE_TAGS = "camera", "image", "light", "shader", "surface"


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
    reader, source_object = _Reader(), cast(Any, source)
    is_stream = hasattr(source_object, "read")
    file_name = getattr(source_object, "name", None) if is_stream else os.fsdecode(source_object)
    if not isinstance(file_name, str):
        file_name = "<stream>"
    try:
        with nullcontext(source_object) if is_stream else open_scene(file_name) as file:
            reader.read(file)
    except FatalError as error:
        reader.errors.append(error.args)
    except OSError as error:
        reason = error.strerror or str(error)
        reader.errors.append((0, f"cannot be read: {reason}; check the path and its permissions"))
    if not reader.errors:
        return reader.make_scene()
    # `make_printable` escapes line breaks and control characters, which may come from the file.
    raise SceneFileError(
        make_printable(f"{file_name or repr(file_name)}{f':{line}' if line else ''}: {message}")
        for line, message in sorted(reader.errors, key=lambda error: error[0])
    )


class _Reader:
    """A reader of one scene file: it collects the elements in tables, then creates the scene.

    Attributes
    ----------
    errors : list of (int, str)
        Line and message of each error so far; line 0 if the error concerns the whole file.
    unique_elements : dict of str to Element
        The elements that occur only once in a file, by tag: "scene" (the root), "camera" and
        "image".
    intended_tags : set of (str or None)
        Tags that were probably meant by unknown tags.  An element with one of the intended tags is
        not reported as missing.
    empty_scene : Scene
        A scene without content, which stores the size of the picture.
    cameras, lights : Table
        The cameras (a valid file has exactly one) and the lights.
    shader_tables, surface_tables : dict of str to Table
        The shaders and surfaces, by the value of their attribute `type`, such as "Sphere".
    surface_counter : iterator of int
        Yields the index of the next surface in the file.
    index_of_name : dict of str to int
        The index of each named shader.  A shader gets its index at its first reference or at its
        definition, whichever comes first.
    definition_lines : array of int
        For each shader, the line that defines it, or 0 if its definition has not been read yet.
        Shader 0 is the default shader, white.
    """

    def __init__(self) -> None:
        self.errors: list[tuple[int, str]] = []
        self.unique_elements: dict[str, Element] = {}
        self.intended_tags: set[str | None] = set()
        self.empty_scene = Scene(width=1, height=1)
        self.cameras, self.lights = Table(model.Camera), Table(model.PointLight)
        self.shader_tables = {cls.__name__: Table(cls) for cls in (model.Lambertian, model.Phong)}
        self.surface_tables = {cls.__name__: Table(cls) for cls in (model.Sphere, model.Box)}
        self.surface_counter = count()
        self.index_of_name: dict[str, int] = {}
        self.definition_lines = array("i", [1])

    def report_at(self, line: int, tag: str, message: str) -> None:
        """Record an error at a line of the file.

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
        self.errors.append((line, f"{shorten(tag)}: {message}"))

    def report(self, element: Element, message: str) -> None:
        """Record an error at the line where an element begins.

        Parameters
        ----------
        element : Element
            The element that contains the error.
        message : str
            What is wrong, and a suggested fix.
        """
        self.report_at(element.line, element.tag, message)

    def read(self, file: IO[bytes]) -> None:
        """Read a scene file into the tables of cameras, lights, shaders and surfaces.

        Errors in the file are added to the list `errors`.

        Parameters
        ----------
        file : binary file
            The scene file, open for reading.

        Raises
        ------
        FatalError
            If the file is not well-formed XML, exceeds a limit, or has more than `MAX_ERRORS`
            errors.  Errors found earlier are in the list.
        """
        try:
            Parser(self.read_element, self.report_at).parse(file)
        finally:
            tables = self.cameras, self.lights, *(self.shader_tables | self.surface_tables).values()
            # After too many errors, the numbers are not checked: the last row may be incomplete.
            for table in tables if len(self.errors) < MAX_ERRORS else ():
                for error in table.find_errors():
                    self.report_at(*error)
        self.report_missing_elements()
        self.report_undefined_shaders()

    def read_element(self, element: Element) -> None:
        """Read the next part of the file: first the root element, then its children one by one.

        A valid child other than <image> becomes a row in a table.  Errors are added to `errors`.

        Parameters
        ----------
        element : Element
            The root without its children, or a child of the root with all its descendants.

        Raises
        ------
        FatalError
            If the root is not <scene>, or there are more than `MAX_ERRORS` errors.
        """
        tag = element.tag
        if tag == "surface" and self.unique_elements:
            self.read_surface(element)
        elif not self.unique_elements:  # the root has not been read yet
            self.read_root(element)
        elif tag == "shader":
            self.read_shader(element)
            if "name" not in element.attrib and not suggest_name("name", element.attrib)[1]:
                self.report(element, 'has no name; add one, as in name="white"')
        elif tag == "light":
            self.add_row(self.lights, element)
        elif tag in ("camera", "image"):
            if self.unique_elements.setdefault(tag, element) is not element:
                self.report_duplicate(element, self.unique_elements[tag])
            self.add_row(self.cameras, element) if tag == "camera" else self.read_image(element)
        else:
            root = self.unique_elements["scene"]
            self.intended_tags.add(self.report_unknown_element(element, root, _SCENE_TAGS))

    def read_root(self, element: Element) -> None:
        """Check and store the root element of the file.

        Parameters
        ----------
        element : Element
            The root element, whose children have not been read yet.

        Raises
        ------
        FatalError
            If the tag is not "scene", or there is an attribute `version`, as in Mitsuba's scene
            files.
        """
        if element.tag != "scene":
            raise FatalError(element.line, f"{shorten(element.tag)}: the root must be <scene>")
        if "version" in element.attrib:
            message = "scene: has a version, so this is a Mitsuba file; use the original scene"
            raise FatalError(element.line, message)
        self.report_unknown_attributes(element)
        self.unique_elements["scene"] = element

    def read_image(self, element: Element) -> None:
        """Read the picture size, and store it in `empty_scene`.

        Parameters
        ----------
        element : Element
            The <image> element.  Any errors in it are reported.
        """
        self.match_children(element, {})
        number_pattern = r"\s*([-+]?\d{1,18})"
        match = re.fullmatch(rf"{number_pattern}\s{number_pattern}\s*", element.text, re.ASCII)
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
        """Add a surface to the table for its type, such as "Sphere".

        The surface may contain a shader, or a reference to a shader, which may be defined later.

        Parameters
        ----------
        element : Element
            The surface.
        """
        table = self.surface_tables.get(element.attrib.get("type", ""))
        if table is None:
            # The children are not checked, but shaders among them are still defined.
            self.report_invalid_type(element, self.surface_tables)
            for child in element:
                if child.tag == "shader":
                    self.read_shader_or_reference(child)
            return
        table.object_indices.append(next(self.surface_counter))
        children = self.add_row(table, element, "type")
        shader = children.get("shader")
        table.shader_indices.append(0 if shader is None else self.read_shader_or_reference(shader))
        table.shader_lines.append(0 if shader is None else shader.line)

    def read_shader(self, element: Element) -> int:
        """Add a shader to the table for its type, and report any errors in it.

        Parameters
        ----------
        element : Element
            The <shader> element.

        Returns
        -------
        index : int
            Index of the shader in the list of all shaders.
        """
        table = self.shader_tables.get(element.attrib.get("type", ""))
        name = element.attrib.get("name")
        index = self.find_or_add_shader(name)
        if name is not None and self.definition_lines[index]:
            owner = f"the shader on line {self.definition_lines[index]}"
            self.report(element, f"the name {quote(name)} is taken by {owner}; choose another")
        else:
            self.definition_lines[index] = element.line
        if table is None:
            self.report_invalid_type(element, self.shader_tables, "name")
        else:
            table.object_indices.append(index)
            self.add_row(table, element, "name", "type")
        return index

    def read_shader_or_reference(self, element: Element) -> int:
        """Read the <shader> inside a surface: a definition, or a reference by name.

        Parameters
        ----------
        element : Element
            The <shader> element.  It is a reference if it has the attribute `ref`.

        Returns
        -------
        index : int
            Index of the shader in the list of all shaders.
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
        return self.find_or_add_shader(name)

    def find_or_add_shader(self, name: str | None) -> int:
        """Return the index of a shader; a new shader gets the next free index.

        Parameters
        ----------
        name : str or None
            Name of the shader.  A shader without a name (None) is always new.

        Returns
        -------
        index : int
            Index of the shader in the list of all shaders.
        """
        new_index = len(self.definition_lines)
        index = new_index if name is None else self.index_of_name.setdefault(name, new_index)
        if index == new_index:
            self.definition_lines.append(0)
        return index

    def add_row(self, table: Table, element: Element, *attributes: str) -> dict[str, Element]:
        """Read an element into a new row of a table, and report any errors in the element.

        Parameters
        ----------
        table : Table
            The table, whose dataclass defines which children the element may have.
        element : Element
            A camera, light, shader or surface.
        *attributes : str
            Names of the attributes that the element may have.

        Returns
        -------
        children : dict of str to Element
            For each field name, the child element that gives the field's value.
        """
        children, intended_names = self.match_children(element, table.field_of_tag, *attributes)
        table.lines.append(element.line)
        for field_name, column in table.columns.items():
            child = children.get(field_name)
            if child is not None:
                column.append(self.read_numbers(child, column.validator), child.line, child.tag)
                continue
            tag = column.tags[0]
            column.append(column.default_row, 0, tag)
            if column.default is MISSING and tag not in intended_names:
                self.report(element, f"has no {tag}; add <{tag}>x y z</{tag}>")
        return children

    def match_children(
        self, element: Element, field_of_tag: Mapping[str, str], *attributes: str
    ) -> tuple[dict[str, Element], set[str | None]]:
        """Match the children of an element to dataclass fields by tag.

        Unknown attributes, unknown children and duplicate children are reported as errors.

        Parameters
        ----------
        element : Element
            The element.
        field_of_tag : mapping of str to str
            For each tag that a child may have, the name of its dataclass field.
        *attributes : str
            Names of the attributes that the element may have.

        Returns
        -------
        children : dict of str to Element
            For each field name, the child element that gives the field's value.
        intended_names : set of (str or None)
            The names probably meant by unknown attributes and tags; None for one that is unclear.
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
        """Read the numbers in an element such as <center>, and report any errors in it.

        Parameters
        ----------
        element : Element
            The element.
        validator : NumberValidator
            Validator of the dataclass field.  Only the count of the numbers is checked here; their
            values are validated later.

        Returns
        -------
        numbers : list of float
            The numbers.  If one of them is invalid, or their count is wrong, all are NaN.
        """
        if element or element.attrib:  # children and attributes are errors here
            self.match_children(element, {})
        numbers = parse_numbers(element.text, validator.number_count)
        if numbers:
            return numbers
        words = re.findall("[^ \t\r\n]+", element.text)  # str.split() accepts more white space
        invalid_words = [word for word in words[:_MAX_CHECKED_WORDS] if not parse_numbers(word, 1)]
        explained_words = dict.fromkeys(invalid_words)
        # All commas are explained by the first word with one.
        for word in [word for word in explained_words if word.isascii() and "," in word][1:]:
            del explained_words[word]
        for word in explained_words:
            self.report(element, explain_invalid_number(word))
        if not invalid_words and not element:
            self.report(element, f"{validator.requirement}, but has {len(words)}")
        return [np.nan] * validator.number_count

    # Errors in elements and attributes

    def report_invalid_type(self, element: Element, types: Iterable[str], *attributes: str) -> None:
        """Report that the type of a shader or surface is missing or unknown.

        Unknown attributes are reported, too.

        Parameters
        ----------
        element : Element
            The shader or surface.
        types : iterable of str
            The allowed types.
        *attributes : str
            Names of the attributes that the element may have in addition to `type`.
        """
        intended_names = self.report_unknown_attributes(element, (*attributes, "type"))
        unknown_type = element.attrib.get("type")
        if unknown_type is not None:
            remedy, _ = suggest_name(unknown_type, types)
            self.report(element, f"unknown type {quote(unknown_type)}; {remedy}")
        elif "type" not in intended_names:
            choices = " or ".join(f'type="{known_type}"' for known_type in types)
            self.report(element, f"has no type; add {choices}")

    def report_unknown_element(
        self, element: Element, parent: Element, allowed_tags: Collection[str]
    ) -> str | None:
        """Report a child element with an unknown tag.

        Parameters
        ----------
        element : Element
            The child.
        parent : Element
            The element that contains the child.
        allowed_tags : collection of str
            Tags that children of the parent may have.

        Returns
        -------
        intended_tag : str or None
            The tag that was probably meant; None if it cannot be guessed.
        """
        if element.tag in _SCENE_TAGS:
            remedy, intended_tag = f"close the {parent.tag} on line {parent.line} first", None
        else:
            remedy, intended_tag = suggest_tag(element.tag, allowed_tags)
        parent_type = shorten(parent.attrib.get("type", parent.tag))
        self.report(element, f"unknown in {parent_type}; {remedy}")
        return intended_tag

    def report_duplicate(self, element: Element, original: Element) -> None:
        """Report an element that defines the same thing as an earlier element.

        Parameters
        ----------
        element : Element
            The later element.
        original : Element
            The earlier element.  Its tag may differ: <intensity> and <color> have the same meaning.
        """
        subject = "" if original.tag == element.tag else f"{original.tag} is "
        self.report(element, f"{subject}already given on line {original.line}; keep one of the two")

    def report_unknown_attributes(
        self, element: Element, allowed_names: Sequence[str] = (), child_tags: Collection[str] = ()
    ) -> set[str | None]:
        """Report all unknown attributes of an element.

        Parameters
        ----------
        element : Element
            The element.
        allowed_names : sequence of str
            Names of the attributes that the element may have.
        child_tags : collection of str
            Tags that children of the element may have; an attribute may be a misplaced child.

        Returns
        -------
        intended_names : set of (str or None)
            The names probably meant by unknown attributes; None for one that is unclear.
        """
        intended_names: set[str | None] = set()
        for name, value in element.attrib.items():
            if name in allowed_names:
                continue
            remedy, intended_name = suggest_tag(name, (*allowed_names, *child_tags))
            if intended_name == "shader":
                remedy = f'write <shader ref="{shorten(value)}"/> in it'
            elif intended_name in child_tags:
                remedy = f"write <{intended_name}>{shorten(value)}</{intended_name}> in it"
            elif intended_name is None:
                remedy, _ = suggest_name(name, allowed_names)
            intended_names.add(intended_name)
            self.report(element, f"unknown attribute {quote(name)}; {remedy}")
        return intended_names

    # From tables to a scene

    def report_missing_elements(self) -> None:
        """Report a missing camera or image, unless its tag was probably misspelt."""
        for tag in ("camera", "image"):
            if tag not in self.unique_elements and tag not in self.intended_tags:
                message = f"has no {tag}; add <{tag}> ... </{tag}>"
                self.report(self.unique_elements["scene"], message)

    def report_undefined_shaders(self) -> None:
        """Report each reference to an undefined shader, with a suggested fix.

        Call this after the whole file has been read.
        """
        definition_lines = self.definition_lines  # 0 for undefined shaders
        if 0 not in definition_lines:
            return
        name_of_index = {index: name for name, index in self.index_of_name.items()}
        names_and_lines = ((name, definition_lines[index]) for index, name in name_of_index.items())
        line_of_name = {name: line for name, line in names_and_lines if line}
        line_of_normal_form = {normalize("NFC", name): line for name, line in line_of_name.items()}
        fixes: dict[str, str] = {}
        for table in self.surface_tables.values():
            for reference_line, index in zip(table.shader_lines, table.shader_indices, strict=True):
                if definition_lines[index]:
                    continue
                name = name_of_index[index]
                if name not in fixes:
                    can_search = line_of_name and len(fixes) < _MAX_SEARCHES
                    fixes[name] = suggest_name(name, line_of_name)[0] if can_search else "define it"
                    if lookalike_line := line_of_normal_form.get(normalize("NFC", name)):
                        fixes[name] = _LOOKALIKE_REMEDY.format(lookalike_line)
                message = f"no shader is named {quote(name)}; {fixes[name]}"
                self.report_at(reference_line, "shader", message)

    def make_scene(self) -> Scene:
        """Create the scene from the tables of surfaces, shaders, lights and cameras.

        Call this only after the whole file has been read without errors.

        Returns
        -------
        scene : Scene
            The scene that the file describes.
        """
        shaders: list[model.Shader] = [model.Lambertian()] * len(self.definition_lines)
        for table in self.shader_tables.values():
            for index, shader in zip(table.object_indices, table.make_objects(), strict=True):
                shaders[index] = shader
        tables = self.surface_tables.values()
        surfaces = Surfaces.from_tables(
            {cast(model.Kind, table.dataclass): table.to_arrays() for table in tables},
            shader_index=np.concatenate([table.shader_indices for table in tables]),
            file_index=np.concatenate([table.object_indices for table in tables]),
            shaders=tuple(shaders),
            line=np.concatenate([table.lines for table in tables]),
        )
        (camera,), lights = self.cameras.make_objects(), tuple(self.lights.make_objects())
        return replace(self.empty_scene, camera=camera, lights=lights, surfaces=surfaces)
