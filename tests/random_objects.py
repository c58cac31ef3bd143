"""Random points, directions, spheres and boxes; and vectors in the forms that the tracer takes."""

from __future__ import annotations

import numpy as np
from probe import Vector

from tracer import Box, Sphere
from tracer.arrays import Floats, Triple


def a_point(rng: np.random.Generator) -> Floats:
    """(3,): every other time on a grid, where things touch, line up and coincide."""
    return rng.integers(-8, 9, 3) / 4 if rng.random() < 0.5 else 2 * rng.normal(size=3)


def a_direction(rng: np.random.Generator) -> Floats:
    """A unit vector (3,)."""
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def a_sphere(rng: np.random.Generator) -> Sphere:
    """Around `a_point`, of many sizes."""
    radius = rng.choice([0.25, 0.5, 1, 2, rng.exponential(), 1e-3, 30])
    return Sphere(center=vector(a_point(rng)), radius=float(radius))


def a_box(rng: np.random.Generator) -> Box:
    """Between two of `a_point`: now and then flat, or far longer than wide."""
    corners = np.array([a_point(rng), a_point(rng)])
    flat = rng.random(3) < 0.2
    corners[1, flat] = corners[0, flat]
    if rng.random() < 0.1:
        corners[:, rng.integers(3)] *= 30
    return Box(min_pt=vector(corners.min(axis=0)), max_pt=vector(corners.max(axis=0)))


def unit_vectors(rng: np.random.Generator, count: int) -> Floats:
    """Random directions (count, 3)."""
    return unit(rng.normal(size=(count, 3)))


def unit(v: Floats) -> Floats:
    """The directions of vectors (n, 3), as unit vectors."""
    return np.asarray(v / np.sqrt((v * v).sum(axis=1, keepdims=True)))


def vector(v: Floats) -> Vector:
    """(3,), as scenes and their parts take it."""
    x, y, z = v.tolist()
    return x, y, z


def triple(points: Floats | list[Floats]) -> Triple:
    """Points (n, 3), as one array for each coordinate."""
    x, y, z = np.array(points).T
    return x, y, z
