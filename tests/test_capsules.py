"""Capsules: what they say of all segments from a ball to a light, against samples of them."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import blocks, light_side, size_of
from hypothesis import given, settings
from hypothesis import strategies as st
from probe import Surface
from random_objects import a_box, a_point, a_sphere, triple, unit_vectors, vector

from tracer import Box, Sphere, Surfaces
from tracer.arrays import Bools, Floats
from tracer.shadow.capsules import box_and_capsule, sphere_and_capsule
from tracer.shapes.intersection import SURFACE_TOLERANCE

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
        around = np.abs(self.middle).sum() + np.abs(self.light).sum() + size_of(self.surface)
        self.thickness = float(radius * scale + SLACK * (around + radius * scale))
        x, y, z = (points * scale + shift).T
        reach = np.abs(x) + np.abs(y) + np.abs(z)
        side = light_side(self.surface, vector(self.light))
        self.blocked = [
            blocks(self.surface, eye_inside, side, (x, y, z), vector(self.light), reach)
            for eye_inside in (False, True)
        ]


@np.errstate(all="ignore")
def capsules(cases: list[Case]) -> tuple[Bools, Bools]:
    """Whether the objects, all of one kind, meet and cut their capsules."""
    start, end = triple([c.middle for c in cases]), triple([c.light for c in cases])
    thickness = np.array([c.thickness for c in cases])
    surfaces = Surfaces.of([c.surface for c in cases])
    if len(surfaces.radius):
        center = triple(surfaces.center)
        return sphere_and_capsule(start, end, thickness, center, surfaces.radius)
    low, high = triple(surfaces.min_pt), triple(surfaces.max_pt)
    return box_and_capsule(start, end, thickness, low, high)


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
    center = np.zeros(1000), np.full(1000, -radius), np.zeros(1000)
    start, end = zip(x, height, z, strict=True)
    thickness = np.full(1000, 1e-30)
    meets, cuts = sphere_and_capsule(start, end, thickness, center, np.full(1000, radius))
    assert meets.all()
    assert not cuts.any()


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
