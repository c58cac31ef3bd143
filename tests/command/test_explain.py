"""Explanations of pixels, and warnings about scenes: both agree with the picture."""

import io
import re
import shutil
import tracemalloc
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image
from probe import record_calls, scene_of
from random_scenes import random_scene
from running import run
from scene_files import HARD_SCENES

import tracer
from tracer import Box, Camera, PointLight, Scene, SceneWarning, Sphere, render
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


def test_a_surface_does_not_block_a_light_at_its_horizon():
    """Most lights are less far above or below the horizon than rounding errors of shadow rays."""
    pixel = tracer.explain(BALL, 2, 3)
    tangent = np.cross(pixel.normal, (1, 0, 0))
    tangent /= np.linalg.norm(tangent)
    heights = np.concatenate([np.logspace(-16, -6, 40), -np.logspace(-16, -10, 30)])[:, None]
    steps = 1e-6 * (tangent + heights * np.array(pixel.normal))
    lights = [PointLight(position=pixel.point + step) for step in steps]
    parts = tracer.explain(replace(BALL, lights=lights), 2, 3).lights
    assert [any(part.diffuse) for part in parts] == [not part.occluders for part in parts]


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


@pytest.mark.parametrize("name", ["render", "to_png"])
def test_a_warning_is_about_the_line_that_renders_the_scene(name):
    """`tests/format/messages.txt` has all warnings."""
    user_code = compile(f"\n\ntracer.{name}(scene)", "user.py", "exec")
    scene = replace(BALL, lights=())
    with pytest.warns(SceneWarning) as caught:
        exec(user_code, {"__name__": "user", "tracer": tracer, "scene": scene})
    message = "the scene has no light: the picture is black; add <light>"
    assert [(str(each.message), each.filename, each.lineno) for each in caught] == [
        (message, "user.py", 3)
    ]


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
    exposure = Exposure.from_radiance(image)
    assert exposure == Exposure(63, lit_count=13, clipped_count=4)
    assert exposure.add(exposure) == Exposure(126, lit_count=26, clipped_count=8)


def test_a_notebook_shows_an_explanation_as_text():
    printer, pixel = Mock(), tracer.explain(BALL, 4, 4)
    pixel._repr_pretty_(printer, cycle=False)
    printer.text.assert_called_once_with(str(pixel))


def show_in_notebook(scene: Scene) -> tuple[bytes, list[tuple[str, str]]]:
    """Show a scene as a notebook does; return the picture, and each warning with its place."""
    pictures: list[bytes] = []

    def display(value: Any) -> None:
        pictures.append(value._repr_png_())

    cell = compile("\nscene", "<cell>", "single")
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings(record=True) as caught:
        patch.setattr("sys.displayhook", display)
        warnings.simplefilter("always")
        exec(cell, {"__name__": "__main__", "scene": scene})
    return pictures[0], [(str(each.message), f"{each.filename}:{each.lineno}") for each in caught]


def test_a_notebook_shows_a_scene_as_its_picture():
    picture, messages = show_in_notebook(BALL)
    assert messages == []
    np.testing.assert_array_equal(
        np.asarray(Image.open(io.BytesIO(picture))), tracer.to_codes(render(BALL))
    )


def test_a_warning_in_a_notebook_is_about_the_line_that_shows_the_scene():
    _, messages = show_in_notebook(replace(BALL, lights=()))
    assert messages == [
        ("the scene has no light: the picture is black; add <light>", "<cell>:2"),
    ]


@pytest.mark.parametrize(
    ("size", "shown"),
    [((96, 24), (48, 12)), ((24, 24), (24, 24)), ((65, 2), (64, 1)), ((2, 65), (1, 64))],
)
def test_a_picture_in_a_notebook_is_no_larger_than_a_browser_shows(monkeypatch, size, shown):
    monkeypatch.setattr("tracer.picture.notebook._MAX_PIXELS", 24 * 24)
    monkeypatch.setattr("tracer.picture.notebook._MAX_SIDE", 64)
    (width, height), camera = size, replace(BALL.camera, view_width=size[0] / size[1])
    scene = replace(BALL, camera=camera, width=width, height=height)
    picture, messages = show_in_notebook(scene)
    assert np.asarray(Image.open(io.BytesIO(picture))).shape == (*shown[::-1], 3)
    reduced = f"the picture of {width} x {height} pixels is shown with only {shown[0]} x {shown[1]}"
    if shown == size:
        assert messages == []
    else:
        text = f"{reduced}; tracer.write_png writes all of them"
        assert messages[-1] == (text, "<cell>:2")


def test_a_large_picture_in_a_notebook_takes_little_memory():
    scene = replace(BALL, width=1500, height=1500)
    tracemalloc.start()
    _, messages = show_in_notebook(scene)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert messages == []  # the last tile is black, but not the picture
    # A tile has 98,304 samples, whose arrays take about 10 MB; the whole picture takes 54 MB.
    assert peak < 24 * 1500 * 1500 / 2
