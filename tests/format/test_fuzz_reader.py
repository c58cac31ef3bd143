"""Every file either is read as a scene or raises an error with readable lines."""

import io
from typing import Any

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from test_reader import EVERYTHING

import tracer
from tracer import Box, Camera, Phong, PointLight, Scene, Sphere, load_scene, render, save_scene

VALID = EVERYTHING.encode()

# Pieces that may cause trouble in a reader of XML, of numbers, or of this format.
PIECES = [
    *(line.strip() for line in VALID.splitlines()),
    *VALID.replace(b">", b"> ").replace(b"<", b" <").split(),
    b"<", b">", b"</", b"/>", b"=", b'"', b"'", b"&", b"&amp;", b"&#0;", b"&#x110000;", b"&lol;",
    b"<!--", b"-->", b"<![CDATA[", b"]]>", b"<?", b"?>", b"<!DOCTYPE scene [", b"]>",
    b'<!ENTITY lol "&lol;">', b'<!ATTLIST surface type CDATA "Sphere">', b"a:b",
    b'xmlns="x"', b'xmlns:a="x"', b"nan", b"inf", b"1e999", b"-1e999", b"1e-999", b"0x10", b"1_0",
    b"-0", b"9" * 400, b"1,5",
    b"\0", b"\xff", b"\xef\xbb\xbf", b"\xff\xfe", b"\xc2\xa0", b"\xd9\xa3", b"\r", b"\x0b", b"\x85",
    b'encoding="utf-16"', b'encoding="rot13"', b'encoding="utf-7"', b'encoding="idna"',
    b'encoding="undefined"', b'encoding="cp037"', b"<a>" * 100, b"<a/>" * 100,
]  # fmt: skip


@st.composite
def mutate_file(draw: st.DrawFn) -> bytes:
    """Draw a copy of the valid file in which a few pieces are removed, inserted or repeated."""
    content = VALID
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(content)))
        end = start + draw(st.sampled_from([0, 0, 1, 2, 5, 20, 100]))
        filling = draw(
            st.sampled_from(PIECES) | st.binary(max_size=8) | st.just(content[start:end] * 2)
        )
        content = content[:start] + filling + content[end:]
    return content


def check_reader(content: bytes) -> None:
    """Check that a file is refused with readable lines, or that its scene survives saving."""
    try:
        scene = load_scene(io.BytesIO(content))
    except tracer.SceneFileError as error:
        lines = str(error).split("\n")
        assert all(line.startswith("<stream>:") and line.isprintable() for line in lines)
        assert content != VALID
        return
    save_scene(scene, file := io.BytesIO())
    file.seek(0)
    assert load_scene(file) == scene


@settings(max_examples=20 * settings.default.max_examples)
@given(mutate_file())
@example(VALID)
def test_mutated_files(content):
    check_reader(content)


@settings(max_examples=10 * settings.default.max_examples)
@given(
    st.binary(max_size=200)
    | st.tuples(
        st.sampled_from([b"", b"<scene><camera/><image>4 3</image>"]),
        st.lists(st.sampled_from(PIECES), max_size=20).map(b" ".join),
        st.sampled_from([b"", b"</scene>"]),
    ).map(b"".join)
)
def test_files_of_random_pieces(content):
    check_reader(content)


def construct(dataclass: type, values: dict[str, Any], **required: Any) -> Any:
    """Construct an object from all values, or only from the required ones if others are invalid."""
    try:
        return dataclass(**values, **required)
    except tracer.SceneError:
        return dataclass(**required)


SIZES = st.sampled_from([1e-75, 1e-20, 0.5, 1.0, 3.0, 1e20, 1e75])
AMOUNTS = SIZES | st.sampled_from([0.0, 1e300])
POINTS, COLORS = (
    st.tuples(*[each] * 3)
    for each in (st.builds(float.__mul__, SIZES, st.sampled_from([-1.0, 0.0, 1.0])), AMOUNTS)
)
CAMERAS = st.fixed_dictionaries(
    dict.fromkeys(("view_point", "view_dir", "view_up"), POINTS)
    | dict.fromkeys(("proj_distance", "view_width", "view_height"), SIZES)
).map(lambda values: construct(Camera, values))
LIGHTS = st.builds(lambda p, c: construct(PointLight, {"intensity": c}, position=p), POINTS, COLORS)
SHADERS = st.fixed_dictionaries({"diffuse": COLORS, "specular": COLORS, "exponent": AMOUNTS}).map(
    lambda values: construct(Phong, values)
)
SURFACES = st.builds(Sphere, center=POINTS, radius=SIZES, shader=SHADERS) | st.builds(
    lambda a, b, s: Box(min_pt=np.minimum(a, b), max_pt=np.maximum(a, b), shader=s),
    *(POINTS, POINTS, SHADERS),
)


@settings(max_examples=7 * settings.default.max_examples)
@given(CAMERAS, st.lists(LIGHTS, max_size=4), st.lists(SURFACES, max_size=4))
def test_pictures_of_extremes_are_finite(camera, lights, surfaces):
    scene = Scene(width=4, height=3, camera=camera, lights=lights, surfaces=surfaces)
    assert np.isfinite(render(scene)).all()
    assert np.isfinite(render(scene, samples=4)).all()
