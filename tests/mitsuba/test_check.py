"""The check against Mitsuba: who is right where the two differ, and which pixels count.

What it makes of the scenes is in `test_cross_validation`, what it catches in `test_mutations`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from probe import close_up, scene_of

from converters.rendering import Rendering
from reference.check import check_scene, compare, edge_mask
from reference.command import SCENES
from reference.regenerate import load_small
from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Sphere, load_scene, render


@pytest.mark.parametrize(
    "surfaces",
    [
        pytest.param((Box(min_pt=(-0.3, -0.3, 0), max_pt=(0.3, 0.3, 0)),), id="flat box"),
        pytest.param((), id="nothing"),
        pytest.param((Sphere(radius=0.3), Sphere(radius=0.3)), id="twice the same"),
        pytest.param(
            (Sphere(radius=0.3, shader=Phong(exponent=0, specular=(2, 0, 0))),), id="bright"
        ),
    ],
)
def test_odd_scenes_agree(surfaces: tuple[Sphere | Box, ...]) -> None:
    result = check_scene(close_up(*surfaces), "odd")
    assert result.faults == ()


def test_a_narrow_highlight_keeps_its_digits_in_float32() -> None:
    shader = Phong(diffuse=(0, 0, 0), specular=(1, 1, 1), exponent=1e5)
    floor = Box(min_pt=(-1, -1.2, -1), max_pt=(1.1, 1, 0), shader=shader)
    light = PointLight(position=(0.02, 0.01, 5))
    result = check_scene(replace(close_up(floor), lights=(light,), width=200, height=200), "narrow")
    assert (result.tracer > 0.1).sum() > 100
    assert result.faults == ()


def test_where_mitsuba_errs_exact_arithmetic_judges() -> None:
    """A red plate lies on the face of a white box: float32 cannot tell which is seen."""
    red = Lambertian(diffuse=(1, 0, 0))
    plate = Box(min_pt=(-0.3, -0.3, 0), max_pt=(0.3, 0.3, 0), shader=red)
    result = check_scene(close_up(plate, Box(min_pt=(-1, -1, -1), max_pt=(1, 1, 0))), "plate")
    assert result.faults == ()
    assert result.differing > 0
    assert "plate: agrees with exact arithmetic\n" in result.report()
    assert f"Mitsuba errs on {result.differing} pixel" in result.report()


def test_where_the_tracer_errs_exact_arithmetic_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = replace(close_up(Sphere()), width=40, height=40)
    image = render(scene)
    image[:20] += 0.01
    monkeypatch.setattr("reference.check.render", lambda _scene, **_offset: image)
    result = check_scene(scene, "off")
    assert result.faults != ()
    assert (result.differing, result.agreed) == (800, 0)
    assert 250 <= result.asked <= 500
    assert f"asked about {result.asked} of the 800 pixels that differ" in result.report()


def test_edges_that_differ_are_masked_and_nobody_is_asked() -> None:
    scene = load_small(SCENES / "four-spheres.xml")
    image = render(scene)
    edges = edge_mask(scene, image)
    assert edges.any()
    result = compare(scene, "edges", Rendering(image + edges[:, :, None], "scalar_rgb", 0.0))
    assert np.array_equal(result.mask, edges)
    assert (result.differing, result.asked, result.remark) == (0, 0, "")


def test_limits_are_relative_in_bright_pictures() -> None:
    light = PointLight(position=(3, 4, 5), intensity=(300, 300, 300))
    result = check_scene(replace(close_up(Sphere()), lights=(light,)), "bright")
    assert result.tracer.max() > 200
    assert result.faults == ()


def scaled(size: float) -> Scene:
    camera = Camera(view_point=(0, 0, 5 * size), proj_distance=size, view_width=0.3 * size,
                    view_height=0.3 * size)  # fmt: skip
    at = (3 * size, 4 * size, 5 * size)
    return scene_of(Sphere(radius=0.5 * size), camera=camera, size=(24, 24), lights=at)


@pytest.mark.parametrize(("width", "height"), [(1, 96), (96, 1)])
def test_edges_on_which_both_agree_are_not_masked(width: int, height: int) -> None:
    """In pixels so tall or wide a sample that moves a little meets an edge in many."""
    scene = replace(load_scene(SCENES / "room.xml"), width=width, height=height)
    result = check_scene(scene, "thin")
    assert edge_mask(scene, result.tracer).mean() > 0.05
    assert result.faults == ()
    assert not result.mask.any()


@pytest.mark.parametrize("size", [1e-45, 1e45])
def test_scenes_of_any_size_agree(size: float) -> None:
    """What is written is ten units large, even where float32 could not hold the scene."""
    result = check_scene(scaled(size), "size")
    assert result.faults == ()
    assert result.tracer.max() > 0.5
