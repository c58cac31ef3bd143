"""The oracle against answers worked by hand, then the tracer against the oracle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from judge import judge
from probe import Surface, Vector, scene_of
from random_scenes import KINDS, random_scene
from scene_files import small

from reference import plain
from reference.command import SCENES, own_scenes
from reference.plain import Seen
from reference.workloads import resized
from tracer import Box, Camera, Lambertian, Phong, Sphere, load_scene, render, write_png

# The tracer's rounding, times 10^4 lengths seen from afar, times exponents of 60; a light near the
# ground sees points rounded by 2^24 EPS; an eye at 10^-9 over a floor has its points further along.
RADIANCE = dict.fromkeys(KINDS, 1e-8) | {"enormous": 1e-7, "grazing": 1e-4}


def along(eye: Vector, direction: Vector, light: Vector, *surfaces: Surface) -> Seen:
    """What the oracle sees along one ray by one light."""
    camera = Camera(view_point=eye, view_dir=direction, view_up=(0.48, 0.6, 0.64))
    scene = scene_of(*surfaces, camera=camera, size=(1, 1), lights=light)
    return plain.trace(scene, [0.5], [0.5], arithmetic="decimal")


def lit(eye: Vector, direction: Vector, light: Vector, *surfaces: Surface) -> tuple[int, bool]:
    """The place of what is seen, and whether the light reaches it."""
    seen = along(eye, direction, light, *surfaces)
    return int(seen.surface[0]), bool(seen.lit[0, 0])


BALL = Sphere()
CUBE = Box(min_pt=(-1, -1, -1), max_pt=(1, 1, 1))
FLOOR = Box(min_pt=(-9, -2, -9), max_pt=(9, -1, 9))
WALL = Box(min_pt=(-9, -9, -3), max_pt=(9, 9, -2))
# The box's upper right edge touches the ball's lowest point, the origin, where n = (0, -1, 0).
LYING = Sphere(center=(0, 0.5, 0), radius=0.5)
EDGE = Box(min_pt=(-1, -1, -1), max_pt=(0, 0, 1))
DOWN, BACK = (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)


class TestByHand:
    """Each answer follows from the drawing in the comment."""

    def test_nearest_first(self) -> None:
        # Ball in front of a wall: the ball is seen, at n = (0, 0, 1), lit from (3, 0, 5)
        # along (3, 0, 4) / 5.
        seen = along((0, 0, 7), BACK, (3, 0, 5), WALL, BALL)
        assert (seen.surface.tolist(), seen.lit.tolist()) == ([1], [[True]])
        assert seen.radiance == pytest.approx(np.full((1, 3), 0.8), rel=1e-15)

    def test_nothing(self) -> None:
        seen = along((0, 0, 7), (0, 0, 1), (3, 0, 5), BALL, CUBE)
        assert (seen.surface.tolist(), seen.radiance.tolist()) == ([-1], [[0, 0, 0]])

    def test_highlight(self) -> None:
        # v = (0, 1, 0), l = (0.96, 0.28, 0): n.h = cos(acos(0.28) / 2) = 0.8, squared 0.64.
        floor = replace(FLOOR, shader=Phong(diffuse=(1, 0, 0), specular=(0, 1, 0), exponent=2))
        seen = along((0, 5, 0), DOWN, (0.96 * 25, -1 + 0.28 * 25, 0), floor)
        assert seen.radiance[0] == pytest.approx((0.28, 0.64, 0), rel=1e-15)

    @pytest.mark.parametrize("x", [1, 0, -1])
    def test_box_touching_a_ball(self, x: float) -> None:
        # Segments from the ball to the right or along the face x = 0 pass the box.
        assert lit((1, -1, 0), (-1, 1, 0), (x, -5, 0), LYING, EDGE) == (0, x >= 0)

    @pytest.mark.parametrize("y", [-1, 0, 1])
    def test_ball_touching_a_box(self, y: float) -> None:
        # The box's face x = 0 is seen, and only segments that rise enter the ball.
        assert lit((1, -1, 0), (-1, 1, 0), (5, y, 0), EDGE, LYING) == (0, y <= 0)

    def test_inside(self) -> None:
        # Eye and light in the ball: n = -d, and l = (0, 0, -1) turned by the light's place.
        inside = along((0, 0, 0), BACK, (0.75, 0, 0), BALL)
        assert inside.radiance[0] == pytest.approx((0.8,) * 3, rel=1e-15)
        for z in (5, 1):
            assert lit((0, 0, 0), BACK, (0, 0, z), BALL) == (0, False)

    @pytest.mark.parametrize("x", [0.5, 1.5])
    def test_light_on_a_ball(self, x: float) -> None:
        # On its right side: the ball keeps it from all that is left of the plane x = 1.
        assert lit((x, -0.999, 0), DOWN, (1, 0, 0), FLOOR, BALL) == (0, x > 1)

    def test_light_in_the_plane_of_a_face(self) -> None:
        # It grazes the floor, which it does not light, not even by a highlight of exponent 0.
        floor = replace(FLOOR, shader=Phong(specular=(1, 1, 1), exponent=0))
        assert not along((0, 5, 0), DOWN, (20, -1, 0), floor).radiance.any()

    @pytest.mark.parametrize("twin", [BALL, CUBE])
    def test_twins(self, twin: Surface) -> None:
        # A twin changes nothing, from outside or inside.
        for eye, light in (((0, 0, 7), (3, 0, 5)), ((0, 0, 0), (0.75, 0, 0))):
            once, twice = (along(eye, BACK, light, *[twin] * k) for k in (1, 2))
            assert once.lit.all()
            assert twice.lit.all()
            assert (twice.surface.tolist(), twice.radiance.tolist()) == (
                [0],
                once.radiance.tolist(),
            )

    def test_face_in_the_ray(self) -> None:
        # Camera rays in a face meet the box; segments to a light in one pass it.
        assert lit((0, 1, 7), BACK, (0, 1, 7), CUBE) == (0, True)
        assert lit((0, 1, -1.5), BACK, (0, 1, 7), WALL, CUBE) == (0, True)
        assert lit((0, 0.99, -1.5), BACK, (0, 0.99, 7), WALL, CUBE) == (0, False)

    def test_place_in_the_picture(self) -> None:
        # Through the corner of four pixels the ball's middle is seen, in the shader's colour.
        ball = Sphere(shader=Lambertian(diffuse=(0.5, 0.25, 1)))
        camera = Camera(view_point=(0, 0, 7))
        scene = scene_of(ball, camera=camera, size=(2, 2), lights=(0, 0, 9))
        assert plain.trace(scene, [1], [1]).radiance.tolist() == [[0.5, 0.25, 1]]


def test_a_pixel_is_sure_unless_an_edge_is_a_hair_away_or_surfaces_nearly_coincide() -> None:
    # The cube's edge, at x = 1, is that part of a pixel right of the middle of the picture.
    for off in (0.01, 0.0001):
        camera = Camera(view_point=(1 - off, 0, 5), proj_distance=4)
        scene = scene_of(CUBE, camera=camera, size=(1, 1), lights=(0, 0, 9))
        assert judge(scene).sure.tolist() == [off > 0.001]
    # A ground that touches the plane of the floor at x = 0, and is 8e-6 below it at x = 1.
    ground = Sphere(center=(0, -1 - 2.0**16, 0), radius=2.0**16)
    for x in (0.0, 1.0):
        eye = (x + 1e-3, 1, 0)
        camera = Camera(view_point=eye, view_dir=DOWN, view_up=(1, 0, 0), view_width=1e-4)
        scene = scene_of(FLOOR, ground, camera=camera, size=(1, 1), lights=(0, 5, 0))
        assert judge(scene).sure.tolist() == [x > 0]


def test_an_error_is_found() -> None:
    scene = small("four-spheres", 8, 6)
    image = render(scene)
    assert not judge(scene, image).wrong(1e-12)
    image[2, 3, 1] += 1e-6
    assert judge(scene, image).wrong(1e-8).startswith("pixel 19:")


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind == "crowd")) for kind in KINDS]
)
def test_tracer_agrees(kind: str) -> None:
    # Of a thousand objects, few pixels.
    size, count = ((3, 2), 2) if kind == "crowd" else ((13, 9), 3)
    sure = []
    for seed in range(count):
        judged = judge(random_scene(kind, seed, *size))
        assert not (wrong := judged.wrong(RADIANCE[kind])), f"{kind}, seed {seed}:\n{wrong}"
        assert np.isfinite(judged.error).all()
        sure.append(judged.sure.mean())
    # Or the test would say nothing.
    assert np.mean(sure) > 0.95


@given(
    kind=st.sampled_from([kind for kind in KINDS if kind != "crowd"]), seed=st.integers(1000, 2**32)
)
def test_tracer_agrees_on_any(kind: str, seed: int) -> None:
    assert not judge(random_scene(kind, seed, width=3, height=2)).wrong(RADIANCE[kind])


_LARGE = {path.stem for path in own_scenes() if len(load_scene(path).surfaces) > 100}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(path.stem, marks=[pytest.mark.slow] * (path.stem in _LARGE))
        for path in own_scenes()
    ],
)
def test_tracer_agrees_on_the_scenes(name: str) -> None:
    # Nearly orthographic scenes are seen from 1,700 times their size.
    scene = load_scene(SCENES / f"{name}.xml")
    scene = resized(scene, *((16, 9) if len(scene.surfaces) > 20 else (48, 27)))
    exact = plain.render(scene, arithmetic="decimal")
    assert exact.max() > 0.1
    np.testing.assert_allclose(render(scene), exact, rtol=0, atol=1e-11)
    # Floats alone do not decide what coincides.
    if name != "touching":
        np.testing.assert_allclose(plain.render(scene), exact, rtol=0, atol=1e-10)


def test_offset_moves_the_samples_of_both_renderers_alike() -> None:
    scene = small("four-spheres")
    for offset in [(0.25, 0.0), (0.0, -0.5)]:
        moved = plain.render(scene, offset)
        assert np.abs(moved - render(scene)).max() > 0.01
        np.testing.assert_allclose(moved, render(scene, offset=offset), rtol=0, atol=1e-12)


def test_command_writes_the_picture(tmp_path, monkeypatch, capsys) -> None:
    path, right = tmp_path / "plain.png", tmp_path / "right.png"
    scene = SCENES / "one-sphere.xml"
    monkeypatch.setattr("sys.argv", ["plain", str(scene), "-o", str(path), "--shadows", "t>1e-4"])
    plain.main()
    assert capsys.readouterr().out == f"{path}\n"
    write_png(right, render(load_scene(scene)))
    assert path.read_bytes() == right.read_bytes()
