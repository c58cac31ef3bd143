"""Random scenes in which rounding, ties and culling are hard to get right.

All numbers of a scene come from one `random.Random`, so there are two sources of scenes.
`random_scene` takes a seed.  `scenes` is a Hypothesis strategy: Hypothesis chooses the numbers, and
reduces a scene that fails a test to a simple one.  Coordinates are small dyadic fractions wherever
objects touch, so that they touch exactly.
"""

import math
from collections.abc import Callable, Iterable
from io import BytesIO
from random import Random
from typing import NamedTuple

from hypothesis import note
from hypothesis import strategies as st
from probe import Surface, Vector

from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Shader, Sphere, save_scene


class Setting(NamedTuple):
    """Surfaces, and a range of places from which to look at them."""

    surfaces: list[Surface]
    target: Vector
    """The point at which the camera looks."""
    reach: float
    """Distance of the camera from the target, and the scale of the lights' distances."""
    flatness: float = 1
    """Factor on the heights of the camera and the lights above the target."""


def random_scene(kind: str, seed: int, width: int = 13, height: int = 9) -> Scene:
    """Return a scene of a kind in `KINDS`: always the same for the same arguments."""
    return _scene(kind, Random(f"{kind} {seed}"), width, height)


@st.composite
def scenes(
    draw: st.DrawFn,
    kinds: Iterable[str],
    width: st.SearchStrategy[int],
    height: st.SearchStrategy[int],
) -> Scene:
    """Draw a scene of one of some kinds.  If a test fails, the scene is printed as a scene file.

    Parameters
    ----------
    kinds : iterable of str
        Names in `FEW_OBJECTS`: a crowd has too many numbers for Hypothesis.
    width, height : strategy of int
        Size of the picture in pixels.
    """
    kind, random = draw(st.sampled_from([*kinds])), draw(st.randoms(use_true_random=False))
    scene = _scene(kind, random, draw(width), draw(height))
    save_scene(scene, file := BytesIO())
    note(file.getvalue().decode())
    return scene


def _scene(kind: str, random: Random, width: int, height: int) -> Scene:
    setting = KINDS[kind](random)
    camera = _camera(random, setting)
    lights = [_light(random, camera, setting) for _ in range(random.randint(1, 3))]
    return Scene(
        camera=camera, width=width, height=height, lights=lights, surfaces=setting.surfaces
    )


def _uniform(random: Random, low: float, high: float) -> float:
    """Return a random number between two bounds, one of 2^20 steps.

    Hypothesis reduces the number towards the lower bound.  `random.uniform` would not do:
    Hypothesis would also choose numbers below the range of the format, such as 1e-300.
    """
    return low + (high - low) * random.randint(0, 2**20) / 2**20


def _vector(random: Random, low: float, high: float) -> Vector:
    x, y, z = (_uniform(random, low, high) for _ in range(3))
    return x, y, z


def _direction(random: Random) -> Vector:
    """Return a unit vector, uniformly distributed: its height is so (Archimedes)."""
    turn, y = _uniform(random, 0, 2 * math.pi), _uniform(random, -1, 1)
    across = math.sqrt(1 - y * y)
    return across * math.sin(turn), y, across * math.cos(turn)


def _moved(point: Vector, scale: float, direction: Vector) -> Vector:
    """Return the point that is reached from another by a multiple of a vector."""
    x, y, z = (p + scale * d for p, d in zip(point, direction, strict=True))
    return x, y, z


def _camera(random: Random, setting: Setting) -> Camera:
    """Return a camera that looks at the target, often through an oblique or oblong window."""
    x, y, z = _direction(random)
    up = _direction(random)
    if random.randint(0, 3) == 0:
        axis, sign = random.randrange(3), random.choice([-1.0, 1.0])
        x, y, z = (sign * (axis == k) for k in range(3))
        up = abs(z), abs(x), abs(y)
    direction = x, y * setting.flatness, z
    is_oblique = random.randint(0, 9) < 4
    return Camera(
        view_point=_moved(setting.target, -setting.reach, direction),
        view_dir=direction,
        view_up=up,
        proj_normal=_moved(direction, 0.5, _direction(random)) if is_oblique else None,
        # From far away, the lens is longer.
        proj_distance=_uniform(random, 0.5, 2) * max(1, setting.reach / 3),
        view_width=_uniform(random, 0.3, 3),
        view_height=_uniform(random, 0.3, 2),
    )


def _light(random: Random, camera: Camera, setting: Setting) -> PointLight:
    """Return a light anywhere around, sometimes at the eye, in a sphere's centre or on a face."""
    surface, place = random.choice(setting.surfaces), random.randint(0, 9)
    x, y, z = _direction(random)
    distance = setting.reach * _uniform(random, 0.25, 3)
    position = x * distance, y * distance * setting.flatness, z * distance
    if place == 0:
        position = camera.view_point
    elif place == 1 and isinstance(surface, Sphere):
        position = surface.center
    elif place == 2 and isinstance(surface, Box):
        (x0, y0, z0), (x1, _, z1) = surface.min_pt, surface.max_pt
        position = _uniform(random, x0, x1), y0, _uniform(random, z0, z1)
    return PointLight(position=position, intensity=_vector(random, 0.2, 1))


def _shader(random: Random) -> Shader:
    diffuse = _vector(random, 0.1, 1)
    if random.randint(0, 1) == 0:
        return Lambertian(diffuse=diffuse)
    return Phong(diffuse=diffuse, specular=(0.5, 0.4, 0.3), exponent=random.randrange(60))


def _eighths(random: Random, low: float, high: float) -> float:
    """Return a random multiple of 1/8."""
    return random.randint(int(low * 8), int(high * 8)) / 8


def _ball(random: Random, x: float, y: float, z: float, radius: float) -> Sphere:
    return Sphere(center=(x, y, z), radius=radius, shader=_shader(random))


def _box(random: Random, low: Vector, high: Vector) -> Box:
    return Box(min_pt=low, max_pt=high, shader=_shader(random))


def _ball_or_box(random: Random, spread: float, size: float) -> Surface:
    """Return a surface of random size, which is flat along an axis now and then."""
    center = _vector(random, -spread, spread)
    if random.randint(0, 1) == 0:
        return _ball(random, *center, _uniform(random, 0.1 * size, size))
    x, y, z = (_uniform(random, 0.1 * size, size) * (random.randint(0, 9) > 0) for _ in range(3))
    return _box(random, _moved(center, -1, (x, y, z)), _moved(center, 1, (x, y, z)))


def _balls_and_boxes(random: Random, count: int, spread: float, size: float = 1) -> list[Surface]:
    return [_ball_or_box(random, spread, size) for _ in range(count)]


def _scattered(random: Random) -> Setting:
    surfaces = _balls_and_boxes(random, random.randint(1, 8), 2)
    return Setting(surfaces, (0, 0, 0), _uniform(random, 1, 6))


def _touching(random: Random) -> Setting:
    """Boxes and balls stand on each other and on a floor at y = 0."""
    surfaces: list[Surface] = [_box(random, (-8, low, -8), (8, 0, 8)) for low in (-1, 0)]
    for _ in range(4):
        x, z = _eighths(random, -2, 2), _eighths(random, -2, 2)
        a, h, r = (_eighths(random, 0.25, 1) for _ in range(3))
        surfaces += [
            _box(random, (x - a, 0, z - a), (x + a, h, z + a)),
            _ball(random, x, h + r, z, r),
            _ball(random, x + a + r, r, z, r),
            _ball(random, x, h + 2 * r + h, z, h),
        ]
    return Setting(surfaces, (0, 0.5, 0), _uniform(random, 2, 6))


def _nested(random: Random) -> Setting:
    """Each surface is inside the next, and some touch it; the eye is between them."""
    surfaces: list[Surface] = []
    r = 0.25
    for _ in range(5):
        r *= random.choice([1.5, 2, 4])
        offset = random.choice([0, 0.25]) * r
        surfaces += [_ball(random, offset, 0, 0, r), _box(random, (-r, -r, -r), (r, r, r + offset))]
    return Setting(surfaces, (0, 0, 0), _uniform(random, 0.1, 1.2) * r)


def _duplicated(random: Random) -> Setting:
    """Every surface of a scene is listed twice: the copies look like the originals."""
    setting = random.choice([_scattered, _touching, _nested, _rooms])(random)
    copies = random.sample(setting.surfaces, len(setting.surfaces))
    return setting._replace(surfaces=setting.surfaces + copies)


def _enormous(random: Random) -> Setting:
    """Small things lie on the flank of a huge ball, beside a huge box."""
    radius = float(2 ** random.randint(10, 23))
    ground = _ball(random, 0, -radius, 0, radius)
    slab = _box(random, (-radius, -3, -radius), (radius, -2, 0))
    surfaces = [ground, slab, *_balls_and_boxes(random, 4, 2)]
    return Setting(surfaces, (0, 1, 0), _uniform(random, 1, 6))


def _rooms(random: Random) -> Setting:
    """The eye is inside a box or a ball, together with things, some of which cross its walls."""
    size = _eighths(random, 2, 4)
    is_round = random.randint(0, 1) == 0
    room = (
        _ball(random, 0, 0, 0, 2 * size)
        if is_round
        else _box(random, (-size, -size, -size), (size, size, size))
    )
    surfaces = [room, *_balls_and_boxes(random, 5, size)]
    return Setting(surfaces, (0, 0, 0), size * _uniform(random, 0.1, 0.9))


def _far(random: Random) -> Setting:
    """The surfaces are seen from up to 10^4 times their size."""
    return Setting(_balls_and_boxes(random, 6, 1), (0, 0, 0), 10 ** _uniform(random, 1, 4))


def _grazing(random: Random) -> Setting:
    """The eye and the lights are as close to a floor as 10^-9; there is a wall behind it."""
    surfaces: list[Surface] = [
        _box(random, (-64, -1, -64), (64, 0, 64)),
        _box(random, (-64, 0, -9), (64, 8, -8)),
        _ball(random, 0, -(2.0**16), 0, 2.0**16),
        *_balls_and_boxes(random, 5, 2),
    ]
    reach, flatness = _uniform(random, 2, 8), 10 ** _uniform(random, -9, -1)
    return Setting(surfaces, (0, 0, 0), reach, flatness)


def _walled(random: Random) -> Setting:
    """Six slabs around the eye, most lights and some objects hide the whole sky."""
    surfaces = _balls_and_boxes(random, 4, 1)
    for axis in range(3):
        for ends in ((-2.5, -2), (2, 2.5)):
            sides = [ends if k == axis else (-2.5, 2.5) for k in range(3)]
            low, high = zip(*sides, strict=True)
            surfaces.append(_box(random, low, high))
    return Setting(surfaces, (0, 0, 0), _uniform(random, 0.5, 1.9))


def _crowd(random: Random) -> Setting:
    """A thousand small objects surround the eye and the lights."""
    surfaces = _balls_and_boxes(random, 1000, 2, 0.06)
    return Setting(surfaces, (0, 0, 0), _uniform(random, 0, 4))


KINDS: dict[str, Callable[[Random], Setting]] = {
    make.__name__[1:]: make
    for make in (
        *(_scattered, _touching, _nested, _duplicated, _enormous),
        *(_rooms, _far, _grazing, _walled, _crowd),
    )
}
FEW_OBJECTS = [kind for kind in KINDS if kind != "crowd"]
