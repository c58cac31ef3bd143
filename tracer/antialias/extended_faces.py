"""Extend the faces that rays have hit beyond their rims, and intersect them with other rays.

A ray from the eye to an edge between two surfaces meets both at the same distance.  The distances
of both faces are therefore compared in a whole cell (a pixel or a square part of a pixel), although
a face may end within it.

A ray d from the eye meets a face at the point t d.  The number 1 / t is computed instead of t,
because it is a linear function of d if the face is planar.  All vectors are in camera axes, and
points are relative to the eye.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Floats, Ints, Triple, dot, find, take, take_columns
from tracer.geometry.shape import CURVED_FACE, NO_AXIS, Shape
from tracer.trace.hits import Hits


class ExtendedFaces(NamedTuple):
    """The faces that n hits are on, extended beyond their rims, ready to be met by other rays.

    All points q of a planar face with the unit normal n and the hit p satisfy n . q = n . p.  So a
    ray d from the eye meets the face at t d, where 1 / t = d . n / (n . p).
    """

    curved_shapes: list[Shape]  # all shapes that have a curved face
    scaled_normal: Shaped[Triple, "n"]  # n / (n . p); meaningless for curved faces
    curved_object: Shaped[Ints, "n"]  # object index of hits on curved faces; -1 for planar faces

    @classmethod
    def from_hits(cls, hits: Hits) -> ExtendedFaces:
        """Collect the face that each hit is on, in the order of the hits."""
        scaled_normal = np.empty(hits.from_eye.shape)
        curved_object = np.empty(hits.from_eye.shape[1], dtype=np.intp)
        for group in hits.groups:
            planes = group.planes
            run_object = np.where(planes.face_axis == NO_AXIS, group.run_object, -1)
            curved_object[group.interval] = group.repeat_runs(run_object)
            # The height of the eye above the plane is -(n . p).
            for axis, component in enumerate(planes.normal):
                scaled_component = component / -planes.eye_height
                scaled_normal[axis, group.interval] = group.expand_to_hits(scaled_component)
        return cls(
            curved_shapes=[shape for shape in hits.scene.shapes if shape.has_curved_face],
            scaled_normal=(scaled_normal[0], scaled_normal[1], scaled_normal[2]),
            curved_object=curved_object,
        )

    def take(self, face_index: Shaped[Ints, "m"]) -> ExtendedFaces:
        return self._replace(
            scaled_normal=take(self.scaled_normal, face_index),
            curved_object=self.curved_object[face_index],
        )

    def compute_inverse_t(self, ray: Shaped[Triple, "#6 n"]) -> Shaped[Floats, "6 n"]:
        """Compute 1 / t of six rays for each face, where the point t * ray lies on the face.

        If a ray misses a curved face, the result is a smooth continuation.
        """
        inverse_t = dot(self.scaled_normal, ray)
        for shape in self.curved_shapes:
            face_index = find(shape.objects.contains(self.curved_object))
            if face_index.size:
                inverse_t[:, face_index] = shape.compute_inverse_t(
                    CURVED_FACE, self.curved_object[face_index], take_columns(ray, face_index)
                )
        return inverse_t
