"""Mistakes, of a tracer and of the converter, that the comparison with live Mitsuba catches.

Some are made in the tracer's camera itself, while scenes are converted as well: nothing that has
gone through that camera may enter what is rendered by Mitsuba.  The others change the scene, the
picture, or what Mitsuba is given.
"""

import importlib
import sys
from collections.abc import Callable
from dataclasses import replace

import drjit as dr
import numpy as np
import pytest
from probe import Surface

import tracer.geometry.camera
from converters import flavours
from converters.camera import Window, window_of
from converters.flavours import exact
from converters.rendering import Rendering
from converters.variant import SCALAR, use
from reference import check
from reference.check import check_diffuse, check_scene, compare
from reference.command import SCENES
from reference.handins.drawing import draw
from reference.regenerate import load_small, stored
from tracer import Phong, PointLight, Scene, Sphere, first_hits, render
from tracer.arrays import Floats

pytestmark = pytest.mark.cross_validation

CameraFrame = tracer.geometry.camera.CameraFrame
CAMERA_FRAME = tracer.geometry.camera.camera_frame


def mirrored(*arguments: object) -> CameraFrame:
    """Right is left."""
    frame = CAMERA_FRAME(*arguments)
    return frame._replace(axes=frame.axes * [[-1], [1], [1]], shift_u=-frame.shift_u)


def half_a_pixel_out(*arguments: object) -> CameraFrame:
    """Samples lie on the edges of the pixels."""
    frame = CAMERA_FRAME(*arguments)
    return frame._replace(shift_u=frame.shift_u + frame.step_u / 2)


def normal_ignored(camera: tracer.Camera, *arguments: object) -> CameraFrame:
    """The window is perpendicular to the view direction."""
    return CAMERA_FRAME(replace(camera, proj_normal=None), *arguments)


def use_camera(monkeypatch: pytest.MonkeyPatch, camera: Callable[..., CameraFrame]) -> None:
    """Put another camera into the tracer: wherever it has this one."""
    modules = [module for name, module in sys.modules.items() if name.startswith("tracer")]
    homes = [module for module in modules if vars(module).get("camera_frame") is CAMERA_FRAME]
    assert len(homes) > 1
    for module in homes:
        monkeypatch.setattr(module, "camera_frame", camera)


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
    assert compared(scene, name).verdict == "agrees"
    use_camera(monkeypatch, camera)
    assert compared(scene, name).verdict == "DIFFERS"


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
        (lambda scene: draw(scene, "specular-none", formula="image"), "non-square-pixels", True),
        (lambda scene: draw(scene, "shadow-none", formula="image"), "non-square-pixels", False),
        (boxes_out, "two-boxes", False),
    ],
    ids=["gamma", "brighter", "no highlights", "no shadows", "boxes out"],
)
def test_a_wrong_picture_is_caught(monkeypatch, mutation, name, ssim_misses):
    scene = load_small(SCENES / f"{name}.xml")
    assert compare(scene, name, Rendering(stored(name), "stored", 0.0)).verdict == "agrees"
    wrong = mutation(scene)
    monkeypatch.setattr(check, "render", lambda _scene, **_offset: wrong)
    result = check_scene(scene, name)
    assert result.verdict == "DIFFERS"
    assert (result.figures.ssim >= USUAL_SSIM) == ssim_misses


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
    assert np.allclose(draw(scene, formula="image"), render(scene), atol=1e-9)
    wrong = draw(scene, mistake, formula="image")
    monkeypatch.setattr(check, "render", lambda _scene, **_offset: wrong)
    assert check_scene(scene, mistake).verdict == "DIFFERS"


def moved_aside(window: Window) -> Window:
    """By a fifth of the picture."""
    return window._replace(center=window.center + np.array([0.2 * window.width, 0, 0]))


def reflected(window: Window) -> Window:
    """Right is left."""
    flip = np.array([-1, 1, 1])
    return window._replace(axes=window.axes * flip[:, None], center=window.center * flip)


def wider(window: Window) -> Window:
    """A field of view that is 1 % too large."""
    return window._replace(width=window.width * 1.01, height=window.height * 1.01)


def without_a_surface(scene: Scene) -> Scene:
    """Without the one that is in fewest pixels, of those which are in the light."""
    y, x = np.indices((scene.height, scene.width)).reshape(2, -1) + 0.5
    lit = render(scene).max(axis=2).ravel() > 0.05
    surface, count = np.unique(first_hits(scene, x, y).surface[lit], return_counts=True)
    surfaces = [*scene.surfaces]
    del surfaces[surface[count.argmin()]]
    return replace(scene, surfaces=surfaces)


def with_surfaces(change: Callable[[Surface], Surface]) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, surfaces=[change(surface) for surface in scene.surfaces])


def larger(surface: Surface) -> Surface:
    is_sphere = isinstance(surface, Sphere)
    return replace(surface, radius=surface.radius * 1.01) if is_sphere else surface


def shiny(strength: float, exponent: float) -> Callable[[Surface], Surface]:
    """A surface with another highlight, if it has one."""

    def change(surface: Surface) -> Surface:
        if not isinstance(old := surface.shader, Phong):
            return surface
        specular = tuple(strength * k for k in old.specular)
        return replace(
            surface, shader=replace(old, specular=specular, exponent=exponent * old.exponent)
        )

    return change


def lights_swapped(scene: Scene) -> Scene:
    intensities = [light.intensity for light in scene.lights]
    swapped = zip(scene.lights, intensities[1:] + intensities[:1], strict=True)
    return replace(scene, lights=[replace(light, intensity=i) for light, i in swapped])


WRONG_WINDOWS = {"moved": moved_aside, "mirrored": reflected, "field of view": wider}

WRONG_SCENES: dict[str, Callable[[Scene], Scene]] = {
    "no light": lambda scene: replace(scene, lights=scene.lights[1:]),
    "lights swapped": lights_swapped,
    "no surface": without_a_surface,
    "radius": with_surfaces(larger),
    "no highlight": with_surfaces(shiny(0, 1)),
    "exponent": with_surfaces(shiny(1, 1.01)),
}


def break_converter(monkeypatch: pytest.MonkeyPatch, mistake: str) -> None:
    if mistake in WRONG_WINDOWS:
        wrong = WRONG_WINDOWS[mistake]
        monkeypatch.setattr(flavours, "window_of", lambda camera: wrong(window_of(camera)))
    elif mistake in WRONG_SCENES:
        monkeypatch.setattr(check, "exact", lambda scene: exact(WRONG_SCENES[mistake](scene)))
    else:
        plugins = importlib.import_module("converters.plugins")
        right = plugins.BlinnPhong.eval

        def without_cosine(self, ctx, si, wo, active=True):  # type: ignore[no-untyped-def]
            more = self.diffuse * (1 - dr.abs(wo.z))
            return right(self, ctx, si, wo, active) + dr.select(si.wi.z * wo.z > 0, more, 0)

        monkeypatch.setattr(plugins.BlinnPhong, "eval", without_cosine)


@pytest.mark.parametrize("variant", [SCALAR, None])  # and the fastest that works here
@pytest.mark.parametrize(
    "name",
    [
        "sticks-perspective",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("four-spheres", "many-objects")),
    ],
)
@pytest.mark.parametrize("mistake", [*WRONG_WINDOWS, *WRONG_SCENES, "no cosine"])
def test_a_broken_converter_is_caught(monkeypatch, mistake, name, variant):
    scene = replace(load_small(SCENES / f"{name}.xml"), width=64, height=48)
    use(variant)
    break_converter(monkeypatch, mistake)
    result = check_scene(scene, name, variant)
    use()
    assert result.verdict == "undecided"
    assert "Mitsuba or the converter is wrong" in result.report()
