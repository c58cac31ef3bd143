"""Visibility: which surface does the ray through each sample meet first?

Each object is tested only with the rays through samples that it may cover in the picture.  Then the
nearest intersection at each sample is selected.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, find, join_ranges, mark_run_starts, repeat_runs
from tracer.geometry.camera import CameraFrame
from tracer.trace.hits import Hits, ShapeHits
from tracer.trace.samples import Samples
from tracer.world.prepared_scene import PreparedScene, Shape

# Runs of scattered samples end at the borders of squares of this width, in pixels.
_RUN_WIDTH = 4.0

# Larger than the ray parameter t of any intersection; smaller than infinity, which means a miss.
_MAX_T = np.finfo(np.float64).max


def find_nearest_hits(scene: PreparedScene, samples: Samples) -> Hits:
    """Find the first surface that the ray through each sample hits.

    If several surfaces are at exactly the same distance, the first one in the scene file is hit.

    Parameters
    ----------
    scene : PreparedScene
        The scene.
    samples : Rows or Scattered
        Positions in the picture, through which rays are traced.

    Returns
    -------
    hits : Hits
        One hit for each sample whose ray meets a surface; other samples have no hit.
    """
    groups = _intersect_objects(scene, samples)
    visible_groups = _select_visible(scene, groups, _find_nearest_t(samples, groups))
    return _build_hits(scene, samples, visible_groups)


def find_nearest_and_hidden_hits(scene: PreparedScene, samples: Samples) -> tuple[Hits, Hits]:
    """Find the first surface that the ray through each sample hits, and the objects behind it.

    Parameters
    ----------
    scene : PreparedScene
        The scene.
    samples : Rows or Scattered
        Positions in the picture, through which rays are traced.

    Returns
    -------
    nearest_hits : Hits
        One hit for each sample whose ray meets a surface: the result of `find_nearest_hits`.
    hidden_hits : Hits
        One hit for each object that the ray meets behind the nearest surface.  A sample may have
        any number of hidden hits.
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
    """Intersections of rays with objects of one shape, for n (sample, object) pairs.

    The ray through a sample has the direction (ray_x, ray_y, depth), in camera axes.  The
    pairs are arranged in spans: consecutive samples in one row, paired with the same object.

    Attributes
    ----------
    shape : Spheres or Boxes
        The shape of all objects.
    sample_count : (spans,) int array or None
        Number of samples in each span; None if each span has one sample.
    object_index : (spans,) int array
        Index of each span's object, among all objects of the scene.
    ray_y : (spans,) float array
        Downward component of the rays in each span.
    sample_index : (n,) int array
        Index of each pair's sample.
    ray_x : (n,) float array
        Rightward component of the ray through the sample.
    t : (n,) float array
        Ray parameter of the intersection: its distance from the eye, divided by the length of the
        ray's direction vector.  Infinity if the ray misses the object.
    hit_data : (n,) array
        Second result of `Spheres.intersect` or `Boxes.intersect`; for boxes, the face that is hit.
    """

    shape: Shape
    sample_count: Ints | None
    object_index: Ints
    ray_y: Floats
    sample_index: Ints
    ray_x: Floats
    t: Floats
    hit_data: NDArray[Any]

    @property
    def pair_object(self) -> Ints:
        """Index (n,) of each pair's object, among all objects of the scene."""
        return repeat_runs(self.object_index, self.sample_count)

    def select(self, is_selected: Bools) -> _Intersections:
        """Select some of the (sample, object) pairs.

        Parameters
        ----------
        is_selected : (n,) bool array
            Whether to select each pair.

        Returns
        -------
        selection : _Intersections
            The selected pairs in the same order; this object itself if all pairs are selected.
        """
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

    def find_run_starts(self, samples: Samples, frame: CameraFrame, depth: Floats) -> Ints:
        """Find the first hit of each run.

        A run consists of consecutive hits in one row of samples, on the same face of the same
        object.  A run of scattered samples lies in one row of pixels instead, and its hits are
        close together.

        Parameters
        ----------
        samples : Rows or Scattered
            Positions in the picture, through which rays are traced.
        frame : CameraFrame
            The camera.
        depth : (n,) float array
            Depth of each hit: the forward component of the vector from the eye.

        Returns
        -------
        run_start : (runs,) int array
            Index of the first hit of each run, in ascending order.
        """
        is_planar = self.shape.is_planar
        is_start = mark_run_starts(self.hit_data) if is_planar else np.zeros(depth.size, dtype=bool)
        if self.sample_count is None:
            x, y = samples.get_positions(self.sample_index)
            strip, depth_layer = np.floor(x / _RUN_WIDTH), frame.assign_layer(depth, _RUN_WIDTH)
            is_start |= mark_run_starts(self.object_index, np.floor(y), strip, depth_layer)
        else:
            is_start[(self.sample_count.cumsum() - self.sample_count)[self.sample_count > 0]] = True
            is_start[1:] |= np.diff(self.sample_index) > 1  # a nearer object interrupts the run
        return find(is_start)


def _intersect_objects(scene: PreparedScene, samples: Samples) -> list[_Intersections]:
    """Intersect the ray through each sample with all objects that may cover the sample.

    Parameters
    ----------
    scene : PreparedScene
        The scene.
    samples : Rows or Scattered
        Positions in the picture, through which rays are traced.

    Returns
    -------
    groups : list of _Intersections
        One group of (sample, object) pairs for each shape.  The ray parameter t is infinite if the
        ray misses the object.
    """
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


def _find_nearest_t(samples: Samples, groups: list[_Intersections]) -> Floats:
    """Find the ray parameter t of the nearest intersection at each sample.

    The parameter is the distance from the eye, divided by the length of the ray's direction vector.

    Parameters
    ----------
    samples : Rows or Scattered
        The n samples: positions in the picture, through which rays are traced.
    groups : list of _Intersections
        One group of (sample, object) pairs for each shape.

    Returns
    -------
    nearest_t : (n,) float array
        The ray parameter at each sample; `_MAX_T` if the ray meets no surface.
    """
    nearest_t = np.full(samples.size, _MAX_T)
    for group in groups:
        np.minimum.at(nearest_t, group.sample_index, group.t)
    return nearest_t


def _select_visible(
    scene: PreparedScene, groups: list[_Intersections], nearest_t: Floats
) -> list[_Intersections]:
    """Select the visible intersections: one for each sample whose ray meets a surface.

    Parameters
    ----------
    scene : PreparedScene
        The scene.
    groups : list of _Intersections
        One group of (sample, object) pairs for each shape.
    nearest_t : (samples,) float array
        Ray parameter of the nearest intersection at each sample, from `_find_nearest_t`.

    Returns
    -------
    visible_groups : list of _Intersections
        The nearest intersection at each sample, in the same groups.  If several objects are at the
        same distance, only the first one in the scene file is selected.
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
    """Compute the positions and tangent planes of hits from intersections.

    Parameters
    ----------
    scene : PreparedScene
        The scene.
    samples : Rows or Scattered
        Positions in the picture, through which rays are traced.
    groups : list of _Intersections
        One group of intersections for each shape, without misses.

    Returns
    -------
    hits : Hits
        One hit for each intersection.
    """
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
        tangent_planes = group.shape.compute_tangent_planes(
            run_object, run_length, group_from_eye, group.t, group.hit_data
        )
        fields = group.shape, slice(start, end), group.sample_index, run_length, run_object
        shape_hits.append(ShapeHits(*fields, *tangent_planes))
    run_start = np.concatenate([no_hits, [0], *(group.run_length for group in shape_hits)]).cumsum()
    sample_index = np.concatenate([no_hits, *(group.sample_index for group in shape_hits)])
    run_object = np.concatenate([no_hits, *(group.run_object for group in shape_hits)])
    return Hits(scene, samples, from_eye, shape_hits, sample_index, run_start, run_object)
