"""Suggest fixes for errors in scene files: XML syntax errors, unknown names, and invalid numbers.

Expat's messages show where a syntax error is, but not which mistake caused it.  The table
`_SYNTAX_REMEDIES` recognises common mistakes by the text before and after the error.  Unknown names
are compared with the allowed ones, and looked up in a table of names in other scene formats.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import islice
from typing import Any, NamedTuple
from xml.parsers.expat import errors

from tracer.messages import quote, shorten

SCENE_REMEDY = "a scene file holds <scene> ... </scene>"

# Maximum number of known names that are compared with an unknown one.  A comparison takes 30 us.
_MAX_COMPARED = 256

# Maximum number of known names that a message lists.
_MAX_LISTED = 9

_INVALID, _UNCLOSED = errors.XML_ERROR_INVALID_TOKEN, errors.XML_ERROR_UNCLOSED_TOKEN
_QUOTED = 'put the value of an attribute in quotes, as in type="Sphere"'
_TAGS = 'tags are written like <shader name="red" type="Phong">, </shader>, <shader ref="red"/>'


class _SyntaxRemedy(NamedTuple):
    """A fix that is suggested for a syntax error if all three conditions hold."""

    # The fix.  {line} stands for the line where the match of `before` begins, and {description} for
    # the character at the error.
    remedy: str
    message: str = ""  # expat's message; "" for any message
    before: bytes = rb""  # a pattern that the text before the error must end with
    after: bytes = rb""  # a pattern that the text from the error on must begin with


# The first remedy whose conditions hold is suggested.  The comment above a remedy is an example, in
# which | stands right before the error.
_SYNTAX_REMEDIES = (
    # A file in UTF-16: |<\0s\0c\0
    _SyntaxRemedy("save the file as UTF-8, and without a NUL", after=rb".?\0"),
    # Not XML, such as a PNG file: |\x89PNG
    _SyntaxRemedy(SCENE_REMEDY, message=_INVALID, before=rb"\A[^<]*", after=rb"[^<]"),
    # A byte that is no character in UTF-8, such as an umlaut in Latin-1: name="gr|\xfcn"
    _SyntaxRemedy(
        "save the file as UTF-8",
        after=rb"[\x80-\xc1\xf5-\xff]|[\xc2-\xf4](?![\x80-\xbf])",
    ),
    # The end of the file is in a comment: |<!-- spheres
    _SyntaxRemedy("end it with -->", message=_UNCLOSED, after=rb"<!--"),
    # |<?xml version="1.0"
    _SyntaxRemedy("end it with ?>", message=_UNCLOSED, after=rb"<\?"),
    # |<center
    _SyntaxRemedy("end it with >", message=_UNCLOSED, after=rb"<"),
    # <!-- red --| or green -->
    _SyntaxRemedy("in a comment, write - in place of --", before=rb"<!--(?:(?!-->).)*--"),
    # <surface type=|Sphere>
    _SyntaxRemedy(_QUOTED, before=rb"=\s*", after=rb"\w"),
    # Typographic quotes, in UTF-8: <surface type=|\xe2\x80\x9cSphere
    _SyntaxRemedy(
        'write straight quotes, as in type="Sphere"', after=rb"\xe2\x80[\x98\x99\x9c\x9d]"
    ),
    # <center>0 0 |\x07
    _SyntaxRemedy("remove the control character", after=rb"[\x01-\x08\x0e-\x1f]"),
    # A no-break space between attributes: <shader|\xc2\xa0name="red">
    _SyntaxRemedy("write a plain character in place of {description}", after=rb"[\x80-\xff]"),
    # <camera |<viewPoint>
    _SyntaxRemedy("end the tag on line {line} with >", before=rb"<[a-zA-Z/][^<>]*", after=rb"<"),
    # <shader name="red>|<diffuseColor>
    _SyntaxRemedy(
        "close the quotes on line {line}",
        before=rb'<[a-zA-Z/][^<"]*(?:"[^<"]*"[^<"]*)*"[^<"]*',
        after=rb"<",
    ),
    # <shader name='red>|<diffuseColor>
    _SyntaxRemedy(
        "close the quotes on line {line}",
        before=rb"<[a-zA-Z/][^<']*(?:'[^<']*'[^<']*)*'[^<']*",
        after=rb"<",
    ),
    # <|5 spheres
    _SyntaxRemedy(
        "in text, < is written &lt;, and a tag has its name right after <",
        message=_INVALID,
        before=rb"<",
    ),
    # <!-| spheres -->
    _SyntaxRemedy("a comment is written <!-- ... -->", message=_INVALID, before=rb"<![^<>\"']*"),
    # <shader ref="red"/|/>
    _SyntaxRemedy(_TAGS, message=_INVALID, before=rb"""<(?:[^<>"']|"[^<>"]*"|'[^<>']*')*"""),
    # black &| white
    _SyntaxRemedy("in text, < is written &lt; and & is written &amp;", message=_INVALID),
)

# Suggested fixes for errors whose cause is clear from expat's message, which is the key.
_MESSAGE_REMEDIES = {
    errors.XML_ERROR_BAD_CHAR_REF: "no character of XML has this number; remove it",
    errors.XML_ERROR_DUPLICATE_ATTRIBUTE: "keep one of the two",
    errors.XML_ERROR_INCORRECT_ENCODING: "save the file as UTF-8, and declare no other",
    errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT: "nothing may follow </scene>",
    errors.XML_ERROR_MISPLACED_XML_PI: "nothing may stand before <?xml ... ?>",
    errors.XML_ERROR_UNCLOSED_CDATA_SECTION: "end it with ]]>",
    errors.XML_ERROR_UNDEFINED_ENTITY: "write out what the entity stands for",
    errors.XML_ERROR_UNKNOWN_ENCODING: "save the file as UTF-8",
    errors.XML_ERROR_XML_DECL: 'write it as <?xml version="1.0"?>, or leave it out',
}


def suggest_syntax_fix(
    message: str, line: int, before: bytes, after: bytes, elements: Sequence[Any], encoding: str
) -> str:
    """Return a suggested fix for an XML syntax error, such as "close the <light> on line 3".

    Parameters
    ----------
    message
        Expat's error message.
    line
        Line of the error in the file.
    before, after
        Some bytes of the file before the error, and some from the error on.
    elements
        The elements that are still open at the error, starting with the root.  Each has the
        attributes `tag` and `line`.
    encoding
        The encoding that the file declares; "" if it declares none.
    """
    # A file in UTF-8 may declare another encoding.  (Expat does not know the name "utf8".)
    if encoding.lower() not in ("", "utf-8") and re.match(rb"[\xc2-\xf4][\x80-\xbf]", after):
        return f'write encoding="UTF-8" on the first line, not {quote(encoding)}'
    if remedy := _find_syntax_remedy(message, line, before, after):
        return remedy
    if not elements:
        return _MESSAGE_REMEDIES.get(message, SCENE_REMEDY)
    innermost_tag = f"the <{shorten(elements[-1].tag)}> opened on line {elements[-1].line}"
    if message == errors.XML_ERROR_TAG_MISMATCH:
        end_tag = re.split(rb"[\s>]", after)[0].decode(errors="ignore")
        if all(end_tag != element.tag for element in elements):
            return f"only {innermost_tag} can be closed here: no <{shorten(end_tag)}> is open"
    return _MESSAGE_REMEDIES.get(message, f"close {innermost_tag}")


def _find_syntax_remedy(message: str, line: int, before: bytes, after: bytes) -> str | None:
    """Return the first fix of `_SYNTAX_REMEDIES` whose conditions hold, or None."""
    for candidate in _SYNTAX_REMEDIES:
        if candidate.message not in ("", message):
            continue
        match = re.search(rb"(?s:%b)\Z" % candidate.before, before)
        if match and re.match(candidate.after, after):
            character = after.decode(errors="replace")[:1] or " "
            description = f"{character!r} (U+{ord(character):04X})"
            first_line = line - match[0].count(b"\n")
            return candidate.remedy.format(line=first_line, description=description)
    return None


class Suggestion(NamedTuple):
    """A suggested fix for an unknown name."""

    remedy: str  # the fix as a clause of a message: "did you mean 'radius'?"
    name: str | None  # the name or tag that was probably meant; None if this is unclear
    needs_more: bool = False  # whether more than the name must be changed


def suggest_name(name: str, allowed_names: Iterable[str]) -> Suggestion:
    """Suggest the allowed name that is most similar to an unknown one; ignore the case of letters.

    If none is similar, the suggestion lists some allowed names instead.  To save time, only the
    first `_MAX_COMPARED` allowed names and the beginnings of long names are compared.
    """
    from difflib import get_close_matches  # only after an error: importing takes milliseconds

    name_of_key = {shorten(word).lower(): word for word in islice(allowed_names, _MAX_COMPARED)}
    for key in get_close_matches(shorten(name).lower(), name_of_key, n=1):
        similar_name = name_of_key[key]
        return Suggestion(remedy=f"did you mean {quote(similar_name)}?", name=similar_name)
    if not name_of_key:
        return Suggestion(remedy="remove it", name=None)
    names = [shorten(word) for word in sorted(name_of_key.values())]
    ellipsis = ["..."] * (len(names) > _MAX_LISTED)
    return Suggestion(remedy=f"known: {', '.join(names[:_MAX_LISTED] + ellipsis)}", name=None)


class _Replacement(NamedTuple):
    """An element of this scene format that has the meaning of a name in another format."""

    tag: str
    advice: str = ""  # says, after the tag, what else differs; "" if only the name differs
    type_name: str = ""  # the value of the element's attribute `type`; "" if it needs none


_EYE = _Replacement("viewPoint"), _Replacement("center")
_DIRECTION = (_Replacement("viewDir"),)
_TARGET = (_Replacement("viewDir", advice=", the target minus viewPoint"),)
_ANGLE = (_Replacement("viewHeight", advice=", 2 tan(fov/2) projDistance, and viewWidth"),)

# Replacements for names of elements and attributes in other scene formats.  The keys are in lower
# case.  Of several replacements, the first one that the surrounding element may contain is used.
_REPLACEMENTS: dict[str, Sequence[_Replacement]] = {
    **dict.fromkeys(("position", "eye", "from"), _EYE),
    **dict.fromkeys(("direction", "gaze"), _DIRECTION),
    "up": (_Replacement("viewUp"),),
    "imageplane": (_Replacement("projDistance", advice=", viewWidth and viewHeight"),),
    **dict.fromkeys(("lookat", "target", "to"), _TARGET),
    **dict.fromkeys(("fov", "fovy"), _ANGLE),
    **{name.lower(): (_Replacement("surface", type_name=name),) for name in ("Sphere", "Box")},
    **{name.lower(): (_Replacement("shader", type_name=name),) for name in ("Lambertian", "Phong")},
}

# Names in other scene formats, in lower case, that should be removed where no replacement is
# allowed.
_SUPERFLUOUS = frozenset(("imageplane", "lookat", "target", "to", "fov", "fovy", "exposure"))
_SUPERFLUOUS |= {"samples", "background", "ambient", "integrator"}


def suggest_tag(tag: str, allowed_tags: Collection[str]) -> Suggestion:
    """Suggest what to write in place of an unknown tag, which may come from another scene format.

    The suggested tag is in `allowed_tags`, or it is "surface" or "shader" even if these are not.
    It is None if the tag should be removed.
    """
    for replacement in _REPLACEMENTS.get(tag.lower(), ()):
        if replacement.type_name:
            remedy = f'write <{replacement.tag} type="{replacement.type_name}">'
            return Suggestion(remedy=remedy, name=replacement.tag, needs_more=True)
        if replacement.tag in allowed_tags:
            remedy = f"write {replacement.tag}{replacement.advice}"
            needs_more = bool(replacement.advice)
            return Suggestion(remedy=remedy, name=replacement.tag, needs_more=needs_more)
    if tag.lower() in _SUPERFLUOUS:
        return Suggestion(remedy="remove it", name=None)
    return suggest_name(tag, allowed_tags)


# Suggested fixes for characters in numbers, by Unicode category: format characters (Cf), dashes
# (Pd) and separators (Zs, Zl and Zp).
_CHARACTER_REMEDIES = {"Cf": "remove it", "Pd": "write - in its place"}
_CHARACTER_REMEDIES |= dict.fromkeys(("Zs", "Zl", "Zp"), "write a plain space in its place")


def explain_invalid_numbers(words: Iterable[str]) -> Iterator[str]:
    """Explain why each of these words is not a valid number.

    Equal words are explained once.  Of several words with commas, only the first is explained.
    """
    is_comma_explained = False
    for word in dict.fromkeys(words):
        is_about_comma = word.isascii() and "," in word
        if not (is_about_comma and is_comma_explained):
            yield explain_invalid_number(word)
        is_comma_explained |= is_about_comma


def explain_invalid_number(word: str) -> str:
    """Explain why a word is not a valid number, and suggest a fix.

    The word must not be a valid number.  So if it is written like one, it is so small that it would
    become 0 in float64.
    """
    for character in word:
        if not character.isascii():
            category = "Pd" if character == "\N{MINUS SIGN}" else unicodedata.category(character)
            remedy = _CHARACTER_REMEDIES.get(category, "write a plain character in its place")
            description = f"U+{ord(character):04X}, {unicodedata.name(character, '?')}"
            return f"{quote(word)} contains {description}; {remedy}"
    if "," in word:
        return f"{quote(word)} contains a comma; put spaces between numbers, and write 1.5 for 1,5"
    if re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", word, re.ASCII):
        return f"{quote(word)} is too small, and would count as 0; write 0 in its place"
    return f"{quote(word)} is not a decimal number; write it as 2, -.5 or 1e-3"
