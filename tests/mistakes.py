"""Pictures as a tracer with a mistake would make them, from this one, which stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tracer import Lambertian, Scene, render
from tracer.antialias.lattice import CENTRES
from tracer.arrays import Floats
from tracer.view.camera import raster_of
from tracer.view.view import view_of
from tracer.view.visibility import visible as hits_of


def no_highlights(scene: Scene) -> Floats:
    """Every shader's diffuse part alone."""
    matte = [replace(s, shader=Lambertian(diffuse=s.shader.diffuse)) for s in scene.surfaces]
    return render(replace(scene, surfaces=matte))


def no_shadows(scene: Scene) -> Floats:
    """Each surface as if it were alone in the world."""
    _, owner = visible(scene)
    image = np.zeros((scene.height, scene.width, 3))
    for index, surface in enumerate(scene.surfaces):
        own = owner == index
        image[own] = render(replace(scene, surfaces=[surface]))[own]
    return image


@np.errstate(all="ignore")
def visible(scene: Scene) -> tuple[Floats, Floats]:
    """What is seen: points (h, w, 3) and the places of their surfaces (h, w); NaN for nothing."""
    height, width = scene.height, scene.width
    view = view_of(raster_of(scene.camera, width, height), scene.surfaces)
    hits = hits_of(view, CENTRES.samples(slice(0, height), slice(0, width)))
    points, owner = np.full((height * width, 3), np.nan), np.full(height * width, np.nan)
    points[hits.sample] = np.stack(hits.points(slice(None)), axis=1)
    owner[hits.sample] = scene.surfaces.file_index[hits.own]
    return points.reshape(height, width, 3), owner.reshape(height, width)
