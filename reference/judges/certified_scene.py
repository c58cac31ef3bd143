"""Connect the certificate with the tracer: a scene as both need it, and samples of it.

The *certificate* is a picture with proven bounds on every pixel (see `certificate`).  It is
computed in square *cells* of the picture.  Of the modules that compute it, only this one and
`shadow_volumes` use internals of the tracer: the prepared scene, its light grid, and single
samples.  From a sample, the certificate uses only *which* face is visible and *which* lights reach
it, never the radiance.

A *face* is a sphere or a side of a box (see `faces`).

Positions are relative to the eye and along the camera's axes, unless said otherwise.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from reference.judges.arrays import Bools, Floats, Ints
from reference.judges.box_sides import BoxSides, describe_sides
from reference.judges.faces import (
    Faces,
    SphereShapes,
    Viewpoint,
    describe_faces,
    find_sheet_faces,
    find_unlit_faces,
)
from reference.judges.shadow_volumes import ShadowVolumes, compute_shadow_volumes
from tracer import Scene
from tracer.geometry.box import Boxes
from tracer.geometry.camera import CameraFrame
from tracer.geometry.sphere import Spheres
from tracer.trace.hits import Hits
from tracer.trace.light_geometry import compute_light_geometry
from tracer.trace.occlusion import find_shadows
from tracer.trace.samples import Scattered
from tracer.trace.visibility import find_nearest_hits
from tracer.world.prepared_scene import Lights, PreparedScene

# Maximum distance of a light, relative to the size of the smallest object.  Seen from farther away,
# both ends of an object may round to the same direction.
_MAX_LIGHT_DISTANCE = 1e14


class VisibleFaces(NamedTuple):
    """What samples show; samples that show the background are left out."""

    hits: Hits
    sample_index: Shaped[Ints, "hits"]  # in any order
    face_index: Shaped[Ints, "hits"]


class CertifiedScene:
    """A scene, described for the certificate by numbers that do not depend on the cell.

    Objects are numbered with all spheres first.
    """

    frame: CameraFrame
    prepared_scene: PreparedScene
    lights: Lights
    spheres: SphereShapes
    faces: Faces
    shadow_volumes: ShadowVolumes
    sphere_count: int
    object_count: int
    to_center: Shaped[Floats, "3 lights spheres"]  # from the light to the sphere's centre
    is_unlit: Shaped[Bools, "lights faces"]  # see `find_unlit_faces`
    _sheet_face_index: Shaped[Ints, "objects"]  # see `find_sheet_faces`

    def __init__(self, scene: Scene) -> None:
        """Describe a scene.

        Raise ValueError if the eye is on a surface, or if the distance of a light is more than 1e14
        times the size of the smallest object.
        """
        self.prepared_scene = prepared_scene = PreparedScene(scene)
        self.frame = frame = prepared_scene.frame
        self.lights = lights = prepared_scene.prepare_lights()
        boxes = Boxes.from_surfaces(frame, scene.surfaces)
        self.spheres = spheres = _describe_spheres(Spheres.from_surfaces(frame, scene.surfaces))
        self.sphere_count = spheres.radius.size
        self.object_count = prepared_scene.is_eye_inside.size
        is_eye_in_box = prepared_scene.is_eye_inside[self.sphere_count :]
        sides = describe_sides(boxes.min_pt, boxes.max_pt, frame.eye, is_eye_in_box)
        _refuse_impossible_scenes(spheres, sides, is_eye_in_box, lights.from_eye)
        viewpoint = Viewpoint(
            eye=frame.eye,
            camera_axes=frame.axes,
            light_position=lights.from_eye,
            scene_light_position=lights.position,
        )
        self.faces = describe_faces(spheres, sides, viewpoint, prepared_scene.is_duplicate)
        is_sheet = np.append(np.full(self.sphere_count, False), sides.is_of_sheet)
        self._sheet_face_index = find_sheet_faces(self.faces, is_sheet)
        self.shadow_volumes = compute_shadow_volumes(sides, lights.position, frame)
        self.to_center = spheres.center[:, None] - lights.from_eye.T[:, :, None]
        light_side = _find_sides_of_lights(lights, boxes)
        self.is_unlit = find_unlit_faces(self.faces, light_side, prepared_scene.is_eye_inside)

    def compute_rays(
        self, x: Shaped[Floats, "cells"], y: Shaped[Floats, "cells"], cell_width: float
    ) -> Shaped[Floats, "3 3 cells"]:
        """Compute the directions of camera rays in square cells, as functions of X and Y.

        The cells have their centres at x and y in the picture, in pixels.  In each cell, X and Y
        run from -1 to 1.  The first axis of the result holds the components right, down and ahead,
        and the second the coefficients of 1, X and Y.
        """
        rays = np.zeros((3, 3, x.size))
        rays[0, 0] = self.frame.to_ray_x(x)
        rays[1, 0] = self.frame.to_ray_y(y)
        rays[2, 0] = self.frame.depth
        rays[0, 1] = cell_width / 2 * self.frame.pixel_width
        rays[1, 2] = cell_width / 2 * self.frame.pixel_height
        return rays

    def find_occluders(
        self,
        center: Shaped[Floats, "3 parts"],
        half_size: Shaped[Floats, "3 parts"],
        face_index: Shaped[Ints, "parts"],
        is_requested: Shaped[Bools, "lights parts"],
    ) -> Shaped[Ints, "3 triples"]:
        """List the objects that may shade parts of faces from lights.

        Each column of the result names a part, a light, and an object between them.  Its rows are
        the indices of the parts, the lights and the objects.  The columns are sorted, and no two
        are equal.

        Parameters
        ----------
        center, half_size
            A box around each part, in the scene's axes.
        face_index
            The face to which each part belongs.
        is_requested
            Whether to search for objects between a light and a part.
        """
        grid = self.lights.grid
        # Each combination of a part, a light and an object has its own key.
        light_count, part_count = is_requested.shape
        key_shape = part_count, light_count, self.object_count
        triple_keys = [np.zeros(0, np.intp)]
        may_block = ~self.prepared_scene.is_eye_inside & ~self.prepared_scene.is_duplicate
        if grid is not None and is_requested.any():
            object_index = self.faces.object_index[face_index]
            triples = grid.query(center, half_size[:, None], object_index, is_requested)
            for light_index, part_index, occluder_index in triples:
                keys = np.ravel_multi_index((part_index, light_index, occluder_index), key_shape)
                triple_keys.append(keys[may_block[occluder_index]])
        # The grid may find an object in several octants, so remove duplicates.
        sorted_keys = np.unique(np.concatenate(triple_keys))
        return np.array(np.unravel_index(sorted_keys, key_shape))

    def trace_samples(
        self, x: Shaped[Floats, "samples"], y: Shaped[Floats, "samples"]
    ) -> VisibleFaces:
        """Trace a camera ray through each position, and find the face that it hits.

        The positions are in pixels right and down from the upper left corner of the picture.
        """
        samples, position_index = Scattered.from_positions(x, y)
        hits = find_nearest_hits(self.prepared_scene, samples)
        return VisibleFaces(
            hits=hits,
            sample_index=position_index[hits.sample_index],
            face_index=self._identify_faces(hits),
        )

    def _identify_faces(self, hits: Hits) -> Shaped[Ints, "hits"]:
        """Find the index of the face that each camera ray hits."""
        box_count = self.object_count - self.sphere_count
        face_index = np.empty(hits.sample_index.size, dtype=np.intp)
        for group in hits.groups:
            # From outside a box, the normal towards the eye points up on a high side.
            is_eye_inside = hits.scene.is_eye_inside[group.run_object]
            is_high_side = (group.planes.normal_sign > 0) ^ is_eye_inside
            # Boxes are numbered after the spheres, and so are the low sides along x of all boxes.
            # There are `box_count` faces between a box's sides number i and i + 1.
            side_index = 2 * group.planes.face_axis + is_high_side
            is_box = group.shape.has_planar_faces
            run_face_index = group.run_object + is_box * box_count * side_index
            face_index[group.interval] = group.repeat_runs(run_face_index)
        # A ray through the rim of a flat box may hit a side without area: use its visible face.
        sheet_face_index = self._sheet_face_index[self.faces.object_index[face_index]]
        return np.where(sheet_face_index >= 0, sheet_face_index, face_index)

    def test_lights(
        self, hits: Hits, is_tested: Shaped[Bools, "lights hits"]
    ) -> Shaped[Bools, "lights hits"]:
        """Find out which lights reach each hit, among those that `is_tested` marks for it.

        A light reaches a hit if it is in front of the surface and no object lies between them.  The
        result is False where `is_tested` is.
        """
        may_reach = is_tested & (compute_light_geometry(hits, self.lights).n_dot_l > 0)
        return may_reach & ~find_shadows(hits, self.lights, may_reach)


def _describe_spheres(spheres: Spheres) -> SphereShapes:
    return SphereShapes(
        center=np.array(spheres.from_eye),
        scene_center=spheres.center,
        radius=spheres.radius,
        eye_power=spheres.power,
    )


def _refuse_impossible_scenes(
    spheres: SphereShapes,
    sides: BoxSides,
    is_eye_in_box: Shaped[Bools, "boxes"],
    light_position: Shaped[Floats, "lights 3"],
) -> None:
    """Raise ValueError if the eye is on a surface, or if a light is too far away.

    The positions of the lights are relative to the eye.
    """
    is_on_box = is_eye_in_box & np.any(sides.offset == 0, axis=(0, 1))
    if np.any(spheres.eye_power == 0) or is_on_box.any():
        raise ValueError("the eye is on a surface; move it off")
    box_size = sides.position[:, 1] - sides.position[:, 0]
    lengths = np.append(spheres.radius, box_size.ravel())
    max_distance = _MAX_LIGHT_DISTANCE * lengths[lengths > 0].min(initial=np.inf)
    if np.abs(light_position).max(initial=0) > max_distance:
        limit = f"{_MAX_LIGHT_DISTANCE:g} times the size of an object"
        raise ValueError(f"a light is farther away than {limit}; move it closer")


def _find_sides_of_lights(lights: Lights, boxes: Boxes) -> Shaped[NDArray[Any], "lights objects"]:
    """Return positive numbers for lights outside objects, negative inside, 0 on sides of boxes."""
    # `lights.side` differs only in that a light on a side of a box counts as outside.
    side = lights.side.copy()
    box_index = boxes.objects.list_indices()
    light_x, light_y, light_z = lights.position.T[:, :, None]
    distance = boxes.measure_distance(box_index, (light_x, light_y, light_z))
    side[:, box_index] *= distance != 0
    return side
