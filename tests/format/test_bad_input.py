"""Every fault of a scene file is reported in a line of its own, and never by a traceback."""

from __future__ import annotations

import io
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from tracer import SceneFileError, load_scene

FAULTS = Path(__file__).with_name("faults.txt")
EMPTY = "<camera/><image>4 3</image>"
SPHERE = '<surface type="Sphere">{}</surface>'


def faults_of(path) -> list[str]:
    """The lines of the error, without the name of the file."""
    with pytest.raises(SceneFileError) as caught:
        load_scene(path)
    lines = str(caught.value).split("\n")
    assert list(caught.value.lines) == lines
    for line in lines:
        assert line.startswith(f"{path}:")
        assert line.isprintable()
    return [line.removeprefix(f"{path}:").strip() for line in lines]


@pytest.fixture
def faults(tmp_path) -> Callable[[str | bytes], list[str]]:
    def read(content: str | bytes) -> list[str]:
        path = tmp_path / "scene.xml"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return faults_of(path)

    return read


def cases() -> Iterator[tuple[str, str, list[str]]]:
    """Cases of `faults.txt`: as they stand there, contents of files, and what is reported."""
    text = re.sub(r"^\n?# .*\n", "", FAULTS.read_text(encoding="utf-8"), flags=re.M)
    for case, told in re.findall(r"((?:(?!=> ).*\n)+)((?:=> .*\n)+)", text):
        content = case.removesuffix("\n")
        if content.startswith("+ "):
            content = f"<scene>{EMPTY}\n{re.sub('^[+] ', '', content, flags=re.M)}\n</scene>"
        yield case, content, re.findall("^=> (.*)", told, re.M)


def rewrite() -> None:
    """Write what is reported of each case to `faults.txt`."""
    text = FAULTS.read_text(encoding="utf-8")
    warnings.simplefilter("error")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "scene.xml")
        for case, content, told in cases():
            path.write_text(content, encoding="utf-8")
            old, new = (
                "".join(f"=> {line}\n" for line in lines) for lines in (told, faults_of(path))
            )
            text = text.replace(f"\n{case}{old}", f"\n{case}{new}")
    FAULTS.write_text(text, encoding="utf-8")


@pytest.mark.parametrize(("content", "told"), [case[1:] for case in cases()])
def test_wording(faults, content, told):
    assert faults(content) == told
    # In the first line the mark of UTF-16 counts as a column, and remedies are for UTF-8.
    if not told[-1].startswith("1: not XML"):
        same = [re.sub("(not XML.*?);.*", r"\1", line) for line in told]
        told = faults(content.encode("utf-16"))
        assert [re.sub("(not XML.*?);.*", r"\1", line) for line in told] == same


# What faults.txt cannot hold: a file, the line, a key part of what is reported.
OTHERS = [
    *(
        (f'<scene>\n<surface{odd}type="Box"/></scene>', 2, rf"plain character .*U\+{ord(odd):04X}")
        for odd in "\u00a0\u200b\u3000\uff0f"
    ),
    ('\n<?xml version="1.0">\n', 2, r"unclosed token at column 1; end it with \?>"),
    (" \n ", 2, "no element found at column 2; a scene file holds <scene>"),
    (b"<scene>\n\xff</scene>", 2, "column 1; save the file as UTF-8$"),
    (b"<scene>\n<!-- \xff --></scene>", 2, "column 6; save the file as UTF-8$"),
    ("<scene>\n<!-- \x01 --></scene>", 2, "column 6; remove the control character"),
    (b"<scene>\n\0</scene>", 2, "column 1; save the file as UTF-8, and without a NUL"),
    ("<scene>\na</scene>".encode("utf-32"), 1, "and without a NUL"),
    ("<scene>\na</scene>".encode("utf-32-be"), 1, "and without a NUL"),
    ('\n<?xml version="1.0"?><scene/>', 2, "nothing may stand before <[?]xml"),
    (f'\n<!DOCTYPE scene SYSTEM "a.dtd">\n<scene>{EMPTY}&lol;</scene>', 2, "remove the DOCTYPE"),
    # How a PNG begins, a JPEG, and a file that gzip made.
    *(
        (begins, 1, "column 1; a scene file holds <scene>")
        for begins in (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0", b"\x1f\x8b\x08\x08")
    ),
    # Digits of another script, spaces that XML does not know, numbers copied from a page.
    *(
        (f"<scene>\n<light><position>{text}</position></light></scene>", 2, f"position: {fault}")
        for text, fault in (
            ("\u0663 0 0", "'\u0663' is no decimal number"),
            ("1\u20032 3 4", r"'1\\u20032' is no decimal number"),
            ("1\u00a02 3", r"'1\\xa02' is no decimal number"),
        )
    ),
    # Pictures and cameras.
    *(
        (f"<scene><camera/>\n<image>{text}</image></scene>", 2, f"image: {fault}")
        for text, fault in (
            ("4", "needs two whole numbers, width and height, as in 640 480; has '4'"),
            ("", "needs two whole numbers.*; has ''"),
            ("4.0 3", "needs two whole numbers.*; has '4.0 3'"),
            ("1e2 3", "needs two whole numbers.*; has '1e2 3'"),
            ("4 3 2", "needs two whole numbers.*; has '4 3 2'"),
            ("0 3", "width: must be a whole number from 1 to 268435456, is 0"),
            ("4 -3", "height: must be a whole number from 1 to 268435456, is -3"),
            ("16384 16385", "width, height: 16384 x 16385 pixels .* would take 6 GiB of memory"),
            ("1000000 1000000", "width, height: .* 2.24e[+]04 GiB.*; at most 268435456 pixels"),
            (f"1{'0' * 5000} 1", "needs two whole numbers"),
        )
    ),
    *(
        (f"<scene><image>4 3</image>\n<camera>{content}</camera></scene>", 2, fault)
        for content, fault in (
            ("<viewDir>0 0 0</viewDir>", "viewDir: must not be the zero vector"),
            ("<viewUp>0 -0 0</viewUp>", "viewUp: must not be the zero vector"),
            ("<projNormal>0 0 0</projNormal>", "projNormal: must not be the zero vector"),
            ("<viewPoint>0 0 1e999</viewPoint>", "viewPoint: must be finite"),
            ("<viewPoint>1e+80 0 0</viewPoint>", "viewPoint: 1e[+]80 is too large; lengths"),
            ("<viewWidth>1e-80</viewWidth>", "viewWidth: 1e-80 is too small; lengths"),
            ("<projDistance>0</projDistance>", "projDistance: must be positive, is 0"),
            ("<viewWidth>-1</viewWidth>", "viewWidth: must be positive, is -1"),
            ("<viewHeight>0</viewHeight>", "viewHeight: must be positive, is 0"),
            ("<viewUp>0 0 3</viewUp>", "viewUp: .* parallel to viewDir; choose another viewUp"),
            ("<viewUp>0 1e-15 1</viewUp>", "viewUp: must not be parallel to viewDir"),
            # The default viewUp is not in the file: the camera is to blame.
            ("<viewDir>0 -2 0</viewDir>", "viewUp: must not be parallel to viewDir"),
            (
                "<viewUp>1 0 1</viewUp><projNormal>-2 0 -2</projNormal>",
                "viewUp: must not be parallel to projNormal",
            ),
            ("<projNormal>1 0 0</projNormal>", "projNormal: must not be perpendicular to viewDir"),
        )
    ),
]


@pytest.mark.parametrize(("content", "line", "key"), OTHERS)
def test_line_and_key(faults, content, line, key):
    told = [fault for fault in faults(content) if re.match(f"{line}: ", fault)]
    assert [fault for fault in told if re.search(key, fault)] == told[:1]


def test_a_long_stray_text_is_one_fault(faults):
    text = " \n" + "stray text of many words " * 100_000
    assert faults(f"<scene>{EMPTY}{text}<light>{text}</light></scene>") == [
        "2: scene: stray text 'stray text of many words stray text o...'; remove it",
        "2: light: has no position; add <position>x y z</position>",
        "3: light: stray text 'stray text of many words stray text o...'; remove it",
    ]


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
        expected += [
            f"{line}: center: ';' is no decimal number; write it as 2, -.5 or 1e-3"
        ] * words.count(";")
        if len(words) != 3 and ";" not in words:
            expected.append(f"{line}: center: needs 3 numbers, has {len(words)}")
    assert faults(f"<scene>{content}{EMPTY}</scene>") == expected


# Limits


def test_the_number_of_faults_told_is_bounded(faults):
    told = faults(f"<scene>{EMPTY}{'<a/>' * 100_000}</scene>")
    assert len(told) == 1000 + 1
    assert told[-1] == f"1: {1000} faults so far; mend these first"


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
    ("content", "fault"),
    [
        ("<a>" * 63 + "</a>" * 63, "a: unknown in scene; known:"),
        ("<a>" * 64 + "</a>" * 64, "a: more than 64 elements in another"),
        (SPHERE.format("<b/>" * 64), "b: unknown in Sphere; known:"),
        (SPHERE.format("<b/>" * 65), "surface: more than 64 elements in another"),
    ],
    ids=["deepest", "too deep", "most", "too many"],
)
def test_deepest_nesting_and_most_children(faults, content, fault):
    assert faults(f"<scene>{EMPTY}{content}</scene>")[-1].startswith(f"1: {fault}")


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


# What is no readable file


def a_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


@pytest.mark.parametrize(
    ("make", "fault"),
    [
        (
            lambda path: None,
            "cannot be read: No such file or directory; check the path and its permissions",
        ),
        (Path.touch, "is empty; a scene file holds <scene> ... </scene>"),
        (Path.mkdir, "is a folder; name a scene file in it"),
        # Sparse: takes no room.
        (
            lambda path: path.touch() or os.truncate(path, 2**28 + 1),
            "has 268435457 bytes; at most 268435456 are allowed",
        ),
        (os.mkfifo, "is not a regular file; save the scene to one"),
        (a_socket, "is not a regular file; save the scene to one"),
        (
            lambda path: path.symlink_to("/dev/zero"),
            "is not a regular file; save the scene to one",
        ),
        (
            lambda path: path.symlink_to(path),
            "cannot be read: Too many levels of symbolic links; check the path and its permissions",
        ),
    ],
    ids=["none", "empty", "folder", "too large", "pipe", "socket", "device", "link to itself"],
)
def test_no_readable_file(tmp_path, make, fault):
    make(tmp_path / "a.xml")
    assert faults_of(tmp_path / "a.xml") == [fault]


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


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("a\0b", r"a\x00b: no path has a NUL or half of a surrogate pair in it; check the path"),
        ("\ud800", r"\ud800: no path has a NUL or half of a surrogate pair in it; check the path"),
        (b"none\xff.xml", r"none\udcff.xml: cannot be read: No such file"),
        ("", "'': cannot be read: No such file or directory;"),
        ("a\nb\x1b[31m.xml", r"a\nb\x1b[31m.xml: cannot be read"),
    ],
)
def test_odd_names(name, told):
    with pytest.raises(SceneFileError) as caught:
        load_scene(name)
    assert str(caught.value).startswith(told)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("source", "wrong"), [(0, "not int"), (io.StringIO("<a/>"), "binary file")]
)
def test_what_no_scene_is_read_from(source, wrong):
    with pytest.raises(TypeError, match=wrong):
        load_scene(source)


# Files that are open already


class Pipe(io.BytesIO):
    """What can only be read on, and gives few bytes at a time."""

    name = 3

    def read(self, size: int | None = -1, /) -> bytes:
        return super().read(min(size or 0, 1000))

    def seek(self, *_: object) -> int:
        raise AssertionError


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "<stream>: is empty; a scene file holds <scene> ... </scene>"),
        (b"<scene><image>0 1</image><camera/></scene>", "<stream>:1: image: width: must be"),
        (
            b"<scene>\n<camera/>" + b"<!-- many -->\n" * 9000 + b"<image\n>4 3</image\n</scene>",
            "<stream>:9004: not XML: not well-formed (invalid token) at column 1;"
            " end the tag of line 9003 with >",
        ),
    ],
)
def test_a_stream(content, told):
    with pytest.raises(SceneFileError) as caught:
        load_scene(Pipe(content))
    assert str(caught.value).startswith(told)


def test_a_stream_has_a_name_and_a_limit(tmp_path, monkeypatch):
    path = tmp_path / "scene.xml"
    path.write_text("<scene>")
    with path.open("rb") as file, pytest.raises(SceneFileError) as caught:
        load_scene(file)
    assert str(caught.value).startswith(f"{file.name}:1: not XML")
    monkeypatch.setattr("tracer.scene.elements.MAX_BYTES", 100)
    with pytest.raises(SceneFileError, match=r"^<stream>: has more than 100 bytes"):
        load_scene(io.BytesIO(b"<scene>" + b" " * 100))


def test_too_little_memory_is_an_error_of_its_own(monkeypatch):
    def no_memory(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("tracer.scene.reader._numbers", no_memory)
    with pytest.raises(MemoryError):
        load_scene(
            io.BytesIO(f"<scene>{EMPTY}{SPHERE.format('<radius>1</radius>')}</scene>".encode())
        )


@pytest.mark.parametrize(
    "line",
    [
        "<light><position>1 2 3</position></light>",
        '<shader name="{}" type="Phong"/>',
        '<surface type="Sphere"><shader ref="{}"/></surface>',
    ],
    ids=["lights", "shaders", "undefined"],
)
def test_many_are_read_in_little_time(line):
    """A fraction of the time that checking one by one would take: 20 to 40 us each."""
    body = "".join(map(line.format, range(50_000)))
    start = time.process_time()
    with suppress(SceneFileError):
        load_scene(io.BytesIO(f"<scene>{EMPTY}{body}</scene>".encode()))
    assert time.process_time() - start < 1


if __name__ == "__main__":
    rewrite()
