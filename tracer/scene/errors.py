"""Collect the errors in a scene file, with a suggested fix for each.

Errors are collected instead of raised, so that the user sees all of them at once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from tracer.messages import quote, shorten
from tracer.scene.elements import Element, FatalError
from tracer.scene.hints import Suggestion, suggest_name, suggest_tag

MAX_ERRORS = 1_000
"""Maximum number of errors that are reported for a file."""

SCENE_TAGS = "camera", "image", "light", "shader", "surface"
"""Tags of the children of the root."""


class ErrorCollector:
    """The errors found so far in a scene file.

    All methods add errors, and raise FatalError if there are already `MAX_ERRORS`.
    """

    # Line and message of each error so far; line 0 if the error concerns the whole file.
    errors: list[tuple[int, str]]

    def __init__(self) -> None:
        self.errors = []

    def report_at(self, line: int, tag: str, message: str) -> None:
        """Add an error at a line of the file, in an element with this tag."""
        if len(self.errors) == MAX_ERRORS:
            last_line = max(line for line, _ in self.errors)
            raise FatalError(last_line, f"{MAX_ERRORS} errors so far; fix these first")
        self.errors.append((line, f"{shorten(tag)}: {message}"))

    def report(self, element: Element, message: str) -> None:
        """Add an error at the line where an element begins."""
        self.report_at(element.line, element.tag, message)

    def report_invalid_type(self, element: Element, types: Iterable[str], *attributes: str) -> None:
        """Report that the attribute "type" of a shader or surface is missing or unknown.

        `types` are the known types.  Attributes other than "type" and `attributes` are reported as
        unknown.
        """
        intended_names = self.report_unknown_attributes(element, (*attributes, "type"))
        unknown_type = element.attrib.get("type")
        if unknown_type is not None:
            remedy = suggest_name(unknown_type, types).remedy
            self.report(element, f"unknown type {quote(unknown_type)}; {remedy}")
        elif "type" not in intended_names:
            choices = " or ".join(f'type="{known_type}"' for known_type in types)
            self.report(element, f"has no type; add {choices}")

    def report_unknown_element(
        self, element: Element, parent: Element, allowed_tags: Collection[str]
    ) -> str | None:
        """Report a child with an unknown tag.

        `allowed_tags` are the tags that children of the parent may have.  Return the tag that was
        probably meant, or None if this is unclear.
        """
        if element.tag in SCENE_TAGS:
            remedy = f"close the {parent.tag} on line {parent.line} first"
            suggestion = Suggestion(remedy=remedy, name=None)
        else:
            suggestion = suggest_tag(element.tag, allowed_tags)
        parent_type = shorten(parent.attrib.get("type", parent.tag))
        self.report(element, f"unknown in {parent_type}; {suggestion.remedy}")
        return suggestion.name

    def report_duplicate(self, element: Element, original: Element) -> None:
        """Report an element that defines the same thing as `original`, an earlier one.

        Their tags may differ: <intensity> and <color> have the same meaning.
        """
        subject = "" if original.tag == element.tag else f"{original.tag} is "
        self.report(element, f"{subject}already given on line {original.line}; keep one of the two")

    def report_unknown_attributes(
        self, element: Element, allowed_names: Sequence[str] = (), child_tags: Collection[str] = ()
    ) -> set[str | None]:
        """Report all attributes of an element that are not in `allowed_names`.

        If an attribute was probably written in place of a child element, suggest the child.
        `child_tags` are the tags that children may have.  Return the names of attributes and the
        tags that were probably meant; None stands for attributes whose meaning is unclear.
        """
        intended_names: set[str | None] = set()
        for name, value in element.attrib.items():
            if name in allowed_names:
                continue
            suggestion = suggest_tag(name, (*allowed_names, *child_tags))
            tag = suggestion.name
            remedy = suggestion.remedy
            if tag is None:
                remedy = suggest_name(name, allowed_names).remedy
            elif tag == "shader" and not suggestion.needs_more:
                remedy = f'write <shader ref="{shorten(value)}"/> in it'
            elif tag in child_tags and not suggestion.needs_more:
                remedy = f"write <{tag}>{shorten(value)}</{tag}> in it"
            intended_names.add(tag)
            self.report(element, f"unknown attribute {quote(name)}; {remedy}")
        return intended_names
