"""Lambert and Blinn-Phong in closed form, mostly through whole renders of one ray."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from probe import EPS, Vector, colored, radiance_along

from tracer import Box, Lambertian, Phong, PointLight, Sphere
from tracer.light.shading import highlight

# The top of the floor is y = 0; the eye above the origin looks straight down: n = v = (0, 1, 0).
FLOOR = Box(min_pt=(-50, -1, -50), max_pt=(50, 0, 50))
EYE, DOWN = (0.0, 10.0, 0.0), (0.0, -1.0, 0.0)

# 3-4-5 and its kin: directions with rational cosines, far and near (there is no fall-off).
PYTHAGOREAN = [((3, 4, 0), 0.8), ((4, 3, 0), 0.6), ((0, 28, 96), 0.28), ((0, 1e4, 0), 1.0)]


@pytest.mark.parametrize(("light", "cosine"), PYTHAGOREAN)
def test_lambert(light: Vector, cosine: float) -> None:
    # kd I n.l, a channel at a time.
    floor = replace(FLOOR, shader=Lambertian(diffuse=(1, 0.5, 0.25)))
    lights = [PointLight(position=light, intensity=(0.5, 2, 4))]
    seen = radiance_along(EYE, DOWN, lights, floor)
    assert seen == pytest.approx([0.5 * cosine, cosine, cosine], rel=4 * EPS)


@pytest.mark.parametrize(("light", "cosine"), PYTHAGOREAN)
@pytest.mark.parametrize("exponent", [0.5, 1, 2, 10, 1000])
def test_blinn_phong(light: Vector, cosine: float, exponent: float) -> None:
    # v = n, so h is halfway between n and l: n.h = cos(a / 2) = sqrt((1 + n.l) / 2).
    half = math.sqrt((1 + cosine) / 2)
    shader = Phong(diffuse=(1, 0, 0.5), specular=(0, 1, 0.25), exponent=exponent)
    seen = radiance_along(EYE, DOWN, light, replace(FLOOR, shader=shader))
    power = half**exponent
    # Python's own power errs by EPS times the exponent.
    expected = [cosine, power, 0.5 * cosine + 0.25 * power]
    assert seen == pytest.approx(expected, rel=(8 + exponent) * EPS)


def test_half_vector_not_reflection() -> None:
    # Light and eye at +-60 degrees: h = n, so the highlight is whole; the eye at the light
    # instead has h = l, 60 degrees off: (1/2)^e.  (A reflected ray would see -1/2 there.)
    shader = Phong(diffuse=(0, 0, 0), specular=(1, 1, 1), exponent=3)
    floor = replace(FLOOR, shader=shader)
    s = math.sqrt(3)
    assert radiance_along((-s, 1, 0), (s, -1, 0), (2 * s, 2, 0), floor) == pytest.approx(
        1, abs=8 * EPS
    )
    seen = radiance_along((2 * s, 2, 0), (-2 * s, -2, 0), (2 * s, 2, 0), floor)
    assert seen == pytest.approx(0.125, rel=16 * EPS)


@pytest.mark.parametrize(
    ("tilt", "exponent"),
    [
        *product((0.5, 1.2, 1.5, math.pi / 2 - 0.03, math.pi / 2 - 1e-3), (10, 250, 1e3, 6e4, 1e6)),
        (0.5, 1e8),
        (0.5, 1e9),
    ],
)
def test_highlights_at_all_angles(tilt: float, exponent: float) -> None:
    # Light and eye are on either side of the normal, both about so far from it.
    rng = np.random.default_rng(1)
    for share in rng.uniform(-1, 1, 30):
        off = share * min(3 / math.sqrt(exponent), (math.pi / 2 - tilt) / 2)
        angles = np.array([0, tilt + off, off - tilt])
        plane = np.stack([np.sin(angles), np.cos(angles), np.zeros(3)], axis=1)
        n, light, view = plane @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
        power = highlight(
            np.array([n @ light]),
            np.array([n @ view]),
            np.array([light @ view]),
            np.array([float(exponent)]),
            lambda _, vectors=(n, light, view): tuple(vector[:, None] for vector in vectors),
        )
        # h is `off` from the normal; its cosine is 1 - sin^2 under a root.
        exact = math.exp(exponent / 2 * math.log1p(-(math.sin(off) ** 2)))
        assert power == pytest.approx(exact, abs=1e-10)


def test_no_cosine_on_the_highlight() -> None:
    # n.l = 0.28 takes nothing off ks.
    shader = Phong(diffuse=(0, 0, 0), specular=(0.5, 0.5, 0.5), exponent=0)
    assert (
        radiance_along(EYE, DOWN, (0, 28, 96), replace(FLOOR, shader=shader)).tolist() == [0.5] * 3
    )


def test_no_highlight_without_diffuse_side() -> None:
    # The light is below the plane: neither term, although n.h > 0.
    shader = Phong(diffuse=(1, 1, 1), specular=(1, 1, 1), exponent=1)
    assert not radiance_along(EYE, DOWN, (60, -0.5, 0), replace(FLOOR, shader=shader)).any()


def test_lights_add_up() -> None:
    # Three lights, each in its own channel, then two in the same.
    lights = colored((3, 4, 0), (0, 3, 4), (0, 28, 96))
    assert radiance_along(EYE, DOWN, lights, FLOOR) == pytest.approx([0.8, 0.6, 0.28], rel=4 * EPS)
    assert radiance_along(EYE, DOWN, [*lights, *lights], FLOOR) == pytest.approx(
        [1.6, 1.2, 0.56], rel=4 * EPS
    )


def test_no_light_and_no_ambient() -> None:
    assert not radiance_along(EYE, DOWN, [], FLOOR).any()


def test_not_clipped() -> None:
    # Radiance is linear and open above; only the 8-bit codes end at 1.
    lights = [PointLight(position=(0, 5, 0), intensity=(1000, 1, 0))]
    assert radiance_along(EYE, DOWN, lights, FLOOR).tolist() == [1000, 1, 0]


@pytest.mark.parametrize("distance", [0.125, 1, 100, 1e6])
def test_no_fall_off(distance: float) -> None:
    assert radiance_along(EYE, DOWN, (0, distance, 0), FLOOR).tolist() == [1, 1, 1]


def test_default_shader_is_white() -> None:
    ball = Sphere(center=(0, 1, 0))
    assert radiance_along(EYE, DOWN, EYE, ball) == pytest.approx(1, abs=4 * EPS)


@pytest.mark.parametrize("normal", [(0.6, 0.0, 0.8), (0.48, 0.6, 0.64), (0, 0.28, 0.96)])
def test_sphere_normal(normal: Vector) -> None:
    # The eye is straight above the point, the lights a unit along each axis from it:
    # their n.l are the normal's components.
    x, y, z = (2 + 3 * c for c in normal)
    lights = colored((x + 1, y, z), (x, y + 1, z), (x, y, z + 1))
    eye = (x + 2 * normal[0], y + 2 * normal[1], z + 2 * normal[2])
    toward = (-normal[0], -normal[1], -normal[2])
    seen = radiance_along(eye, toward, lights, Sphere(center=(2, 2, 2), radius=3))
    # Lengths up to 7 are rounded, against the unit.
    assert seen == pytest.approx(normal, abs=16 * EPS)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_box_normals(axis: int, sign: float) -> None:
    # Each face from outside, n.l = 0.8; and from inside, where the opposite face faces the eye.
    def along(a: float, b: float) -> Vector:
        v = [0.0, 0.0, 0.0]
        v[axis], v[(axis + 1) % 3] = a, b
        return v[0], v[1], v[2]

    cube = Box(min_pt=(-1, -1, -1), max_pt=(1, 1, 1))
    seen = radiance_along(along(5 * sign, 0), along(-sign, 0), along(5 * sign, 3), cube)
    assert seen == pytest.approx(0.8, rel=2 * EPS)
    inside = radiance_along((0, 0, 0), along(sign, 0), along(0.2 * sign, 0.6), cube)
    assert inside == pytest.approx(0.8, rel=4 * EPS)


def test_shadow_is_black_and_sharp() -> None:
    # A ball of radius 1 at height 3 under a light at height 9, seen from below it: rays from
    # the light touch it at sin a = 1 / 6, so the shadow's radius is 9 tan a = 9 / sqrt(35).
    ball, edge = Sphere(center=(0, 3, 0)), 9 / math.sqrt(35)
    for x, lit in ((0, False), (edge - 1e-9, False), (edge + 1e-9, True), (-edge - 1e-9, True)):
        seen = radiance_along((x, 1, 0), DOWN, (0, 9, 0), FLOOR, ball)
        assert seen == pytest.approx(9 / math.hypot(9, x) if lit else 0.0, rel=4 * EPS, abs=0.0)


def test_nothing_behind_the_light_casts_a_shadow() -> None:
    ball = Sphere(center=(0, 12, 0))
    assert radiance_along((0, 5, 0), DOWN, (0, 9, 0), FLOOR, ball).tolist() == [1, 1, 1]
    assert radiance_along((0, 5, 0), DOWN, (0, 15, 0), FLOOR, ball).tolist() == [0, 0, 0]
