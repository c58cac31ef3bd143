"""Every fault of a scene file is told in a line: the exact words, and never a traceback."""

from __future__ import annotations

import os
import socket
import subprocess
import sys

import pytest

from tracer import SceneFileError, contents, load_scene, reader

EMPTY = "<camera/><image>4 3</image>"
LIGHT = "<light><position>1 2 3</position>{}</light>"
SPHERE = '<surface type="Sphere">{}</surface>'
BOX = '<surface type="Box">{}</surface>'
PHONG = '<surface type="Sphere"><shader type="Phong">{}</shader></surface>'

LENGTHS = "lengths other than 0 are from 1e-75 to 1e+75"
TAGS = 'tags are written like <shader name="red" type="Phong">, </shader>, <shader ref="red"/>'
DECIMAL = "is no decimal number; write it as 2, -.5 or 1e-3"


def faults_of(path) -> list[str]:
    """The lines of the error, without the name of the file."""
    with pytest.raises(SceneFileError) as caught:
        load_scene(path)
    lines = str(caught.value).split("\n")
    assert list(caught.value.lines) == lines
    for line in lines:
        assert line.startswith(f"{path}:")
    return [line.removeprefix(f"{path}:").strip() for line in lines]


# Every fault is told alike, whether the file is read without line numbers first or not.
pytestmark = pytest.mark.usefixtures("either_reader")


@pytest.fixture
def faults(tmp_path):
    def read(content: str | bytes) -> list[str]:
        path = tmp_path / "scene.xml"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return faults_of(path)

    return read


NOT_XML = [
    (
        "<scene>\n  <surface type=Sphere>\n</scene>",
        "2: not XML: not well-formed (invalid token) at column 17;"
        ' put the value of an attribute in quotes, as in type="Sphere"',
    ),
    (
        '<scene>\n<surface type="Box" name = b/>',
        "2: not XML: not well-formed (invalid token) at column 28;"
        ' put the value of an attribute in quotes, as in type="Sphere"',
    ),
    *(
        (
            f"<scene>\n<surface type={left}Sphere{right}/></scene>",
            "2: not XML: not well-formed (invalid token) at column 15;"
            ' write straight quotes, as in type="Sphere"',
        )
        for left, right in ("\u201c\u201d", "\u2018\u2019", "\u201d\u201d")
    ),
    *(
        (
            f"<scene>\n<surface type={quote}Sphere>\n\n<radius>1</radius></surface></scene>",
            "4: not XML: not well-formed (invalid token) at column 1; close the quotes of line 2",
        )
        for quote in "'\""
    ),
    *(
        (
            f"<scene>\n{tag}\n<image>4 3</image></scene>",
            "3: not XML: not well-formed (invalid token) at column 1; end the tag of line 2 with >",
        )
        for tag in ('<surface type="Sphere"', "<camera></camera")
    ),
    (
        "<scene>\n<image>don't <</image></scene>",
        "2: not XML: not well-formed (invalid token) at column 15;"
        " in text, < is written &lt;, and a tag has its name right after <",
    ),
    *(
        (
            f"<scene>\n{tag}</scene>".encode(encoding),
            f"2: not XML: not well-formed (invalid token) at column {column}; {remedy}",
        )
        for encoding in ("utf-8", "utf-16")
        for tag, column, remedy in (
            ('<surface type="Box",/>', 20, TAGS),
            ('<shader name="a"type="Phong"/>', 17, TAGS),
            ('<surface type:"Box"/>', 15, TAGS),
            ("<surface type/>", 14, TAGS),
            ("</ light>", 3, TAGS),
            ('<shader name="a&b"/>', 18, "in text, < is written &lt; and & is written &amp;"),
            ("< light/>", 2, "in text, < is written &lt;, and a tag has its name right after <"),
            ("<\\light>", 2, "in text, < is written &lt;, and a tag has its name right after <"),
            ("<!- a ->", 4, "a comment is written <!-- ... -->"),
        )
    ),
    *(
        (
            f'<scene>\n<surface{odd}type="Box"/></scene>',
            "2: not XML: not well-formed (invalid token) at column 9;"
            f" write a plain character in place of {odd!r} (U+{ord(odd):04X})",
        )
        for odd in "\u00a0\u200b\u3000\uff0f"
    ),
    (
        "<scene>\n<camera></Camera></scene>",
        "2: not XML: mismatched tag at column 11;"
        " only <camera> of line 2 can be closed here: no <Camera> is open",
    ),
    (
        "<scene>\n</light></scene>".encode("utf-16"),
        "2: not XML: mismatched tag at column 3;"
        " only <scene> of line 1 can be closed here: no <light> is open",
    ),
    (
        "<scene>\n<camera>\n</scene>",
        "3: not XML: mismatched tag at column 3; close <camera> of line 2",
    ),
    ("<scene>\n<camera>", "2: not XML: no element found at column 9; close <camera> of line 2"),
    ("<scene>\n<camera", "2: not XML: unclosed token at column 1; end it with >"),
    ('\n<?xml version="1.0">\n', "2: not XML: unclosed token at column 1; end it with ?>"),
    (
        "<scene>\na & b</scene>",
        "2: not XML: not well-formed (invalid token) at column 4;"
        " in text, < is written &lt; and & is written &amp;",
    ),
    (
        "<scene>\n&lol;</scene>",
        "2: not XML: undefined entity at column 1; write out what the entity stands for",
    ),
    (
        '<scene><shader name="a" name="b"/></scene>',
        "1: not XML: duplicate attribute at column 25; keep one of the two",
    ),
    (
        f"<scene>{EMPTY}</scene>\n<scene/>",
        "2: not XML: junk after document element at column 1; nothing may follow </scene>",
    ),
    ("P6 640 480", "1: not XML: syntax error at column 1; a scene file holds <scene> ... </scene>"),
    (
        '{"a": 1}',
        "1: not XML: not well-formed (invalid token) at column 1;"
        " a scene file holds <scene> ... </scene>",
    ),
    (
        '<scene version="1 & 2">',
        "1: not XML: not well-formed (invalid token) at column 20;"
        " in text, < is written &lt; and & is written &amp;",
    ),
    (" \n ", "2: not XML: no element found at column 2; a scene file holds <scene> ... </scene>"),
    (
        b"<scene>\n\xff</scene>",
        "2: not XML: not well-formed (invalid token) at column 1; save the file as UTF-8",
    ),
    (
        b"<scene>\n\0</scene>",
        "2: not XML: not well-formed (invalid token) at column 1;"
        " save the file as UTF-8, and without a NUL",
    ),
    *(
        (
            "<scene>\na</scene>".encode(encoding),
            f"1: not XML: not well-formed (invalid token) at column {column};"
            " save the file as UTF-8, and without a NUL",
        )
        for encoding, column in (("utf-32", 2), ("utf-32-be", 1))
    ),
    (
        "<scene>\na & b</scene>".encode("utf-16"),
        "2: not XML: not well-formed (invalid token) at column 4;"
        " in text, < is written &lt; and & is written &amp;",
    ),
    (
        b"\xfe\xff" + "<scene>\n<!-- a -->&;</scene>".encode("utf-16-be"),
        "2: not XML: not well-formed (invalid token) at column 12;"
        " in text, < is written &lt; and & is written &amp;",
    ),
    (
        "<scene>\n<!-- a -- b --></scene>",
        "2: not XML: not well-formed (invalid token) at column 10;"
        " in a comment, write - in place of --",
    ),
    (
        b"<scene>\n<!-- \xff --></scene>",
        "2: not XML: not well-formed (invalid token) at column 6; save the file as UTF-8",
    ),
    (
        "<scene>\n<!-- \x01 --></scene>",
        "2: not XML: not well-formed (invalid token) at column 6; remove the control character",
    ),
    (
        "<scene><!-- a -->\n-- & b</scene>",
        "2: not XML: not well-formed (invalid token) at column 5;"
        " in text, < is written &lt; and & is written &amp;",
    ),
    (
        "<scene>\n<camera><!-- a </scene>".encode("utf-16"),
        "2: not XML: unclosed token at column 9; end it with -->",
    ),
    (
        "<scene><image>\n<![CDATA[ a </scene>",
        "2: not XML: unclosed CDATA section at column 21; end it with ]]>",
    ),
    (
        "<scene>\n<camera>&#11;</camera></scene>",
        "2: not XML: reference to invalid character number at column 9;"
        " no character of XML has this number; remove it",
    ),
    (
        '\n<?xml version="1.0"?><scene/>',
        "2: not XML: XML or text declaration not at start of entity at column 1;"
        " nothing may stand before <?xml ... ?>",
    ),
    (
        '<?xml version="1.0" encoding="utf-16"?><scene/>',
        "1: not XML: encoding specified in XML declaration is incorrect at column 31;"
        " save the file as UTF-8, and declare no other",
    ),
    (
        '<?xml version="1.0"encoding="utf-8"?><scene/>',
        "1: not XML: XML declaration not well-formed at column 20;"
        ' write it as <?xml version="1.0"?>, or leave it out',
    ),
    (
        '<?xml version="1.0" encoding="klingon"?><scene/>',
        "1: not XML: unknown encoding; save the file as UTF-8",
    ),
    (
        '<?xml version="1.0" encoding="shift-jis"?><scene/>',
        "1: not XML: unknown encoding; save the file as UTF-8",
    ),
    (
        '<?xml version="1.0" encoding="cp037"?><scene/>',
        "1: not XML: unknown encoding at column 31; save the file as UTF-8",
    ),
    # Where warnings are errors, as they are here, its codec raises one.
    (
        '<?xml version="1.0" encoding="unicode_escape"?><scene/>',
        "1: not XML: unknown encoding; save the file as UTF-8",
    ),
    (
        '<?xml version="1.0"?>\n<!DOCTYPE scene [<!ENTITY lol "lol">]><scene>&lol;</scene>',
        "2: DOCTYPE: declarations are not allowed; write out what entities stand for",
    ),
    (
        f'\n<!DOCTYPE scene SYSTEM "scene.dtd">\n<scene>{EMPTY}&lol;</scene>',
        "2: DOCTYPE: declarations in another file are not allowed; remove the DOCTYPE",
    ),
    (
        f'<!DOCTYPE scene PUBLIC "scene" "scene.dtd"><scene lol="&lol;">{EMPTY}</scene>',
        "1: DOCTYPE: declarations in another file are not allowed; remove the DOCTYPE",
    ),
    (
        f'<!DOCTYPE scene SYSTEM "scene.dtd" [<!ENTITY lol "lol">]>\n<scene>{EMPTY}</scene>',
        "1: DOCTYPE: declarations are not allowed; write out what entities stand for",
    ),
    (
        f'<!DOCTYPE scene>\n<scene>{EMPTY}<surface type="&Sphere;"/></scene>',
        "2: not XML: undefined entity at column 35; write out what the entity stands for",
    ),
    ("<scen/>", "1: scen: the root must be <scene>"),
    (f"<Scene>{EMPTY}</Scene>", "1: Scene: the root must be <scene>"),
    (f'<scene colour="2">{EMPTY}</scene>', "1: scene: unknown attribute 'colour'; remove it"),
    (
        '<scene version="3.0.0">\n<integrator type="path"/><shape type="sphere"/></scene>',
        "1: scene: has a version, so it is Mitsuba's; name the scene it was made from",
    ),
    ("<html><body>", "1: html: the root must be <scene>"),
    # How a PNG begins, a JPEG, and a file that gzip made.
    *(
        (
            begins,
            "1: not XML: not well-formed (invalid token) at column 1;"
            " a scene file holds <scene> ... </scene>",
        )
        for begins in (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0", b"\x1f\x8b\x08\x08")
    ),
]


@pytest.mark.parametrize(("content", "fault"), NOT_XML)
def test_what_is_no_scene_at_all(faults, content, fault):
    assert faults(content) == [fault]


STRUCTURE = [
    ("<image>4 3</image>", "scene: has no camera; add <camera> ... </camera>"),
    ("<camera/>", "scene: has no image; add <image> ... </image>"),
    (EMPTY + "<light/>", "light: has no position; add <position>x y z</position>"),
    (EMPTY + BOX.format("<minPt>0 0 0</minPt>"), "surface: has no maxPt; add <maxPt>x y z</maxPt>"),
    (EMPTY + BOX.format("<maxPt>0 0 0</maxPt>"), "surface: has no minPt; add <minPt>x y z</minPt>"),
    (EMPTY + "<camra/>", "camra: unknown in scene; did you mean 'camera'?"),
    (EMPTY + "<Light/>", "Light: unknown in scene; did you mean 'light'?"),
    (
        EMPTY + "<texture><image/></texture>",
        "texture: unknown in scene; known: camera, image, light, shader, surface",
    ),
    (
        EMPTY + LIGHT.format("<colour>1 1 1</colour>"),
        "colour: unknown in light; did you mean 'color'?",
    ),
    (
        EMPTY + SPHERE.format("<centre>1 1 1</centre>"),
        "centre: unknown in Sphere; did you mean 'center'?",
    ),
    (
        EMPTY + SPHERE.format("<minPt>1 1 1</minPt>"),
        "minPt: unknown in Sphere; known: center, radius, shader",
    ),
    (
        EMPTY + '<shader name="a" type="Lambertian"><exponent>3</exponent></shader>',
        "exponent: unknown in Lambertian; known: diffuseColor",
    ),
    (EMPTY + "<sphere/>", 'sphere: unknown in scene; write <surface type="Sphere">'),
    (EMPTY + "<Phong/>", 'Phong: unknown in scene; write <shader type="Phong">'),
    (
        EMPTY + SPHERE.format("<lambertian/>"),
        'lambertian: unknown in Sphere; write <shader type="Lambertian">',
    ),
    (
        EMPTY + '<shader name="a" type="Phong"/>' + SPHERE.format('<shader name="a"/>'),
        'shader: has a name, but no type; to refer to a shader, write ref="a"',
    ),
    (
        # What else is in it is no fault: it depends on the type.
        EMPTY + '<surface type="Torus"><turns>9</turns><radius>x</radius></surface>',
        "surface: unknown type 'Torus'; known: Box, Sphere",
    ),
    (EMPTY + '<surface type="Spere"/>', "surface: unknown type 'Spere'; did you mean 'Sphere'?"),
    (EMPTY + '<surface type="box"/>', "surface: unknown type 'box'; did you mean 'Box'?"),
    (EMPTY + '<surface type="Torus"/>', "surface: unknown type 'Torus'; known: Box, Sphere"),
    (EMPTY + "<surface/>", 'surface: has no type; add type="Sphere" or type="Box"'),
    (
        EMPTY + '<shader name="a" type="Fong"/>',
        "shader: unknown type 'Fong'; did you mean 'Phong'?",
    ),
    (EMPTY + '<shader name="a"/>', 'shader: has no type; add type="Lambertian" or type="Phong"'),
    (EMPTY + '<shader type="Phong"/>', 'shader: has no name; add one, as in name="white"'),
    (
        EMPTY + '<shader name="gray" type="Phong"/>' + SPHERE.format('<shader ref="grey"/>'),
        "shader: no shader is named 'grey'; did you mean 'gray'?",
    ),
    (EMPTY + SPHERE.format('<shader ref="grey"/>'), "shader: no shader is named 'grey'; define it"),
    (
        EMPTY + '<shader name="a" type="Phong"/>\n<shader name="a" type="Lambertian"/>',
        "shader: the name 'a' is taken by the shader in line 1; choose another",
    ),
    (
        EMPTY
        + SPHERE.format('<shader name="a" type="Phong"/>')
        + SPHERE.format('<shader name="a" type="Phong"/>'),
        "shader: the name 'a' is taken by the shader in line 1; choose another",
    ),
    (EMPTY + "<camera/>", "camera: given already, in line 1; keep one of the two"),
    (EMPTY + "\n<image>4 3</image>", "image: given already, in line 1; keep one of the two"),
    (
        EMPTY + SPHERE.format("<radius>1</radius>\n<radius>1</radius>"),
        "radius: given already, in line 1; keep one of the two",
    ),
    (
        EMPTY + SPHERE.format('<shader type="Phong"/><shader type="Phong"/>'),
        "shader: given already, in line 1; keep one of the two",
    ),
    (
        EMPTY + LIGHT.format("<color>1 1 1</color>\n<intensity>1 1 1</intensity>"),
        "intensity: color is given already, in line 1; keep one of the two",
    ),
    (
        EMPTY + '<surface type="Sphere" name="ball"/>',
        "surface: unknown attribute 'name'; known: type",
    ),
    (
        EMPTY + '<surface type="Sphere" tpye="Box"/>',
        "surface: unknown attribute 'tpye'; did you mean 'type'?",
    ),
    (
        EMPTY + SPHERE.format('<radius unit="m">1</radius>'),
        "radius: unknown attribute 'unit'; remove it",
    ),
    (
        EMPTY + '<shader name="a" type="Phong"/>' + SPHERE.format('<shader ref="a"><b/></shader>'),
        "shader: no element may stand in it; remove <b>",
    ),
    (
        EMPTY + '<shader name="a" type="Phong"/>' + SPHERE.format('<shader ref="a" type="Phong"/>'),
        "shader: unknown attribute 'type'; known: ref",
    ),
    (
        EMPTY + '<shader name="a" type="Phong" ref="a"/>',
        "shader: unknown attribute 'ref'; known: name, type",
    ),
    (EMPTY + "1 2 3", "scene: stray text '1 2 3'; remove it"),
    (EMPTY + SPHERE.format("r = 2"), "surface: stray text 'r = 2'; remove it"),
    (
        EMPTY + LIGHT.format("<color>1 <b>1</b> 1</color>"),
        "color: no element may stand in it; remove <b>",
    ),
]


@pytest.mark.parametrize(("content", "fault"), STRUCTURE)
def test_structure(faults, content, fault):
    line = 1 + content.count("\n")
    assert faults(f"<scene>{content}</scene>") == [f"{line}: {fault}"]


VALUES = [
    (LIGHT.format("<color>1 1</color>"), ["color: needs 3 numbers, has 2"]),
    (LIGHT.format("<color/>"), ["color: needs 3 numbers, has 0"]),
    (SPHERE.format("<radius>1 2</radius>"), ["radius: needs 1 number, has 2"]),
    (SPHERE.format("<radius>big</radius>"), [f"radius: 'big' {DECIMAL}"]),
    (
        SPHERE.format("<center>0x10 1_0 1,5</center>"),
        [f"center: '0x10' {DECIMAL}", f"center: '1_0' {DECIMAL}", f"center: '1,5' {DECIMAL}"],
    ),
    (
        SPHERE.format("<center>nan inf -Infinity</center>"),
        [f"center: 'nan' {DECIMAL}", f"center: 'inf' {DECIMAL}", f"center: '-Infinity' {DECIMAL}"],
    ),
    (
        SPHERE.format("<center>NAN INF Infinity</center>"),
        [f"center: 'NAN' {DECIMAL}", f"center: 'INF' {DECIMAL}", f"center: 'Infinity' {DECIMAL}"],
    ),
    (SPHERE.format("<radius>-NaN</radius>"), [f"radius: '-NaN' {DECIMAL}"]),
    (SPHERE.format("<center>1,2, -3</center>"), ["center: has commas; write it as '1 2 -3'"]),
    (SPHERE.format("<center>1,5 2 3,5</center>"), ["center: has commas; write it as '1.5 2 3.5'"]),
    (SPHERE.format("<radius>1,5</radius>"), ["radius: has commas; write it as '1.5'"]),
    (SPHERE.format("<radius>1,e</radius>"), [f"radius: '1,e' {DECIMAL}"]),
    (SPHERE.format("<radius>1e</radius>"), [f"radius: '1e' {DECIMAL}"]),
    (SPHERE.format("<radius>--1</radius>"), [f"radius: '--1' {DECIMAL}"]),
    # Digits of another script, and a space that XML does not know.
    (SPHERE.format("<radius>\u0663</radius>"), [f"radius: '\u0663' {DECIMAL}"]),
    (SPHERE.format("<center>1\u20032 3</center>"), [f"center: '1\\u20032' {DECIMAL}"]),
    # As copied from a page or a program.
    (
        SPHERE.format("<center>1\u00a02 3</center>"),
        ["center: has '\\xa0' (U+00A0); write it as '1 2 3'"],
    ),
    (
        SPHERE.format("<center>\u22121 \u20132 3</center>"),
        ["center: has '\u2212' (U+2212) and '\u2013' (U+2013); write it as '-1 -2 3'"],
    ),
    (
        SPHERE.format("<center>\ufeff1\u30002 \uff0d\uff13</center>"),
        [
            "center: has '\\ufeff' (U+FEFF) and '\\u3000' (U+3000) and '\uff0d' (U+FF0D)"
            " and '\uff13' (U+FF13); write it as '1 2 -3'"
        ],
    ),
    (
        SPHERE.format("<center>(1, 2, 3)</center>"),
        ["center: has '(' and ',' and ')'; write it as '1 2 3'"],
    ),
    (SPHERE.format("<radius>(r)</radius>"), [f"radius: '(r)' {DECIMAL}"]),
    (SPHERE.format(f"<radius>{'x' * 99}</radius>"), [f"radius: '{'x' * 37}...' {DECIMAL}"]),
    (SPHERE.format("<center>1 1e999 0</center>"), ["center: must be finite"]),
    (
        SPHERE.format("<radius>-2.3456789</radius>"),
        ["radius: must be positive and finite, is -2.3456789"],
    ),
    (LIGHT.format("<color>1e999 1 0</color>"), ["color: must be finite"]),
    (SPHERE.format("<radius>1e999</radius>"), ["radius: must be positive and finite, is inf"]),
    *(
        (SPHERE.format(f"<radius>{size}</radius>"), [f"radius: {size} is too {too}; {LENGTHS}"])
        for size, too in (("1e-76", "small"), ("1e+76", "large"))
    ),
    (LIGHT.replace("2", "-1e-99").format(""), [f"position: -1e-99 is too small; {LENGTHS}"]),
    (
        BOX.format("<minPt>0 -1e+80 0</minPt><maxPt>1e+90 1e-80 0</maxPt>"),
        [f"minPt: -1e+80 is too large; {LENGTHS}", f"maxPt: 1e+90 is too large; {LENGTHS}"],
    ),
    (SPHERE.format("<radius>0</radius>"), ["radius: must be positive and finite, is 0"]),
    (SPHERE.format("<radius>-.5</radius>"), ["radius: must be positive and finite, is -0.5"]),
    (
        BOX.format("<minPt>1 0 0</minPt><maxPt>0 1 -2</maxPt>"),
        ["minPt: must not exceed maxPt, but x has 1 > 0 and z has 0 > -2; swap these"],
    ),
    (LIGHT.format("<color>1 -1 0</color>"), ["color: must not be negative, has -1"]),
    (LIGHT.format("<intensity>1 -1 0</intensity>"), ["intensity: must not be negative, has -1"]),
    (
        PHONG.format("<diffuseColor>-1 1 0</diffuseColor>"),
        ["diffuseColor: must not be negative, has -1"],
    ),
    (
        PHONG.format("<specularColor>1 1 -.1</specularColor>"),
        ["specularColor: must not be negative, has -0.1"],
    ),
    (PHONG.format("<exponent>-1</exponent>"), ["exponent: must be finite and not negative, is -1"]),
    (
        PHONG.format("<exponent>1e999</exponent>"),
        ["exponent: must be finite and not negative, is inf"],
    ),
]


@pytest.mark.parametrize(("content", "expected"), VALUES)
def test_values(faults, content, expected):
    assert faults(f"<scene>\n{EMPTY}\n{content}</scene>") == [f"3: {fault}" for fault in expected]


IMAGES = [
    ("4", "needs two whole numbers, width and height, as in 640 480; has '4'"),
    ("", "needs two whole numbers, width and height, as in 640 480; has ''"),
    ("4.0 3", "needs two whole numbers, width and height, as in 640 480; has '4.0 3'"),
    ("1e2 3", "needs two whole numbers, width and height, as in 640 480; has '1e2 3'"),
    ("4 3 2", "needs two whole numbers, width and height, as in 640 480; has '4 3 2'"),
    ("0 3", "width: must be a whole number of at least 1, is 0"),
    ("4 -3", "height: must be a whole number of at least 1, is -3"),
    (
        "16384 16385",
        "width, height: 16384 x 16385 pixels are too many: the picture would take 6 GiB of memory;"
        " at most 268435456 pixels are allowed",
    ),
    (
        "1000000 1000000",
        "width, height: 1000000 x 1000000 pixels are too many: the picture would take 2.24e+04 GiB"
        " of memory; at most 268435456 pixels are allowed",
    ),
    (
        f"1{'0' * 5000} 1",
        f"'1{'0' * 36}...' is out of range; from 1 to 268435456 pixels are allowed",
    ),
]


@pytest.mark.parametrize(("text", "fault"), IMAGES)
def test_image(faults, text, fault):
    assert faults(f"<scene><camera/>\n<image>{text}</image></scene>") == [f"2: image: {fault}"]


CAMERAS = [
    ("<viewDir>0 0 0</viewDir>", "viewDir: must not be the zero vector"),
    ("<viewUp>0 -0 0</viewUp>", "viewUp: must not be the zero vector"),
    ("<projNormal>0 0 0</projNormal>", "projNormal: must not be the zero vector"),
    ("<viewPoint>0 0 1e999</viewPoint>", "viewPoint: must be finite"),
    ("<viewPoint>1e+80 0 0</viewPoint>", f"viewPoint: 1e+80 is too large; {LENGTHS}"),
    ("<viewWidth>1e-80</viewWidth>", f"viewWidth: 1e-80 is too small; {LENGTHS}"),
    ("<projDistance>0</projDistance>", "projDistance: must be positive and finite, is 0"),
    ("<viewWidth>-1</viewWidth>", "viewWidth: must be positive and finite, is -1"),
    ("<viewHeight>0</viewHeight>", "viewHeight: must be positive and finite, is 0"),
    ("<viewUp>0 0 3</viewUp>", "viewUp: must not be parallel to viewDir; choose another viewUp"),
    (
        "<viewUp>0 1e-15 1</viewUp>",
        "viewUp: must not be parallel to viewDir; choose another viewUp",
    ),
    # The default viewUp is not in the file: the camera is to blame.
    ("<viewDir>0 -2 0</viewDir>", "viewUp: must not be parallel to viewDir; choose another viewUp"),
    (
        "<viewUp>1 0 1</viewUp><projNormal>-2 0 -2</projNormal>",
        "viewUp: must not be parallel to projNormal; choose another viewUp",
    ),
    (
        "<projNormal>1 0 0</projNormal>",
        "projNormal: must not be perpendicular to viewDir: no ray would meet it",
    ),
]


@pytest.mark.parametrize(("content", "fault"), CAMERAS)
def test_camera(faults, content, fault):
    content = f"<scene><image>4 3</image>\n<camera>{content}</camera></scene>"
    assert faults(content) == [f"2: {fault}"]


def test_a_file_with_several_faults_reports_them_all_in_its_order(faults):
    content = """<scene>
  <camera>
    <viewDir>0 0 x</viewDir>
    <viewUp>0 0 1</viewUp>
    <viewWidth>0</viewWidth>
  </camera>
  <light>
    <color>1 1</color>
  </light>
  <surface type="Sphere">
    <shader ref="nobody"/>
    <center>0 0</center>
    <radius>-1</radius>
  </surface>
  <!-- a comment
       of two lines -->  stray
  <surface type="Box">
    <minPt>1 0 0</minPt>
    <maxPt>0 0 0</maxPt>
    <shader type="Phong">
      <exponent>-1</exponent>
    </shader>
  </surface>
</scene>
"""
    assert faults(content) == [
        "1: scene: has no image; add <image> ... </image>",
        f"3: viewDir: 'x' {DECIMAL}",
        "5: viewWidth: must be positive and finite, is 0",
        "7: light: has no position; add <position>x y z</position>",
        "8: color: needs 3 numbers, has 2",
        "11: shader: no shader is named 'nobody'; define it",
        "12: center: needs 3 numbers, has 2",
        "13: radius: must be positive and finite, is -1",
        "16: scene: stray text 'stray'; remove it",
        "18: minPt: must not exceed maxPt, but x has 1 > 0; swap these",
        "21: exponent: must be finite and not negative, is -1",
    ]


def test_faults_before_the_file_stops_being_xml_are_told_too(faults):
    assert faults("<scene>\n<camra/>\n<image>") == [
        "2: camra: unknown in scene; did you mean 'camera'?",
        "3: not XML: no element found at column 8; close <image> of line 3",
    ]


def test_a_long_stray_text_is_one_fault(faults):
    text = " \n" + "stray text of many words " * 100_000
    assert faults(f"<scene>{EMPTY}{text}<light>{text}</light></scene>") == [
        "2: scene: stray text 'stray text of many words stray text o...'; remove it",
        "2: light: has no position; add <position>x y z</position>",
        "3: light: stray text 'stray text of many words stray text o...'; remove it",
    ]


def test_stray_text_after_an_element_of_an_element(faults):
    content = "<scene><image>4 3</image><camera><viewWidth>1</viewWidth>x</camera></scene>"
    assert faults(content) == ["1: camera: stray text 'x'; remove it"]


@pytest.mark.parametrize("start", [100, *range(16377, 16386)])
def test_a_namespace_wherever_the_file_is_cut(faults, start):
    """Into pieces of 16 KiB."""
    content = f"<scene>{EMPTY}"
    surface = '<surface type="Sphere" '
    content += " " * (start - len(content) - len(surface)) + surface
    assert len(content) == start
    assert faults(f'{content}xmlns:a="b"/>{" " * 20_000}</scene>') == [
        "1: surface: unknown attribute 'xmlns:a'; known: type"
    ]


def test_what_one_fault_leads_to_is_no_fault(faults):
    """A minPt that cannot be read does not exceed maxPt; a faulty shader is still defined."""
    content = f"""<scene>{EMPTY}
      <surface type="Box"><minPt>1 1</minPt><maxPt>0 0 0</maxPt><shader ref="a"/></surface>
      <shader name="a" type="Phong"><exponent>one</exponent></shader></scene>"""
    assert faults(content) == ["2: minPt: needs 3 numbers, has 2", f"3: exponent: 'one' {DECIMAL}"]


@pytest.mark.parametrize(
    "texts",
    [
        ("1 2", "3 4 5 6"),
        ("1 2 3 4", "5 6"),
        ("1 2 3 4 5 6", ""),
        ("1 2 3", "4 5 6 7"),
        ("1 2 3 ; 4 5 6", ""),
        ("", "1 2 3 ; 4 5 6"),
        ("1 2 3 ;", "4 5 6"),
        ("1 2 ; 3", "4 5 6"),
    ],
)
def test_no_surface_takes_numbers_of_the_next(faults, texts):
    """The numbers of many surfaces are read at once, from texts with a ; in between."""
    content = "".join(SPHERE.format(f"<center>{text}</center>") + "\n" for text in texts)
    expected = []
    for line, words in enumerate(map(str.split, texts), 1):
        expected += [f"{line}: center: ';' {DECIMAL}"] * words.count(";")
        if len(words) != 3 and ";" not in words:
            expected.append(f"{line}: center: needs 3 numbers, has {len(words)}")
    assert faults(f"<scene>{content}{EMPTY}</scene>") == expected


# Limits


def test_the_number_of_faults_told_is_bounded(faults):
    told = faults(f"<scene>{EMPTY}{'<a/>' * 100_000}</scene>")
    assert len(told) == contents.MAX_FAULTS + 1
    assert told[-1] == f"1: {contents.MAX_FAULTS} faults so far; mend these first"


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ("<scene>" + "<a>" * 100_000, "a: more than 64 elements in another"),
        ("<scene><camera>" + "<a/>" * 100_000, "camera: more than 64 elements in another"),
        (
            "<scene><image>" + "1 " * 1_000_000,
            "image: more than 1048576 characters; make it shorter",
        ),
        (
            f"<scene>{EMPTY}<!--" + "x" * 2_000_000,
            "a tag or comment of more than 1048576 bytes; make it shorter",
        ),
        (
            f"<scene>{EMPTY}<!--{'x' * 2_000_000}--></scene>",
            "a tag or comment of more than 1048576 bytes; make it shorter",
        ),
        (
            f'<scene>{EMPTY}<shader name="' + "x" * 2_000_000,
            "a tag or comment of more than 1048576 bytes; make it shorter",
        ),
    ],
    ids=["nesting", "children", "text", "comment", "whole comment", "attribute"],
)
def test_what_would_eat_memory_or_time(faults, content, fault):
    assert faults(content) == [f"1: {fault}"]


@pytest.mark.parametrize(
    ("levels", "fault"),
    [
        (64, "a: unknown in scene; known: camera, image, light, shader, surface"),
        (65, "a: more than 64 elements in another"),
    ],
)
def test_deepest_nesting(faults, levels, fault):
    inside = levels - 1
    assert faults(f"<scene>{EMPTY}{'<a>' * inside}{'</a>' * inside}</scene>") == [f"1: {fault}"]


@pytest.mark.parametrize(("count", "fault"), [(64, "b: unknown"), (65, "surface: more")])
def test_most_children(faults, count, fault):
    told = faults(f"<scene>{EMPTY}<surface type='Sphere'>{'<b/>' * count}</surface></scene>")
    assert told[-1].startswith(f"1: {fault}")


BOMBS = {
    "entities of entities": '<!ENTITY a "ha">'
    + "".join(
        f'<!ENTITY {outer} "{f"&{inner};" * 10}">'
        for inner, outer in zip("abcdefghi", "bcdefghij", strict=True)
    ),
    "parameter entities": '<!ENTITY % a "ha"><!ENTITY % b "&#37;a;&#37;a;">%b;',
    "a large entity": f'<!ENTITY a "{"ha" * 1_000_000}">',
    "a foreign file": '<!ENTITY a SYSTEM "file:///dev/zero">',
    "many attributes": "".join(f'<!ATTLIST scene a{i} CDATA "">' for i in range(100_000)),
}


@pytest.mark.parametrize("declarations", BOMBS.values(), ids=BOMBS)
def test_bombs(faults, declarations):
    assert faults(f"<!DOCTYPE scene [{declarations}]>\n<scene>&j;&a;</scene>") == [
        "1: DOCTYPE: declarations are not allowed; write out what entities stand for"
    ]


def test_few_shaders_get_a_suggestion(faults, monkeypatch):
    """It takes long to find, among many."""
    calls = []
    nearest = contents._nearest
    monkeypatch.setattr(contents, "_nearest", lambda *a: calls.append(a) or nearest(*a))
    defined = "".join(f'<shader name="a{i}" type="Phong"/>' for i in range(9))
    used = "".join(SPHERE.format(f'<shader ref="a{i}b"/>') for i in range(99))
    told = faults(f"<scene>{EMPTY}{defined}{used}</scene>")
    assert told[0] == "1: shader: no shader is named 'a0b'; did you mean 'a0'?"
    assert told[98] == "1: shader: no shader is named 'a98b'; define it"
    assert len(told) == 99
    assert len(calls) < 40


def test_largest_file(tmp_path):
    path = tmp_path / "large.xml"
    with path.open("wb") as file:
        file.truncate(reader.MAX_BYTES + 1)  # sparse: takes no room
    assert faults_of(path) == ["has 268435457 bytes; at most 268435456 are allowed"]


# What is no readable file


def test_missing(tmp_path):
    fault = "cannot be read: No such file or directory; check the path and its permissions"
    assert faults_of(tmp_path / "none.xml") == [fault]


def test_empty(tmp_path):
    (tmp_path / "empty.xml").touch()
    fault = "is empty; a scene file holds <scene> ... </scene>"
    assert faults_of(tmp_path / "empty.xml") == [fault]


def test_folder(tmp_path):
    assert faults_of(tmp_path) == ["is a folder; name a scene file in it"]


@pytest.mark.parametrize("kind", ["pipe", "socket", "device"])
def test_no_regular_file(tmp_path, kind):
    path = tmp_path / kind
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(str(path))
    else:
        path.symlink_to("/dev/zero")
    assert faults_of(path) == ["is not a regular file; save the scene to one"]


def test_link_to_itself(tmp_path):
    path = tmp_path / "loop.xml"
    path.symlink_to(path)
    fault = "cannot be read: Too many levels of symbolic links; check the path and its permissions"
    assert faults_of(path) == [fault]


def test_unreadable(tmp_path):
    """As a user without privileges: root may read everything."""
    path = tmp_path / "secret.xml"
    path.write_text(f"<scene>{EMPTY}</scene>")
    path.chmod(0)
    script = f"""
import os
from tracer import SceneFileError, load_scene
os.chdir({str(tmp_path)!r})
if os.geteuid() == 0:
    os.setuid(65534)
try:
    load_scene({path.name!r})
except SceneFileError as error:
    print(error)
"""
    # The folders above the file may be closed to others: start inside, with modules loaded.
    tmp_path.chmod(0o755)
    process = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    fault = "secret.xml: cannot be read: Permission denied; check the path and its permissions\n"
    assert process.stdout == fault


def test_a_name_with_a_nul():
    with pytest.raises(SceneFileError, match=r"^a\\x00b: no path has a NUL in it; check the path$"):
        load_scene("a\0b")


def test_a_name_in_bytes():
    with pytest.raises(SceneFileError, match=r"^none\\udcff\.xml: cannot be read: No such file"):
        load_scene(b"none\xff.xml")


def test_what_is_no_name():
    with pytest.raises(TypeError, match="not int"):
        load_scene(0)


def test_a_name_that_cannot_be_encoded():
    fault = r"^\\ud800: no path has half of a surrogate pair in it; check the path$"
    with pytest.raises(SceneFileError, match=fault):
        load_scene("\ud800")


def test_no_name():
    with pytest.raises(SceneFileError, match=r"^'': cannot be read: No such file or directory;"):
        load_scene("")


def test_a_name_with_a_new_line_still_makes_one_line(tmp_path):
    with pytest.raises(SceneFileError) as caught:
        load_scene(tmp_path / "a\nb\x1b[31m.xml")
    assert str(caught.value).count("\n") == 0
    assert str(caught.value).startswith(f"{tmp_path}/a\\nb\\x1b[31m.xml: cannot be read")
