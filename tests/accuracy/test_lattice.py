"""Where samples lie."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from tracer.antialias.lattice import CENTRES, Lattice

SIDES = range(2, 17)


def test_the_centres() -> None:
    samples = CENTRES.samples(slice(2, 4), slice(5, 8))
    for x, y in (samples.positions(), samples.at(np.arange(samples.size))):
        assert x.tolist() == [5.5, 6.5, 7.5] * 2
        assert y.tolist() == [2.5] * 3 + [3.5] * 3


@pytest.mark.parametrize("per_side", SIDES)
def test_a_lattice_is_a_turned_square_grid_across_all_pixels(per_side: int) -> None:
    lattice = Lattice.of(per_side)
    x, y = lattice.points()
    assert x.size == lattice.size > per_side**2
    place = np.stack([x, y], axis=1)
    # To the same point of this pixel's neighbours, too.
    apart = place[:, None] - place[None]
    apart -= np.round(apart)
    distance = np.sort(np.hypot(*np.moveaxis(apart, 2, 0)), axis=1)
    nearest = distance[:, 1:5] * np.sqrt(lattice.size)
    np.testing.assert_allclose(nearest, 1, rtol=1e-9)


@pytest.mark.parametrize("per_side", SIDES)
def test_points_of_a_lattice_lie_in_many_rows_and_columns(per_side: int) -> None:
    lattice = Lattice.of(per_side)
    for place in lattice.points():
        _, many = np.unique(place.round(9), return_counts=True)
        assert many.tolist() == [lattice.columns] * lattice.rows


@pytest.mark.parametrize("per_side", SIDES)
def test_a_quarter_turn_leaves_a_lattice_as_it_is(per_side: int) -> None:
    x, y = (place.round(9) + 0.0 for place in Lattice.of(per_side).points())
    assert {*zip(x, y, strict=True)} == {*zip(-y + 0.0, x, strict=True)}


@pytest.mark.parametrize("per_side", [1, *SIDES])
def test_all_pixels_hold_the_same_points_or_their_mirror_image(per_side: int) -> None:
    lattice = Lattice.of(per_side) if per_side > 1 else CENTRES
    samples = lattice.samples(slice(3, 6), slice(2, 4))
    x, y = samples.positions()
    x, y = x / lattice.columns, y / lattice.rows
    own_x, own_y = lattice.points()
    for row, column in product(range(3, 6), range(2, 4)):
        here = np.flatnonzero((np.floor(x) == column) & (np.floor(y) == row))
        found = zip((x[here] - column - 0.5).round(9), (y[here] - row - 0.5).round(9), strict=True)
        own = zip((-own_x if row % 2 else own_x).round(9), own_y.round(9), strict=True)
        np.testing.assert_allclose(sorted(found), sorted(own), rtol=0, atol=1e-12)


def test_the_mean_is_that_of_each_pixel() -> None:
    lattice = Lattice.of(4)
    samples = lattice.samples(slice(3, 6), slice(2, 4))
    x, y = samples.positions()
    pixel = np.floor(x / lattice.columns) + 10 * np.floor(y / lattice.rows)
    mean = lattice.mean(np.stack([pixel, 2 * pixel, np.ones_like(pixel)]), 2)
    expected = np.add.outer(10 * np.arange(3, 6), np.arange(2, 4))
    np.testing.assert_allclose(mean[..., 0], expected, rtol=1e-12)
    np.testing.assert_allclose(mean[..., 1], 2 * expected, rtol=1e-12)
    np.testing.assert_allclose(mean[..., 2], 1, rtol=1e-12)


@pytest.mark.parametrize("per_side", SIDES)
def test_the_mean_of_a_pixel_does_not_depend_on_its_neighbours(per_side: int) -> None:
    lattice, width = Lattice.of(per_side), 7
    radiance = np.random.default_rng(0).random((3, lattice.rows, width, lattice.columns))
    together = lattice.mean(radiance.reshape(3, -1), width)
    for column in range(width):
        alone = lattice.mean(radiance[:, :, column].reshape(3, -1), 1)
        np.testing.assert_array_equal(alone[:, 0], together[:, column])
