"""Lines across cells: what lies beside them, which are the same, and where outlines draw them.

Areas are held against sums over many points, and lines that outlines draw against single rays.
"""

from __future__ import annotations

import numpy as np
import pytest
from random_objects import triple, unit, unit_vectors

from tracer import Lambertian, Surfaces
from tracer.antialias.edges import MOST_TURN, Kind, Lines, Pencil, joined
from tracer.arrays import Bools, Floats, Triple
from tracer.shapes.silhouette import box_corners, silhouette_planes


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


def a_pencil(rng: np.random.Generator, targets: Floats, size: Floats) -> Pencil:
    """Rays to targets (n, 3) seen from the apex, through cells so wide, seen at a slant."""
    count = len(targets)
    ray = targets * 10.0 ** rng.uniform(-3, 3, (count, 1))
    length = np.sqrt((ray * ray).sum(axis=1, keepdims=True))
    normal = unit(ray / length + 0.7 * unit_vectors(rng, count))
    across = unit(np.cross(normal, unit_vectors(rng, count)))
    down = np.cross(normal, across)
    across, down = (v * length * size[:, None] for v in (across, down))
    return Pencil(Kind.EDGE, np.arange(count), triple(ray), triple(across), triple(down))


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
    lines, _, _ = pencil.discs(triple(center), radius)
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
    planes, _ = silhouette_planes(
        box_corners(surfaces.min_pt, surfaces.max_pt, apex), apex, surfaces.min_pt, surfaces.max_pt
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
    ends = [[m[:, k, None] / d[k] for k in range(3)] for m in (low, high)]
    enter, leave = np.minimum(*ends).max(axis=0), np.maximum(*ends).min(axis=0)
    hit = (enter <= leave) & (leave > 0)
    crossed = np.isin(np.arange(400), lines.cell)
    assert crossed.sum() > 100
    for i in range(400):
        if crossed[i]:
            assert (hit[i] == inner[i])[~near[i]].all(), surfaces[i]
        else:
            assert hit[i].all() or not hit[i].any(), surfaces[i]


def a_disc_in_a_cell(radius: float, aside: float) -> tuple[Lines, Floats]:
    """Ahead of the eye, in cells from its centre; and how far its outline turns."""
    zero, one = np.zeros(1), np.ones(1)
    step = 1e-4
    ray = (aside * step * one, zero, one)
    across, down = (step * one, zero, zero), (zero, step * one, zero)
    pencil = Pencil(Kind.EDGE, np.zeros(1, dtype=np.intp), ray, across, down)
    lines, turn, _ = pencil.discs((zero, zero, 1e3 * one), 1e3 * radius * step * one)
    return lines, turn


@pytest.mark.parametrize("aside", [-0.4, 0.0, 0.3])
@pytest.mark.parametrize("radius", [6.0, 10.0])
def test_a_line_in_place_of_a_flat_arc_leaves_its_area_as_it_is(
    radius: float, aside: float
) -> None:
    lines, turn = a_disc_in_a_cell(radius, radius + aside)
    assert 0.05 < turn[0] < 0.2
    y = (np.arange(2000) + 0.5) / 2000 - 0.5
    within = np.clip(np.sqrt(radius**2 - y * y) - radius - aside, -0.5, 0.5).mean() + 0.5
    # Without the arc's sagitta it would be off by 1 / (24 radius), or 0.004 and more.
    assert 1 - lines.areas_and_moments()[0] == pytest.approx(within, abs=5e-4)


def test_a_disc_with_both_sides_in_a_cell_is_no_line() -> None:
    assert np.isinf(a_disc_in_a_cell(0.1, 0.12)[1])
    assert not np.isinf(a_disc_in_a_cell(10.0, 10.1)[1])


@np.errstate(all="ignore")
@pytest.mark.parametrize("narrow", [0.3, 1, 2.5])
def test_lines_of_discs_across_cells_of_all_shapes(narrow: float) -> None:
    # Long, narrow cells enter a disc and leave it again, beside where they come nearest to it.
    rng = np.random.default_rng(0)
    count, far = 20_000, 1e5
    length = 10 ** rng.uniform(-1.3, 1, count)
    width = length * 10 ** -rng.uniform(0, narrow, count)
    at, along = rng.uniform(0, 2 * np.pi, (2, count))
    aside = along + rng.uniform(0.05, np.pi - 0.05, count)
    zero, one = np.zeros(count), np.ones(count)
    across = length * np.cos(along), length * np.sin(along), zero
    down = width * np.cos(aside), width * np.sin(aside), zero
    # Some place in or beside the cell lies on the outline.
    x, y = rng.uniform(-0.62, 0.62, (2, count))
    ray = tuple(
        m - a * x - b * y
        for m, a, b in zip((np.cos(at), np.sin(at), far * one), across, down, strict=True)
    )
    pencil = Pencil(Kind.EDGE, np.arange(count), (ray[0], ray[1], ray[2]), across, down)
    lines, turn, near = pencil.discs((zero, zero, far * one), one)
    straight = np.flatnonzero(~(near & (turn > MOST_TURN)))
    share = 1 - lines.take(straight).areas_and_moments()[0]
    expected = np.zeros(straight.size)
    for x, y in zip(*spread(1000), strict=True):
        expected += np.hypot(*(ray[k] + across[k] * x + down[k] * y for k in (0, 1)))[straight] < 1
    off = np.abs(share - expected / 1000)
    assert np.all(off < np.where(turn[straight] > 0.2, 0.08, 0.03))
    assert np.mean(near & (turn > MOST_TURN)) < 0.6
