"""Ids of samples: what antialiasing takes for one smooth surface."""

from __future__ import annotations

import numpy as np
from probe import scene_of

from tracer import Box, Camera, PointLight, Sphere, explain
from tracer.antialias.lattice import CENTRES
from tracer.geometry.camera import camera_frame
from tracer.trace.radiance import radiance_and_ids
from tracer.world.prepared_scene import PreparedScene


def test_ids_are_equal_where_object_face_and_lights_are():
    camera = Camera(view_point=(5, 4, 3), view_dir=(-5, -4, -3), view_width=1, view_height=0.75)
    boxes = [
        Box(min_pt=(-3, -2, -3), max_pt=(3, -1, 3)),
        Box(min_pt=(-1, -1, -1), max_pt=(1, 1, 1)),
    ]
    lights = [PointLight(position=p) for p in ((2, 9, 1), (9, 5, 2), (3, 4, 9))]
    ball = Sphere(center=(1, 0, 2), radius=0.7)
    scene = scene_of(ball, *boxes, camera=camera, size=(16, 12), lights=lights)
    frame = camera_frame(scene.camera, scene.width, scene.height)
    samples = CENTRES.samples(slice(0, scene.height), slice(0, scene.width))
    with np.errstate(all="ignore"):  # as where pictures are rendered
        _, ids = radiance_and_ids(PreparedScene(scene, frame), samples)
    keys = {}
    for (y, x), found in np.ndenumerate(ids.reshape(scene.height, scene.width)):
        pixel = explain(scene, x, y)
        flat = pixel.surface is not None and pixel.surface.kind == "Box"
        lit = tuple(not light.occluders for light in pixel.lights)
        key = pixel.surface and (pixel.surface, flat and pixel.normal, lit)
        assert keys.setdefault(key, found) == found
    assert len(set(keys.values())) == len(keys) > 9
    assert keys[None] == -1
