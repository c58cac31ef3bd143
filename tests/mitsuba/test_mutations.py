"""Mistakes of a tracer that the comparison with live Mitsuba catches; SSIM alone does not.

Some are made in the tracer's camera itself, while scenes are converted as well: nothing that has
gone through that camera may enter what is rendered by Mitsuba.  The others change the scene or the
picture.
"""

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import tracer.view.camera

from reference.check import MAX_DIFFERENCE, check_diffuse, check_scene, edge_mask, faults
from reference.command import SCENES
from reference.figures import figures
from reference.handins.drawing import radiance
from reference.regenerate import load_small, stored
from tracer import PointLight, Scene, Sphere, render
from tracer.arrays import Floats

pytestmark = pytest.mark.cross_validation

Raster = tracer.view.camera.Raster
RASTER_OF = tracer.view.camera.raster_of


def mirrored(*arguments: object) -> Raster:
    """Right is left."""
    raster = RASTER_OF(*arguments)
    return raster._replace(axes=raster.axes * [[-1], [1], [1]], shift_u=-raster.shift_u)


def half_a_pixel_out(*arguments: object) -> Raster:
    """Samples lie on the edges of the pixels."""
    raster = RASTER_OF(*arguments)
    return raster._replace(shift_u=raster.shift_u + raster.step_u / 2)


def normal_ignored(camera: tracer.Camera, *arguments: object) -> Raster:
    """The window is perpendicular to the view direction."""
    return RASTER_OF(replace(camera, proj_normal=None), *arguments)


def use_camera(monkeypatch: pytest.MonkeyPatch, camera: Callable[..., Raster]) -> None:
    """Put another camera into the tracer: wherever it has this one."""
    modules = [module for name, module in sys.modules.items() if name.startswith("tracer")]
    homes = [module for module in modules if vars(module).get("raster_of") is RASTER_OF]
    assert len(homes) > 1
    for module in homes:
        monkeypatch.setattr(module, "raster_of", camera)


@pytest.mark.parametrize("compared", [check_scene, check_diffuse])
@pytest.mark.parametrize(
    ("camera", "name"),
    [
        *((mirrored, name) for name in ("four-spheres", "non-square-pixels")),
        *((half_a_pixel_out, name) for name in ("four-spheres", "non-square-pixels")),
        *(
            pytest.param(camera, "sticks-shifted", marks=pytest.mark.slow)
            for camera in (mirrored, half_a_pixel_out)
        ),
        (normal_ignored, "sticks-shifted"),
    ],
)
def test_a_wrong_camera_is_caught(monkeypatch, compared, camera, name):
    scene = replace(load_small(SCENES / f"{name}.xml"), width=64, height=48)
    assert compared(scene, name).faults == ()
    use_camera(monkeypatch, camera)
    result = compared(scene, name)
    assert result.faults != ()
    assert result.agreed < result.asked


def boxes_out(scene: Scene) -> Floats:
    """Boxes, and there is nothing else, one unit beside where they should be."""
    aside = np.array([1, 0, 0])
    boxes = [replace(b, min_pt=b.min_pt + aside, max_pt=b.max_pt + aside) for b in scene.surfaces]
    return render(replace(scene, surfaces=boxes))


# What is usually asked of SSIM between two renderers.  The last column: whether the mistake passes.
USUAL_SSIM = 0.98


@pytest.mark.parametrize(
    ("mutation", "name", "ssim_misses"),
    [
        # Encoded with 1.8 and, like all pictures, shown with 2.2.
        (lambda scene: np.clip(render(scene), 0, 1) ** (2.2 / 1.8), "non-square-pixels", True),
        (lambda scene: render(scene) * 1.02, "non-square-pixels", True),
        (lambda scene: radiance(scene, "specular-none"), "non-square-pixels", True),
        (lambda scene: radiance(scene, "shadow-none"), "non-square-pixels", False),
        (boxes_out, "two-boxes", False),
    ],
    ids=["gamma", "brighter", "no highlights", "no shadows", "boxes out"],
)
def test_a_wrong_picture_is_caught(monkeypatch, mutation, name, ssim_misses):
    scene = load_small(SCENES / f"{name}.xml")
    reference, right, wrong = stored(name), render(scene), mutation(scene)
    mask = edge_mask(scene, right)
    assert faults(figures(right, reference, mask), mask) == ()
    found = figures(wrong, reference, mask)
    assert found.max > 100 * MAX_DIFFERENCE
    assert faults(found, mask) != ()
    assert (found.ssim >= USUAL_SSIM) == ssim_misses
    monkeypatch.setattr("reference.check.render", lambda _scene, **_offset: wrong)
    assert check_scene(scene, name).faults != ()


# Mistakes as `reference/handins/mistakes.md` draws them.
BEGINNERS = """
ambient-.1 diffuse-ignored exponent-2 falloff-2 h-length l-length light-first mirrored
nl-absolute-diffuse nl-unclipped normal-inwards normal-length-sphere pixel-upper-left flipped
projDistance-ignored reflection shadow-from-behind shadow-none silhouettes size-minus-1
specular-none unshaded viewDir-length window-ignored
"""


@pytest.mark.parametrize("mistake", BEGINNERS.split())
def test_mistakes_of_beginners_are_caught(monkeypatch, mistake):
    scene = replace(load_small(SCENES / "four-spheres.xml"), width=48, height=48)
    if mistake == "shadow-from-behind":
        # Of two balls, one is beyond the light.
        balls = Sphere(center=(0, 0, -4)), Sphere(center=(0, 3, -4))
        lights = (PointLight(position=(0, 1.5, -4)),)
        scene = replace(scene, camera=tracer.Camera(), lights=lights, surfaces=balls)
    assert np.allclose(radiance(scene), render(scene), atol=1e-9)
    wrong = radiance(scene, mistake)
    monkeypatch.setattr("reference.check.render", lambda _scene, **_offset: wrong)
    assert check_scene(scene, mistake).faults != ()
