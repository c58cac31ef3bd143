"""Random scenes that are hard to get right, each from its own seed.

Coordinates are small dyadic numbers wherever objects touch, so that they do so exactly.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from probe import Surface, Vector, a_direction

from tracer import Box, Camera, Lambertian, Phong, PointLight, Scene, Shader, Sphere
from tracer.arrays import Floats


class Setting(NamedTuple):
    """Objects, and where to look at them from: at `target`, so far away."""

    surfaces: list[Surface]
    target: Vector
    reach: float
    flat: float = 1
    """Factor on the heights of the eye and the lights over the target."""


def random_scene(kind: str, seed: int, width: int = 13, height: int = 9) -> Scene:
    """A scene of a kind in `KINDS`; the same for the same seed."""
    rng = np.random.default_rng([*kind.encode(), seed])
    setting = KINDS[kind](rng)
    camera = _camera(rng, setting)
    lights = [_light(rng, camera, setting) for _ in range(rng.integers(1, 4))]
    return Scene(
        camera=camera, width=width, height=height, lights=lights, surfaces=setting.surfaces
    )


def _camera(rng: Generator, setting: Setting) -> Camera:
    """Looks at the target, often through a window that is oblique or not square."""
    direction = a_direction(rng)
    axis_aligned = rng.random() < 0.25
    if axis_aligned:
        direction = np.eye(3)[rng.integers(3)] * rng.choice([-1, 1])
    direction[1] *= setting.flat
    eye = np.array(setting.target) - direction * setting.reach
    up = np.roll(np.abs(direction), 1) if axis_aligned else a_direction(rng)
    tilted = direction + 0.5 * a_direction(rng) if rng.random() < 0.4 else None
    # From further away through a longer lens.
    distance = rng.uniform(0.5, 2) * max(1, setting.reach / 3)
    width, height = rng.uniform(0.3, 3), rng.uniform(0.3, 2)
    return Camera(view_point=eye, view_dir=direction, view_up=up,
                  proj_normal=tilted, proj_distance=distance, view_width=width,
                  view_height=height)  # fmt: skip


def _light(rng: Generator, camera: Camera, setting: Setting) -> PointLight:
    """Anywhere around; sometimes at the eye, in a sphere's centre or on a box's face."""
    position = rng.normal(size=3) * setting.reach * (1, setting.flat, 1)
    surface = setting.surfaces[rng.integers(len(setting.surfaces))]
    where = rng.random()
    if where < 0.1:
        position = camera.view_point
    elif where < 0.2 and isinstance(surface, Sphere):
        position = surface.center
    elif where < 0.3 and isinstance(surface, Box):
        position = rng.uniform(surface.min_pt, surface.max_pt)
        position[1] = surface.min_pt[1]
    return PointLight(position=tuple(position), intensity=rng.uniform(0.2, 1, 3))


def _shader(rng: Generator) -> Shader:
    diffuse = rng.uniform(0.1, 1, 3)
    if rng.random() < 0.5:
        return Lambertian(diffuse=diffuse)
    return Phong(diffuse=diffuse, specular=(0.5, 0.4, 0.3), exponent=float(rng.integers(0, 60)))


def _dyadic(rng: Generator, low: float, high: float, size: int) -> Floats:
    """Multiples of 1/8."""
    return rng.integers(int(low * 8), int(high * 8) + 1, size) / 8


def _ball(rng: Generator, x: float, y: float, z: float, radius: float) -> Sphere:
    return Sphere(center=(x, y, z), radius=radius, shader=_shader(rng))


def _box(rng: Generator, low: Vector, high: Vector) -> Box:
    return Box(min_pt=low, max_pt=high, shader=_shader(rng))


def _some(rng: Generator, count: int, spread: float) -> list[Surface]:
    surfaces: list[Surface] = []
    for _ in range(count):
        center, shader = rng.uniform(-spread, spread, 3), _shader(rng)
        size = rng.uniform(0.1, 0.9, 3) * (rng.random(3) > 0.1)  # now and then flat
        surfaces.append(
            Sphere(center=center, radius=rng.uniform(0.1, 1), shader=shader)
            if rng.random() < 0.5
            else Box(min_pt=center - size, max_pt=center + size, shader=shader)
        )
    return surfaces


def _scattered(rng: Generator) -> Setting:
    return Setting(_some(rng, int(rng.integers(1, 9)), 2), (0, 0, 0), rng.uniform(1, 6))


def _touching(rng: Generator) -> Setting:
    """Boxes and balls standing on each other and on a floor at y = 0."""
    surfaces: list[Surface] = [_box(rng, (-8, low, -8), (8, 0, 8)) for low in (-1, 0)]
    for _ in range(4):
        x, z = _dyadic(rng, -2, 2, 2).tolist()
        a, h, r = _dyadic(rng, 0.25, 1, 3).tolist()
        surfaces += [
            _box(rng, (x - a, 0, z - a), (x + a, h, z + a)),
            _ball(rng, x, h + r, z, r),
            _ball(rng, x + a + r, r, z, r),
            _ball(rng, x, h + 2 * r + h, z, h),
        ]
    return Setting(surfaces, (0, 0.5, 0), rng.uniform(2, 6))


def _nested(rng: Generator) -> Setting:
    """Each in the next, some touching it from inside; the eye between them."""
    surfaces: list[Surface] = []
    r = 0.25
    for _ in range(5):
        r *= float(rng.choice([1.5, 2, 4]))
        away = float(rng.choice([0, 0.25])) * r
        surfaces += [_ball(rng, away, 0, 0, r), _box(rng, (-r, -r, -r), (r, r, r + away))]
    return Setting(surfaces, (0, 0, 0), rng.uniform(0.1, 1.2) * r)


def _duplicated(rng: Generator) -> Setting:
    """All of another kind, listed twice: the copies shine like the originals."""
    kind = [_scattered, _touching, _nested, _rooms][rng.integers(4)]
    once = kind(rng)
    again = [once.surfaces[i] for i in rng.permutation(len(once.surfaces))]
    return once._replace(surfaces=once.surfaces + again)


def _enormous(rng: Generator) -> Setting:
    """Small things on the flank of a huge ball, beside a huge box."""
    radius = float(2 ** rng.integers(10, 24))
    ground = _ball(rng, 0, -radius, 0, radius)
    slab = _box(rng, (-radius, -3, -radius), (radius, -2, 0))
    return Setting([ground, slab, *_some(rng, 4, 2)], (0, 1, 0), rng.uniform(1, 6))


def _rooms(rng: Generator) -> Setting:
    """The eye inside a box or a ball, with things in it, some through its walls."""
    size = float(_dyadic(rng, 2, 4, 1)[0])
    room: Surface = _ball(rng, 0, 0, 0, 2 * size)
    if rng.random() < 0.5:
        room = _box(rng, (-size,) * 3, (size,) * 3)
    return Setting([room, *_some(rng, 5, size)], (0, 0, 0), size * rng.uniform(0.1, 0.9))


def _far(rng: Generator) -> Setting:
    """Seen from up to 10^4 times their size."""
    return Setting(_some(rng, 6, 1), (0, 0, 0), 10 ** rng.uniform(1, 4))


def _grazing(rng: Generator) -> Setting:
    """A floor and a wall, with eye and lights as near to the floor as 10^-9."""
    surfaces: list[Surface] = [
        _box(rng, (-64, -1, -64), (64, 0, 64)),
        _box(rng, (-64, 0, -9), (64, 8, -8)),
        _ball(rng, 0, -(2.0**16), 0, 2.0**16),
        *_some(rng, 5, 2),
    ]
    return Setting(surfaces, (0, 0, 0), rng.uniform(2, 8), 10 ** rng.uniform(-9, -1))


def _walled(rng: Generator) -> Setting:
    """Six slabs around the eye, most lights, and some objects: they cover the whole sky."""
    surfaces = _some(rng, 4, 1)
    for axis in range(3):
        for sign in (-1, 1):
            low, high = np.full(3, -2.5), np.full(3, 2.5)
            low[axis], high[axis] = sorted((2 * sign, 2.5 * sign))
            surfaces.append(_box(rng, low, high))
    return Setting(surfaces, (0, 0, 0), rng.uniform(0.5, 1.9))


def _crowd(rng: Generator) -> Setting:
    """A thousand small objects, with the eye and the lights amid them."""
    surfaces: list[Surface] = []
    for center in rng.uniform(-2, 2, (1000, 3)):
        size, shader = rng.uniform(0.01, 0.06, 3), _shader(rng)
        surfaces.append(
            Sphere(center=center, radius=float(size[0]), shader=shader)
            if rng.random() < 0.5
            else Box(min_pt=center - size, max_pt=center + size, shader=shader)
        )
    return Setting(surfaces, (0, 0, 0), rng.uniform(0, 4))


KINDS: dict[str, Callable[[Generator], Setting]] = {
    make.__name__[1:]: make
    for make in (
        *(_scattered, _touching, _nested, _duplicated, _enormous),
        *(_rooms, _far, _grazing, _walled, _crowd),
    )
}
