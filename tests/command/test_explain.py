"""Explanations of pixels, and warnings about scenes: both agree with the picture."""

import re
import shutil
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from probe import record_calls, scene_of
from random_scenes import random_scene
from running import run
from scene_files import HARD_SCENES

import tracer
from tracer import Box, Camera, PointLight, SceneWarning, Sphere, render
from tracer.picture import explanation
from tracer.picture.lint import Exposure
from tracer.world.prepared_scene import PreparedScene


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Copy the file of a scene with a sphere, a box and two lights to an empty folder."""
    return Path(shutil.copy(HARD_SCENES / "ball-between-a-box-and-two-lights.xml", tmp_path))


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
            half_vector = to_light / np.linalg.norm(to_light) + to_eye / np.linalg.norm(to_eye)
            n_dot_half = light.n_dot_h * np.linalg.norm(half_vector)
            np.testing.assert_allclose(n_dot_half, half_vector @ pixel.normal, atol=1e-6)
            if light.occluders:
                assert not any(term)
                continue
            diffuse = np.multiply(light.intensity, pixel.kd) * light.n_dot_l
            np.testing.assert_allclose(diffuse, light.diffuse, rtol=1e-9, atol=1e-10)
            highlight = max(light.n_dot_h, 0) ** pixel.exponent
            specular = np.multiply(light.intensity, pixel.ks) * highlight
            np.testing.assert_allclose(specular, light.specular, rtol=1e-7, atol=1e-9)


def test_an_explanation_names_occluders(path):
    pixel = tracer.explain(tracer.load_scene(path), 4, 4)
    assert str(pixel.surface) == "Sphere 1 (line 9)"
    assert pixel.distance == pytest.approx(4)
    assert (pixel.eye, pixel.direction) == ((0, 0, 5), (0, 0, -1))
    np.testing.assert_allclose((pixel.point, pixel.normal), [(0, 0, 1)] * 2, atol=1e-12)
    above, right = pixel.lights
    assert (above.line, above.occluders) == (6, ())
    assert above.n_dot_l == pytest.approx(8 / np.hypot(9, 8))
    assert (right.line, right.n_dot_l < 0) == (7, True)
    assert [str(ref) for ref in right.occluders] == ["Sphere 1 (line 9)"]
    # From farther right, the camera sees the side of the sphere that faces the second light.  The
    # box is between them.
    camera = Camera(view_point=(5, 0, 5), view_dir=(-4.2, 0, -4.4))
    (_, right) = tracer.explain(replace(tracer.load_scene(path), camera=camera), 4, 4).lights
    assert right.n_dot_l > 0
    assert [str(ref) for ref in right.occluders] == ["Box 0 (line 8)"]


def test_a_face_blocks_a_light_in_its_plane():
    """Test that the cosine is 0, and that the face itself is the occluder."""
    scene = replace(BALL, lights=[PointLight(position=(9, 0, 1))], surfaces=[CUBE])
    pixel = tracer.explain(scene, 4, 4)
    (light,) = pixel.lights
    assert (pixel.normal, light.n_dot_l, light.occluders) == ((0, 0, 1), 0, (pixel.surface,))


def test_a_pixel_is_traced_once(monkeypatch):
    samples = record_calls(
        monkeypatch, explanation, "find_nearest_hits", lambda _, samples: samples
    )
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
    assert "surface   Sphere 1 (line 9)" in out
    assert "shader    kd 1 1 1, ks 0 0 0, exponent 1\n" in out
    assert re.search(r"light 0 \(line 6\): n.l = 0.66\d+, n.h = 0.91\d+, reaches the point\n", out)
    assert re.search(r"  diffuse   (0.66\d+) \1 \1 = 1 1 1 \* 1 1 1 \* \1\n", out)
    assert re.search(r"  specular  0 0 0 = 1 1 1 \* 0 0 0 \* 0.91\d+\^1\n", out)
    assert "light 1 (line 7): n.l = -" in out
    assert list(path.parent.iterdir()) == [path]


BALL = scene_of(Sphere(), camera=Camera(view_point=(0, 0, 4)), size=(8, 8), lights=(3, 5, 4))
CUBE = Box(min_pt=(-1, -1, -1), max_pt=(1, 1, 1))


def test_a_warning_is_about_the_line_that_renders_the_scene():
    """`tests/format/messages.txt` has all warnings."""
    with pytest.warns(SceneWarning) as caught:
        render(replace(BALL, lights=()))
    message = "the scene has no light: the picture is black; add <light>"
    assert [(str(warning.message), warning.filename) for warning in caught] == [(message, __file__)]


def test_exposure_of_a_large_picture_is_estimated():
    image = np.zeros((1600, 40, 3))
    assert Exposure.from_radiance(image) == Exposure(64_000)
    image[-1, -1] = 0.5  # not among the examined pixels
    assert Exposure.from_radiance(image) == Exposure(64_000, lit_count=1)
    image[:800, :, 1] = 0.5
    image[:160, :, 2] = 1.5
    estimate = Exposure.from_radiance(image)
    assert estimate == pytest.approx((64_000, 32_000, 6_400), rel=0.01)
    image[0::16, :, 1], image[0::16, :, 2] = 0, 0  # the estimate sees only black rows
    assert Exposure.from_radiance(image) == Exposure(64_000, lit_count=1)


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
