"""Closed forms: where things appear, Lambert, Blinn-Phong, and the cases where ray tracers fail.

Every case goes through a whole render, of the tracer and of the oracle.  A picture of one pixel has
one ray, along `view_dir`; lights of pure red, green and blue show their n.l apart.  Tolerances are
roundings: EPS times the lengths that are rounded, over the length that they are measured against.
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
    """An eye and a direction, lights and surfaces, and the radiance that is seen.

    Where that is 0 it is so exactly.
    """

    name: str
    eye: tuple
    direction: tuple
    lights: tuple | list
    surfaces: list
    radiance: float | list[float]
    tolerance: float = 4 * EPS


def shiny(specular: float, exponent: float, diffuse: float = 0) -> Phong:
    return Phong(diffuse=(diffuse,) * 3, specular=(specular,) * 3, exponent=exponent)


def floor_under(light: tuple | list, radiance: float | list, shader: Phong, errs: float) -> Ray:
    """A floor of some shader from straight above: n = v = (0, 1, 0)."""
    name = f"floor, exponent {shader.exponent:g}, {radiance}"
    return Ray(name, EYE, DOWN, light, [replace(FLOOR, shader=shader)], radiance, errs)


def shading() -> Iterator[Ray]:
    """Lambert and Blinn-Phong."""
    # 3-4-5 and its kin: directions with rational cosines, far and near (there is no fall-off).
    matte = replace(FLOOR, shader=Lambertian(diffuse=(1, 0.5, 0.25)))
    for at, cosine in (((3, 4, 0), 0.8), ((4, 3, 0), 0.6), ((0, 28, 96), 0.28), ((0, 1e4, 0), 1.0)):
        # I kd n.l, a channel at a time.
        lights = [PointLight(position=at, intensity=(0.5, 2, 4))]
        seen = [0.5 * cosine, cosine, cosine]
        yield Ray(f"Lambert, light at {at}", EYE, DOWN, lights, [matte], seen)
        # h is halfway between n and l: n.h = cos(a / 2) = sqrt((1 + n.l) / 2).
        for exponent in (0.5, 1, 2, 10, 1000):
            power = math.sqrt((1 + cosine) / 2) ** exponent
            shader = Phong(diffuse=(1, 0, 0.5), specular=(0, 1, 0.25), exponent=exponent)
            seen = [0.5 * cosine, 2 * power, 2 * cosine + power]
            # Python's own power errs by EPS times the exponent.
            yield floor_under(lights, seen, shader, (8 + exponent) * EPS)
    # n.l = 0.28 takes nothing off ks; a light below the plane adds neither term, although n.h > 0,
    # nor does one in the plane.
    yield floor_under((0, 28, 96), 0.5, shiny(0.5, 0), 0)
    yield floor_under((60, -0.5, 0), 0, shiny(1, 1, 1), 0)
    yield floor_under((20, 0, 0), 0, shiny(1, 0, 1), 0)
    # Light and eye at +-60 degrees: h = n, so the highlight is whole; the eye at the light instead
    # has h = l, 60 degrees off: (1/2)^e.  (A reflected ray would see -1/2 there.)
    s, cubed = math.sqrt(3), [replace(FLOOR, shader=shiny(1, 3))]
    yield Ray("h = n", (-s, 1, 0), (s, -1, 0), (2 * s, 2, 0), cubed, 1, 8 * EPS)
    yield Ray("h = l", (2 * s, 2, 0), (-2 * s, -2, 0), (2 * s, 2, 0), cubed, 0.125)
    # With x = tan(d) = 2^-10 the light at (2 x, 1 - x^2, 0), exactly, is 2 d off the vertical on
    # which the eye is, so n.h = cos d = (1 + x^2)^(-1/2).
    x = 2.0**-10
    for exponent in (1.0, 1e2, 1e4, 1e6):
        power = math.exp(-exponent / 2 * math.log1p(x * x))
        yield floor_under((2 * x, 1 - x * x, 0), power, shiny(1, exponent), 1e-12 * power)
    # Light and eye are on either side of the normal, both about so far from it; h is `off` from it,
    # and its cosine is 1 - sin^2 under a root.
    tilts = 0.5, 1.2, 1.5, math.pi / 2 - 0.03, math.pi / 2 - 1e-3
    for tilt, exponent in (*product(tilts, (10, 250, 1e3, 6e4, 1e6)), (0.5, 1e8), (0.5, 1e9)):
        for share in np.linspace(-1, 1, 12):
            off = share * min(3 / math.sqrt(exponent), (math.pi / 2 - tilt) / 2)
            light, eye = ((math.sin(a), math.cos(a), 0) for a in (tilt + off, off - tilt))
            name = f"highlight, {tilt:.4g}, {exponent:g}, {off:.3g}"
            power = math.exp(exponent / 2 * math.log1p(-(math.sin(off) ** 2)))
            floor = replace(FLOOR, shader=shiny(1, exponent))
            yield Ray(name, eye, (-eye[0], -eye[1], 0), light, [floor], power, 1e-10)
    # The ray touches the ball at (0, 1, 0), where l = -v: no half vector, and n.l is 0 or rounded.
    for exponent in (0, 1, 10):
        name, ball = f"behind the silhouette, {exponent}", Sphere(shader=shiny(1, exponent, 1))
        yield Ray(name, (-2, 1, 0), RIGHT, (2, 1, 0), [ball], 2 * EPS, 2 * EPS)
    # (n.h)^0 = 1 where n.l > 0, and nothing elsewhere or where the light is at the point.
    ball = Sphere(shader=shiny(0.5, 0))
    for light, seen in (((5, 3, 9), 0.5), ((5, 3, 0.9), 0), ((0, 0, 1), 0)):
        yield Ray(f"ball, exponent 0, light at {light}", (0, 0, 5), BACK, light, [ball], seen)
    yield floor_under((0, 0, 0), 0, shiny(1, 10, 1), 0)
    # Three lights, each in its own channel, twice; radiance is not clipped; no light is no light.
    lights = rgb_lights((3, 4, 0), (0, 3, 4), (0, 28, 96)) * 2
    yield Ray("lights add up", EYE, DOWN, lights, [FLOOR], [1.6, 1.2, 0.56])
    bright = [PointLight(position=(0, 5, 0), intensity=(1000, 1, 0))]
    yield Ray("not clipped", EYE, DOWN, bright, [FLOOR], [1000, 1, 0], 0)
    yield Ray("no light and no ambient", EYE, DOWN, [], [FLOOR], 0)
    for distance in (0.125, 1, 100, 1e6):
        yield Ray(f"no fall-off, {distance}", EYE, DOWN, (0, distance, 0), [FLOOR], 1, 0)
    # The eye is straight above the point, the lights a unit along each axis from it: their n.l are
    # the normal's components.  Lengths up to 7 are rounded, against the unit.
    ball = Sphere(center=(2, 2, 2), radius=3)
    for n in np.array([(0.6, 0.0, 0.8), (0.48, 0.6, 0.64), (0, 0.28, 0.96)]):
        lights = rgb_lights(*(2 + 3 * n + AXES))
        yield Ray(f"sphere, normal {n}", 2 + 5 * n, -n, lights, [ball], n.tolist(), 16 * EPS)
    # Each face from outside and, where the opposite face looks at the eye, from inside.
    for axis, sign in product(range(3), (-1, 1)):
        n, up = sign * AXES[axis], AXES[axis - 2]
        eye, light = 5 * n, 5 * n + 3 * up
        yield Ray(f"box from {eye}", eye, -n, light, [CUBE], 0.8)
        light = 0.2 * n + 0.6 * up
        yield Ray(f"box along {eye}", (0, 0, 0), n, light, [CUBE], 0.8)
        # From on it, inwards a wall that the light in the middle reaches, and outwards none.
        for ahead, seen in ((-n, 1), (up - n / 2, math.sqrt(0.8)), (up + n / 2, 0), (n, 0)):
            yield Ray(f"box on {n}, {ahead}", n, ahead, (0, 0, 0), [CUBE], seen)


def shadows() -> Iterator[Ray]:
    """What blocks light, to the last bit."""
    # A ball of radius 1 at height 3 under a light at height 9: rays from there touch it at
    # sin a = 1 / 6, so the shadow's radius is 9 tan a = 9 / sqrt(35).  And a plate of half width
    # 1/2 at height 1 under a light at height 4: the shadow ends at 1/2 * 4 / 3 = 2/3.
    plate = Box(min_pt=(-0.5, 1, -0.5), max_pt=(0.5, 1, 0.5))
    for other, at, edge, off in ((Sphere(center=(0, 3, 0)), 9, 9 / math.sqrt(35), 1e-9),
                                 (plate, 4, 2 / 3, 1e-12)):  # fmt: skip
        for x, lit in ((-edge - off, 1), (off - edge, 0), (0, 0), (edge - off, 0), (edge + off, 1)):
            seen = lit * at / math.hypot(at, x)
            yield Ray(f"edge, {x}", (x, 0.5, 0), DOWN, (0, at, 0), [FLOOR, other], seen, 1e-12)
    # A slab from 0.01 to 0.02 over the floor, |x| <= 1, light along (0.6, 0.8, 0) from 1e8: rays
    # from (x, 0) rise through it where x + 0.0075 <= 1 and x + 0.015 >= -1.
    slab = [FLOOR, Box(min_pt=(-1, 0.01, -1), max_pt=(1, 0.02, 1))]
    for x, lit in ((-1.0151, 1), (-1.0149, 0), (0, 0), (0.9924, 0), (0.9926, 1)):
        sun = (6e7, 8e7, 0)
        yield Ray(f"light at 1e8, {x}", (x, 0.005, 0), DOWN, sun, slab, 0.8 * lit, 2e-8)
    # What is behind the light casts no shadow; from within the ball nothing comes out.
    for at, lit in ((9, 1), (15, 0), (11.5, 0)):
        behind = [FLOOR, Sphere(center=(0, 12, 0))]
        yield Ray(f"before and behind, {at}", (0, 5, 0), DOWN, (0, at, 0), behind, lit, 0)
    # From a wall, straight along a face of the cube: only what is within the cube blocks.
    for y, lit in ((1.0, 1), (-1.0, 1), (1 - 2.0**-30, 0)):
        yield Ray(f"in a face, {y}", (2, y, 0), RIGHT, (-5, y, 0), [CUBE, WALL], lit, 0)
    # A camera's ray in a face does meet the cube, through z = 1.
    for y, dy in product((-1, 1), (-0.0, 0.0)):
        yield Ray(f"ray in a face, {y}, {dy}", (0, y, 5), (0, dy, -1), (0, y, 5), [CUBE], 1, 0)
    # The box's upper right edge touches the ball's lowest point, the origin: segments from the ball
    # to the right or along the face x = 0 pass the box, and only those that rise enter the ball.
    lying, box = Sphere(center=(0, 0.5, 0), radius=0.5), Box(min_pt=(-1, -1, -1), max_pt=(0, 0, 1))
    for c in (-1, 0, 1):
        from_below, touching = ((1, -1, 0), (-1, 1, 0)), 5 / math.hypot(5, c)
        yield Ray(f"box on ball, {c}", *from_below, (c, -5, 0), [lying, box], touching * (c >= 0))
        yield Ray(f"ball on box, {c}", *from_below, (5, c, 0), [box, lying], touching * (c <= 0))
    # The light at (0, 5, 0) is seen from n iff n.(L - n) > 0, that is n_y > 1 / 5.
    for off, angle, side in product((1e-3, 1e-6, 1e-9, 1e-12), (0.0, 0.3, 1.0, 1.4), (-1, 1)):
        y = 0.2 + side * off
        across, x, z = math.sqrt(1 - y * y), math.cos(angle), math.sin(angle)
        seen = max(0, 5 * y - 1) / math.sqrt(26 - 10 * y)
        eye, toward = (across * x * 7, y, across * z * 7), (-x, 0, -z)
        yield Ray(f"terminator, {y}, {angle}", eye, toward, (0, 5, 0), [BALL], seen, 1e-14)


def odd_lights_and_eyes() -> Iterator[Ray]:
    """On surfaces, and inside."""
    # From above n = (0, 1, 0), from below (0, -1, 0); the light along (3, +-4, 0) / 5.
    for side in (-1, 1):
        light = (3, 4 * side, 0)
        yield Ray(f"sheet, {side}", (0, 2 * side, 0), (0, -side, 0), light, [SHEET], 0.8, EPS)
    # The light is in the ceiling's lower face; the floor y = 0 gets n.l = height / |L - p|.
    for height, x in product((3.0, 0.1, 1e5 / 3), (-5, -1, 0, 2, 5)):
        both = [Box(min_pt=(-9, height, -9), max_pt=(9, 1.1 * height, 9)), FLOOR]
        seen, light = height / math.hypot(x - 0.3, height, 0.2), (0.3, height, 0.2)
        yield Ray(f"ceiling, {height}, {x}", (x, height / 2, 0), DOWN, light, both, seen, 8 * EPS)
    # The light is on top of the ball; a wall 3 away is lit above that level only, and the ball
    # itself nowhere, being convex.
    for ball in (BALL, Sphere(center=(0.25, 0.75, 0.5), radius=0.125)):
        x, y, z = ball.center
        top, both = (x, y + ball.radius, z), [ball, WALL]
        for off, side in product((1, 1e-3, 1e-9), (-1, 1)):
            eye, seen = (2, top[1] + side * off, z), (side > 0) * (3 - x) / math.hypot(3 - x, off)
            yield Ray(f"light on {x}, {side * off}", eye, RIGHT, top, both, seen)
        for up in (-0.99, -0.3, 0.2, 0.99):
            eye = (x + 2, y + up * ball.radius, z)
            yield Ray(f"light on {x}, ball at {up}", eye, (-1, 0, 0), top, [ball], 0)
    # The light is on a ball of radius 5, and the segments to a wall touch the ball only there.
    for z in range(8):
        both, seen = (
            [Sphere(radius=5), Box(min_pt=(7, -9, -9), max_pt=(8, 9, 9))],
            4 / math.hypot(5, z),
        )
        yield Ray(f"light where a ball is touched, {z}", (6.5, 1, z), RIGHT, (3, 4, 0), both, seen)
    # In a box, deeper than its rounding, and less deep than that of points which are seen.
    far = Box(min_pt=(1e6 - 1, -1, -1), max_pt=(1e6, 1, 1))
    wall = Box(min_pt=(1e6 + 3, -9, -9), max_pt=(1e6 + 4, 9, 9))
    for deep, lit in ((1.5e-8, 0), (0, 1), (-1.5e-8, 1)):
        eye, light, seen = (1e6 + 2, 0.5, 0), (1e6 - deep, 0, 0), lit * 6 / math.sqrt(37)
        yield Ray(f"{deep} deep in a box", eye, RIGHT, light, [far, wall], seen, 1e-8)
    # A lamp at the top of a round room, 4 over a table in the middle.
    for x in (-2, 0, 1):
        room = [Sphere(radius=4), Box(min_pt=(-2, -1, -1), max_pt=(2, 0, 1))]
        seen = 4 / math.hypot(x, 4)
        yield Ray(f"round room, {x}", (x, 1, 0), DOWN, (0, 4, 0), room, seen, 8 * EPS)
    # Eye and light at the centre: l = -d = n.  From on the ball its other side is seen.
    for d in ((0, 0, -1), (3, 1, -2), (-1, 7, 0.3)):
        yield Ray(f"centre, {d}", (0, 0, 0), d, (0, 0, 0), [BALL], 1)
    yield Ray("eye on a ball", (0, 0, 1), BACK, (0, 0, 0), [BALL], 1, 0)
    yield Ray("aside in a ball", (0, 0, 0), BACK, (0.75, 0, 0), [BALL, BALL], 0.8)
    # A box or a ball keeps out all light that is not strictly inside; from within it comes through.
    for light, d in product(((0, 0, 5), (0, 0, -1), (0, 0, 1.0000001), (3, 2, -9)),
                            (BACK, RIGHT, (1, 2, 3))):  # fmt: skip
        yield Ray(f"in a box, {light}, {d}", (0, 0, 0), d, light, [CUBE], 0)
    yield Ray("light in a box", (0, 0, 0), BACK, (0, 0, 0.5), [CUBE, CUBE], 1, 0)
    for z in (5, 1):
        yield Ray(f"in a ball, light at {z}", (0, 0, 0), BACK, (0, 0, z), [BALL], 0)
    # Seen from outside such a ball is black, and so is all that it keeps from the light.
    under = Box(min_pt=(-9, -3, -9), max_pt=(9, -2, 9))
    for x in (-4, -1, 0, 2.5):
        yield Ray(f"lamp, {x}", (x, 3, 5), (-x / 9, -3, -5), (0.5, 0.25, 0), [BALL], 0)
        yield Ray(f"under a lamp, {x}", (x, -1.5, 0), DOWN, (0.5, 0.25, 0), [BALL, under], 0)
    # A ball before a wall, and nothing.
    wall = Box(min_pt=(-9, -9, -3), max_pt=(9, 9, -2))
    red, green = Lambertian(diffuse=(1, 0, 0)), Lambertian(diffuse=(0, 1, 0))
    before = [replace(wall, shader=red), BALL]
    yield Ray("nearest first", (0, 0, 7), BACK, (3, 0, 5), before, 0.8)
    # Of equals the first in the file.
    for shape, light in product((BALL, CUBE), ((0, 0, 7), (0, 0, 0))):
        twins = [replace(shape, shader=shader) for shader in (red, green)]
        name = f"twins, {type(shape).__name__}, {light}"
        yield Ray(name, light, BACK, light, twins, [1, 0, 0])
        yield Ray(f"{name}, reversed", light, BACK, light, twins[::-1], [0, 1, 0])
    yield Ray("nothing", (0, 0, 7), (0, 0, 1), (3, 0, 5), [BALL, CUBE], 0)


RAYS = [*shading(), *shadows(), *odd_lights_and_eyes()]


def one_ray(eye: tuple, direction: tuple, lights: tuple | list, *surfaces: Sphere | Box) -> Scene:
    """A picture of one pixel."""
    up = (0, 1, 0) if direction[0] or direction[2] else (0, 0, 1)
    camera = Camera(view_point=eye, view_dir=direction, view_up=up)
    return scene_of(*surfaces, camera=camera, size=(1, 1), lights=lights)


@pytest.mark.parametrize("ray", [pytest.param(ray, id=ray.name) for ray in RAYS])
def test_one_ray(ray):
    errs = ray.tolerance if np.any(ray.radiance) else 0
    scene = one_ray(ray.eye, ray.direction, ray.lights, *ray.surfaces)
    for image in render(scene), plain.render(scene, arithmetic="decimal"):
        np.testing.assert_allclose(image[0, 0], np.broadcast_to(ray.radiance, 3), 0, errs)


def test_a_light_on_a_surface_but_for_rounding():
    # On top, as 0.3 on a table is although it is less than 0.1 + 0.2.
    for surface, light in (
        (Sphere(center=(0.3, 0.7, 0.2), radius=0.1), (0.3, 0.7 + 0.1, 0.2)),
        (Box(min_pt=(-1, 0, -1), max_pt=(1, 0.1 + 0.2, 1)), (0, 0.3, 0)),
        # Only the radius, and only the upper corner, show how large coordinates are.
        (Sphere(radius=0.1 + 0.2), (0, 0.3, 0)),
        (Box(min_pt=(0, 0, 0), max_pt=(1, 0.1 + 0.2, 1)), (0.5, 0.3, 0.5)),
    ):
        for off, lit in product((1e-3, 1e-9), (-1, 1)):
            eye = (2, light[1] + lit * off, light[2])
            image = render(one_ray(eye, RIGHT, light, surface, WALL))
            assert (image > 0).all() == image.any() == (lit > 0)


@pytest.mark.parametrize("distance", [30, 1e5])
def test_what_counts_as_on_a_surface_is_more_than_rounding(distance):
    # A ball in another, smaller by two roundings: points on the outer one err as much, and by more
    # the farther away the eye is.
    up, lens = np.array([1, 2, 2]) / 3, {"view_width": 1, "view_height": 1}
    eye, ahead = distance * up, -up
    camera = Camera(view_point=eye, view_dir=ahead, proj_distance=distance, **lens)
    outer, inner = Sphere(), Sphere(radius=1 - 2 * EPS)
    alone, both = (
        render(scene_of(*some, camera=camera, size=(24, 24), lights=tuple(eye)))
        for some in ([outer], [outer, inner])
    )
    assert alone.min() > 0.5
    np.testing.assert_allclose(both, alone, rtol=1e-9)


@pytest.mark.parametrize("depth", [1e-12, -1e-12])
def test_what_counts_as_on_a_surface_is_little_more_than_rounding(depth):
    # A lamp so far below the top of a ball lights nothing outside of it; so far above, it does.
    ball, floor = Sphere(), Box(min_pt=(-9, -3, -9), max_pt=(9, 1 - 1e-6, -4))
    camera = Camera(view_point=(0, 3, 0), view_dir=(0, -0.4, -1))
    scene = scene_of(ball, floor, camera=camera, size=(8, 8), lights=(0, 1 - depth, 0))
    image, exact = render(scene), plain.render(scene, arithmetic="decimal")
    np.testing.assert_allclose(image, exact, rtol=1e-9)
    assert (image.max() > 0) == (depth < 0)


def test_a_window_of_nearly_180_degrees():
    # The tangent of half of it is more than that of pi / 2 as rounded.
    camera = Camera(view_point=(0, 0, 0), view_width=1e17, view_height=1e17)
    scene = scene_of(Sphere(radius=5), camera=camera, size=(8, 8), lights=(0, 0, 0))
    np.testing.assert_allclose(render(scene), 1, rtol=1e-15)


# A wall at z = -8 where radiance tells where a point is: the light at (0, 0, -7) shines with n.l =
# 1 / sqrt(1 + x^2 + y^2) on (x, y); the others tell left from right and top from bottom.
BACKDROP = Box(min_pt=(-100, -100, -9), max_pt=(100, 100, -8))
LIGHTS = (0, 0), (1, 0), (0, 1)
FOUR = (-3, -1, 1, 3)
SLANTED = {"view_dir": (1, 2, -4), "proj_normal": (0, 0, 1)}
SLANTED_POINTS = [
    [(2 + 8 * s * math.sqrt(21) / 4, 4 - 8 * r * math.sqrt(21) / 4) for s in (-0.125, 0.125)]
    for r in (-0.125, 0.125)
]

CAMERAS = {
    # Window 1 x 1 at distance 1, wall 8 away: columns at 8 ((j + 1/2) / 4 - 1/2), rows down.
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
    # Only its part in the window's plane counts.
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
    at = np.array(points)[:, :, None] - LIGHTS
    expected = 1 / np.sqrt(1 + (at**2).sum(axis=3))
    # Points up to 20 away are rounded, against the light's distance of 1.
    np.testing.assert_allclose(render(scene), expected, rtol=0, atol=64 * EPS)
    np.testing.assert_allclose(plain.render(scene), expected, rtol=0, atol=64 * EPS)
    # An offset, right and down, moves the samples of both alike.
    aside, off = plain.render(scene, (0.25, -0.5)), render(scene, offset=(0.25, -0.5))
    assert np.abs(aside - expected).max() > 0.01
    np.testing.assert_allclose(off, aside, rtol=0, atol=64 * EPS)


def test_window_is_not_a_near_plane():
    # What is nearer than the window is seen; what is behind the eye is not.
    for z, radiance in ((-0.5, 1), (0.5, 0)):
        ball = Sphere(center=(0, 0, z), radius=0.125)
        scene = scene_of(ball, camera=Camera(proj_distance=8), size=(1, 1), lights=(0, 0, 0))
        assert render(scene)[0, 0].tolist() == [radiance] * 3
