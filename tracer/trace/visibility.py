"""Visibility: which surface does the ray through each sample meet first?

Rays are tested only with objects that may be visible at their samples: with the samples in the span
of a row that an object covers.  Then the nearest of the intersections at each sample is selected.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats, Ints, indices, join_ranges, repeat_runs, run_starts
from tracer.geometry.camera import CameraFrame
from tracer.trace.hits import Hits, ShapeHits
from tracer.trace.samples import Samples
from tracer.world.prepared_scene import PreparedScene, Shape

# Runs of scattered samples end at the borders of squares of this width, in pixels.
_RUN_WIDTH = 4.0

# Larger than the distance of any intersection, and less than infinity, the distance of a miss.
_MAX_DISTANCE = np.finfo(np.float64).max


def nearest_hits(prepared: PreparedScene, samples: Samples) -> Hits:
    """Find the nearest surface at each sample.

    If surfaces are at exactly the same distance, the first of them in the file is visible.
    Samples whose rays meet no surface have no hit.

    Parameters
    ----------
    prepared : PreparedScene
        The scene.
    samples : Rows or Scattered
        All samples.
    """
    groups = _intersect_objects(prepared, samples)
    return _build_hits(
        prepared, samples, _select_visible(prepared, groups, _nearest_distances(samples, groups))
    )


def nearest_and_hidden_hits(prepared: PreparedScene, samples: Samples) -> tuple[Hits, Hits]:
    """Find the nearest surface at each sample, and all surfaces behind it.

    Parameters
    ----------
    prepared : PreparedScene
        The scene.
    samples : Rows or Scattered
        All samples.

    Returns
    -------
    nearest : Hits
        The same as from `nearest_hits`.
    hidden : Hits
        The hits on objects that are hidden by the nearest surface.  A sample may have several.
    """
    groups = _intersect_objects(prepared, samples)
    nearest = _nearest_distances(samples, groups)
    hidden = [g.select((g.t > nearest.take(g.sample)) & (g.t < np.inf)) for g in groups]
    visible = _select_visible(prepared, groups, nearest)
    return _build_hits(prepared, samples, visible), _build_hits(prepared, samples, hidden)


class _Intersections(NamedTuple):
    """n pairs of a sample and an object of one shape, with the distance at which the ray meets it.

    The pairs are arranged in spans: consecutive samples in one row, paired with one object.

    Attributes
    ----------
    shape : Spheres or Boxes
        The objects.
    sample_count : (spans,) int array or None
        Number of samples in each span; None if each span has one sample.
    object_index : (spans,) int array
        The object of each span.
    g : (spans,) float array
        Second component of the rays in each span.
    sample : (n,) int array
        The sample of each pair.
    s : (n,) float array
        First component of the sample's ray.
    t : (n,) float array
        Distance of the intersection, in units of the length of the ray's direction (s, g, depth);
        infinity if the ray misses the object.
    detail : (n,) array
        Second result of `Spheres.intersect` or `Boxes.intersect`.
    """

    shape: Shape
    sample_count: Ints | None
    object_index: Ints
    g: Floats
    sample: Ints
    s: Floats
    t: Floats
    detail: NDArray[Any]

    def select(self, mask: Bools) -> _Intersections:
        """Select pairs by a mask (n,)."""
        index = indices(mask)
        if index.size == mask.size:
            return self
        shape, sample_count, object_index, g, *pairs = self
        if sample_count is None:
            object_index, g = object_index.take(index), g.take(index)
        else:
            sample_count = np.diff(index.searchsorted(sample_count.cumsum()), prepend=0)
        pairs = [values.take(index) for values in pairs]
        return _Intersections(shape, sample_count, object_index, g, *pairs)

    def find_run_starts(self, samples: Samples, frame: CameraFrame, ahead: Floats) -> Ints:
        """Divide the intersections into runs, and return the index of the first in each run.

        A run consists of consecutive hits in one row of samples, on the same face of the same
        object.  Runs of scattered samples also end at the borders of squares of `_RUN_WIDTH`
        pixels, and of layers of depth: see `CameraFrame.depth_layer`.

        Parameters
        ----------
        samples : Rows or Scattered
            All samples.
        frame : CameraFrame
            The rays of the camera.
        ahead : (n,) float array
            Depth of each intersection: component along w of the vector from the eye.
        """
        planar = self.shape.is_planar
        is_start = run_starts(self.detail) if planar else np.zeros(ahead.size, dtype=np.bool_)
        if self.sample_count is None:
            x, y = samples.positions(self.sample)
            layer = frame.depth_layer(ahead, _RUN_WIDTH)
            is_start |= run_starts(self.object_index, np.floor(y), np.floor(x / _RUN_WIDTH), layer)
        else:
            is_start[(self.sample_count.cumsum() - self.sample_count)[self.sample_count > 0]] = True
            is_start[1:] |= np.diff(self.sample) > 1  # a nearer object hides the samples between
        return indices(is_start)


def _intersect_objects(prepared: PreparedScene, samples: Samples) -> list[_Intersections]:
    """Intersect the ray of each sample with the objects that may be visible at the sample.

    Parameters
    ----------
    prepared : PreparedScene
        The scene.
    samples : Rows or Scattered
        All samples.

    Returns
    -------
    groups : list of _Intersections
        The pairs of a sample and an object, for each shape.  They include rays that miss.
    """
    frame, groups = prepared.frame, []
    all_s, all_g = samples.ray_s(frame), frame.ray_g(samples.y)
    for shape in prepared.shapes:
        object_index, row, first_sample, sample_count = samples.covered_samples(shape, prepared)
        sample = first_sample if sample_count is None else join_ranges(first_sample, sample_count)
        g, s = all_g.take(row), all_s.take(sample)
        t, detail = shape.intersect(object_index, g, s, sample_count)
        groups.append(_Intersections(shape, sample_count, object_index, g, sample, s, t, detail))
    return groups


def _nearest_distances(samples: Samples, groups: list[_Intersections]) -> Floats:
    """Return the distance of the nearest intersection at each sample.

    Parameters
    ----------
    samples : Rows or Scattered
        All n samples.
    groups : list of _Intersections
        All intersections, for each shape.

    Returns
    -------
    nearest : (n,) float array
        Distance in units of the length of the ray's direction; `_MAX_DISTANCE` if the ray meets no
        surface.
    """
    nearest = np.full(samples.size, _MAX_DISTANCE)
    for group in groups:
        np.minimum.at(nearest, group.sample, group.t)
    return nearest


def _select_visible(
    prepared: PreparedScene, groups: list[_Intersections], nearest: Floats
) -> list[_Intersections]:
    """Select the intersections that are visible: one for each sample whose ray meets a surface.

    Parameters
    ----------
    prepared : PreparedScene
        The scene.
    groups : list of _Intersections
        All intersections, for each shape.
    nearest : (samples,) float array
        Distance of the nearest intersection at each sample.

    Returns
    -------
    visible : list of _Intersections
        The nearest intersection at each sample; of several, that with the object that is first in
        the scene file.
    """
    visible = [group.select(group.t == nearest.take(group.sample)) for group in groups]
    if sum(g.t.size for g in visible) == np.count_nonzero(nearest < _MAX_DISTANCE):
        return visible  # no sample has two
    file_index = prepared.surfaces.file_index
    ranks = [repeat_runs(file_index.take(g.object_index), g.sample_count) for g in visible]
    first = np.full(nearest.size, file_index.size)
    for group, rank in zip(visible, ranks, strict=True):
        np.minimum.at(first, group.sample, rank)
    return [
        group.select(rank == first.take(group.sample))
        for group, rank in zip(visible, ranks, strict=True)
    ]


def _build_hits(prepared: PreparedScene, samples: Samples, groups: list[_Intersections]) -> Hits:
    """Compute the hits, with their surfaces, from intersections without misses.

    Parameters
    ----------
    prepared : PreparedScene
        The scene.
    samples : Rows or Scattered
        All samples.
    groups : list of _Intersections
        The intersections, for each shape.
    """
    frame, groups = prepared.frame, [group for group in groups if group.t.size]
    ends = np.cumsum([0] + [group.t.size for group in groups]).tolist()
    local, shape_hits, none = np.empty((3, ends[-1])), [], np.zeros(0, dtype=np.intp)
    for group, start, end in zip(groups, ends, ends[1:], strict=False):
        group_local = local[:, start:end]
        np.multiply(group.t, group.s, out=group_local[0])
        np.multiply(group.t, repeat_runs(group.g, group.sample_count), out=group_local[1])
        np.multiply(group.t, frame.depth, out=group_local[2])
        run_start = group.find_run_starts(samples, frame, group_local[2])
        length = np.diff(run_start, append=end - start)
        run_object = repeat_runs(group.object_index, group.sample_count)[run_start]
        surface = group.shape.tangent_planes(run_object, length, group_local, group.t, group.detail)
        interval = slice(start, end)
        shape_hits.append(
            ShapeHits(group.shape, interval, group.sample, length, run_object, *surface)
        )
    run_start = np.concatenate([none, [0], *(group.run_length for group in shape_hits)]).cumsum()
    sample = np.concatenate([none, *(group.sample for group in shape_hits)])
    run_object = np.concatenate([none, *(group.run_object for group in shape_hits)])
    return Hits(prepared, samples, local, shape_hits, sample, run_start, run_object)
