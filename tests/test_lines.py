"""Lines across cells: what lies beside them, and which are the same."""

from __future__ import annotations

import numpy as np
import pytest

from tracer.antialias.lines import Kind, Lines, joined


def some_lines(rng: np.random.Generator, count: int) -> Lines:
    """Lines at all slopes, upright and level ones, through cells and past them."""
    a, b = rng.normal(size=(2, count)) * 10.0 ** rng.integers(-6, 7, count)
    a, b = np.where(rng.random(count) < 0.1, 0, a), np.where(rng.random(count) < 0.1, 0, b)
    b = np.where(rng.random(count) < 0.1, a * rng.choice([1, -1, 1e-4, 1e-7]), b)
    b = np.where((a == 0) & (b == 0), 1, b)
    c = 0.5 * (np.abs(a) + np.abs(b)) * rng.uniform(-1.2, 1.2, count)
    return Lines(np.arange(count), np.full(count, Kind.EDGE), a, b, c)


@pytest.mark.parametrize("seed", range(3))
def test_areas_and_moments_beside_lines(seed: int) -> None:
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
    beyond = lines._replace(a=-lines.a, b=-lines.b, c=-lines.c)
    assert beyond.areas_and_moments()[0] == pytest.approx(1 - share, abs=1e-7)


@pytest.mark.parametrize(("a", "b"), [(1, 0), (0, 1), (1, 1e-9), (-1, 0)])
def test_the_share_beside_an_upright_line(a: float, b: float) -> None:
    one = np.zeros(1, dtype=np.intp)
    line = Lines(one, one, *(np.array([float(m)]) for m in (a, b, -0.48)))
    assert line.areas_and_moments()[0] == pytest.approx(0.02, abs=1e-3)


def test_lines_that_are_the_same() -> None:
    cell, a = np.array([1, 1, 1, 0, 0]), np.array([1.0, -2.0, 1.0, 1.0, 1.0])
    c = np.array([0.1, -0.2, 0.3, 0.1, -0.1])
    distinct = Lines(cell, np.full(5, Kind.EDGE), a, 0 * a, c).distinct(0.02)
    assert distinct.cell.tolist() == [0, 0, 1, 1]
    assert (distinct.c / distinct.a).tolist() == [-0.1, 0.1, 0.1, 0.3]


def test_which_line_is_kept_does_not_depend_on_their_order() -> None:
    rng = np.random.default_rng(1)
    lines = some_lines(rng, 40)._replace(cell=rng.integers(0, 4, 40), kind=rng.integers(0, 3, 40))
    near = lines._replace(c=lines.c + 1e-3 * rng.normal(size=40), kind=rng.integers(0, 3, 40))
    both = joined([lines, near])
    expected = both.distinct(0.02)
    assert 4 < expected.cell.size < 80
    for _ in range(20):
        shuffled = both.take(rng.permutation(80)).distinct(0.02)
        for mine, its in zip(shuffled, expected, strict=True):
            assert np.array_equal(mine, its)


def test_of_an_edge_and_a_shadow_in_the_same_place_the_edge_is_kept() -> None:
    one, cell = np.ones(2), np.zeros(2, dtype=np.intp)
    kinds = np.array([Kind.SHADOW, Kind.EDGE])
    kept = Lines(cell, kinds, one, 0 * one, np.array([0.1, 0.101])).distinct(0.02)
    assert kept.kind.tolist() == [Kind.EDGE]
