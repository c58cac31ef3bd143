"""Every error in a scene file is reported in a line of its own, and never by a traceback."""

import ast
import io
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from test_model import ARRAYS

import tracer
from tracer import SceneFileError, load_scene

MESSAGES = Path(__file__).with_name("messages.txt")
EMPTY = "<camera/><image>4 4</image>"
SPHERE = '<surface type="Sphere">{}</surface>'


def read_errors(source: str | bytes | Path) -> list[str]:
    """Return the lines of the error in a file or stream, without the name of the file."""
    name = f"{source}" if isinstance(source, Path) else "<stream>"
    content = source.encode() if isinstance(source, str) else source
    with pytest.raises(SceneFileError) as caught:
        load_scene(content if isinstance(content, Path) else io.BytesIO(content))
    lines = str(caught.value).split("\n")
    assert list(caught.value.lines) == lines
    for line in lines:
        assert line.startswith(f"{name}:")
        assert line.isprintable()
    return [line.removeprefix(f"{name}:").strip() for line in lines]


def collect_messages(content: str | bytes) -> list[str]:
    """Return all messages about the content of a case in `messages.txt`."""
    if isinstance(content, str) and content.startswith(">>> "):
        names = {name: getattr(tracer, name) for name in tracer.__all__} | {"np": np}
        names["surfaces"] = lambda **arrays: tracer.Surfaces(**ARRAYS | arrays)
        names |= {"scene": tracer.Scene(width=4, height=3), "io": io}
        with pytest.raises((AttributeError, TypeError, ValueError)) as caught:
            eval(content.removeprefix(">>> "), names)
        is_scene_error = isinstance(caught.value, tracer.SceneError)
        prefix = "" if is_scene_error else f"{type(caught.value).__name__}: "
        return [f"{prefix}{line}" for line in str(caught.value).split("\n")]
    with warnings.catch_warnings(record=True) as scene_warnings:
        warnings.simplefilter("always", tracer.SceneWarning)
        with suppress(SceneFileError):
            scene = load_scene(
                io.BytesIO(content.encode() if isinstance(content, str) else content)
            )
            tracer.render(scene)
            return [f"warning: {warning.message}" for warning in scene_warnings] or ["no message"]
    return read_errors(content)


def read_cases() -> Iterator[tuple[str, str | bytes, list[str]]]:
    """Yield each case of `messages.txt`: its text there, its content, and the expected messages."""
    text = re.sub(r"^\n?# .*\n", "", MESSAGES.read_text(encoding="utf-8"), flags=re.M)
    for case, expected in re.findall(r"((?:(?!=> ).*\n)+)((?:=> .*\n)+)", text):
        content = case.removesuffix("\n")
        if content.startswith("+ "):
            content = f"<scene>{EMPTY}\n{re.sub('^[+] ', '', content, flags=re.M)}\n</scene>"
        elif content.startswith("b'"):
            content = ast.literal_eval(content)
        yield case, content, re.findall("^=> (.*)", expected, re.M)


def is_expected(lines: list[str], expected: list[str]) -> bool:
    """Test whether messages are those of a case; "..." at the end matches any text."""
    return len(lines) == len(expected) and all(
        line.startswith(start.removesuffix("...")) and (start.endswith("...") or line == start)
        for line, start in zip(lines, expected, strict=True)
    )


@pytest.mark.parametrize(("content", "expected"), [case[1:] for case in read_cases()])
def test_wording(content, expected):
    lines = collect_messages(content)
    assert lines == expected or is_expected(lines, expected)
    # In the first line, the byte order mark of UTF-16 counts as a column.  Remedies are for UTF-8.
    is_text = isinstance(content, str) and content.startswith("<") and "encoding=" not in content
    if is_text and not expected[-1].startswith("1: not XML"):
        same = [re.sub("(not XML.*?);.*", r"\1", line) for line in expected]
        lines = collect_messages(content.encode("utf-16"))
        assert [re.sub("(not XML.*?);.*", r"\1", line) for line in lines] == same


def test_numbers_of_many_digits():
    """The first has more digits than int() reads; float() would round the second to 0."""
    large, small = f"1{'0' * 5000}", f"0.{'0' * 400}1"
    camera = f"<camera><viewPoint>0 {small} 0</viewPoint></camera>"
    assert read_errors(f"<scene>{camera}<image>{large} 1</image></scene>") == [
        f"1: viewPoint: '{small[:37]}...' is too small, and would count as 0; write 0 in its place",
        "1: image: needs two whole numbers, width and height, as in 640 480;"
        f" has '{large[:37]}...'",
    ]


def test_a_long_stray_text_is_one_error():
    text = " \n" + "stray text of many words " * 100_000
    assert read_errors(f"<scene>{EMPTY}{text}<light>{text}</light></scene>") == [
        "2: scene: stray text 'stray text of many words stray text o...'; remove it",
        "2: light: has no position; add <position>x y z</position>",
        "3: light: stray text 'stray text of many words stray text o...'; remove it",
    ]


# Limits


def test_the_number_of_errors_is_bounded():
    lines = read_errors(f"<scene>{EMPTY}" + "\n<a/>" * 100_000)
    assert lines[1000:] == ["1001: 1000 errors so far; fix these first"]
    box = '<surface type="Box"><minPt>0 0 0</minPt><maxPt>{}</maxPt></surface>'
    boxes = box.format("1 1 1") * 2 + box.format("1 1 x")
    lines = read_errors(f"<scene>{EMPTY}" + "\n<a/>" * 1000 + boxes)
    assert lines[1000:] == ["1001: 1000 errors so far; fix these first"]


TOKEN = "a tag or comment of more than 1048576 bytes; make it shorter"
TOO_MANY = "contains more than 64 elements or attributes; close the <{0}> on line 1 sooner, or"
ATTRIBUTES = " ".join(f'a{k}=""' for k in range(65))

LIMITS = {
    "deepest": (f"{'<a>' * 65}{'</a>' * 65}", "a: unknown in scene; known:"),
    "too deep": (f"{'<a>' * 66}{'</a>' * 66}", f"a: {TOO_MANY.format('a')}"),
    "nesting": ("<a>" * 100_000, f"a: {TOO_MANY.format('a')}"),
    "most": (SPHERE.format("<b/>" * 64), "b: unknown in Sphere; known:"),
    "too many": (SPHERE.format("<b/>" * 65), f"surface: {TOO_MANY.format('surface')}"),
    "tree": (f"<light>{'<a><b/></a>' * 33}", f"light: {TOO_MANY.format('light')}"),
    "attributes": (f"<a {ATTRIBUTES}/>", f"a: {TOO_MANY.format('a')}"),
    "text": ("<image>" + "1 " * 1_000_000, "image: more than 1048576 characters; make"),
    "comment": (f"<!--{'x' * 2_000_000}", TOKEN),
    "whole comment": (f"<!--{'x' * 2_000_000}-->", TOKEN),
    "attribute": (f'<shader name="{"x" * 2_000_000}', TOKEN),
}


@pytest.mark.parametrize(("content", "message"), LIMITS.values(), ids=LIMITS)
def test_limits_of_memory_and_time(content, message):
    assert read_errors(f"<scene>{EMPTY}{content}</scene>")[-1].startswith(f"1: {message}")


# Files that cannot be read


UNREADABLE: dict[str, Callable[[Path], object]] = {
    "cannot be read: No such file or directory; check the path": lambda path: None,
    "cannot be read: Too many levels of symbolic links": lambda path: path.symlink_to(path),
    "is empty; a scene file holds <scene>": Path.touch,
    "is a folder; name a scene file in it": Path.mkdir,
    # A sparse file, which takes no space.
    "has 268435457 bytes; at most 268435456 are": lambda p: p.touch() or os.truncate(p, 2**28 + 1),
    "is not a regular file; save the scene to one": os.mkfifo,
    "is not a regular": lambda path: path.symlink_to("/dev/zero"),
}


@pytest.mark.parametrize(("message", "make_file"), UNREADABLE.items())
def test_a_file_that_cannot_be_read(tmp_path, make_file, message):
    make_file(tmp_path / "a.xml")
    (line,) = read_errors(tmp_path / "a.xml")
    assert line.startswith(message)


# Streams


class Pipe(io.BytesIO):
    """A stream without seek.  Each read returns at most 1,000 bytes."""

    name = 3
    seek = None  # type: ignore[assignment]

    def read(self, size: int | None = -1, /) -> bytes:
        return super().read(min(size or 0, 1000))


def test_streams(tmp_path, monkeypatch):
    content = b"<scene>\n<camera/>" + b"<!-- many -->\n" * 9000 + b"<image\n>4 3</image\n</scene>"
    with pytest.raises(SceneFileError) as caught:
        load_scene(Pipe(content))
    invalid = "not XML: not well-formed (invalid token) at column 1"
    assert str(caught.value) == f"<stream>:9004: {invalid}; end the tag on line 9003 with >"
    path = tmp_path / "scene.xml"
    path.write_text("<scene>")
    with path.open("rb") as file, pytest.raises(SceneFileError) as caught:
        load_scene(file)
    assert str(caught.value).startswith(f"{file.name}:1: not XML")
    monkeypatch.setattr("tracer.scene.elements.MAX_BYTES", 100)
    assert read_errors("<scene>" + " " * 100) == ["has more than the 100 bytes allowed"]


NAMES = [f"red{'d' * 10_000}{k}" for k in range(250)]
SHADERS = "".join(f'<shader name="{name}" type="Phong"/>' for name in NAMES)

LARGE = {
    "lights": ("<light><position>1 2 3</position></light>" * 5000, 50 * 5000),
    "shaders": (SHADERS, 50 * 250),
    # A comparison of two names takes four calls or more: 900 times 250 would take 900,000.
    "misspelt": (SHADERS + "".join(SPHERE.format(f'<shader ref="rad{k}"/>') for k in range(900)),
                 300_000),
    # 32 names are compared with 256 of these: with all, it would take 5,700,000 calls.
    "many names": ("".join(f'<shader name="red{k}" type="Phong"/>' for k in range(5000))
                   + "".join(SPHERE.format(f'<shader ref="rad{k}"/>') for k in range(40)),
                   800_000),
    "numbers": ("<light><position>" + "1 " * 100_000 + "</position></light>", 1000),
    "a wrong number": ("<light><position>" + "1 " * 100_000 + "x</position></light>", 1000),
}  # fmt: skip


@pytest.mark.parametrize(("content", "max_calls"), LARGE.values(), ids=LARGE)
def test_a_large_file_takes_few_calls(content, max_calls):
    calls = 0

    def count(_frame: object, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    file = io.BytesIO(f"<scene>{EMPTY}{content}</scene>".encode())
    load_scene(io.BytesIO(f"<scene>{EMPTY}</scene>".encode()))  # imports modules
    sys.setprofile(count)
    try:
        with suppress(SceneFileError):
            load_scene(file)
    finally:
        sys.setprofile(None)
    # In an empty file there are up to 1,000 calls, and as many again while shapes are checked.
    assert 0 < calls < max_calls + 4000
