"""Pictures as a tracer with a mistake would make them, from this one, which stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tracer import Hits, Lambertian, Scene, first_hits, render
from tracer.arrays import Floats


def no_highlights(scene: Scene) -> Floats:
    """Every shader's diffuse part alone."""
    matte = [replace(s, shader=Lambertian(diffuse=s.shader.diffuse)) for s in scene.surfaces]
    return render(replace(scene, surfaces=matte))


def no_shadows(scene: Scene) -> Floats:
    """Each surface as if it were alone in the world."""
    owner = visible(scene).surface.reshape(scene.height, scene.width)
    image = np.zeros((scene.height, scene.width, 3))
    for index, surface in enumerate(scene.surfaces):
        own = owner == index
        image[own] = render(replace(scene, surfaces=[surface]))[own]
    return image


def visible(scene: Scene) -> Hits:
    """Surfaces at the pixels' centres, row by row."""
    row, column = np.divmod(np.arange(scene.height * scene.width), scene.width)
    return first_hits(scene, column + 0.5, row + 0.5)
