"""Lines and regions of cells: exact areas and centroids, whatever lines divide them."""

from __future__ import annotations

import numpy as np
import pytest

from tracer.antialias.lattice import Lattice
from tracer.antialias.lines import Lines
from tracer.antialias.regions import mixed, stratified
from tracer.arrays import Floats, Ints

FINE = (np.arange(400) + 0.5) / 400 - 0.5


def lines_in(rng: np.random.Generator, counts: Ints) -> Lines:
    """So many lines in each cell, sorted by cell: at all slopes, upright, level, and alike."""
    cell = np.repeat(np.arange(counts.size), counts)
    angle = rng.uniform(0, 2 * np.pi, cell.size)
    angle = np.where(rng.random(cell.size) < 0.2, np.round(angle), angle * np.pi / 3)
    angle = np.where(rng.random(cell.size) < 0.2, 0.5 * np.pi * rng.integers(4, size=1), angle)
    scale = 10.0 ** rng.integers(-6, 7, cell.size)
    a, b = scale * np.cos(angle), scale * np.sin(angle)
    c = 0.5 * (np.abs(a) + np.abs(b)) * rng.uniform(-1, 1, cell.size)
    return Lines(cell, a, b, c)


def codes(lines: Lines, cell: int, x: Floats, y: Floats) -> Ints:
    """On which side of each of a cell's lines points are: a bit for each."""
    at = np.flatnonzero(lines.cell == cell)
    z = lines.a[at, None] * x + lines.b[at, None] * y + lines.c[at, None]
    sides: Ints = ((z < 0) << np.arange(at.size)[:, None]).sum(axis=0)
    return sides


@np.errstate(all="ignore")
@pytest.mark.parametrize("lattice", [Lattice(1, 13), Lattice(1, 25), Lattice.of(4)])
@pytest.mark.parametrize("seed", range(3))
def test_points_of_a_region_stand_for_its_area_and_centroid(seed: int, lattice: Lattice) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 5, 60, dtype=np.intp)
    lines = lines_in(rng, counts)
    x, y = lattice.points()
    points = stratified(lines, counts.size, x, y)
    assert np.bincount(points.cell, points.weight) == pytest.approx(1, abs=1e-9)
    fine_x, fine_y = (m.ravel() for m in np.meshgrid(FINE, FINE))
    for cell, count in enumerate(counts.tolist()):
        here = np.flatnonzero(points.cell == cell)
        assert np.array_equal(points.x[here[: x.size]], x)
        assert np.array_equal(points.y[here[: x.size]], y)
        own, weight = codes(lines, cell, points.x[here], points.y[here]), points.weight[here]
        assert np.array_equal(np.unique(own).size, np.unique(points.region[here]).size)
        code, many = codes(lines, cell, fine_x, fine_y), np.bincount(own, minlength=1 << count)

        def sums(values: Floats, code: Ints = code, count: int = count) -> Floats:
            return np.bincount(code, values / code.size, minlength=1 << count)

        def found(values: Floats, own: Ints = own, count: int = count) -> Floats:
            return np.bincount(own, values, minlength=1 << count)

        assert found(weight) == pytest.approx(sums(np.ones(code.size)), abs=0.003)
        for place, fine in ((points.x[here], fine_x), (points.y[here], fine_y)):
            off = np.abs(found(weight * place) - sums(fine))
            large = (found(weight) > 0.3) | (many < 3)
            assert np.all(off[large] < 0.004)


@np.errstate(all="ignore")
def test_what_changes_linearly_within_regions_has_an_exact_mean() -> None:
    rng = np.random.default_rng(0)
    lines = lines_in(rng, np.ones(200, dtype=np.intp))
    points = stratified(lines, 200, *Lattice(1, 25).points())
    whole = np.bincount(points.cell, points.weight * (3 * points.x - points.y + 0.5))
    assert np.abs(whole - 0.5).mean() < 1e-5


def test_points_that_differ_from_others_in_their_region() -> None:
    region = np.array([0, 0, 1, 2, 3, 2, 4, 5, 5])
    ids = np.array([7, 7, 7, -1, 7, -1, 7, 7, -1])
    assert mixed(region, ids).tolist() == [7]
    assert not mixed(region[:0], ids[:0]).size


def test_lines_that_are_the_same() -> None:
    cell, a = np.array([1, 1, 1, 0, 0]), np.array([1.0, -2.0, 1.0, 1.0, 1.0])
    c = np.array([0.1, -0.2, 0.3, 0.1, -0.1])
    distinct = Lines(cell, a, 0 * a, c).distinct(0.02)
    assert distinct.cell.tolist() == [0, 0, 1, 1]
    assert (distinct.c / distinct.a).tolist() == pytest.approx([-0.1, 0.1, 0.1, 0.3])


def test_which_line_is_kept_does_not_depend_on_their_order() -> None:
    rng = np.random.default_rng(1)
    lines = lines_in(rng, np.full(4, 10))
    near = lines._replace(c=lines.c * (1 + 1e-3 * rng.normal(size=40)))
    both = Lines._make(map(np.append, lines, near))
    expected = both.distinct(0.02)
    assert 4 < expected.cell.size < 80
    for _ in range(20):
        shuffled = both.take(rng.permutation(80)).distinct(0.02)
        for mine, its in zip(shuffled, expected, strict=True):
            assert np.array_equal(mine, its)
