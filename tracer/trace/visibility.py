"""Visibility: the first surface that the ray through each sample meets.

Each object is intersected only with the rays through samples that it may cover in the picture.
Then the nearest intersection at each sample is selected, and becomes a hit.

A ray has the direction (ray_x, ray_y, depth), in camera axes (see `CameraFrame`).  The intersection
is at t times this direction from the eye; t is infinite if the ray misses the object.

Intersections are computed for one shape after the other.  A *pair* consists of a sample and an
object that may cover it.  Pairs are arranged in *spans*: consecutive samples in one row, paired
with the same object.  Hits are arranged in *runs*: consecutive hits in one row of samples, on the
same face of the same object.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, find, mark_run_starts, repeat_runs
from tracer.geometry.camera import CameraFrame
from tracer.geometry.shape import Shape
from tracer.trace.hits import Hits, ShapeHits
from tracer.trace.packet_size import assign_depth_layers
from tracer.trace.samples import Samples
from tracer.world.prepared_scene import PreparedScene

# Runs of scattered samples also end at the borders of vertical strips of this width, in pixels, and
# where the depth changes by about as much.  So their hits are close together, and a small sphere
# contains them in shadow tests.
_RUN_WIDTH = 4.0

# Larger than the ray parameter t of any intersection; smaller than infinity, which means a miss.
_MAX_T = np.finfo(np.float64).max


def find_nearest_hits(scene: PreparedScene, samples: Samples) -> Hits:
    """Find the first surface that the ray through each sample hits, if it hits any.

    If several surfaces are at exactly the same distance, the first one in the scene file is hit.
    """
    groups = _intersect_objects(scene, samples)
    visible_groups = _select_visible(scene, groups, _find_nearest_t(samples, groups))
    return _build_hits(scene, samples, visible_groups)


def find_nearest_and_hidden_hits(scene: PreparedScene, samples: Samples) -> tuple[Hits, Hits]:
    """Find the first hit of the ray through each sample, and the hidden hits behind it.

    The first result is what `find_nearest_hits` returns.  The second contains the hits of these
    rays on all objects that are farther away, so a sample may have any number of them.
    """
    groups = _intersect_objects(scene, samples)
    nearest_t = _find_nearest_t(samples, groups)
    hidden_groups = [
        group.select((group.t > nearest_t.take(group.sample_index)) & (group.t < np.inf))
        for group in groups
    ]
    visible_groups = _select_visible(scene, groups, nearest_t)
    return _build_hits(scene, samples, visible_groups), _build_hits(scene, samples, hidden_groups)


class _Intersections(NamedTuple):
    """Intersections of rays with objects of one shape, for n pairs arranged in spans."""

    shape: Shape
    sample_count: Shaped[Ints, "spans"] | None  # None: each span has one sample
    object_index: Shaped[Ints, "spans"]
    ray_y: Shaped[Floats, "spans"]
    sample_index: Shaped[Ints, "n"]
    ray_x: Shaped[Floats, "n"]
    t: Shaped[Floats, "n"]
    hit_data: Shaped[NDArray[Any], "n"]  # what `Shape.intersect` returned: for boxes, face codes

    @property
    def pair_object(self) -> Shaped[Ints, "n"]:
        return repeat_runs(self.object_index, self.sample_count)

    def select(self, is_selected: Shaped[Bools, "n"]) -> _Intersections:
        """Keep the selected pairs, in the same order; return this instance if they are all."""
        pair_index = find(is_selected)
        if pair_index.size == is_selected.size:
            return self
        if self.sample_count is None:
            sample_count = None
            object_index, ray_y = self.object_index.take(pair_index), self.ray_y.take(pair_index)
        else:
            # Spans stay where they are, but may become empty.  Count the selected pairs before the
            # end of each span; the difference between two spans is the number in the second.
            span_end = self.sample_count.cumsum()
            selected_before_end = pair_index.searchsorted(span_end)
            sample_count = np.diff(selected_before_end, prepend=0)
            object_index, ray_y = self.object_index, self.ray_y
        return _Intersections(
            shape=self.shape,
            sample_count=sample_count,
            object_index=object_index,
            ray_y=ray_y,
            sample_index=self.sample_index.take(pair_index),
            ray_x=self.ray_x.take(pair_index),
            t=self.t.take(pair_index),
            hit_data=self.hit_data.take(pair_index),
        )

    def compute_positions(self, depth: float, out: Shaped[Floats, "3 n"]) -> None:
        """Store the vectors from the eye to the hits, in camera axes, in an array.

        `depth` is the forward component of all rays.
        """
        ray_y = repeat_runs(self.ray_y, self.sample_count)
        np.multiply(self.t, self.ray_x, out=out[0])
        np.multiply(self.t, ray_y, out=out[1])
        np.multiply(self.t, depth, out=out[2])

    def find_run_starts(
        self, samples: Samples, frame: CameraFrame, hit_depth: Shaped[Floats, "n"]
    ) -> Shaped[Ints, "runs"]:
        """Find the index of the first hit of each run.  All rays must hit.

        `hit_depth` is the distance of each hit ahead of the eye, in scene units.
        """
        if self.sample_count is None:
            is_start = self._mark_scattered_starts(samples, frame, hit_depth)
        else:
            is_start = self._mark_row_starts(self.sample_count)
        if self.shape.has_planar_faces:
            is_start |= mark_run_starts(self.hit_data)  # face codes
        return find(is_start)

    def _mark_row_starts(self, sample_count: Shaped[Ints, "spans"]) -> Shaped[Bools, "n"]:
        """Mark the first hit of each span, and the first hit after each gap in a span.

        There is a gap where a nearer object hides this one.
        """
        is_start = np.zeros(self.t.size, dtype=np.bool_)
        span_start = sample_count.cumsum() - sample_count
        is_start[span_start[sample_count > 0]] = True
        is_start[1:] |= np.diff(self.sample_index) > 1
        return is_start

    def _mark_scattered_starts(
        self, samples: Samples, frame: CameraFrame, hit_depth: Shaped[Floats, "n"]
    ) -> Shaped[Bools, "n"]:
        """Mark the hits at which the object, the row of pixels, the strip or the depth changes.

        Strips are `_RUN_WIDTH` pixels wide, and the depth changes with its layer.
        """
        x, y = samples.get_positions(self.sample_index)
        strip, row = np.floor(x / _RUN_WIDTH), np.floor(y)
        depth_layer = assign_depth_layers(frame, hit_depth, _RUN_WIDTH)
        return mark_run_starts(self.object_index, row, strip, depth_layer)


def _intersect_objects(scene: PreparedScene, samples: Samples) -> list[_Intersections]:
    """Intersect the ray through each sample with all objects that may cover the sample."""
    groups = []
    sample_ray_x = samples.compute_ray_x(scene.frame)
    row_ray_y = scene.frame.to_ray_y(samples.y)
    for shape in scene.shapes:
        spans = samples.find_spans(shape, scene.bounds)
        sample_index = spans.list_samples()
        ray_y, ray_x = row_ray_y.take(spans.row), sample_ray_x.take(sample_index)
        t, hit_data = shape.intersect(spans.object_index, ray_y, ray_x, spans.sample_count)
        groups.append(
            _Intersections(
                shape=shape,
                sample_count=spans.sample_count,
                object_index=spans.object_index,
                ray_y=ray_y,
                sample_index=sample_index,
                ray_x=ray_x,
                t=t,
                hit_data=hit_data,
            )
        )
    return groups


def _find_nearest_t(samples: Samples, groups: list[_Intersections]) -> Shaped[Floats, "samples"]:
    """Find the t of the nearest intersection at each sample; `_MAX_T` if its ray meets nothing."""
    nearest_t = np.full(samples.size, _MAX_T)
    for group in groups:
        np.minimum.at(nearest_t, group.sample_index, group.t)
    return nearest_t


def _select_visible(
    scene: PreparedScene, groups: list[_Intersections], nearest_t: Shaped[Floats, "samples"]
) -> list[_Intersections]:
    """Select the intersections at `nearest_t` (see `_find_nearest_t`), at most one for each sample.

    If several objects are at the same distance, the first one in the scene file is selected.
    """
    nearest = [group.select(group.t == nearest_t.take(group.sample_index)) for group in groups]
    hit_count = np.count_nonzero(nearest_t < _MAX_T)
    if sum(group.t.size for group in nearest) == hit_count:
        return nearest  # no sample has two nearest intersections
    file_index = scene.surfaces.file_index
    first_file_index = np.full(nearest_t.size, file_index.size)  # for each sample
    for group in nearest:
        np.minimum.at(first_file_index, group.sample_index, file_index.take(group.pair_object))
    return [
        group.select(
            file_index.take(group.pair_object) == first_file_index.take(group.sample_index)
        )
        for group in nearest
    ]


def _build_hits(scene: PreparedScene, samples: Samples, groups: list[_Intersections]) -> Hits:
    """Turn intersections into hits, with their positions, runs and tangent planes.

    All rays of the groups must hit.
    """
    from_eye = np.empty((3, sum(group.t.size for group in groups)))
    shape_hits = list[ShapeHits]()
    start = 0
    for group in groups:
        end = start + group.t.size
        if group.t.size:
            positions = from_eye[:, start:end]
            group.compute_positions(scene.frame.depth, out=positions)
            shape_hits.append(_build_shape_hits(scene, samples, group, positions, start))
        start = end
    # Without groups, np.concatenate needs an array that has the type of the result.
    no_index = np.zeros(0, dtype=np.intp)
    run_length = np.concatenate([no_index, *(group.run_length for group in shape_hits)])
    return Hits(
        scene=scene,
        samples=samples,
        from_eye=from_eye,
        groups=shape_hits,
        sample_index=np.concatenate([no_index, *(group.sample_index for group in shape_hits)]),
        run_start=np.append(0, run_length.cumsum()),
        run_object=np.concatenate([no_index, *(group.run_object for group in shape_hits)]),
    )


def _build_shape_hits(
    scene: PreparedScene,
    samples: Samples,
    group: _Intersections,
    positions: Shaped[Floats, "3 n"],
    start: int,
) -> ShapeHits:
    """Compute the runs and tangent planes of the hits on objects of one shape.

    `positions` are vectors from the eye to the hits, in camera axes.  Among the hits of all shapes,
    the first of these hits has the index `start`.
    """
    run_start = group.find_run_starts(samples, scene.frame, positions[2])
    run_length = np.diff(run_start, append=group.t.size)
    run_object = group.pair_object[run_start]
    return ShapeHits(
        shape=group.shape,
        interval=slice(start, start + group.t.size),
        sample_index=group.sample_index,
        run_length=run_length,
        run_object=run_object,
        planes=group.shape.compute_tangent_planes(
            run_object, run_length, positions, group.t, group.hit_data
        ),
    )
