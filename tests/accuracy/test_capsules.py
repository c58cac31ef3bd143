"""Capsules: what they say of all segments from a ball to a light, against samples of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from brute_force import blocks
from hypothesis import given, settings
from hypothesis import strategies as st
from probe import Surface
from random_objects import a_box, a_point, a_sphere, triple, unit_vectors, vector

from tracer import Box, Camera, Sphere, Surfaces
from tracer.arrays import Bools, Floats
from tracer.shapes.rounding import SURFACE_TOLERANCE
from tracer.view.camera import raster_of
from tracer.view.view import Shape, view_of

SLACK = 1e-9
"""Of all sizes around: so much thicker than their balls capsules are asked for."""

SIZES = [1.0, 2.0**-60, 2.0**60, 1e-9, 1e9, 1e30]


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
        return onto(surface, a_point(rng)[None, :])[0]
    if kind == 2:
        return middle + radius * rng.random() * unit_vectors(rng, 1)[0]
    if kind == 3:
        return np.where(rng.random(3) < 0.6, middle, a_point(rng))  # parallel to an axis, or none
    if kind == 4:
        return a_point(rng) * 10.0 ** rng.uniform(1, 8)
    if kind <= 6:
        through = inside(rng, surface, 1)[0]  # right behind the object
        return through + rng.uniform(0.5, 3) * (through - middle)
    return a_point(rng)


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
        middle = a_point(rng) if rng.random() < 0.8 else inside(rng, surface, 1)[0]
        light = a_light(rng, surface, middle, radius)
        points = in_ball(rng, surface, light, middle, radius)
        if isinstance(surface, Sphere):
            center = vector(np.array(surface.center) * scale + shift)
            self.surface: Surface = Sphere(center=center, radius=surface.radius * scale)
        else:
            low, high = (np.array(v) * scale + shift for v in (surface.min_pt, surface.max_pt))
            self.surface = Box(min_pt=vector(low), max_pt=vector(high))
        self.middle, self.light = middle * scale + shift, light * scale + shift
        shape = alone(self.surface)
        around = np.abs(self.middle).sum() + np.abs(self.light).sum() + shape.size[0]
        self.thickness = float(radius * scale + SLACK * (around + radius * scale))
        p = triple(points * scale + shift)
        # Of a point on a sphere it counts from which side it is seen.
        sides = [
            replace(shape, power=np.array([m])) if not shape.flat else shape for m in (1.0, -1)
        ]
        self.blocked = [blocks(side, np.zeros(3), p, vector(self.light)) for side in sides]


def alone(*surfaces: Surface) -> Shape:
    """A shape with objects of one kind; where they are seen from does not matter."""
    (shape,) = view_of(raster_of(Camera(), 1, 1), Surfaces.of(surfaces)).shapes
    return shape


@np.errstate(all="ignore")
def capsules(cases: list[Case]) -> tuple[Bools, Bools]:
    """Whether the objects, all of one kind, meet and cut their capsules."""
    start, end = triple([c.middle for c in cases]), triple([c.light for c in cases])
    thickness = np.array([c.thickness for c in cases])
    shape = alone(*(c.surface for c in cases))
    return shape.capsules(np.arange(len(cases)), start, end, thickness)


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


@np.errstate(all="ignore")
@pytest.mark.parametrize("radius", [1.0, 2.0**20, 2.0**45])
def test_ends_on_a_planet(radius: float) -> None:
    # As near to it they count as on its surface, whatever the thickness: the pair's test decides.
    rng = np.random.default_rng(1)
    height = 2 * radius * SURFACE_TOLERANCE * rng.uniform(-1, 1, (2, 1000))
    x, z = 1e-9 * radius * rng.normal(size=(2, 2, 1000))
    planet = alone(Sphere(center=(0, -radius, 0), radius=radius))
    start, end = zip(x, height, z, strict=True)
    thickness = np.full(1000, 1e-30)
    meets, cuts = planet.capsules(np.zeros(1000, dtype=np.intp), start, end, thickness)
    assert meets.all()
    assert not cuts.any()


@pytest.mark.parametrize("size", [1.0, 2.0**27, 2.0**40, 2.0**200])
def test_light_straight_over_a_large_ball(size: float) -> None:
    # A box aside of the segment along an axis, but within the ball at its foot.
    start, end = (np.zeros(1),) * 3, (np.zeros(1), np.array([10 * size]), np.zeros(1))
    box = alone(Box(min_pt=(3 * size, 2 * size, -size), max_pt=(5 * size, 2.5 * size, size)))
    with np.errstate(all="ignore"):
        meets, cuts = box.capsules(np.zeros(1, np.intp), start, end, np.array([14 * size]))
    assert meets.all()
    assert not cuts.any()
