"""Mistakes of a tracer that the comparison with live Mitsuba catches; SSIM alone does not.

Some are made in the tracer's camera itself, while scenes are converted as well: nothing that has
gone through that camera may enter what is rendered by Mitsuba.  The others change the scene or the
picture.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from mistakes import no_highlights, no_shadows, radiance, visible
from numpy.typing import NDArray

import tracer.view.camera
from reference.check import (
    MAX_DIFFERENCE,
    MIN_SSIM,
    CheckResult,
    check_diffuse,
    check_scene,
    edge_mask,
    faults,
)
from reference.command import SCENES
from reference.compare import figures
from reference.regenerate import load_small, stored
from tracer import Box, PointLight, Scene, Sphere, render

pytestmark = pytest.mark.cross_validation

Floats = NDArray[np.float64]
Raster = tracer.view.camera.Raster
RASTER_OF = tracer.view.camera.raster_of


def mirrored(*arguments: object, **options: object) -> Raster:
    """Right is left."""
    raster = RASTER_OF(*arguments, **options)
    return raster._replace(axes=raster.axes * [[-1], [1], [1]], shift_u=-raster.shift_u)


def half_a_pixel_out(*arguments: object, **options: object) -> Raster:
    """Samples lie on the edges of the pixels."""
    raster = RASTER_OF(*arguments, **options)
    return raster._replace(shift_u=raster.shift_u + raster.step_u / 2)


def normal_ignored(camera: tracer.Camera, *arguments: object, **options: object) -> Raster:
    """The window is perpendicular to the view direction."""
    return RASTER_OF(replace(camera, proj_normal=None), *arguments, **options)


def use_camera(monkeypatch: pytest.MonkeyPatch, camera: Callable[..., Raster]) -> None:
    """Put another camera into the tracer: wherever it has this one."""
    homes = [
        module
        for name, module in sys.modules.items()
        if name.partition(".")[0] == "tracer" and vars(module).get("raster_of") is RASTER_OF
    ]
    assert len(homes) > 1
    for module in homes:
        monkeypatch.setattr(module, "raster_of", camera)


@pytest.mark.parametrize("compared", [check_scene, check_diffuse])
@pytest.mark.parametrize(
    ("camera", "name"),
    [
        *(
            (camera, name)
            for camera in (mirrored, half_a_pixel_out)
            for name in ("four-spheres", "sticks-shifted", "non-square-pixels")
        ),
        (normal_ignored, "sticks-shifted"),
    ],
)
def test_a_wrong_camera_is_caught(
    monkeypatch: pytest.MonkeyPatch,
    compared: Callable[[Scene, str], CheckResult],
    camera: Callable[..., Raster],
    name: str,
) -> None:
    scene = replace(load_small(SCENES / f"{name}.xml"), width=64, height=48)
    assert compared(scene, name).faults == ()
    use_camera(monkeypatch, camera)
    result = compared(scene, name)
    assert result.faults != ()
    assert result.agreed < result.asked


def wrong_gamma(scene: Scene) -> Floats:
    """Encoded with 1.8 and, like all pictures, shown with 2.2."""
    image: Floats = np.clip(render(scene), 0, 1) ** (2.2 / 1.8)
    return image


def falling_off(scene: Scene) -> Floats:
    """Lights as strong as they should be at the middle distance, but falling off."""
    points, _ = visible(scene)
    image = np.zeros((scene.height, scene.width, 3))
    for light in scene.lights:
        distance2 = ((points - light.position) ** 2).sum(axis=2)
        falloff = np.nanmedian(distance2) / distance2
        alone = render(replace(scene, lights=(light,)))
        image += np.where(np.isnan(falloff), 0, falloff)[:, :, None] * alone
    return image


def brighter(scene: Scene) -> Floats:
    """All of it by 2 %."""
    return render(scene) * 1.02


def boxes_out(scene: Scene) -> Floats:
    """Boxes one unit beside where they should be."""

    def moved(box: Box) -> Box:
        (x0, y0, z0), (x1, y1, z1) = box.min_pt, box.max_pt
        return replace(box, min_pt=(x0 + 1, y0, z0), max_pt=(x1 + 1, y1, z1))

    surfaces = [moved(s) if isinstance(s, Box) else s for s in scene.surfaces]
    return render(replace(scene, surfaces=surfaces))


# What is usually asked of SSIM between two renderers.  The last column: whether the mistake passes.
USUAL_SSIM = 0.98


@pytest.mark.parametrize(
    ("mutation", "name", "ssim_misses"),
    [
        (wrong_gamma, "non-square-pixels", True),
        (no_highlights, "non-square-pixels", True),
        (falling_off, "non-square-pixels", True),
        (brighter, "non-square-pixels", True),
        (no_shadows, "non-square-pixels", False),
        (boxes_out, "two-boxes", False),
    ],
)
def test_a_wrong_picture_is_caught(
    monkeypatch: pytest.MonkeyPatch,
    mutation: Callable[[Scene], Floats],
    name: str,
    ssim_misses: bool,
) -> None:
    scene = load_small(SCENES / f"{name}.xml")
    reference, right, wrong = stored(name), render(scene), mutation(scene)
    mask = edge_mask(scene, right)
    assert faults(figures(right, reference, mask), mask) == ()
    found = figures(wrong, reference, mask)
    assert found.max > 100 * MAX_DIFFERENCE
    assert faults(found, mask) != ()
    assert (found.ssim >= USUAL_SSIM) == ssim_misses
    assert mutation is not brighter or found.ssim >= MIN_SSIM
    monkeypatch.setattr("reference.check.render", lambda _scene, **_offset: wrong)
    assert check_scene(scene, name).faults != ()


BEGINNERS = """
absolute cosine, acne, ambient, background, corners, ends, exponent ignored, falls off,
first light only, half vector not normalised, light not normalised, mirrored, no clamp,
no highlights, no shading, no shadows, normals inwards, normals not normalised, one colour, Phong,
projDistance ignored, shadows behind the light, upside down, viewDir not normalised, white,
window ignored
"""


@pytest.mark.parametrize("mistake", BEGINNERS.strip().replace("\n", " ").split(", "))
def test_mistakes_of_beginners_are_caught(monkeypatch: pytest.MonkeyPatch, mistake: str) -> None:
    scene = replace(load_small(SCENES / "four-spheres.xml"), width=48, height=48)
    if mistake == "shadows behind the light":
        # Of two balls, one is beyond the light.
        balls = Sphere(center=(0, 0, -4)), Sphere(center=(0, 3, -4))
        lights = (PointLight(position=(0, 1.5, -4)),)
        scene = replace(scene, camera=tracer.Camera(), lights=lights, surfaces=balls)
    assert np.allclose(radiance(scene), render(scene), atol=1e-9)
    wrong = np.nan_to_num(radiance(scene, mistake))
    monkeypatch.setattr("reference.check.render", lambda _scene, **_offset: wrong)
    assert check_scene(scene, mistake).faults != ()
