"""Lines fitted to margins: they divide cells as the rays through many points of them say."""

from __future__ import annotations

import numpy as np
import pytest
from random_objects import unit, unit_vectors, vector

from tracer import Box, Camera, Sphere, Surfaces
from tracer.antialias.edges import silhouettes
from tracer.antialias.lines import Lines
from tracer.antialias.margins import fitted
from tracer.arrays import Bools, Floats
from tracer.view.camera import raster_of
from tracer.view.view import view_of

EYE = np.array([0.3, -0.2, 5.0])
X, Y = np.arange(1500) / 1500 - 0.5, np.arange(1500) * (np.sqrt(1.25) - 0.5) % 1 - 0.5


def camera_at(rng: np.random.Generator, target: Floats, size: float) -> Camera:
    """A camera with a target (3,) in the middle of its only pixel, so wide, seen at a slant."""
    ahead = (target - EYE) / np.linalg.norm(target - EYE)
    return Camera(
        view_point=vector(EYE),
        view_dir=vector(ahead),
        proj_normal=vector(0.4 * unit_vectors(rng, 1)[0] - ahead),
        view_up=vector(unit_vectors(rng, 1)[0]),
        view_width=size,
        view_height=size * rng.uniform(0.5, 2),
    )


@np.errstate(all="ignore")
def lines_and_rays(camera: Camera, surface: Sphere | Box) -> tuple[Lines, int, Floats]:
    """Lines of a silhouette across the only pixel, how often it is none, rays through points."""
    view = view_of(raster_of(camera, 1, 1), Surfaces.of([surface]))
    raster, one, half = view.raster, np.zeros(1, dtype=np.intp), np.full(1, 0.5)
    lines, curved = fitted(silhouettes(view, one, one, half, half, 1.0), 1e-3)
    s, g = raster.across(X + 0.5), raster.down(Y + 0.5)
    return lines, curved.size, np.stack([s, g, np.full(s.size, raster.depth)], axis=1) @ raster.axes


def within(lines: Lines) -> Bools:
    """Whether points lie on the positive side of all lines."""
    inside: Bools = np.all(
        [c + a * X + b * Y > 0 for _, a, b, c in zip(*lines, strict=True)], axis=0
    )
    return inside


@pytest.mark.parametrize("size", [1e-5, 1e-3, 1e-2])
def test_silhouettes_of_spheres(size: float) -> None:
    rng = np.random.default_rng(0)
    crossed = 0
    for _ in range(60):
        radius, sine = rng.uniform(0.1, 3), rng.uniform(0.1, 0.9)
        distance = radius / sine
        ahead = unit_vectors(rng, 1)[0]
        ball = Sphere(center=vector(EYE + distance * ahead), radius=radius)
        aside = unit(np.cross(ahead, unit_vectors(rng, 1)))[0]
        # Near the tangent, by less than a cell, which is a part of the disc.
        slope = np.tan(np.arcsin(sine)) + size * sine * rng.uniform(-0.6, 0.6)
        camera = camera_at(rng, EYE + ahead + slope * aside, size * sine)
        lines, curved, d = lines_and_rays(camera, ball)
        assert curved == 0
        offset = ball.center - EYE
        nearest = d @ offset / (d * d).sum(axis=1)
        hit = np.linalg.norm(offset - nearest[:, None] * d, axis=1) < radius
        outside = within(lines).mean() if lines.cell.size else np.round(1 - hit.mean())
        assert 1 - hit.mean() == pytest.approx(outside, abs=0.01)
        crossed += lines.cell.size
    assert crossed > 30


@pytest.mark.parametrize("size", [1e-4, 1e-2, 0.3])
def test_silhouettes_of_boxes(size: float) -> None:
    rng = np.random.default_rng(0)
    crossed = 0
    for _ in range(80):
        low, high = np.sort(rng.normal(size=(2, 3)), axis=0)
        # Around edges and corners.
        target = low + np.clip(rng.uniform(-0.5, 1.5, 3), 0, 1) * (high - low)
        camera = camera_at(rng, target, size)
        lines, curved, d = lines_and_rays(camera, Box(min_pt=vector(low), max_pt=vector(high)))
        assert curved == 0
        ends = (low - EYE) / d, (high - EYE) / d
        enter, leave = np.minimum(*ends).max(axis=1), np.maximum(*ends).min(axis=1)
        hit = (enter <= leave) & (leave > 0)
        if lines.cell.size:
            assert np.mean(hit != within(lines)) < 1e-3
            crossed += 1
        else:
            assert hit.all() or not hit.any()
    assert crossed > 20


@pytest.mark.parametrize("aside", [-0.4, 0.0, 0.3])
@pytest.mark.parametrize("radius", [6.0, 10.0])
def test_a_line_in_place_of_a_flat_arc_leaves_its_area_as_it_is(
    radius: float, aside: float
) -> None:
    # A disc of so many cells, whose rim crosses the cell.
    camera = Camera(view_point=(0, 0, 1e4), proj_distance=1e4, view_width=1, view_height=1)
    lines, _, _ = lines_and_rays(camera, Sphere(center=(radius + aside, 0, 0), radius=radius))
    y = (np.arange(2000) + 0.5) / 2000 - 0.5
    within_disc = 0.5 - np.clip(radius + aside - np.sqrt(radius**2 - y * y), -0.5, 0.5).mean()
    # Without the arc's sagitta it would be off by 1 / (24 radius), or 0.004 and more.
    assert np.mean(lines.c + lines.a * X + lines.b * Y < 0) == pytest.approx(
        within_disc, abs=1.5e-3
    )


def test_a_disc_with_both_sides_in_a_cell_is_no_line() -> None:
    camera = Camera(view_point=(0, 0, 1e4), proj_distance=1e4, view_width=1, view_height=1)
    for radius, no_lines in ((0.1, 1), (10.0, 0)):
        lines, curved, _ = lines_and_rays(
            camera, Sphere(center=(radius + 0.2, 0, 0), radius=radius)
        )
        assert (curved, lines.cell.size) == (no_lines, 1 - no_lines)
