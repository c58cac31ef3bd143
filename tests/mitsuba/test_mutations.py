"""Mistakes of a tracer and of the converter that the comparison with Mitsuba must detect.

Some mistakes are put into the tracer's camera, and scenes are converted with that wrong camera.
They are detected only if the converter does not depend on it.  Other mistakes change the scene, the
picture, or the converted scene.
"""

import importlib
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated as Shaped

import drjit as dr
import numpy as np
import pytest
from known_mistakes import render_with_mistakes
from probe import Surface

import tracer.geometry.camera
from converters import flavours
from converters.camera import Window, compute_window
from converters.flavours import convert_to_exact
from converters.rendering import Rendering
from converters.variant import SCALAR, use_variant
from reference import check
from reference.check import check_diffuse_light, check_scene, compare
from reference.command import SCENES
from reference.regenerate import load_small_scene, read_stored_picture
from tracer import Phong, Scene, Sphere, first_hits, render
from tracer.arrays import Floats

pytestmark = pytest.mark.cross_validation

CameraFrame = tracer.geometry.camera.CameraFrame
CAMERA_FRAME = tracer.geometry.camera.compute_frame


def mirrored(*arguments: object) -> CameraFrame:
    """Return a camera that exchanges left and right."""
    frame = CAMERA_FRAME(*arguments)
    return frame._replace(axes=frame.axes * [[-1], [1], [1]], center_right=-frame.center_right)


def half_a_pixel_out(*arguments: object) -> CameraFrame:
    """Return a camera whose samples lie on the pixels' edges."""
    frame = CAMERA_FRAME(*arguments)
    return frame._replace(center_right=frame.center_right + frame.pixel_width / 2)


def normal_ignored(camera: tracer.Camera, *arguments: object) -> CameraFrame:
    """Return a camera whose window is perpendicular to the view direction."""
    return CAMERA_FRAME(replace(camera, proj_normal=None), *arguments)


def use_camera(monkeypatch: pytest.MonkeyPatch, camera: Callable[..., CameraFrame]) -> None:
    """Replace the tracer's function `compute_frame` in all modules that import it."""
    modules = [module for name, module in sys.modules.items() if name.startswith("tracer")]
    homes = [module for module in modules if vars(module).get("compute_frame") is CAMERA_FRAME]
    assert len(homes) > 1
    for module in homes:
        monkeypatch.setattr(module, "compute_frame", camera)


@pytest.mark.parametrize("check_flavour", [check_scene, check_diffuse_light])
@pytest.mark.parametrize(
    ("camera", "name"),
    [
        *((mirrored, name) for name in ("four-spheres", "non-square-pixels")),
        *((half_a_pixel_out, name) for name in ("four-spheres", "non-square-pixels")),
        (normal_ignored, "sticks-shifted"),
    ],
)
def test_a_wrong_camera_is_detected(monkeypatch, check_flavour, camera, name):
    scene = replace(load_small_scene(SCENES / f"{name}.xml"), width=64, height=48)
    assert check_flavour(scene, name).verdict == "agrees"
    use_camera(monkeypatch, camera)
    assert check_flavour(scene, name).verdict == "DIFFERS"


def boxes_shifted(scene: Scene) -> Shaped[Floats, "height width 3"]:
    """Render a scene of boxes with all boxes one unit to the right."""
    offset = np.array([1, 0, 0])
    boxes = [replace(b, min_pt=b.min_pt + offset, max_pt=b.max_pt + offset) for b in scene.surfaces]
    return render(replace(scene, surfaces=boxes))


# Minimum SSIM that is usually required between two renderers.  In the table below, the last column
# states whether the mistake would go undetected by it.
USUAL_SSIM = 0.98


@pytest.mark.parametrize(
    ("mutation", "name", "ssim_misses"),
    [
        # Encoded with a gamma of 1.8 and, like all pictures, displayed with 2.2.
        (lambda scene: np.clip(render(scene), 0, 1) ** (2.2 / 1.8), "non-square-pixels", True),
        (lambda scene: render(scene) * 1.02, "non-square-pixels", True),
        (boxes_shifted, "two-boxes", False),
    ],
    ids=["gamma", "brighter", "boxes shifted"],
)
def test_a_wrong_picture_is_detected(monkeypatch, mutation, name, ssim_misses):
    scene = load_small_scene(SCENES / f"{name}.xml")
    stored = Rendering(read_stored_picture(name), "stored", 0.0)
    assert compare(scene, name, stored).verdict == "agrees"
    wrong = mutation(scene)
    monkeypatch.setattr(check, "render", lambda _scene, **_offset: wrong)
    result = check_scene(scene, name)
    assert result.verdict == "DIFFERS"
    assert (result.metrics.ssim >= USUAL_SSIM) == ssim_misses


# Mistakes that `reference/handins/mistakes.md` describes.
MISTAKES = """
ambient-.1 diffuse-ignored exponent-1 falloff-2 h-length l-length light-first mirrored
nl-absolute-diffuse nl-unclipped normal-inwards normal-length-sphere pixel-upper-left flipped
projDistance-ignored reflection shadow-none silhouettes size-minus-1
specular-none unshaded viewDir-length window-ignored
"""


@pytest.mark.parametrize("mistake", MISTAKES.split())
def test_mistakes_of_beginners_are_detected(monkeypatch, mistake):
    scene = replace(load_small_scene(SCENES / "four-spheres.xml"), width=48, height=48)
    assert np.allclose(render_with_mistakes(scene, formula="image"), render(scene), atol=1e-9)
    wrong = render_with_mistakes(scene, mistake, formula="image")
    monkeypatch.setattr(check, "render", lambda _scene, **_offset: wrong)
    assert check_scene(scene, mistake).verdict == "DIFFERS"


def without_a_surface(scene: Scene) -> Scene:
    """Return the scene without the lit surface that is visible in the fewest pixels."""
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    is_lit = render(scene).max(axis=2).ravel() > 0.05
    surface, count = np.unique(first_hits(scene, x, y).surface[is_lit], return_counts=True)
    surfaces = [*scene.surfaces]
    del surfaces[surface[count.argmin()]]
    return replace(scene, surfaces=surfaces)


def with_surfaces(change: Callable[[Surface], Surface]) -> Callable[[Scene], Scene]:
    """Return a function that changes each surface of a scene."""
    return lambda scene: replace(scene, surfaces=[change(surface) for surface in scene.surfaces])


def shiny(strength: float, exponent: float) -> Callable[[Surface], Surface]:
    """Return a function that multiplies the strength and the exponent of a surface's highlight."""

    def change(surface: Surface) -> Surface:
        if not isinstance(old := surface.shader, Phong):
            return surface
        specular = tuple(strength * k for k in old.specular)
        return replace(
            surface, shader=replace(old, specular=specular, exponent=exponent * old.exponent)
        )

    return change


def lights_swapped(scene: Scene) -> Scene:
    """Return the scene with the intensity of each light replaced by that of the next."""
    intensities = [light.intensity for light in scene.lights]
    swapped = zip(scene.lights, intensities[1:] + intensities[:1], strict=True)
    return replace(scene, lights=[replace(light, intensity=i) for light, i in swapped])


FLIP = np.array([-1, 1, 1])

WRONG_WINDOWS: dict[str, Callable[[Window], Window]] = {
    "shifted": lambda w: w._replace(offset=w.offset + np.array([0.2 * w.width, 0, 0])),
    "mirrored": lambda w: w._replace(axes=w.axes * FLIP[:, None], offset=w.offset * FLIP),
    "field of view": lambda w: w._replace(width=w.width * 1.01, height=w.height * 1.01),
}

WRONG_SCENES: dict[str, Callable[[Scene], Scene]] = {
    "no light": lambda scene: replace(scene, lights=scene.lights[1:]),
    "lights swapped": lights_swapped,
    "no surface": without_a_surface,
    "radius": with_surfaces(
        lambda s: replace(s, radius=s.radius * 1.01) if isinstance(s, Sphere) else s
    ),
    "no highlight": with_surfaces(shiny(0, 1)),
    "exponent": with_surfaces(shiny(1, 1.01)),
}


def break_converter(monkeypatch: pytest.MonkeyPatch, mistake: str) -> None:
    """Put a mistake into the converter, or into the BSDF of the exact flavour."""
    if mistake in WRONG_WINDOWS:
        wrong = WRONG_WINDOWS[mistake]
        monkeypatch.setattr(
            flavours, "compute_window", lambda camera: wrong(compute_window(camera))
        )
    elif mistake in WRONG_SCENES:
        monkeypatch.setattr(
            check, "convert_to_exact", lambda scene: convert_to_exact(WRONG_SCENES[mistake](scene))
        )
    else:
        plugins = importlib.import_module("converters.plugins")
        right = plugins.BlinnPhong.eval

        def without_cosine(self, ctx, si, wo, active=True):  # type: ignore[no-untyped-def]
            more = self.diffuse * (1 - dr.abs(wo.z))
            return right(self, ctx, si, wo, active) + dr.select(si.wi.z * wo.z > 0, more, 0)

        monkeypatch.setattr(plugins.BlinnPhong, "eval", without_cosine)


@pytest.mark.parametrize("variant", [SCALAR, None])  # and the fastest that works here
@pytest.mark.parametrize("mistake", [*WRONG_WINDOWS, *WRONG_SCENES, "no cosine"])
def test_a_broken_converter_is_detected(monkeypatch, mistake, variant):
    scene = replace(load_small_scene(SCENES / "sticks-perspective.xml"), width=64, height=48)
    use_variant(variant)
    break_converter(monkeypatch, mistake)
    result = check_scene(scene, mistake, variant)
    use_variant()
    assert result.verdict == "undecided"
    assert "Mitsuba or the converter is wrong" in result.format_report()
