"""Visibility: which surface does the ray through each sample meet first?

Each object is tested only with the rays through samples that it may cover in the picture.  Then the
nearest intersection at each sample is selected.

A ray has the direction (ray_x, ray_y, depth), in camera axes (see `CameraFrame`).  Its parameter t
is the distance from the eye divided by the length of the direction; t is infinite if the ray misses
the object.

There is one group of intersections for each shape.  In a group, (sample, object) pairs are arranged
in *spans*: consecutive samples in one row, paired with the same object.  Hits are arranged in
*runs*: consecutive hits in one row of samples, on the same face of the same object.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, find, join_ranges, mark_run_starts, repeat_runs
from tracer.geometry.camera import CameraFrame
from tracer.geometry.shape import Shape
from tracer.trace.hits import Hits, ShapeHits
from tracer.trace.samples import Samples
from tracer.world.prepared_scene import PreparedScene

# Runs of scattered samples end at the borders of squares of this width, in pixels.
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
    """Find the nearest hits, as `find_nearest_hits`, and hits on all objects behind them.

    A sample may have any number of hidden hits.
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
    """Intersections of rays with objects of one shape, for n (sample, object) pairs in spans."""

    shape: Shape
    sample_count: Shaped[Ints, "spans"] | None  # None: each span has one sample
    object_index: Shaped[Ints, "spans"]
    ray_y: Shaped[Floats, "spans"]
    sample_index: Shaped[Ints, "n"]
    ray_x: Shaped[Floats, "n"]
    t: Shaped[Floats, "n"]
    hit_data: Shaped[NDArray[Any], "n"]  # see `Shape.intersect`

    @property
    def pair_object(self) -> Shaped[Ints, "n"]:
        """Object index of each pair."""
        return repeat_runs(self.object_index, self.sample_count)

    def select(self, is_selected: Shaped[Bools, "n"]) -> _Intersections:
        """Select pairs, in the same order; return this object itself if all pairs are selected."""
        pair_index = find(is_selected)
        if pair_index.size == is_selected.size:
            return self
        shape, sample_count, object_index, ray_y, *pair_fields = self
        if sample_count is None:
            object_index, ray_y = object_index.take(pair_index), ray_y.take(pair_index)
        else:
            sample_count = np.diff(pair_index.searchsorted(sample_count.cumsum()), prepend=0)
        pair_fields = [field.take(pair_index) for field in pair_fields]
        return _Intersections(shape, sample_count, object_index, ray_y, *pair_fields)

    def find_run_starts(
        self, samples: Samples, frame: CameraFrame, depth: Shaped[Floats, "n"]
    ) -> Shaped[Ints, "runs"]:
        """Find the first hit of each run, from the pairs' samples, objects and depths.

        A run of scattered samples lies in one row of pixels, and its hits are close together.
        """
        if self.shape.has_planar_faces:
            is_start = mark_run_starts(self.hit_data)  # face codes
        else:
            is_start = np.zeros(depth.size, dtype=np.bool_)
        if self.sample_count is None:
            x, y = samples.get_positions(self.sample_index)
            strip, depth_layer = np.floor(x / _RUN_WIDTH), frame.assign_layer(depth, _RUN_WIDTH)
            is_start |= mark_run_starts(self.object_index, np.floor(y), strip, depth_layer)
        else:
            is_start[(self.sample_count.cumsum() - self.sample_count)[self.sample_count > 0]] = True
            is_start[1:] |= np.diff(self.sample_index) > 1  # a nearer object interrupts the run
        return find(is_start)


def _intersect_objects(scene: PreparedScene, samples: Samples) -> list[_Intersections]:
    """Intersect the ray through each sample with all objects that may cover the sample."""
    frame, groups = scene.frame, []
    sample_ray_x, row_ray_y = samples.compute_ray_x(frame), frame.to_ray_y(samples.y)
    for shape in scene.shapes:
        object_index, row, span_start, sample_count = samples.find_spans(shape, scene)
        sample_index = span_start if sample_count is None else join_ranges(sample_count, span_start)
        ray_y, ray_x = row_ray_y.take(row), sample_ray_x.take(sample_index)
        t, hit_data = shape.intersect(object_index, ray_y, ray_x, sample_count)
        fields = sample_count, object_index, ray_y, sample_index, ray_x, t, hit_data
        groups.append(_Intersections(shape, *fields))
    return groups


def _find_nearest_t(samples: Samples, groups: list[_Intersections]) -> Shaped[Floats, "samples"]:
    """Find the t of the nearest intersection at each sample; `_MAX_T` if there is none."""
    nearest_t = np.full(samples.size, _MAX_T)
    for group in groups:
        np.minimum.at(nearest_t, group.sample_index, group.t)
    return nearest_t


def _select_visible(
    scene: PreparedScene, groups: list[_Intersections], nearest_t: Shaped[Floats, "samples"]
) -> list[_Intersections]:
    """Select the nearest intersection at each sample whose ray meets a surface.

    If several objects are at the same distance, only the first one in the scene file is selected.
    """
    candidates = [group.select(group.t == nearest_t.take(group.sample_index)) for group in groups]
    if sum(group.t.size for group in candidates) == np.count_nonzero(nearest_t < _MAX_T):
        return candidates  # no sample has two nearest intersections
    file_index = scene.surfaces.file_index
    min_file_index = np.full(nearest_t.size, file_index.size)
    for group in candidates:
        np.minimum.at(min_file_index, group.sample_index, file_index.take(group.pair_object))
    return [
        group.select(file_index.take(group.pair_object) == min_file_index.take(group.sample_index))
        for group in candidates
    ]


def _build_hits(scene: PreparedScene, samples: Samples, groups: list[_Intersections]) -> Hits:
    """Compute the positions and tangent planes of hits from intersections, without misses."""
    frame, groups = scene.frame, [group for group in groups if group.t.size]
    group_starts = np.cumsum([0] + [group.t.size for group in groups]).tolist()
    from_eye, shape_hits, no_hits = np.empty((3, group_starts[-1])), [], np.zeros(0, dtype=np.intp)
    for group, start, end in zip(groups, group_starts, group_starts[1:], strict=False):
        group_from_eye = from_eye[:, start:end]
        ray_y = repeat_runs(group.ray_y, group.sample_count)
        np.multiply(group.t, group.ray_x, out=group_from_eye[0])
        np.multiply(group.t, ray_y, out=group_from_eye[1])
        np.multiply(group.t, frame.depth, out=group_from_eye[2])
        run_start = group.find_run_starts(samples, frame, group_from_eye[2])
        run_length = np.diff(run_start, append=end - start)
        run_object = group.pair_object[run_start]
        planes = group.shape.compute_tangent_planes(
            run_object, run_length, group_from_eye, group.t, group.hit_data
        )
        shape_hits.append(
            ShapeHits(
                shape=group.shape,
                interval=slice(start, end),
                sample_index=group.sample_index,
                run_length=run_length,
                run_object=run_object,
                planes=planes,
            )
        )
    run_start = np.concatenate([no_hits, [0], *(group.run_length for group in shape_hits)]).cumsum()
    sample_index = np.concatenate([no_hits, *(group.sample_index for group in shape_hits)])
    run_object = np.concatenate([no_hits, *(group.run_object for group in shape_hits)])
    return Hits(scene, samples, from_eye, shape_hits, sample_index, run_start, run_object)
