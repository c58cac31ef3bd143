"""The check against Mitsuba: who is right where the two differ, and which pixels count.

What it makes of the scenes is in `test_cross_validation`, what it catches in `test_mutations`.
"""

from dataclasses import replace

import numpy as np
import pytest
from probe import close_up, moved

from converters.rendering import Rendering
from reference.check import check_scene, compare, edge_mask
from reference.command import SCENES
from reference.regenerate import load_small
from tracer import Box, Lambertian, Phong, PointLight, Sphere, load_scene, render

BALL, DOT = Sphere(), Sphere(radius=0.3)
WALL = Box(min_pt=(-1, -1.2, -1), max_pt=(1.1, 1, 0))
PLATE = Box(min_pt=(-0.3, -0.3, 0), max_pt=(0.3, 0.3, 0))
NARROW = Phong(diffuse=(0, 0, 0), specular=(1, 1, 1), exponent=1e5)

ODD = {
    "nothing": close_up(),
    "flat box": close_up(PLATE),
    "twice the same": close_up(DOT, DOT),
    "bright": close_up(replace(DOT, shader=Phong(exponent=0, specular=(2, 0, 0)))),
    # A narrow highlight keeps its digits in float32.
    "narrow": replace(
        close_up(replace(WALL, shader=NARROW)),
        **{"lights": (PointLight(position=(0.02, 0.01, 5)),), "width": 200, "height": 200},
    ),
    # Limits are relative in bright pictures.
    "brighter": replace(
        close_up(BALL), lights=(PointLight(position=(3, 4, 5), intensity=(300,) * 3),)
    ),
    "sun": close_up(BALL, light=(3e20, 5e20, 4e20)),
    # What is written is ten units large, even where float32 could not hold the scene.
    "tiny": moved(close_up(DOT), 1e-45),
    "enormous": moved(close_up(DOT), 1e45),
}


@pytest.mark.parametrize("name", ODD)
def test_odd_scenes_agree(name):
    result = check_scene(ODD[name], name)
    assert result.faults == ()
    assert result.tracer.max() > {"nothing": -1, "brighter": 200}.get(name, 0.5)


@pytest.mark.parametrize(("width", "height"), [(1, 96), (96, 1)])
def test_edges_on_which_both_agree_are_not_masked(width, height):
    # In pixels so tall or wide a sample that moves a little meets an edge in many.
    scene = replace(load_scene(SCENES / "room.xml"), width=width, height=height)
    result = check_scene(scene, "thin")
    assert edge_mask(scene, result.tracer).mean() > 0.05
    assert result.faults == ()
    assert not result.mask.any()


def test_where_mitsuba_errs_exact_arithmetic_judges():
    # A red plate lies on the face of a white box: float32 cannot tell which is seen.
    plate = replace(PLATE, shader=Lambertian(diffuse=(1, 0, 0)))
    result = check_scene(close_up(plate, WALL), "plate")
    assert result.faults == ()
    assert result.differing > 0
    assert "plate: agrees with exact arithmetic\n" in result.report()
    assert f"Mitsuba errs on {result.differing} pixel" in result.report()


def test_where_the_tracer_errs_exact_arithmetic_says_so(monkeypatch):
    scene = replace(close_up(BALL), width=40, height=40)
    image = render(scene)
    image[:20] += 0.01
    monkeypatch.setattr("reference.check.render", lambda _scene, **_offset: image)
    result = check_scene(scene, "off")
    assert result.faults != ()
    assert (result.differing, result.agreed) == (800, 0)
    assert 250 <= result.asked <= 500
    assert f"asked about {result.asked} of the 800 pixels that differ" in result.report()


def test_edges_that_differ_are_masked_and_nobody_is_asked():
    scene = load_small(SCENES / "four-spheres.xml")
    image = render(scene)
    edges = edge_mask(scene, image)
    assert edges.any()
    result = compare(scene, "edges", Rendering(image + edges[:, :, None], "scalar_rgb", 0.0))
    assert np.array_equal(result.mask, edges)
    assert (result.differing, result.asked, result.remark) == (0, 0, "")
