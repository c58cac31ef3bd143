"""Bounds that stand for many exact tests, each against samples of what it stands for.

A capsule for the segments from a ball to a light, a cell for the directions to
a ball, a line for an outline across a pixel.
"""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import blocks, light_side, size_of
from hypothesis import given, settings
from hypothesis import strategies as st
from probe import Surface, Vector

from tracer import Box, Camera, Lambertian, Sphere, Surfaces
from tracer.arrays import Bools, Floats, Triple
from tracer.camera import raster_of
from tracer.capsules import (
    box_and_capsule,
    box_around_capsule,
    sphere_and_capsule,
    sphere_around_capsule,
)
from tracer.edges import Kind, Lines, Pencil
from tracer.intersection import box_hit
from tracer.light_buffers import LightBuffer, light_buffer_finder
from tracer.occluders import occluders_of
from tracer.outlines import box_corners, outlines_of, silhouette_planes
from tracer.visibility import View

SLACK = 1e-9
"""Of all sizes around: so much thicker than their balls capsules are asked for."""

SIZES = [1.0, 2.0**-60, 2.0**60, 1e-9, 1e9, 1e30]


def unit_vectors(rng: np.random.Generator, count: int) -> Floats:
    return unit(rng.normal(size=(count, 3)))


def unit(v: Floats) -> Floats:
    unit: Floats = v / np.sqrt((v * v).sum(axis=1, keepdims=True))
    return unit


def point(rng: np.random.Generator) -> Floats:
    """Every other time on a grid, where things touch, line up and coincide."""
    return rng.integers(-8, 9, 3) / 4 if rng.random() < 0.5 else 2 * rng.normal(size=3)


def a_sphere(rng: np.random.Generator) -> Sphere:
    radius = rng.choice([0.25, 0.5, 1, 2, rng.exponential(), 1e-3, 30])
    return Sphere(center=vector(point(rng)), radius=float(radius))


def a_box(rng: np.random.Generator) -> Box:
    corners = np.array([point(rng), point(rng)])
    flat = rng.random(3) < 0.2
    corners[1, flat] = corners[0, flat]
    if rng.random() < 0.1:
        corners[:, rng.integers(3)] *= 30
    return Box(min_pt=vector(corners.min(axis=0)), max_pt=vector(corners.max(axis=0)))


def vector(v: Floats) -> Vector:
    x, y, z = v.tolist()
    return x, y, z


def inside(rng: np.random.Generator, surface: Surface, count: int) -> Floats:
    """Points (count, 3) in the object, many of them on its surface."""
    if isinstance(surface, Sphere):
        depth = rng.choice([0.0, 0.5, 0.9, 1.0], size=(count, 1))
        return np.array(surface.center) + surface.radius * depth * unit_vectors(rng, count)
    place = np.clip(rng.uniform(-0.3, 1.3, (count, 3)), 0, 1)
    low, high = np.array(surface.min_pt), np.array(surface.max_pt)
    return np.clip(low + place * (high - low), low, high)


def onto(surface: Surface, p: Floats) -> Floats:
    """The nearest points (n, 3) of the object's surface, or of the box itself."""
    if isinstance(surface, Box):
        return np.clip(p, surface.min_pt, surface.max_pt)
    away = p - surface.center
    distance = np.sqrt((away * away).sum(axis=1, keepdims=True))
    nearest: Floats = surface.center + surface.radius * away / np.maximum(distance, 1e-300)
    return nearest


def a_light(rng: np.random.Generator, surface: Surface, middle: Floats, radius: float) -> Floats:
    """Anywhere, or at a place that is special to the ball or the object."""
    kind = rng.integers(10)
    if kind == 0:
        return inside(rng, surface, 1)[0]
    if kind == 1:
        return onto(surface, point(rng)[None, :])[0]
    if kind == 2:
        return middle + radius * rng.random() * unit_vectors(rng, 1)[0]
    if kind == 3:
        return np.where(rng.random(3) < 0.6, middle, point(rng))  # parallel to an axis, or none
    if kind == 4:
        return point(rng) * 10.0 ** rng.uniform(1, 8)
    if kind <= 6:
        through = inside(rng, surface, 1)[0]  # right behind the object
        return through + rng.uniform(0.5, 3) * (through - middle)
    return point(rng)


def in_ball(
    rng: np.random.Generator, surface: Surface, light: Floats, middle: Floats, radius: float
) -> Floats:
    """Points (n, 3) of a ball: all over it, on the object, and where the object is in the way."""
    anywhere = middle + radius * rng.choice([1.0, 0.5], size=(24, 1)) * unit_vectors(rng, 24)
    # On the lines from the light through the object, where they enter the ball and leave it.
    ray = inside(rng, surface, 32) - light
    length2 = np.maximum((ray * ray).sum(axis=1, keepdims=True), 1e-300)
    foot = light + ray * (((middle - light) * ray).sum(axis=1, keepdims=True) / length2)
    aside2 = ((foot - middle) ** 2).sum(axis=1, keepdims=True)
    half = ray * np.sqrt(np.maximum(radius * radius - aside2, 0) / length2)
    points = np.concatenate([middle[None, :], anywhere, foot, foot + half, foot - half])
    points = np.concatenate([points, onto(surface, points)])
    distance = np.sqrt(((points - middle) ** 2).sum(axis=1))
    return points[distance <= radius * (1 + 1e-12)]


class Case:
    """A ball, a light, an object, and which segments from points of the ball it blocks."""

    def __init__(self, rng: np.random.Generator, scale: float, shift: float) -> None:
        surface: Surface = a_sphere(rng) if rng.random() < 0.5 else a_box(rng)
        radius = float(rng.choice([0, 1e-6, 1e-3, 0.03, 0.1, 0.5, 2, 20]))
        middle = point(rng) if rng.random() < 0.8 else inside(rng, surface, 1)[0]
        light = a_light(rng, surface, middle, radius)
        points = in_ball(rng, surface, light, middle, radius)
        if isinstance(surface, Sphere):
            center = vector(np.array(surface.center) * scale + shift)
            self.surface: Surface = Sphere(center=center, radius=surface.radius * scale)
        else:
            low, high = (np.array(v) * scale + shift for v in (surface.min_pt, surface.max_pt))
            self.surface = Box(min_pt=vector(low), max_pt=vector(high))
        self.middle, self.light = middle * scale + shift, light * scale + shift
        around = np.abs(self.middle).sum() + np.abs(self.light).sum() + size_of(self.surface)
        self.thickness = float(radius * scale + SLACK * (around + radius * scale))
        x, y, z = (points * scale + shift).T
        reach = np.abs(x) + np.abs(y) + np.abs(z)
        side = light_side(self.surface, vector(self.light))
        self.blocked = [
            blocks(
                self.surface,
                eye_inside,
                side,
                (x, y, z),
                vector(self.light),
                reach,
            )
            for eye_inside in (False, True)
        ]


@np.errstate(all="ignore")
def capsules(cases: list[Case]) -> tuple[Bools, Bools]:
    """Whether the objects, all of one kind, meet and cut their capsules."""
    start, end = columns([c.middle for c in cases]), columns([c.light for c in cases])
    thickness = np.array([c.thickness for c in cases])
    surfaces = Surfaces.of([c.surface for c in cases])
    if len(surfaces.radius):
        sphere = start, end, thickness, columns(surfaces.center), surfaces.radius
        meets, cuts = sphere_and_capsule(*sphere)
        return meets & ~sphere_around_capsule(*sphere), cuts
    box = start, end, thickness, columns(surfaces.min_pt), columns(surfaces.max_pt)
    meets, cuts = box_and_capsule(*box)
    return meets & ~box_around_capsule(*box), cuts


def columns(points: Floats | list[Floats]) -> Triple:
    x, y, z = np.array(points).T
    return x, y, z


@np.errstate(all="ignore")
def some_cases(seed: int, scale: float, shift: float) -> list[tuple[Case, bool, bool]]:
    """Cases, whether the object meets the capsule, and whether it cuts it."""
    rng = np.random.default_rng(seed)
    cases = [Case(rng, scale, shift) for _ in range(60)]
    found = []
    for kind in (Sphere, Box):
        some = [case for case in cases if isinstance(case.surface, kind)]
        if some:
            found += zip(some, *(m.tolist() for m in capsules(some)), strict=True)
    return found


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32),
    scale=st.sampled_from(SIZES),
    shift=st.sampled_from([0.0, 0.0, 1.0, -1e4, 1e7]),
)
def test_capsules(seed: int, scale: float, shift: float) -> None:
    for case, meets, cuts in some_cases(seed, scale, shift * scale):
        for blocked in case.blocked:
            assert meets or not blocked.any(), vars(case)
            assert not cuts or blocked.all(), vars(case)


def test_capsules_decide_often() -> None:
    # Bounds that always say "perhaps" would be right, too.
    found = [case for seed in range(20) for case in some_cases(seed, 1.0, 0.0)]
    for kind in (Sphere, Box):
        decided = [(meets, cuts) for case, meets, cuts in found if isinstance(case.surface, kind)]
        assert np.mean([not meets for meets, _ in decided]) > 0.2
        assert np.mean([cuts for _, cuts in decided]) > 0.03


@pytest.mark.parametrize("size", [1.0, 2.0**27, 2.0**40, 2.0**200])
def test_light_straight_over_a_large_ball(size: float) -> None:
    # A box aside of the segment along an axis, but within the ball at its foot.
    start, end = (np.zeros(1),) * 3, (np.zeros(1), np.array([10 * size]), np.zeros(1))
    low, high = np.array([[3.0], [2.0], [-1.0]]) * size, np.array([[5.0], [2.5], [1.0]]) * size
    with np.errstate(all="ignore"):
        meets, cuts = box_and_capsule(
            start, end, np.array([14 * size]), (low[0], low[1], low[2]), (high[0], high[1], high[2])
        )
    assert meets.all()
    assert not cuts.any()


def a_buffer(rng: np.random.Generator) -> tuple[Floats, LightBuffer]:
    """A light (3,) and the buffer around it, with some objects."""
    surfaces = Surfaces.of([*(a_sphere(rng) for _ in range(9)), *(a_box(rng) for _ in range(9))])
    camera = Camera(view_point=vector(point(rng)), view_dir=vector(unit_vectors(rng, 1)[0]))
    raster = raster_of(camera, 32, 32)
    inside_none = np.zeros(len(surfaces), dtype=np.bool_)
    view = View(raster, surfaces, outlines_of(raster, surfaces, split=False), inside_none)
    light = point(rng)
    return light, light_buffer_finder(occluders_of(view, light[None, :])).buffers[0]


@np.errstate(all="ignore")
@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32))
def test_cells_of_a_buffer_around_a_ball(seed: int) -> None:
    rng = np.random.default_rng(seed)
    light, buffer = a_buffer(rng)
    middle = np.array([point(rng) for _ in range(40)])
    middle[:10] = light + 1e-3 * middle[:10]
    middle[10] = light
    radius = rng.choice([0, 1e-9, 1e-3, 0.1, 1], size=40)
    distance, ball, cell, wide = buffer.around(columns(light - middle), radius)
    pairs = {pair: k for k, pair in enumerate(zip(ball.tolist(), cell.tolist(), strict=True))}
    for i in range(40):
        points = middle[i] + radius[i] * (1 - 1e-12) * unit_vectors(rng, 60)
        far, at, within = buffer.locate(columns(light - points))
        assert (far <= distance[i]).all()
        assert {(i, c) for c in at.tolist()} <= pairs.keys()
        # Bounds of objects are wider by a ten-thousandth: what meets the point meets the ball.
        wider = wide[[pairs[i, c] for c in at.tolist()]] - 3e-5
        assert not (wider > within).any()


def some_lines(rng: np.random.Generator, count: int) -> Lines:
    """Lines at all slopes, upright and level ones, through cells and past them."""
    a, b = rng.normal(size=(2, count)) * 10.0 ** rng.integers(-6, 7, count)
    a, b = np.where(rng.random(count) < 0.1, 0, a), np.where(rng.random(count) < 0.1, 0, b)
    b = np.where(rng.random(count) < 0.1, a * rng.choice([1, -1, 1e-4, 1e-7]), b)
    b = np.where((a == 0) & (b == 0), 1, b)
    c = 0.5 * (np.abs(a) + np.abs(b)) * rng.uniform(-1.2, 1.2, count)
    return Lines(np.arange(count), np.full(count, Kind.EDGE), a, b, c)


@pytest.mark.parametrize("seed", range(3))
def test_halves(seed: int) -> None:
    # In closed form along x, summed over y.
    lines = some_lines(np.random.default_rng(seed), 300)
    y = (np.arange(4000) + 0.5) / 4000 - 0.5
    rest = lines.c[:, None] + lines.b[:, None] * y
    with np.errstate(all="ignore"):
        root = np.clip(-rest / lines.a[:, None], -0.5, 0.5)
    level = lines.a[:, None] == 0
    root = np.where(level, np.where(rest > 0, -0.5, 0.5), root)
    west = np.where(lines.a[:, None] < 0, -0.5, root)
    east = np.where(lines.a[:, None] < 0, root, 0.5)
    share, moment_x, moment_y = lines.areas_and_moments()
    # Level and upright lines are tilted by a ten-thousandth.
    assert share == pytest.approx((east - west).mean(axis=1), abs=1.5e-4)
    assert moment_x == pytest.approx((east**2 - west**2).mean(axis=1) / 2, abs=1.5e-4)
    assert moment_y == pytest.approx((y * (east - west)).mean(axis=1), abs=1.5e-4)
    other = lines._replace(a=-lines.a, b=-lines.b, c=-lines.c)
    assert other.areas_and_moments()[0] == pytest.approx(1 - share, abs=1e-7)


@pytest.mark.parametrize(("a", "b"), [(1, 0), (0, 1), (1, 1e-9), (-1, 0)])
def test_the_share_beside_an_upright_line(a: float, b: float) -> None:
    one = np.zeros(1, dtype=np.intp)
    line = Lines(one, one, *(np.array([float(m)]) for m in (a, b, -0.48)))
    assert line.areas_and_moments()[0] == pytest.approx(0.02, abs=1e-3)


def a_pencil(rng: np.random.Generator, targets: Floats, size: Floats) -> Pencil:
    """Rays to targets (n, 3) seen from the apex, through cells so wide, seen at a slant."""
    count = len(targets)
    ray = targets * 10.0 ** rng.uniform(-3, 3, (count, 1))
    length = np.sqrt((ray * ray).sum(axis=1, keepdims=True))
    normal = unit(ray / length + 0.7 * unit_vectors(rng, count))
    across = unit(np.cross(normal, unit_vectors(rng, count)))
    down = np.cross(normal, across)
    across, down = (v * length * size[:, None] for v in (across, down))
    return Pencil(Kind.EDGE, np.arange(count), columns(ray), columns(across), columns(down))


def rays(pencil: Pencil, x: Floats, y: Floats) -> Triple:
    """Rays (n, m) through points of all cells."""
    d, e, f = (
        c[:, None] + a[:, None] * x + b[:, None] * y
        for c, a, b in zip(pencil.ray, pencil.across, pencil.down, strict=True)
    )
    return d, e, f


def spread(count: int) -> tuple[Floats, Floats]:
    """Points of a cell, as evenly spread as may be in all directions."""
    number = np.arange(count) + 0.5
    return number / count - 0.5, number * (np.sqrt(1.25) - 0.5) % 1 - 0.5


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("size", [1e-5, 1e-3, 1e-2])
def test_outlines_of_spheres(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    count = 200
    radius, sine = rng.uniform(0.1, 3, count), rng.uniform(0.05, 0.9, count)
    ahead, aside = unit_vectors(rng, count), unit_vectors(rng, count)
    center = ahead * (radius / sine)[:, None]
    aside = unit(aside - ahead * (ahead * aside).sum(axis=1, keepdims=True))
    # Near the tangent, by less than a cell, which is a part of the disc.
    width = size * sine
    slope = np.tan(np.arcsin(sine) + width * rng.uniform(-0.6, 0.6, count))
    pencil = a_pencil(rng, ahead + aside * slope[:, None], width)
    lines, _, _ = pencil.discs(columns(center), radius)
    # Where rays touch the sphere, straight across the line: by bisection.
    steep = np.hypot(lines.a, lines.b)
    low, high = np.full(count, -1.0), np.full(count, 1.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        x, y = (middle * m / steep for m in (lines.a, lines.b))
        outside = ~met(pencil, x[:, None], y[:, None], center, radius)[:, 0]
        low, high = np.where(outside, low, middle), np.where(outside, middle, high)
    # What bends it, and how the rays' distances change across the cell, are of its size.
    assert -lines.c / steep == pytest.approx(low, abs=0.6 * size)
    x, y = spread(1500)
    share = 1 - met(pencil, x, y, center, radius).mean(axis=1)
    assert lines.areas_and_moments()[0] == pytest.approx(share, abs=0.01)


def met(pencil: Pencil, x: Floats, y: Floats, center: Floats, radius: Floats) -> Bools:
    """Whether rays through points (n, m) of cells meet spheres before the apex."""
    d = rays(pencil, x, y)
    along = sum(center[:, k, None] * d[k] for k in range(3))
    aside = [center[:, k, None] - along / sum(m * m for m in d) * d[k] for k in range(3)]
    meets: Bools = sum(m * m for m in aside) <= (radius * radius)[:, None]
    return meets


@np.errstate(all="ignore")
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("size", [1e-4, 1e-2, 0.3])
def test_outlines_of_boxes(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    corners = np.sort(rng.normal(size=(2, 400, 3)), axis=0)
    surfaces = Surfaces(
        min_pt=corners[0], max_pt=corners[1], box_shader=np.zeros(400), shaders=(Lambertian(),)
    )
    apex = np.array([5.0, rng.uniform(-2, 2), rng.uniform(-2, 2)])
    low, high = surfaces.min_pt - apex, surfaces.max_pt - apex
    # Around edges and corners.
    place = np.clip(rng.uniform(-0.5, 1.5, low.shape), 0, 1)
    pencil = a_pencil(rng, low + place * (high - low), np.full(400, size))
    planes = silhouette_planes(
        box_corners(surfaces.min_pt, surfaces.max_pt, apex),
        apex,
        surfaces.min_pt,
        surfaces.max_pt,
    )
    lines, turn, _ = pencil.boxes(planes)
    assert not turn.any()
    x, y = spread(150)
    inner = np.ones((400, x.size), dtype=np.bool_)
    near = np.zeros((400, x.size), dtype=np.bool_)
    value = lines.c[:, None] + lines.a[:, None] * x + lines.b[:, None] * y
    np.logical_and.at(inner, lines.cell, value > 0)
    np.logical_or.at(near, lines.cell, np.abs(value) < 1e-9 * lines.reach()[:, None])
    d = rays(pencil, x, y)
    bounds = [tuple(np.repeat(m[:, k], x.size) for k in range(3)) for m in (low, high)]
    t, _ = box_hit((d[0].ravel(), d[1].ravel(), d[2].ravel()), bounds[0], bounds[1])
    hit = np.isfinite(t).reshape(inner.shape)
    crossed = np.isin(np.arange(400), lines.cell)
    assert crossed.sum() > 100
    for i in range(400):
        if crossed[i]:
            assert (hit[i] == inner[i])[~near[i]].all(), surfaces[i]
        else:
            assert hit[i].all() or not hit[i].any(), surfaces[i]
