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
    """The surfaces of a scene, and limits for the positions of its camera and lights."""

    surfaces: list[Surface]
    target: Vector  # the point at which the camera looks
    # Distance of the camera from the target.  The lights have 0.25 to 3 times this distance from
    # the origin.
    reach: float
    # Factor on the height of the camera above the target, and of the lights above the origin.
    height_factor: float = 1


def random_scene(kind: str, seed: int, width: int = 13, height: int = 9) -> Scene:
    """Build a random scene, which is always the same for the same arguments.

    `kind` is what makes the scene hard to render: a key of `KINDS`.
    """
    return build_scene(kind, Random(f"{kind} {seed}"), width, height)


@st.composite
def scenes(
    draw: st.DrawFn,
    kinds: Iterable[str],
    width: st.SearchStrategy[int],
    height: st.SearchStrategy[int],
) -> Scene:
    """Let Hypothesis choose a scene, and print it as a scene file if the test fails.

    A test calls this function without the argument `draw`, which the decorator passes, and receives
    a strategy.  The kinds to choose from are those in `FEW_OBJECTS`: a crowd has too many numbers
    for Hypothesis.
    """
    kind = draw(st.sampled_from([*kinds]))
    random = draw(st.randoms(use_true_random=False))
    scene = build_scene(kind, random, draw(width), draw(height))
    save_scene(scene, file := BytesIO())
    note(file.getvalue().decode())
    return scene


def build_scene(kind: str, random: Random, width: int, height: int) -> Scene:
    """Build a scene of one kind with one to three lights; all its numbers come from `random`."""
    setting = KINDS[kind](random)
    camera = _camera(random, setting)
    lights = [_light(random, camera, setting) for _ in range(random.randint(1, 3))]
    return Scene(
        camera=camera, width=width, height=height, lights=lights, surfaces=setting.surfaces
    )


def _uniform(random: Random, low: float, high: float) -> float:
    """Return one of 2^20 + 1 equally spaced numbers from `low` to `high`, both included."""
    # Hypothesis reduces the number towards `low`.  With `random.uniform`, it would also choose
    # numbers below the range of the format, such as 1e-300.
    return low + (high - low) * random.randint(0, 2**20) / 2**20


def _vector(random: Random, low: float, high: float) -> Vector:
    x, y, z = (_uniform(random, low, high) for _ in range(3))
    return x, y, z


def _direction(random: Random) -> Vector:
    """Return a random unit vector; all directions are equally likely."""
    # A uniform point of the unit sphere has a uniform height (Archimedes).
    angle, y = _uniform(random, 0, 2 * math.pi), _uniform(random, -1, 1)
    radius = math.sqrt(1 - y * y)
    return radius * math.sin(angle), y, radius * math.cos(angle)


def _move(point: Vector, scale: float, direction: Vector) -> Vector:
    pairs = zip(point, direction, strict=True)
    x, y, z = (coordinate + scale * component for coordinate, component in pairs)
    return x, y, z


def _scale_height(x: float, y: float, z: float, setting: Setting) -> Vector:
    """Multiply the y of a direction (x, y, z) by the height factor of a setting.

    A y that is not 0 stays at least 2e-10 in size.  Below that, eyes and lights would be so near a
    floor at y = 0 that rounding decides on which side of it they are.
    """
    height = y * setting.height_factor
    return x, math.copysign(max(abs(height), 2e-10), y) if height else height, z


def _cosine(vector: Vector, other: Vector) -> float:
    """Return the absolute value of the cosine of the angle between two vectors."""
    dot_product = sum(a * b for a, b in zip(vector, other, strict=True))
    return abs(dot_product) / (math.hypot(*vector) * math.hypot(*other))


def _camera(random: Random, setting: Setting) -> Camera:
    """Return a camera that looks at the target of a setting from a random direction.

    One camera in four looks along an axis.  Four in ten have a window that is not perpendicular to
    the view direction.  All random numbers, even if all are equal, define a window.
    """
    x, y, z = _direction(random)
    up = _direction(random)
    if random.randint(0, 3) == 0:
        axis, sign = random.randrange(3), random.choice([-1.0, 1.0])
        x, y, z = (sign * (axis == k) for k in range(3))
        up = abs(z), abs(x), abs(y)
    direction = _scale_height(x, y, z, setting)
    is_oblique = random.randint(0, 9) < 4
    normal = _move(direction, 0.5, _direction(random)) if is_oblique else direction
    # Hypothesis reduces numbers until vectors are equal, and a direction may be shorter than 0.5.
    if _cosine(normal, direction) < 0.01:
        normal = direction
    if _cosine(normal, up) > 0.99999:
        up = min(((1, 0, 0), (0, 1, 0), (0, 0, 1)), key=lambda axis: _cosine(axis, normal))
    return Camera(
        view_point=_move(setting.target, -setting.reach, direction),
        view_dir=direction,
        view_up=up,
        proj_normal=normal if is_oblique else None,
        # From far away, the lens is longer.
        proj_distance=_uniform(random, 0.5, 2) * max(1, setting.reach / 3),
        view_width=_uniform(random, 0.3, 3),
        view_height=_uniform(random, 0.3, 2),
    )


def _light(random: Random, camera: Camera, setting: Setting) -> PointLight:
    """Return a light at a random position, or at one where rendering is hard.

    One light in ten is at the eye.  At most one in ten is at the centre of a sphere, and at most
    one in ten is on the lower face of a box.
    """
    surface, special_case = random.choice(setting.surfaces), random.randint(0, 9)
    direction = _scale_height(*_direction(random), setting)
    position = _move((0, 0, 0), setting.reach * _uniform(random, 0.25, 3), direction)
    if special_case == 0:
        position = camera.view_point
    elif special_case == 1 and isinstance(surface, Sphere):
        position = surface.center
    elif special_case == 2 and isinstance(surface, Box):
        (min_x, min_y, min_z), (max_x, _, max_z) = surface.min_pt, surface.max_pt
        position = _uniform(random, min_x, max_x), min_y, _uniform(random, min_z, max_z)
    return PointLight(position=position, intensity=_vector(random, 0.2, 1))


def _shader(random: Random) -> Shader:
    """Return a shader of random colour: Lambertian, or Phong with a random exponent."""
    diffuse = _vector(random, 0.1, 1)
    if random.randint(0, 1) == 0:
        return Lambertian(diffuse=diffuse)
    return Phong(diffuse=diffuse, specular=(0.5, 0.4, 0.3), exponent=random.randrange(60))


def _eighths(random: Random, low: float, high: float) -> float:
    """Return a random multiple of 1/8 from `low` to `high`, which are multiples of 1/8."""
    return random.randint(int(low * 8), int(high * 8)) / 8


def _ball(random: Random, x: float, y: float, z: float, radius: float) -> Sphere:
    return Sphere(center=(x, y, z), radius=radius, shader=_shader(random))


def _box(random: Random, low: Vector, high: Vector) -> Box:
    return Box(min_pt=low, max_pt=high, shader=_shader(random))


def _ball_or_box(random: Random, spread: float, size: float) -> Surface:
    """Return a ball or a box of random size, at a random position near the origin.

    The coordinates of the centre are between -spread and spread.  The radius of the ball, or half a
    side of the box, is between size / 10 and size.  Along each axis, one box in ten has no
    thickness.
    """
    center = _vector(random, -spread, spread)
    if random.randint(0, 1) == 0:
        return _ball(random, *center, _uniform(random, 0.1 * size, size))
    x, y, z = (_uniform(random, 0.1 * size, size) * (random.randint(0, 9) > 0) for _ in range(3))
    return _box(random, _move(center, -1, (x, y, z)), _move(center, 1, (x, y, z)))


def _balls_and_boxes(random: Random, count: int, spread: float, size: float = 1) -> list[Surface]:
    """Return balls and boxes of random size, each as `_ball_or_box`."""
    return [_ball_or_box(random, spread, size) for _ in range(count)]


def _scattered(random: Random) -> Setting:
    """Return one to eight balls and boxes at random positions, some of which intersect."""
    surfaces = _balls_and_boxes(random, random.randint(1, 8), 2)
    return Setting(surfaces=surfaces, target=(0, 0, 0), reach=_uniform(random, 1, 6))


def _touching(random: Random) -> Setting:
    """Return boxes and balls that touch each other exactly, on a floor at y = 0."""
    surfaces: list[Surface] = [_box(random, (-8, low, -8), (8, 0, 8)) for low in (-1, 0)]
    for _ in range(4):
        x, z = _eighths(random, -2, 2), _eighths(random, -2, 2)
        half, height, radius = (_eighths(random, 0.25, 1) for _ in range(3))
        surfaces += [
            _box(random, (x - half, 0, z - half), (x + half, height, z + half)),
            _ball(random, x, height + radius, z, radius),
            _ball(random, x + half + radius, radius, z, radius),
            _ball(random, x, height + 2 * radius + height, z, height),
        ]
    return Setting(surfaces=surfaces, target=(0, 0.5, 0), reach=_uniform(random, 2, 6))


def _nested(random: Random) -> Setting:
    """Return balls and boxes inside each other, some of which touch, around or near the eye."""
    surfaces: list[Surface] = []
    radius = 0.25
    for _ in range(5):
        radius *= random.choice([1.5, 2, 4])
        offset = random.choice([0, 0.25]) * radius
        low, high = (-radius, -radius, -radius), (radius, radius, radius + offset)
        surfaces += [_ball(random, offset, 0, 0, radius), _box(random, low, high)]
    return Setting(surfaces=surfaces, target=(0, 0, 0), reach=_uniform(random, 0.1, 1.2) * radius)


def _duplicated(random: Random) -> Setting:
    """Return the surfaces of another kind of scene, followed by an equal copy of each."""
    setting = random.choice([_scattered, _touching, _nested, _rooms])(random)
    copies = random.sample(setting.surfaces, len(setting.surfaces))
    return setting._replace(surfaces=setting.surfaces + copies)


def _enormous(random: Random) -> Setting:
    """Return small balls and boxes near the top of a huge ball and the edge of a huge box."""
    radius = float(2 ** random.randint(10, 23))
    ground = _ball(random, 0, -radius, 0, radius)
    slab = _box(random, (-radius, -3, -radius), (radius, -2, 0))
    surfaces = [ground, slab, *_balls_and_boxes(random, 4, 2)]
    return Setting(surfaces=surfaces, target=(0, 1, 0), reach=_uniform(random, 1, 6))


def _rooms(random: Random) -> Setting:
    """Return a box or ball around the eye, and five surfaces, some of which intersect it."""
    size = _eighths(random, 2, 4)
    is_round = random.randint(0, 1) == 0
    room = (
        _ball(random, 0, 0, 0, 2 * size)
        if is_round
        else _box(random, (-size, -size, -size), (size, size, size))
    )
    surfaces = [room, *_balls_and_boxes(random, 5, size)]
    return Setting(surfaces=surfaces, target=(0, 0, 0), reach=size * _uniform(random, 0.1, 0.9))


def _far(random: Random) -> Setting:
    """Return balls and boxes that are seen from a distance of up to 10^4 times their size."""
    surfaces = _balls_and_boxes(random, 6, 1)
    return Setting(surfaces=surfaces, target=(0, 0, 0), reach=10 ** _uniform(random, 1, 4))


def _grazing(random: Random) -> Setting:
    """Return a floor with a wall, balls and boxes, seen and lit from just above the floor.

    The heights of the eye and the lights over the floor may be as small as 10^-9 times their
    distances from the origin.
    """
    surfaces: list[Surface] = [
        _box(random, (-64, -1, -64), (64, 0, 64)),
        _box(random, (-64, 0, -9), (64, 8, -8)),
        _ball(random, 0, -(2.0**16), 0, 2.0**16),
        *_balls_and_boxes(random, 5, 2),
    ]
    reach = _uniform(random, 2, 8)
    height_factor = 10 ** _uniform(random, -9, -1)
    return Setting(surfaces=surfaces, target=(0, 0, 0), reach=reach, height_factor=height_factor)


def _walled(random: Random) -> Setting:
    """Return balls and boxes inside six slabs, which also enclose the eye and many lights."""
    surfaces = _balls_and_boxes(random, 4, 1)
    for axis in range(3):
        for ends in ((-2.5, -2), (2, 2.5)):
            sides = [ends if k == axis else (-2.5, 2.5) for k in range(3)]
            low, high = zip(*sides, strict=True)
            surfaces.append(_box(random, low, high))
    return Setting(surfaces=surfaces, target=(0, 0, 0), reach=_uniform(random, 0.5, 1.9))


def _crowd(random: Random) -> Setting:
    """Return a thousand small balls and boxes, which surround the eye or lie in front of it."""
    surfaces = _balls_and_boxes(random, 1000, 2, 0.06)
    return Setting(surfaces=surfaces, target=(0, 0, 0), reach=_uniform(random, 0, 4))


# For each kind of scene, the function that returns its surfaces.
KINDS: dict[str, Callable[[Random], Setting]] = {
    make.__name__[1:]: make
    for make in (
        *(_scattered, _touching, _nested, _duplicated, _enormous),
        *(_rooms, _far, _grazing, _walled, _crowd),
    )
}
FEW_OBJECTS = [kind for kind in KINDS if kind != "crowd"]
