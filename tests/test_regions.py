"""Regions of cells: exact shares, whatever lines divide them."""

from __future__ import annotations

import numpy as np
import pytest

from tracer.antialias.lattice import Lattice
from tracer.antialias.lines import Kind, Lines
from tracer.antialias.regions import mixed, post_stratified, sides_of
from tracer.arrays import Floats, Ints

FINE = (np.arange(400) + 0.5) / 400 - 0.5


def lines_in(rng: np.random.Generator, counts: Ints, kind: Kind = Kind.EDGE) -> Lines:
    """So many lines in each cell, sorted by cell: at all slopes, upright, level, and alike."""
    cell = np.repeat(np.arange(counts.size), counts)
    angle = rng.uniform(0, 2 * np.pi, cell.size)
    angle = np.where(rng.random(cell.size) < 0.2, np.round(angle), angle * np.pi / 3)
    angle = np.where(rng.random(cell.size) < 0.2, 0.5 * np.pi * rng.integers(4, size=1), angle)
    scale = 10.0 ** rng.integers(-6, 7, cell.size)
    a, b = scale * np.cos(angle), scale * np.sin(angle)
    c = 0.5 * (np.abs(a) + np.abs(b)) * rng.uniform(-1, 1, cell.size)
    return Lines(cell, np.full(cell.size, kind), a, b, c)


def codes(lines: Lines, cell: int, x: Floats, y: Floats) -> Ints:
    """On which side of each of a cell's lines points are: a bit for each."""
    at = np.flatnonzero(lines.cell == cell)
    z = lines.a[at, None] * x + lines.b[at, None] * y + lines.c[at, None]
    sides: Ints = ((z < 0) << np.arange(at.size)[:, None]).sum(axis=0)
    return sides


@np.errstate(all="ignore")
@pytest.mark.parametrize("per_side", [1, 2, 4])
@pytest.mark.parametrize("seed", range(3))
def test_points_of_a_region_have_its_area_together(seed: int, per_side: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 5, 60, dtype=np.intp)
    lines = lines_in(rng, counts)
    x, y = Lattice.of(per_side).points()
    points, numbers = post_stratified(lines, np.arange(counts.size), x, y)
    assert numbers.size == points.cell.size
    shares = points.share[: counts.size * x.size].reshape(counts.size, -1)
    assert np.array_equal(points.x[: x.size], x)
    assert np.array_equal(points.y[: x.size], y)
    lone = points.take(np.arange(shares.size, points.cell.size))
    fine_x, fine_y = (m.ravel() for m in np.meshgrid(FINE, FINE))
    for cell, count in enumerate(counts.tolist()):
        whole = np.bincount(codes(lines, cell, fine_x, fine_y), minlength=1 << count) / fine_x.size
        own = np.flatnonzero(lone.cell == cell)
        code = codes(lines, cell, x, y)
        number = numbers[cell * x.size : (cell + 1) * x.size]
        assert np.array_equal(number - number.min(), code - code.min())
        total = np.bincount(code, shares[cell], minlength=1 << count)
        regions = codes(lines, cell, lone.x[own], lone.y[own])
        # Those without points of the lattice, and no others, have one of their own, inside.
        assert not total[regions].any()
        assert np.unique(regions).size == own.size
        total += np.bincount(regions, lone.share[own], minlength=1 << count)
        assert total == pytest.approx(whole, abs=0.003)
        assert total.sum() == pytest.approx(1, abs=1e-9)


def test_points_that_differ_from_others_in_their_region() -> None:
    region = np.array([0, 0, 1, 2, 3, 2, 4, 5, 5])
    key = np.array([7, 7, 7, -1, 7, -1, 7, 7, -1])
    assert mixed(region, key).tolist() == [7]
    assert not mixed(region[:0], key[:0]).size


@pytest.mark.parametrize("seed", range(3))
def test_sides_of_a_line(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lines = lines_in(rng, np.ones(200, dtype=np.intp))
    sides, beyond = sides_of(lines, 0.02)
    assert np.bincount(sides.cell, sides.share) == pytest.approx(1)
    # What changes evenly across the cell is its mean there, whatever the line.
    assert np.bincount(sides.cell, sides.share * sides.x) == pytest.approx(0, abs=2e-4)
    assert np.bincount(sides.cell, sides.share * sides.y) == pytest.approx(0, abs=2e-4)
    z = lines.c + lines.a * sides.x.reshape(2, -1) + lines.b * sides.y.reshape(2, -1)
    assert (z[0] > 0).all()
    assert (z[1] < 0).all()
    # One of the two is on the side of the middle, unless the line all but passes through it.
    middling = np.abs(lines.c) <= 0.02 * lines.reach()
    assert 0 < middling.sum() < 20
    assert np.array_equal(beyond, (middling | (np.sign(lines.c) * z <= 0)).ravel())


def test_a_shadow_divides_a_single_surface() -> None:
    rng = np.random.default_rng(0)
    _, beyond = sides_of(lines_in(rng, np.ones(20, dtype=np.intp), Kind.SHADOW), 0.02)
    assert not beyond.any()


@pytest.mark.parametrize("seed", range(3))
def test_means_of_roots_within_a_limb_are_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lines = lines_in(rng, np.ones(200, dtype=np.intp), Kind.SILHOUETTE)
    # Some of them pass their cells by.
    lines = lines._replace(c=lines.c * np.where(rng.random(200) < 0.3, -3.0, 1.0))
    steep = np.maximum(np.abs(lines.a), np.abs(lines.b))
    sides, _ = sides_of(lines, 0.02)
    inside = -(lines.c[sides.cell] + lines.a[sides.cell] * sides.x + lines.b[sides.cell] * sides.y)
    fine_x, fine_y = (m.ravel() for m in np.meshgrid(FINE, FINE))
    for power in (0.0, 0.5, 1.0, 1.5):
        value = np.where(inside > 0, np.maximum(inside / steep[sides.cell], 0) ** power, 0)
        mean = np.bincount(sides.cell, sides.share * value, minlength=200)
        for cell in range(0, 200, 7):
            z = -(lines.c[cell] + lines.a[cell] * fine_x + lines.b[cell] * fine_y) / steep[cell]
            exact = np.where(z > 0, np.maximum(z, 0) ** power, 0).mean()
            assert mean[cell] == pytest.approx(exact, abs=2e-3), (cell, power)
    # So are those of what rises evenly along the limb.
    for place, fine in ((sides.x, fine_x), (sides.y, fine_y)):
        mean = np.bincount(sides.cell, sides.share * np.where(inside > 0, place, 0), minlength=200)
        for cell in range(0, 200, 7):
            z = -(lines.c[cell] + lines.a[cell] * fine_x + lines.b[cell] * fine_y)
            assert mean[cell] == pytest.approx(np.where(z > 0, fine, 0).mean(), abs=2e-3), cell
