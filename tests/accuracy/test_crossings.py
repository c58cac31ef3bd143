"""Outlines across the picture: every pixel in which an object begins or ends is found."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_objects import a_box, a_direction, a_point, a_sphere, vector

from tracer import Box, Camera, Surfaces
from tracer.antialias.crossings import crossed
from tracer.view.camera import raster_of
from tracer.view.view import View, view_of

WIDTH, HEIGHT = 24, 20


def marked(view: View, top: int, height: int) -> set[tuple[int, int, int]]:
    """Row, column and object, of the whole width."""
    found = crossed(view, slice(top, top + height), slice(0, WIDTH))
    return set(zip(*(m.tolist() for m in found), strict=True))


def ends_in_fine_rows(view: View, rows: int) -> set[tuple[int, int, int]]:
    """The same of the pixels in which spans end, in so many rows of each pixel."""
    y = (np.arange(HEIGHT * rows) + 0.5) / rows
    found = set()
    for shape in view.shapes:
        spans = shape.spans(view.raster, y)
        for ends in (spans.left, spans.right):
            inside = np.flatnonzero((ends > 0) & (ends < WIDTH))
            column, row = ends[inside].astype(int), spans.row[inside] // rows
            owner = spans.owner[inside]
            found |= set(zip(row.tolist(), column.tolist(), owner.tolist(), strict=True))
    return found


def a_bar(rng: np.random.Generator) -> Box:
    """Long, thin and nearly level before most of these cameras."""
    a, b = (rng.normal(size=3) * (3, 0.5, 0.5) for _ in range(2))
    half = (abs(a[0]), 1e-3 * abs(a[1]), 1e-3 * abs(a[2]))
    return Box(min_pt=vector(b - half), max_pt=vector(b + half))


@np.errstate(all="ignore")
@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32))
def test_every_end_of_an_object_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = Camera(
        view_point=vector(3 * a_point(rng)),
        view_dir=vector(a_direction(rng)),
        view_up=vector(np.array([rng.normal() / 50, 1, 0]) + 1e-9),
        view_width=float(rng.choice([0.5, 1, 4])),
    )
    kinds = [a_bar, a_box, a_sphere]
    surfaces = Surfaces.of([make(rng) for make in kinds for _ in range(5)])
    view = view_of(raster_of(camera, WIDTH, HEIGHT), surfaces)
    found = marked(view, 0, HEIGHT)
    assert ends_in_fine_rows(view, 64) <= found
    # Whatever the bands.
    parts = (marked(view, *rows) for rows in ((0, 7), (7, HEIGHT - 7)))
    assert set.union(*parts) == found


@np.errstate(all="ignore")
@pytest.mark.parametrize("roll", [0.0, 0.003, -0.02])
def test_a_bar_between_two_rows_of_samples(roll: float) -> None:
    bar = Surfaces.of([Box(min_pt=(-0.2, 0.0101, -1.01), max_pt=(0.3, 0.0102, -1))])
    camera = Camera(view_up=(roll, 1, 0))
    view = view_of(raster_of(camera, WIDTH, HEIGHT), bar)
    columns = {column for _, column, _ in marked(view, 0, HEIGHT)}
    assert columns == set(range(7, 20))
