"""Compare the tracer and the oracle with closed forms: cameras, shading, shadows, and hard cases.

Every case renders a whole picture, with the tracer and with the oracle.  A picture of one pixel has
one ray, along `view_dir`.  A red, a green and a blue light show three cosines n.l separately.
Tolerances are rounding errors: EPS times the magnitude of the lengths that are rounded, divided by
the length relative to which they matter.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import pytest
from probe import EPS, rgb_lights, scene_of

from reference.judges import plain
from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Sphere, render

BALL = Sphere()
CUBE = Box(min_pt=(-1, -1, -1), max_pt=(1, 1, 1))
FLOOR = Box(min_pt=(-50, -1, -50), max_pt=(50, 0, 50))
WALL = Box(min_pt=(3, -9, -9), max_pt=(4, 9, 9))
SHEET = Box(min_pt=(-5, 0, -5), max_pt=(5, 0, 5))
EYE = (0, 10, 0)
DOWN, BACK, RIGHT = (0, -1, 0), (0, 0, -1), (1, 0, 0)
AXES = np.eye(3)


class Ray(NamedTuple):
    """A scene that one ray hits, and the expected radiance of this ray."""

    name: str
    eye: tuple
    direction: tuple
    lights: tuple | list  # a tuple is the position of one white light
    surfaces: list
    radiance: float | list[float]  # a float counts for all channels
    tolerance: float = 4 * EPS  # of the radiance; radiance that should be 0 must be 0 exactly


def gray_phong(specular: float, exponent: float, diffuse: float = 0) -> Phong:
    """Build a shader whose colours are the same in all channels."""
    return Phong(diffuse=(diffuse,) * 3, specular=(specular,) * 3, exponent=exponent)


def floor_from_above(
    light: tuple | list, radiance: float | list, shader: Phong, tolerance: float
) -> Ray:
    """Build the case of a floor seen from straight above: n = v = (0, 1, 0)."""
    name = f"floor, exponent {shader.exponent:g}, {radiance}"
    return Ray(name, EYE, DOWN, light, [replace(FLOOR, shader=shader)], radiance, tolerance)


def shading() -> Iterator[Ray]:
    """Yield cases of Lambertian and Blinn-Phong shading of a floor, seen from above."""
    # Pythagorean triples give directions with rational cosines.  Distance does not matter.
    matte = replace(FLOOR, shader=Lambertian(diffuse=(1, 0.5, 0.25)))
    cosines = {(3, 4, 0): 0.8, (4, 3, 0): 0.6, (0, 28, 96): 0.28, (0, 1e4, 0): 1.0}
    for position, cosine in cosines.items():
        # The radiance is I kd n.l in each channel.
        lights = [PointLight(position=position, intensity=(0.5, 2, 4))]
        radiance = [0.5 * cosine, cosine, cosine]
        yield Ray(f"Lambert, light at {position}", EYE, DOWN, lights, [matte], radiance)
        # h is halfway between n and l: n.h = cos(a / 2) = sqrt((1 + n.l) / 2).
        for exponent in (0.5, 1, 2, 10, 1000):
            power = math.sqrt((1 + cosine) / 2) ** exponent
            shader = Phong(diffuse=(1, 0, 0.5), specular=(0, 1, 0.25), exponent=exponent)
            radiance = [0.5 * cosine, 2 * power, 2 * cosine + power]
            # The error of Python's power is EPS times the exponent.
            yield floor_from_above(lights, radiance, shader, (8 + exponent) * EPS)
    # n.l does not multiply ks.  A light below the plane adds neither term, although n.h > 0; nor
    # does a light in the plane.
    yield floor_from_above((0, 28, 96), 0.5, gray_phong(0.5, 0), 0)
    yield floor_from_above((60, -0.5, 0), 0, gray_phong(1, 1, 1), 0)
    yield floor_from_above((20, 0, 0), 0, gray_phong(1, 0, 1), 0)
    # Lights add up: three lights, each in its own channel, twice.  Radiance is not clipped.
    # Without lights, everything is black.
    lights = rgb_lights((3, 4, 0), (0, 3, 4), (0, 28, 96)) * 2
    yield Ray("lights add up", EYE, DOWN, lights, [FLOOR], [1.6, 1.2, 0.56])
    bright = [PointLight(position=(0, 5, 0), intensity=(1000, 1, 0))]
    yield Ray("not clipped", EYE, DOWN, bright, [FLOOR], [1000, 1, 0], 0)
    yield Ray("no light and no ambient", EYE, DOWN, [], [FLOOR], 0)
    for distance in (0.125, 1, 100, 1e6):
        yield Ray(f"no fall-off, {distance}", EYE, DOWN, (0, distance, 0), [FLOOR], 1, 0)


def highlights() -> Iterator[Ray]:
    """Yield cases of highlights whose angle between h and n is known."""
    # If the light and the eye are at +-60 degrees, then h = n, and (n.h)^e = 1.  If the eye is at
    # the light, then h = l is 60 degrees from n, and (n.h)^e = (1/2)^e.
    s, cubed = math.sqrt(3), [replace(FLOOR, shader=gray_phong(1, 3))]
    yield Ray("h = n", (-s, 1, 0), (s, -1, 0), (2 * s, 2, 0), cubed, 1, 8 * EPS)
    yield Ray("h = l", (2 * s, 2, 0), (-2 * s, -2, 0), (2 * s, 2, 0), cubed, 0.125)
    # Let x = tan(d) = 2^-10.  The angle between the vertical and the direction to the light at
    # (2 x, 1 - x^2, 0) is exactly 2 d.  The eye is on the vertical, so n.h = cos d, which is
    # (1 + x^2)^(-1/2).
    x = 2.0**-10
    for exponent in (1.0, 1e2, 1e4, 1e6):
        power = math.exp(-exponent / 2 * math.log1p(x * x))
        yield floor_from_above((2 * x, 1 - x * x, 0), power, gray_phong(1, exponent), 1e-12 * power)
    # The light and the eye are on opposite sides of the normal, both at about the angle `tilt`.
    # The angle between h and the normal is `angle`, and its cosine is the root of 1 - sin^2.
    tilts = 0.5, 1.2, 1.5, math.pi / 2 - 0.03, math.pi / 2 - 1e-3
    for tilt, exponent in (*product(tilts, (10, 250, 1e3, 6e4, 1e6)), (0.5, 1e8), (0.5, 1e9)):
        for share in np.linspace(-1, 1, 12):
            angle = share * min(3 / math.sqrt(exponent), (math.pi / 2 - tilt) / 2)
            light, eye = ((math.sin(a), math.cos(a), 0) for a in (tilt + angle, angle - tilt))
            name = f"highlight, {tilt:.4g}, {exponent:g}, {angle:.3g}"
            power = math.exp(exponent / 2 * math.log1p(-(math.sin(angle) ** 2)))
            floor = replace(FLOOR, shader=gray_phong(1, exponent))
            yield Ray(name, eye, (-eye[0], -eye[1], 0), light, [floor], power, 1e-10)
    # The ray touches the ball at (0, 1, 0).  There l = -v, so there is no half vector, and n.l is 0
    # or a rounding error.
    for exponent in (0, 1, 10):
        name, ball = f"behind the silhouette, {exponent}", Sphere(shader=gray_phong(1, exponent, 1))
        yield Ray(name, (-2, 1, 0), RIGHT, (2, 1, 0), [ball], 2 * EPS, 2 * EPS)
    # (n.h)^0 is 1 if n.l > 0.  Otherwise, or if the light is at the hit, there is no highlight.
    ball = Sphere(shader=gray_phong(0.5, 0))
    for light, radiance in (((5, 3, 9), 0.5), ((5, 3, 0.9), 0), ((0, 0, 1), 0)):
        yield Ray(f"ball, exponent 0, light at {light}", (0, 0, 5), BACK, light, [ball], radiance)
    yield floor_from_above((0, 0, 0), 0, gray_phong(1, 10, 1), 0)
    # The light and the eye are so low above the floor that n.h, which is 2e-19, is rounded to 0.
    low = 2.0**-70
    floor, light = replace(FLOOR, shader=gray_phong(1, 0)), (1, low, 0.01)
    yield Ray("along a floor, exponent 0", (-1, low, 0), (1, -low, 0), light, [floor], 1, 0)


def normals() -> Iterator[Ray]:
    """Yield cases that show the normals of spheres, and of boxes from outside and inside."""
    # The eye is straight above the hit, and the lights are at a distance of 1 from the hit along
    # each axis, so their n.l are the components of the normal.  Lengths up to 7 are rounded.
    ball = Sphere(center=(2, 2, 2), radius=3)
    for n in np.array([(0.6, 0.0, 0.8), (0.48, 0.6, 0.64), (0, 0.28, 0.96)]):
        lights = rgb_lights(*(2 + 3 * n + AXES))
        yield Ray(f"sphere, normal {n}", 2 + 5 * n, -n, lights, [ball], n.tolist(), 16 * EPS)
    # Each face of a box, from outside and from inside.
    for axis, sign in product(range(3), (-1, 1)):
        n, up = sign * AXES[axis], AXES[axis - 2]
        eye, light = 5 * n, 5 * n + 3 * up
        yield Ray(f"box from {eye}", eye, -n, light, [CUBE], 0.8)
        light = 0.2 * n + 0.6 * up
        yield Ray(f"box along {eye}", (0, 0, 0), n, light, [CUBE], 0.8)
        # With the eye on a face, an inward ray sees a face that the light in the box reaches, and
        # an outward ray sees nothing.
        for ahead, radiance in ((-n, 1), (up - n / 2, math.sqrt(0.8)), (up + n / 2, 0), (n, 0)):
            yield Ray(f"box on {n}, {ahead}", n, ahead, (0, 0, 0), [CUBE], radiance)


def shadows() -> Iterator[Ray]:
    """Yield cases of shadows, next to their exact edges."""
    # A ball with the radius 1 at height 3 under a light at height 9: rays from the light touch the
    # ball at the angle a with sin a = 1 / 6, so the radius of the shadow is 9 tan a = 9 / sqrt(35).
    # And a plate with the half width 1/2 at height 1 under a light at height 4: the shadow ends at
    # 1/2 * 4 / 3 = 2/3.
    plate = Box(min_pt=(-0.5, 1, -0.5), max_pt=(0.5, 1, 0.5))
    for occluder, height, edge, d in ((Sphere(center=(0, 3, 0)), 9, 9 / math.sqrt(35), 1e-9),
                                      (plate, 4, 2 / 3, 1e-12)):  # fmt: skip
        for x, lit in ((-edge - d, 1), (d - edge, 0), (0, 0), (edge - d, 0), (edge + d, 1)):
            eye, light, cosine = (x, 0.5, 0), (0, height, 0), height / math.hypot(height, x)
            yield Ray(f"edge, {x}", eye, DOWN, light, [FLOOR, occluder], lit * cosine, 1e-12)
    # A slab from 0.01 to 0.02 above the floor, |x| <= 1, and a light at the distance 1e8 in the
    # direction (0.6, 0.8, 0): rays from (x, 0) to the light pass through the slab if
    # x + 0.0075 <= 1 and x + 0.015 >= -1.
    slab = [FLOOR, Box(min_pt=(-1, 0.01, -1), max_pt=(1, 0.02, 1))]
    for x, lit in ((-1.0151, 1), (-1.0149, 0), (0, 0), (0.9924, 0), (0.9926, 1)):
        sun = (6e7, 8e7, 0)
        yield Ray(f"light at 1e8, {x}", (x, 0.005, 0), DOWN, sun, slab, 0.8 * lit, 2e-8)
    # A ball behind the light casts no shadow.  A ball around the light blocks it.
    for height, lit in ((9, 1), (15, 0), (11.5, 0)):
        behind = [FLOOR, Sphere(center=(0, 12, 0))]
        light = (0, height, 0)
        yield Ray(f"before and behind, {height}", (0, 5, 0), DOWN, light, behind, lit, 0)
    # A shadow segment along a face of the cube is not blocked; one inside of the cube is.
    for y, lit in ((1.0, 1), (-1.0, 1), (1 - 2.0**-30, 0)):
        yield Ray(f"in a face, {y}", (2, y, 0), RIGHT, (-5, y, 0), [CUBE, WALL], lit, 0)
    # A ray from the eye that lies in the plane of a face does meet the cube, in the face z = 1.
    for y, dy in product((-1, 1), (-0.0, 0.0)):
        yield Ray(f"ray in a face, {y}, {dy}", (0, y, 5), (0, dy, -1), (0, y, 5), [CUBE], 1, 0)
    # The upper right edge of the box touches the lowest point of the ball, in the origin.  Segments
    # from the ball to the right, or along the face x = 0, pass the box.  Only segments that rise
    # enter the ball.
    lying, box = Sphere(center=(0, 0.5, 0), radius=0.5), Box(min_pt=(-1, -1, -1), max_pt=(0, 0, 1))
    for c in (-1, 0, 1):
        from_below, touching = ((1, -1, 0), (-1, 1, 0)), 5 / math.hypot(5, c)
        yield Ray(f"box on ball, {c}", *from_below, (c, -5, 0), [lying, box], touching * (c >= 0))
        yield Ray(f"ball on box, {c}", *from_below, (5, c, 0), [box, lying], touching * (c <= 0))
    # The light L = (0, 5, 0) reaches the point n of the ball if n.(L - n) > 0, or n_y > 1 / 5.
    for distance, angle, side in product((1e-3, 1e-6, 1e-9, 1e-12), (0.0, 0.3, 1.0, 1.4), (-1, 1)):
        y = 0.2 + side * distance
        across, x, z = math.sqrt(1 - y * y), math.cos(angle), math.sin(angle)
        radiance = max(0, 5 * y - 1) / math.sqrt(26 - 10 * y)
        eye, toward = (across * x * 7, y, across * z * 7), (-x, 0, -z)
        yield Ray(f"terminator, {y}, {angle}", eye, toward, (0, 5, 0), [BALL], radiance, 1e-14)


def lights_on_surfaces() -> Iterator[Ray]:
    """Yield cases of lights that are on a surface, or within its rounding errors."""
    # A box without height has two sides: n = (0, 1, 0) from above, and (0, -1, 0) from below.
    for side in (-1, 1):
        light = (3, 4 * side, 0)
        yield Ray(f"sheet, {side}", (0, 2 * side, 0), (0, -side, 0), light, [SHEET], 0.8, EPS)
    # The light L is in the lower face of the ceiling: n.l = height / |L - p| at p on the floor.
    for height, x in product((3.0, 0.1, 1e5 / 3), (-5, -1, 0, 2, 5)):
        surfaces = [Box(min_pt=(-9, height, -9), max_pt=(9, 1.1 * height, 9)), FLOOR]
        radiance, light = height / math.hypot(x - 0.3, height, 0.2), (0.3, height, 0.2)
        yield Ray(
            f"ceiling, {height}, {x}", (x, height / 2, 0), DOWN, light, surfaces, radiance, 8 * EPS
        )
    # The light is on top of the ball.  It reaches a wall only above this height, and no point of
    # the ball, because the ball is convex.
    for ball in (BALL, Sphere(center=(0.25, 0.75, 0.5), radius=0.125)):
        x, y, z = ball.center
        top, surfaces = (x, y + ball.radius, z), [ball, WALL]
        for distance, side in product((1, 1e-3, 1e-9), (-1, 1)):
            eye = (2, top[1] + side * distance, z)
            radiance = (3 - x) / math.hypot(3 - x, distance) if side > 0 else 0
            yield Ray(f"light on {x}, {side * distance}", eye, RIGHT, top, surfaces, radiance)
        for up in (-0.99, -0.3, 0.2, 0.99):
            eye = (x + 2, y + up * ball.radius, z)
            yield Ray(f"light on {x}, ball at {up}", eye, (-1, 0, 0), top, [ball], 0)
    # The light is on a ball of radius 5.  Segments to the wall touch the ball only at the light.
    for z in range(8):
        surfaces = [Sphere(radius=5), Box(min_pt=(7, -9, -9), max_pt=(8, 9, 9))]
        radiance = 4 / math.hypot(5, z)
        yield Ray(
            f"light where a ball is touched, {z}", (6.5, 1, z), RIGHT, (3, 4, 0), surfaces, radiance
        )
    # The light is inside a box, deeper than the rounding errors of the box, but less deep than
    # those of hits.
    far = Box(min_pt=(1e6 - 1, -1, -1), max_pt=(1e6, 1, 1))
    wall = Box(min_pt=(1e6 + 3, -9, -9), max_pt=(1e6 + 4, 9, 9))
    for deep, lit in ((1.5e-8, 0), (0, 1), (-1.5e-8, 1)):
        eye, light, radiance = (1e6 + 2, 0.5, 0), (1e6 - deep, 0, 0), lit * 6 / math.sqrt(37)
        yield Ray(f"{deep} deep in a box", eye, RIGHT, light, [far, wall], radiance, 1e-8)
    # The light is at the top of a round room, at height 4 above a table.
    for x in (-2, 0, 1):
        room = [Sphere(radius=4), Box(min_pt=(-2, -1, -1), max_pt=(2, 0, 1))]
        radiance = 4 / math.hypot(x, 4)
        yield Ray(f"round room, {x}", (x, 1, 0), DOWN, (0, 4, 0), room, radiance, 8 * EPS)


def insides() -> Iterator[Ray]:
    """Yield cases of eyes and lights inside of surfaces, and of surfaces behind each other."""
    # The eye and the light are in the centre of the ball: l = -d = n.  An eye on the ball sees the
    # other side of the ball from inside.
    for d in ((0, 0, -1), (3, 1, -2), (-1, 7, 0.3)):
        yield Ray(f"centre, {d}", (0, 0, 0), d, (0, 0, 0), [BALL], 1)
    yield Ray("eye on a ball", (0, 0, 1), BACK, (0, 0, 0), [BALL], 1, 0)
    yield Ray("aside in a ball", (0, 0, 0), BACK, (0.75, 0, 0), [BALL, BALL], 0.8)
    # If the eye is inside of a box or a ball, only a light that is strictly inside reaches it.
    for light, d in product(((0, 0, 5), (0, 0, -1), (0, 0, 1.0000001), (3, 2, -9)),
                            (BACK, RIGHT, (1, 2, 3))):  # fmt: skip
        yield Ray(f"in a box, {light}, {d}", (0, 0, 0), d, light, [CUBE], 0)
    yield Ray("light in a box", (0, 0, 0), BACK, (0, 0, 0.5), [CUBE, CUBE], 1, 0)
    for z in (5, 1):
        yield Ray(f"in a ball, light at {z}", (0, 0, 0), BACK, (0, 0, z), [BALL], 0)
    # A ball around the light is black from outside, and shades everything outside.
    under = Box(min_pt=(-9, -3, -9), max_pt=(9, -2, 9))
    for x in (-4, -1, 0, 2.5):
        yield Ray(f"lamp, {x}", (x, 3, 5), (-x / 9, -3, -5), (0.5, 0.25, 0), [BALL], 0)
        yield Ray(f"under a lamp, {x}", (x, -1.5, 0), DOWN, (0.5, 0.25, 0), [BALL, under], 0)
    # The nearest surface is visible.
    wall = Box(min_pt=(-9, -9, -3), max_pt=(9, 9, -2))
    red, green = Lambertian(diffuse=(1, 0, 0)), Lambertian(diffuse=(0, 1, 0))
    before = [replace(wall, shader=red), BALL]
    yield Ray("nearest first", (0, 0, 7), BACK, (3, 0, 5), before, 0.8)
    # If two surfaces are equal, the first one is visible.
    for shape, light in product((BALL, CUBE), ((0, 0, 7), (0, 0, 0))):
        twins = [replace(shape, shader=shader) for shader in (red, green)]
        name = f"twins, {type(shape).__name__}, {light}"
        yield Ray(name, light, BACK, light, twins, [1, 0, 0])
        yield Ray(f"{name}, reversed", light, BACK, light, twins[::-1], [0, 1, 0])
    yield Ray("nothing", (0, 0, 7), (0, 0, 1), (3, 0, 5), [BALL, CUBE], 0)


RAYS = [*shading(), *highlights(), *normals(), *shadows(), *lights_on_surfaces(), *insides()]


def one_ray(eye: tuple, direction: tuple, lights: tuple | list, *surfaces: Sphere | Box) -> Scene:
    """Return a scene with one pixel, whose ray is given."""
    up = (0, 1, 0) if direction[0] or direction[2] else (0, 0, 1)
    camera = Camera(view_point=eye, view_dir=direction, view_up=up)
    return scene_of(*surfaces, camera=camera, size=(1, 1), lights=lights)


@pytest.mark.parametrize("ray", [pytest.param(ray, id=ray.name) for ray in RAYS])
def test_one_ray(ray):
    tolerance = ray.tolerance if np.any(ray.radiance) else 0
    scene = one_ray(ray.eye, ray.direction, ray.lights, *ray.surfaces)
    for image in render(scene), plain.render(scene, arithmetic="decimal"):
        np.testing.assert_allclose(image[0, 0], np.broadcast_to(ray.radiance, 3), 0, tolerance)


def test_a_light_within_rounding_of_a_surface_is_on_it():
    # The light at 0.3 is on top of the surface at 0.1 + 0.2, although this is more than 0.3.
    for surface, light in (
        (Sphere(center=(0.3, 0.7, 0.2), radius=0.1), (0.3, 0.7 + 0.1, 0.2)),
        (Box(min_pt=(-1, 0, -1), max_pt=(1, 0.1 + 0.2, 1)), (0, 0.3, 0)),
        # Only the radius, or the upper corner, shows the magnitude of the coordinates.
        (Sphere(radius=0.1 + 0.2), (0, 0.3, 0)),
        (Box(min_pt=(0, 0, 0), max_pt=(1, 0.1 + 0.2, 1)), (0.5, 0.3, 0.5)),
    ):
        for distance, lit in product((1e-3, 1e-9), (-1, 1)):
            eye = (2, light[1] + lit * distance, light[2])
            image = render(one_ray(eye, RIGHT, light, surface, WALL))
            assert (image > 0).all() == image.any() == (lit > 0)


@pytest.mark.parametrize("distance", [30, 1e5])
def test_the_tolerance_of_surfaces_exceeds_rounding_errors(distance):
    # The inner ball is smaller by two rounding errors.  Hits on the outer ball have rounding errors
    # of this size, and larger ones if the eye is far away.
    up, lens = np.array([1, 2, 2]) / 3, {"view_width": 1, "view_height": 1}
    eye, ahead = distance * up, -up
    camera = Camera(view_point=eye, view_dir=ahead, proj_distance=distance, **lens)
    outer, inner = Sphere(), Sphere(radius=1 - 2 * EPS)
    alone, both = (
        render(scene_of(*balls, camera=camera, size=(24, 24), lights=tuple(eye)))
        for balls in ([outer], [outer, inner])
    )
    assert alone.min() > 0.5
    np.testing.assert_allclose(both, alone, rtol=1e-9)


@pytest.mark.parametrize("depth", [1e-12, -1e-12])
def test_the_tolerance_of_surfaces_is_little_more_than_rounding_errors(depth):
    # A light at this depth below the top of a ball is inside the ball, and reaches nothing outside.
    ball, floor = Sphere(), Box(min_pt=(-9, -3, -9), max_pt=(9, 1 - 1e-6, -4))
    camera = Camera(view_point=(0, 3, 0), view_dir=(0, -0.4, -1))
    scene = scene_of(ball, floor, camera=camera, size=(8, 8), lights=(0, 1 - depth, 0))
    image, exact = render(scene), plain.render(scene, arithmetic="decimal")
    np.testing.assert_allclose(image, exact, rtol=1e-9)
    assert (image.max() > 0) == (depth < 0)


def test_a_window_of_nearly_180_degrees():
    # The tangent of half the angle is larger than that of pi / 2 rounded to float64.
    camera = Camera(view_point=(0, 0, 0), view_width=1e17, view_height=1e17)
    scene = scene_of(Sphere(radius=5), camera=camera, size=(8, 8), lights=(0, 0, 0))
    np.testing.assert_allclose(render(scene), 1, rtol=1e-15)


# A wall at z = -8 on which the radiance of a point (x, y) shows its position.  The light at
# (0, 0, -7) has n.l = 1 / sqrt(1 + x^2 + y^2); the other lights distinguish left from right, and
# top from bottom.
BACKDROP = Box(min_pt=(-100, -100, -9), max_pt=(100, 100, -8))
LIGHTS = (0, 0), (1, 0), (0, 1)
FOUR = (-3, -1, 1, 3)
SLANTED = {"view_dir": (1, 2, -4), "proj_normal": (0, 0, 1)}
SLANTED_POINTS = [
    [(2 + 8 * s * math.sqrt(21) / 4, 4 - 8 * r * math.sqrt(21) / 4) for s in (-0.125, 0.125)]
    for r in (-0.125, 0.125)
]

CAMERAS = {
    # The window is 1 x 1 at distance 1, and the wall is at distance 8, so column j of the picture
    # is at x = 8 ((j + 1/2) / 4 - 1/2).  Rows go down.
    "pixel centres": ({}, [[(x, -y) for x in FOUR] for y in FOUR]),
    "view direction": ({"view_dir": (3, 2, -4), "view_width": 7, "view_height": 0.1}, [[(6, 4)]]),
    # Eye (1, 2, 8), 16 from the wall; window 3 x 1 at distance 2: columns 8 apart, rows 4.
    "window, distance and eye": (
        {"view_point": (1, 2, 8), "proj_distance": 2, "view_width": 3},
        [[(1 + 8 * j, 2 + y) for j in (-1, 0, 1)] for y in (2, -2)],
    ),
    # A window .75 x .5 over 2 x 4 pixels: columns 8 * .375 = 3 apart, rows 8 * .125 = 1.
    "pixels that are not square": (
        {"view_width": 0.75, "view_height": 0.5},
        [[(x, y) for x in (-1.5, 1.5)] for y in (1.5, 0.5, -0.5, -1.5)],
    ),
    # Only the component of viewUp in the plane of the window matters.
    **{
        f"up {up}": ({"view_up": up}, [[(x, -y) for x in FOUR] for y in FOUR])
        for up in ((0.0, 5.0, 3.0), (0.0, 1e-8, -7.0))
    },
    # With +x up, right is up x w = (1, 0, 0) x (0, 0, 1) = (0, -1, 0).
    "up turns the picture": ({"view_up": (1, 0, 0)}, [[(-y, -x) for x in FOUR] for y in FOUR]),
    # View direction (3, 1, -4) to a window parallel to the wall: its centre is sqrt(26) along
    # it, that is at (3, 1, -4); pixels step by 1 there and by 2 on the wall, around (6, 2).
    "shifted window": (
        {"view_dir": (3, 1, -4), "proj_normal": (0, 0, 1), "proj_distance": math.sqrt(26),
         "view_width": 3, "view_height": 2},
        [[(6 + 2 * j, 2 + y) for j in (-1, 0, 1)] for y in (1, -1)],
    ),
    # The window turns about the vertical: normal (3, 0, 4) / 5, centre (0, 0, -1), so that
    # right is (0, 1, 0) x n = (0.8, 0, -0.6).  The ray through s right of the centre,
    # (0.8 s, r, -1 - 0.6 s), meets the wall at 8 (0.8 s, r) / (1 + 0.6 s).
    "oblique window": (
        {"proj_normal": (3, 0, 4), "view_width": 1.5},
        [[(6.4 * s / (1 + 0.6 * s), 8 * r / (1 + 0.6 * s)) for s in (-0.5, 0, 0.5)]
         for r in (0.25, -0.25)],
    ),
    # The distance is along the view direction, of any length: the window, parallel to the wall, is
    # 4 / sqrt(21) before the eye and shows the wall 2 sqrt(21) times as large.  Twice as far it is
    # half as large.  The sign of the normal does not matter.
    "slanted": ({**SLANTED, "view_width": 0.5, "view_height": 0.5}, SLANTED_POINTS),
    "slanted, from afar": (
        {**SLANTED, "view_dir": (4, 8, -16), "view_up": (0, 0.125, 0), "proj_distance": 2},
        SLANTED_POINTS,
    ),
    "slanted, from behind": (
        {**SLANTED, "proj_normal": (0, 0, -1024), "view_width": 0.5, "view_height": 0.5},
        SLANTED_POINTS,
    ),
}  # fmt: skip


@pytest.mark.parametrize(("camera", "points"), CAMERAS.values(), ids=CAMERAS)
def test_points_of_a_wall(camera, points):
    size = len(points[0]), len(points)
    lights = rgb_lights(*((x, y, -7) for x, y in LIGHTS))
    scene = scene_of(BACKDROP, camera=Camera(**camera), size=size, lights=lights)
    from_light = np.array(points)[:, :, None] - LIGHTS
    expected = 1 / np.sqrt(1 + (from_light**2).sum(axis=3))
    # Coordinates up to 20 are rounded; the distance from the wall to the light is 1.
    np.testing.assert_allclose(render(scene), expected, rtol=0, atol=64 * EPS)
    np.testing.assert_allclose(plain.render(scene), expected, rtol=0, atol=64 * EPS)
    # An offset, to the right and down, moves the samples of the tracer and of `plain` alike.
    offset = (0.25, -0.5)
    image, exact = render(scene, offset=offset), plain.render(scene, offset)
    assert np.abs(exact - expected).max() > 0.01
    np.testing.assert_allclose(image, exact, rtol=0, atol=64 * EPS)


def test_window_is_not_a_near_plane():
    # A ball between the eye and the window is visible; a ball behind the eye is not.
    for z, radiance in ((-0.5, 1), (0.5, 0)):
        ball = Sphere(center=(0, 0, z), radius=0.125)
        scene = scene_of(ball, camera=Camera(proj_distance=8), size=(1, 1), lights=(0, 0, 0))
        assert render(scene)[0, 0].tolist() == [radiance] * 3
