"""Explanations of pixels, and warnings about scenes: both agree with the picture."""

import re
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from probe import record_calls, scene_of
from random_scenes import random_scene
from running import run
from scene_files import HARD_SCENES, small_scene

import tracer
from tracer import Box, Camera, Lambertian, PointLight, SceneWarning, Sphere, load_scene, render
from tracer.picture import explanation
from tracer.picture.lint import Exposure
from tracer.world.prepared_scene import PreparedScene

FILE = """<scene>
<camera><viewPoint>0 0 5</viewPoint></camera> <image>9 9</image>
<light><position>0 9 9</position></light>
<light><position>9 0 0</position></light>
<surface type="Box"><minPt>2 -1 -1</minPt><maxPt>3 1 1</maxPt></surface>
<surface type="Sphere"/>
</scene>
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return the path of a scene file with a sphere, a box and two lights."""
    scene = tmp_path / "scene.xml"
    scene.write_text(FILE)
    return scene


@pytest.mark.parametrize(
    "kind", ["scattered", "touching", "nested", "duplicated", "rooms", "grazing"]
)
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_explanations_agree_with_the_picture(kind, seed):
    scene = random_scene(kind, seed)
    image, codes = render(scene), tracer.to_codes(render(scene))
    for y, x in np.ndindex(scene.height, scene.width):
        pixel = tracer.explain(scene, x, y)
        assert pixel.radiance == tuple(image[y, x])
        assert pixel.codes == tuple(codes[y, x])
        terms = [np.add(light.diffuse, light.specular) for light in pixel.lights]
        np.testing.assert_allclose(sum(terms, np.zeros(3)), image[y, x], rtol=1e-12)
        assert (pixel.surface is None) == np.isinf(pixel.distance)
        assert len(pixel.lights) == (len(scene.lights) if pixel.surface else 0)
        if pixel.surface:
            hit = np.add(pixel.eye, np.multiply(pixel.distance, pixel.direction))
            np.testing.assert_allclose(hit, pixel.point, rtol=1e-9, atol=1e-9)
        for source, light, term in zip(scene.lights, pixel.lights, terms, strict=False):
            to_light, to_eye = np.subtract((source.position, pixel.eye), pixel.point)
            half = to_light / np.linalg.norm(to_light) + to_eye / np.linalg.norm(to_eye)
            n_dot_half = light.n_dot_h * np.linalg.norm(half)
            np.testing.assert_allclose(n_dot_half, half @ pixel.normal, atol=1e-6)
            if light.occluders:
                assert not any(term)
                continue
            diffuse = np.multiply(light.intensity, pixel.kd) * light.n_dot_l
            np.testing.assert_allclose(diffuse, light.diffuse, rtol=1e-9, atol=1e-10)
            power = max(light.n_dot_h, 0) ** pixel.exponent
            specular = np.multiply(light.intensity, pixel.ks) * power
            np.testing.assert_allclose(specular, light.specular, rtol=1e-7, atol=1e-9)


def test_an_explanation_names_occluders(path):
    pixel = tracer.explain(tracer.load_scene(path), 4, 4)
    assert str(pixel.surface) == "Sphere 1 (line 6)"
    assert pixel.distance == pytest.approx(4)
    assert (pixel.eye, pixel.direction) == ((0, 0, 5), (0, 0, -1))
    np.testing.assert_allclose((pixel.point, pixel.normal), [(0, 0, 1)] * 2, atol=1e-12)
    above, right = pixel.lights
    assert (above.line, above.occluders) == (3, ())
    assert above.n_dot_l == pytest.approx(8 / np.hypot(9, 8))
    assert (right.line, right.n_dot_l < 0) == (4, True)
    assert [str(ref) for ref in right.occluders] == ["Sphere 1 (line 6)"]
    # From farther right, the camera sees the side of the sphere that faces the second light.  The
    # box is between them.
    camera = Camera(view_point=(5, 0, 5), view_dir=(-4.2, 0, -4.4))
    (_, right) = tracer.explain(replace(tracer.load_scene(path), camera=camera), 4, 4).lights
    assert right.n_dot_l > 0
    assert [str(ref) for ref in right.occluders] == ["Box 0 (line 5)"]


def test_a_face_blocks_a_light_in_its_plane():
    """Test that the cosine is 0, and that the face itself is the occluder."""
    scene = replace(BALL, lights=[PointLight(position=(9, 0, 1))], surfaces=[CUBE])
    pixel = tracer.explain(scene, 4, 4)
    (light,) = pixel.lights
    assert (pixel.normal, light.n_dot_l, light.occluders) == ((0, 0, 1), 0, (pixel.surface,))


def test_a_pixel_is_traced_once(monkeypatch):
    samples = record_calls(monkeypatch, explanation, "nearest_hits", lambda _, samples: samples)
    scenes = record_calls(monkeypatch, PreparedScene, "__init__", lambda _, scene: scene)
    tracer.explain(BALL, 4, 4)
    assert ([sample.size for sample in samples], scenes) == ([1], [BALL])


def test_an_explanation_of_the_background(path):
    pixel = tracer.explain(tracer.load_scene(path), 0, 0)
    assert (pixel.surface, pixel.lights, pixel.radiance) == (None, (), (0, 0, 0))
    assert "none: the ray meets nothing" in str(pixel)


def test_the_command_explains_a_pixel_and_writes_no_picture(path):
    status, out, err = run(path, "--pixel", "4,4")
    assert (status, err) == (0, "")
    assert "surface   Sphere 1 (line 6)" in out
    assert "shader    kd 1 1 1, ks 0 0 0, exponent 1\n" in out
    assert re.search(r"light 0 \(line 3\): n.l = 0.66\d+, n.h = 0.91\d+, reaches the point\n", out)
    assert re.search(r"  diffuse   (0.66\d+) \1 \1 = 1 1 1 \* 1 1 1 \* \1\n", out)
    assert re.search(r"  specular  0 0 0 = 1 1 1 \* 0 0 0 \* 0.91\d+\^1\n", out)
    assert "light 1 (line 4): n.l = -" in out
    assert list(path.parent.iterdir()) == [path]
    for pixel in ("4,9", "9,0"):
        status, _, err = run(path, "--pixel", pixel)
        assert status == 1
        assert err.startswith(f"{path}: pixel {pixel} is outside the picture of 9 x 9 pixels")
    with pytest.raises(ValueError, match="pixel -1,0 is outside"):
        tracer.explain(tracer.load_scene(path), -1, 0)


BALL = scene_of(Sphere(), camera=Camera(view_point=(0, 0, 4)), size=(8, 8), lights=(3, 5, 4))
BLACK = "the picture is black"
NOTHING = f"no object is in view: {BLACK}; see viewPoint, viewDir and the window"
NO_LIGHT = f"the scene has no light: {BLACK}; add <light>"
DARK = f"no light reaches anything in view: {BLACK}; "
UNLIT = f"{DARK}see the lights' positions and intensities"
CAMERA = "see viewPoint, viewDir and the window"
BETWEEN = f"no pixel's centre sees an object: {BLACK}; try --samples 16, or {CAMERA}"
OFF = "has intensity 0 0 0: it has no effect; increase the intensity, or remove it"
COLOR = "diffuseColor 200 100 0 of surface 1 looks like 0 to 255; for 0 to 1, write 0.784 0.392 0"
INTENSITY = "intensity 255 255 255 of light 0 looks like 0 to 255; for 0 to 1, write 1 1 1"

GARISH = Lambertian(diffuse=(200, 100, 0))
CUBE, FLAT = (Box(min_pt=(-1, -1, -z), max_pt=(1, 1, z)) for z in (1, 0))
WIDE, TALL = (Box(min_pt=(-x, x - 4, -3), max_pt=(x, 4 - x, 5)) for x in (3, 1))


@pytest.mark.parametrize(
    ("change", "warning"),
    [
        ({"camera": Camera(view_point=(0, 0, -4))}, NOTHING),
        ({"surfaces": ()}, NOTHING),
        ({"lights": ()}, NO_LIGHT),
        ({"lights": (), "surfaces": ()}, NO_LIGHT),
        ({"lights": [PointLight(position=(0, 0, -9))]}, UNLIT),
        # One light inside a surface and one behind it; and two lights inside surfaces.
        ({"lights": [PointLight(position=(0, 0, z)) for z in (0, -9)]},
         f"light 0 is inside surface 0: it has no effect; move it out\n{UNLIT}"),
        ({"lights": [PointLight(position=(0, 0, z), line=9) for z in (0, 0.5)]},
         f"light 0 (line 9) is inside surface 0: it has no effect; move it out\n{UNLIT}"),
        ({"lights": [PointLight(position=(0, 0, 0))], "surfaces": [FLAT, CUBE]},
         f"light 0 is inside surface 1: it has no effect; move it out\n{UNLIT}"),
        ({"width": 600, "height": 600, "surfaces": [Sphere(center=(1.5, 0, 0), radius=0.1)],
          "lights": [PointLight(position=(1.5, 0, 0))]},
         f"light 0 is inside surface 0: it has no effect; move it out\n{UNLIT}"),
        # Lights that are off, all or one of two.
        ({"lights": [PointLight(position=(3, 5, 4), intensity=(0, 0, 0), line=9)]},
         f"light 0 (line 9) {OFF}\n{UNLIT}"),
        ({"lights": [*BALL.lights, PointLight(position=(3, 5, 4), intensity=(0, 0, 0), line=9)]},
         f"light 1 (line 9) {OFF}"),
        # One light of two inside a surface; the picture is not black.
        ({"lights": [*BALL.lights, PointLight(position=(0, 0, 0), line=9)]},
         "light 1 (line 9) is inside surface 0: it has no effect; move it out"),
        # Surfaces that are black, or of another colour than the light.
        ({"surfaces": [replace(CUBE, shader=Lambertian(diffuse=(0, 0, 0)), line=7),
                       Sphere(center=(99, 0, 0))]},
         f"all surfaces in view are black: {BLACK}; see the shader of surface 0 (line 7)"),
        ({"surfaces": [Sphere(shader=Lambertian(diffuse=(0, 1, 1)))],
          "lights": [PointLight(position=(3, 5, 4), intensity=(1, 0, 0))]},
         f"the surfaces in view reflect no colour of the lights: {BLACK};"
         " see the shader of surface 0"),
        # Objects between the centres of pixels, narrow and wide; and one beside a corner.
        *(({"surfaces": [surface]}, BETWEEN)
          for surface in (Sphere(radius=0.1), Box(min_pt=(0.01, -9, 0), max_pt=(0.02, 9, 0.01)),
                          Sphere(center=(2.75, 2.75, 0)))),
        # More than half of the lit pixels are clipped.
        ({"lights": [PointLight(position=(3, 5, 4), intensity=(2, 1.5, 3)), *BALL.lights]},
         "78 % of the pixels that are not black are brighter than 1, and clipped at 1 in a PNG"
         " file; lower the intensities, first that of light 0"),
        # The eye is inside a ball, and inside the first of two boxes.
        ({"camera": Camera()},
         f"{DARK}viewPoint is inside surface 0: move it out, or a light in"),
        ({"surfaces": [Sphere(center=(0, 0, -9)), WIDE, TALL]},
         f"{DARK}viewPoint is inside surface 1: move it out, or a light in"),
        # A shader is named by the first surface in the file that uses it.
        ({"surfaces": [FLAT, *2 * [Sphere(shader=GARISH)]]}, COLOR),
        ({"lights": [PointLight(position=(3, 5, 4), intensity=(255, 255, 255))]}, INTENSITY),
        ({"width": 12}, "12 x 8 pixels show a window of 1 x 1, stretched;"
         " viewWidth 1.5, or 8 columns, would make them square"),
        ({"width": 7}, "7 x 8 pixels show a window of 1 x 1, stretched;"
         " viewWidth 0.875, or 8 columns, would make them square"),
    ],
)  # fmt: skip
def test_scenes_that_warn(change, warning):
    with pytest.warns(SceneWarning) as caught:
        render(replace(BALL, **change))
    assert "\n".join(str(each.message) for each in caught) == warning
    assert caught[0].filename == __file__


@pytest.mark.filterwarnings("error::tracer.SceneWarning")
@pytest.mark.parametrize(
    "scene",
    [
        BALL,
        # Brighter than white in some pixels; black surfaces in front of others.
        replace(BALL, lights=[PointLight(position=(3, 5, 4), intensity=(1.3, 1, 1))]),
        replace(BALL, surfaces=[replace(CUBE, shader=Lambertian(diffuse=(0, 0, 0))),
                                Sphere(center=(0, 0, -9), radius=8)]),
        load_scene(HARD_SCENES / "light-on-a-table.xml"),
        # A room that contains the eye and the light.
        replace(BALL, surfaces=[Sphere(center=(9, 9, -9)), Sphere(radius=20)]),
        # Strong lights that are not 8-bit codes.
        *(replace(BALL, surfaces=[Sphere(shader=Lambertian(diffuse=(0.003, 0.003, 0.003)))],
                  lights=[PointLight(position=(3, 5, 4), intensity=(20, 20, blue))])
          for blue in (20.5, 256)),
        replace(BALL, width=100, height=104),
        replace(BALL, width=104, height=100),
        small_scene("room"),
    ],
)  # fmt: skip
def test_scenes_that_do_not_warn(scene):
    assert render(scene).shape == (scene.height, scene.width, 3)


def test_exposure_of_a_large_picture_is_estimated():
    image = np.zeros((200, 300, 3))
    assert Exposure.from_radiance(image) == Exposure(60_000)
    image[-1, -1] = 0.5  # is not among the examined pixels
    assert Exposure.from_radiance(image) == Exposure(60_000, lit_count=1)
    image[:100, :, 1] = 0.5
    image[:20, :, 2] = 1.5
    part = Exposure.from_radiance(image)
    assert part == pytest.approx((60_000, 30_000, 6_000), rel=0.01)


def test_exposure_of_a_small_picture_is_exact():
    image = np.zeros((9, 7, 3))
    image[:, 0] = 0.5
    image[:4, 1, 2] = 2
    assert Exposure.from_radiance(image) == Exposure(63, lit_count=13, clipped_count=4)


def test_a_notebook_shows_an_explanation_as_text():
    printer, pixel = Mock(), tracer.explain(BALL, 4, 4)
    pixel._repr_pretty_(printer, cycle=False)
    printer.text.assert_called_once_with(str(pixel))


def test_a_notebook_shows_a_scene_as_its_picture():
    assert BALL._repr_png_().startswith(b"\x89PNG\r\n")
