"""The oracle against answers worked by hand, then the tracer against the oracle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from probe import scene_of
from random_scenes import KINDS, random_scene

from reference.oracle import Oracle, Verdict
from tracer import Box, Camera, Lambertian, Phong, Scene, Sphere, render

# Far more than the tracer's rounding, of a few hundred epsilon in the same
# measure, and little enough to leave out few pixels.
TIE = 1e-12

# The tracer's rounding, times 10^4 lengths seen from afar, times exponents of 60; an eye at
# 10^-9 over a floor has its points further along it than that.
RADIANCE = dict.fromkeys(KINDS, 1e-08) | {"grazing": 1e-4}

# A thousand objects take the oracle a tenth of a second a pixel.
SIZE = dict.fromkeys(KINDS, (13, 9)) | {"crowd": (3, 2)}


def verdict_along(
    eye: tuple[float, float, float],
    direction: tuple[float, float, float],
    light: tuple[float, float, float],
    *surfaces: Sphere | Box,
) -> Verdict:
    """The verdict on one ray and one light."""
    camera = Camera(view_point=eye, view_dir=direction, view_up=(0.48, 0.6, 0.64))
    scene = scene_of(*surfaces, camera=camera, size=(1, 1), lights=light)
    return Oracle(scene).judge(0.5, 0.5)


BALL = Sphere()
CUBE = Box(min_pt=(-1, -1, -1), max_pt=(1, 1, 1))
FLOOR = Box(min_pt=(-9, -2, -9), max_pt=(9, -1, 9))
DOWN = (0.0, -1.0, 0.0)


class TestByHand:
    """Each answer follows from the drawing in the comment."""

    def test_nearest_first(self) -> None:
        # Ball in front of a wall: the ball is seen, at n = (0, 0, 1), lit from (3, 0, 5)
        # along (3, 0, 4) / 5.
        wall = Box(min_pt=(-9, -9, -3), max_pt=(9, 9, -2))
        verdict = verdict_along((0, 0, 7), (0, 0, -1), (3, 0, 5), wall, BALL)
        assert verdict == Verdict((0.8,) * 3, 1, (True,), verdict.margin)
        assert verdict.margin > 1e-2

    def test_nothing(self) -> None:
        verdict = verdict_along((0, 0, 7), (0, 0, 1), (3, 0, 5), BALL, CUBE)
        assert (verdict.surface, verdict.radiance) == (None, (0, 0, 0))

    def test_highlight(self) -> None:
        # v = (0, 1, 0), l = (0.96, 0.28, 0): n.h = cos(acos(0.28) / 2) = 0.8, squared 0.64.
        floor = replace(FLOOR, shader=Phong(diffuse=(1, 0, 0), specular=(0, 1, 0), exponent=2))
        verdict = verdict_along((0, 5, 0), DOWN, (0.96 * 25, -1 + 0.28 * 25, 0), floor)
        assert verdict.radiance == pytest.approx((0.28, 0.64, 0), rel=1e-15)

    @pytest.mark.parametrize(
        ("light", "lit"), [((1, -5, 0), True), ((0, -5, 0), True), ((-1, -5, 0), False)]
    )
    def test_box_touching_a_ball(self, light: tuple[float, float, float], lit: bool) -> None:
        # The box's upper right edge touches the ball's lowest point, the origin, where
        # n = (0, -1, 0).  Segments to the right or along the face x = 0 pass the box.
        ball = Sphere(center=(0, 0.5, 0), radius=0.5)
        box = Box(min_pt=(-1, -1, -1), max_pt=(0, 0, 1))
        verdict = verdict_along((1, -1, 0), (-1, 1, 0), light, ball, box)
        assert (verdict.surface, verdict.lit) == (0, (lit,))

    @pytest.mark.parametrize(
        ("light", "lit"), [((5, -1, 0), True), ((5, 0, 0), True), ((5, 1, 0), False)]
    )
    def test_ball_touching_a_box(self, light: tuple[float, float, float], lit: bool) -> None:
        # The same, listed the other way round: the box's face x = 0 is seen, and only
        # segments that rise enter the ball.
        ball = Sphere(center=(0, 0.5, 0), radius=0.5)
        box = Box(min_pt=(-1, -1, -1), max_pt=(0, 0, 1))
        verdict = verdict_along((1, -1, 0), (-1, 1, 0), light, box, ball)
        assert (verdict.surface, verdict.lit) == (0, (lit,))

    def test_inside(self) -> None:
        # Eye and light in the ball: n = -d, and l = (0, 0, -1) turned by the light's place.
        inside = verdict_along((0, 0, 0), (0, 0, -1), (0.75, 0, 0), BALL)
        assert inside.radiance == pytest.approx((0.8,) * 3, rel=1e-15)
        assert verdict_along((0, 0, 0), (0, 0, -1), (0, 0, 5), BALL).lit == (False,)
        assert verdict_along((0, 0, 0), (0, 0, -1), (0, 0, 1), BALL).lit == (False,)

    @pytest.mark.parametrize(("x", "lit"), [(0.5, False), (1.5, True)])
    def test_light_on_a_ball(self, x: float, lit: bool) -> None:
        # On its right side: the ball keeps it from all that is left of the plane x = 1.
        verdict = verdict_along((x, -0.999, 0), DOWN, (1, 0, 0), FLOOR, BALL)
        assert (verdict.surface, verdict.lit) == (0, (lit,))

    def test_light_in_the_plane_of_a_face(self) -> None:
        # It grazes the floor, which it does not light, not even by a highlight of exponent 0.
        floor = replace(FLOOR, shader=Phong(specular=(1, 1, 1), exponent=0))
        verdict = verdict_along((0, 5, 0), DOWN, (20, -1, 0), floor)
        assert (verdict.radiance, verdict.lit) == ((0, 0, 0), (False,))

    def test_twins(self) -> None:
        # A twin changes nothing: outside, inside, box or ball.
        for twin in (BALL, CUBE):
            for eye, light in (((0, 0, 7), (3, 0, 5)), ((0, 0, 0), (0.75, 0, 0))):
                once = verdict_along(eye, (0, 0, -1), light, twin)
                twice = verdict_along(eye, (0, 0, -1), light, twin, twin)
                assert twice == replace(once, margin=twice.margin)
                assert once.lit == (True,)

    def test_face_in_the_ray(self) -> None:
        # Camera rays in a face meet the box; segments to a light in one pass it.
        assert verdict_along((0, 1, 7), (0, 0, -1), (0, 1, 7), CUBE).lit == (True,)
        wall = Box(min_pt=(-9, -9, -3), max_pt=(9, 9, -2))
        assert verdict_along((0, 1, -1.5), (0, 0, -1), (0, 1, 7), wall, CUBE).lit == (True,)
        assert verdict_along((0, 0.99, -1.5), (0, 0, -1), (0, 0.99, 7), wall, CUBE).lit == (False,)

    def test_margin_at_a_ridge(self) -> None:
        # From (7, y, 7) to (-1, y, -1), within 1e-9 of the ridge at x = z = 1.
        for off in (1e-9, -1e-9):
            verdict = verdict_along((7, 0, 7 + off), (-1, 0, -1), (9, 0, 8), CUBE)
            assert verdict.margin == pytest.approx(1e-9 / 2**0.5 / 20, rel=0.3)

    def test_margin(self) -> None:
        # A ray that passes the ball at 1e-9: 1e-9 of lengths 7 + 1 + 7.
        verdict = verdict_along((1 + 1e-9, 0, 7), (0, 0, -1), (3, 0, 5), BALL)
        assert verdict.surface is None
        assert verdict.margin == pytest.approx(1e-9 / 15, rel=1e-3)

    @pytest.mark.parametrize("off", [1e-9, -1e-9])
    def test_margin_of_an_eye_near_a_ball(self, off: float) -> None:
        # At 1e-9 over its top, or under it: nearly on it, where it would see the far side.
        verdict = verdict_along((0, 1 + off, 0), (0.6, -0.8, 0), (9, 9, 0), BALL)
        assert verdict.surface == 0
        assert verdict.margin == pytest.approx(1e-9 / 2, rel=0.5)


def disagreements(scene: Scene, tolerance: float) -> tuple[list[str], int, int]:
    """Where tracer and oracle differ, how many pixels are ties, and how many are not."""
    image, wrong, ties, judged = render(scene), [], 0, 0
    for i, row in enumerate(Oracle(scene).picture()):
        for j, verdict in enumerate(row):
            error = np.abs(image[i, j] - verdict.radiance).max()
            if verdict.margin < TIE:
                ties += 1
            else:
                judged += 1
            if not np.isfinite(image[i, j]).all() or (
                verdict.margin >= TIE and not error <= tolerance
            ):
                wrong.append(f"row {i}, column {j}: {image[i, j]} is not {verdict}")
    return wrong, ties, judged


@pytest.mark.parametrize("kind", KINDS)
def test_tracer_agrees(kind: str) -> None:
    ties = judged = 0
    for seed in range(8):
        scene = random_scene(kind, seed, *SIZE[kind])
        wrong, tied, sure = disagreements(scene, RADIANCE[kind])
        assert not wrong, f"{kind}, seed {seed}:\n" + "\n".join(wrong)
        ties += tied
        judged += sure
    # Or the test would say nothing.
    assert ties < (0.2 if kind == "grazing" else 0.05) * judged


@settings(max_examples=40, deadline=None, derandomize=True)
@given(kind=st.sampled_from(list(KINDS)), seed=st.integers(1000, 2**32))
def test_tracer_agrees_on_any(kind: str, seed: int) -> None:
    scene = random_scene(kind, seed, width=3, height=2)
    wrong, _, _ = disagreements(scene, RADIANCE[kind])
    assert not wrong, "\n".join(wrong)


def test_radiance_between_pixels() -> None:
    # The shader's colour, where the ball is seen through the corner of a pixel.
    shader = Lambertian(diffuse=(0.5, 0.25, 1))
    scene = scene_of(
        Sphere(shader=shader), camera=Camera(view_point=(0, 0, 7)), size=(2, 2), lights=(0, 0, 9)
    )
    assert Oracle(scene).judge(1, 1).radiance == (0.5, 0.25, 1)
