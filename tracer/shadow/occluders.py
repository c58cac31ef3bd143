"""What stands between lights and points: the data that all parts of the shadow test share.

A *finder* names the candidates, objects that may keep a light from the points in a ball; the exact
test then takes each point with each candidate of its ball, pair by pair.  Finders differ in how
they search, and in how many points their balls hold.

Objects are numbered together, spheres first, then boxes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, Triple, columns, each, indices, pick, ranges, spread
from tracer.scene.model import Surfaces
from tracer.view.hits import Hits
from tracer.view.view import View

__all__ = [
    "SLACK",
    "Balls",
    "Candidates",
    "Finder",
    "Occluders",
    "Pairs",
    "ShadowEdges",
    "candidates_by_kind",
    "occluders_of",
    "point_candidates",
]

Array = TypeVar("Array", bound=NDArray[Any])

SLACK = 1e-9
"""Bounds are widened by this much of the coordinates involved: far more than all roundings."""


class Occluders(NamedTuple):
    """All surfaces, as what may cast shadows, and the lights.

    Attributes
    ----------
    view : View
    lights : (lights, 3)
    side : (lights, n)
        Where each light is to each object: `OUTSIDE` or `INSIDE`, of spheres also `ON`.
    near_light : (lights, n)
        Whether each light may be so near to each object that `Shape.touches` holds for it.
    middle, radius : three (n,) and (n,)
        A ball around each.
    size : (n,)
        How large each object's coordinates are (1-norm): rounding is in proportion.
    slack : (n,)
        More than rounding can displace a point on each object.
    """

    view: View
    lights: Floats
    side: NDArray[np.int8]
    near_light: Bools
    middle: Triple
    radius: Floats
    size: Floats
    slack: Floats

    @property
    def surfaces(self) -> Surfaces:
        """What may cast shadows."""
        return self.view.surfaces


class Balls(NamedTuple):
    """Neighbouring points of one object, or smaller balls that hold some, each in a ball.

    Attributes
    ----------
    owner : (m,)
        The object.
    start, length : (m,)
        Its points, or smaller balls: `length` of them, from `start` on.
    middle, radius : three (m,) and (m,)
    """

    owner: Ints
    start: Ints
    length: Ints
    middle: Triple
    radius: Floats

    def take(self, index: Ints) -> Balls:
        """Some of them."""
        return Balls(
            self.owner.take(index),
            self.start.take(index),
            self.length.take(index),
            pick(self.middle, index),
            self.radius.take(index),
        )


class Pairs(NamedTuple):
    """Pairs of a point and an object that may keep a light from it.

    Attributes
    ----------
    point, light, occluder : (n,)
    """

    point: Ints
    light: Ints
    occluder: Ints

    def take(self, index: Ints) -> Pairs:
        """Some of them."""
        return Pairs(self.point.take(index), self.light.take(index), self.occluder.take(index))


class Candidates(NamedTuple):
    """Objects that may keep lights from points, still to be tested: at least one.

    Attributes
    ----------
    balls : Balls
        The points (m,).
    light, occluder : (m,)
        A light, and an object that may come between: all spheres, or all boxes.
    single : bool
        Whether every ball is known to hold one point.
    """

    balls: Balls
    light: Ints
    occluder: Ints
    single: bool = False

    def pairs(self) -> Pairs:
        """All points of all balls, with their light and object."""
        start = self.balls.start
        point = start if self.single else ranges(start, self.balls.length)
        return Pairs(point, self.spread(self.light), self.spread(self.occluder))

    def spread(self, values: Array) -> Array:
        """Values of balls, for each of their points."""
        return values if self.single else spread(values, self.balls.length)


class ShadowEdges(NamedTuple):
    """What may keep lights from what is near some points, each on its own object.

    Attributes
    ----------
    hits : Hits
        The points.
    own : (n,)
        The object that each is on.
    footprint : (n,)
        Within which distance of each point is near.
    facing, dark : (lights, n)
        Which points face which light, and where it reaches nothing that is near.
    point, light, occluder : (m,)
        Objects that may keep a light from some of what is near a point.
    """

    hits: Hits
    own: Ints
    footprint: Floats
    facing: Bools
    dark: Bools
    point: Ints
    light: Ints
    occluder: Ints


class Finder(Protocol):
    """Finds what may keep lights from points: stretches, light buffers or a shadow cache."""

    @property
    def occluders(self) -> Occluders:
        """Among which it finds them."""
        ...

    def candidates(
        self, hits: Hits, facing: Bools, dark: Bools, footprint: Floats | None = None
    ) -> Iterator[Candidates]:
        """All that may keep a light from a point that faces it.

        Parameters
        ----------
        hits : Hits
        facing : (lights, n)
            Which points face which light.
        dark : (lights, n)
            Set where a shadow is certain: no candidates need be found there.
        footprint : (n,), optional
            Find what may shade anything on a point's own object within this distance of it.
        """
        ...


def point_candidates(
    occluders: Occluders, own: Ints, p: Triple, pairs: Pairs, footprint: Floats | None
) -> Candidates:
    """Candidates for single points, each at `p`; `own` (n,): the object that each hit is on."""
    point = pairs.point
    owner = own[point]
    radius = occluders.slack[owner]
    if footprint is not None:
        radius = radius + footprint[point]
    balls = Balls(owner, point, np.ones_like(point), p, radius)
    return Candidates(balls, pairs.light, pairs.occluder, single=True)


def candidates_by_kind(
    occluders: Occluders,
    own: Ints,
    points: Triple,
    point: Ints,
    light: int,
    occluder: Ints,
    footprint: Floats | None,
) -> Iterator[Candidates]:
    """`point_candidates` of one light: spheres, then boxes.  `points` and `own` are of all hits."""
    spheres = occluders.surfaces.sphere_count
    for of_kind in (occluder < spheres, occluder >= spheres):
        at = indices(of_kind)
        if at.size:
            pairs = Pairs(point[at], np.full(at.size, light), occluder[at])
            yield point_candidates(occluders, own, pick(points, pairs.point), pairs, footprint)


def occluders_of(view: View, lights: Floats) -> Occluders:
    """Gather spheres and boxes, and lights (n, 3)."""
    both = view.spheres, view.boxes
    size = np.concatenate([shape.size for shape in both])
    slack = SLACK * (size + np.abs(view.raster.eye).sum())
    # A row for each light, a column for each object.
    point = each(lambda m: m[:, None], columns(lights, slice(None)))
    around = SLACK * np.abs(lights).sum(axis=1)[:, None]
    side, near = [], []
    for shape in both:
        every = shape.first + np.arange(shape.count)
        side.append(shape.side(every, point))
        near.append(shape.touches(every, point, slack[every] + around))
    middle, radius = zip(*(shape.balls for shape in both), strict=True)
    return Occluders(
        view=view,
        lights=lights,
        side=np.concatenate(side, axis=1),
        near_light=np.concatenate(near, axis=1),
        middle=columns(np.concatenate(middle), slice(None)),
        radius=np.concatenate(radius),
        size=size,
        slack=slack,
    )
