"""Mistakes, of a tracer and of the converter, that the comparison with live Mitsuba catches.

Some are made in the tracer's camera itself, while scenes are converted as well: nothing that has
gone through that camera may enter what is rendered by Mitsuba.  The others change the scene, the
picture, or what Mitsuba is given.
"""

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from probe import Surface

import tracer.geometry.camera
from converters import flavours
from converters.camera import Window, window_of
from converters.flavours import exact
from reference import check
from reference.check import check_diffuse, check_scene
from reference.command import SCENES
from reference.handins.drawing import radiance
from reference.regenerate import load_small
from tracer import Phong, PointLight, Scene, Sphere, render

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
    monkeypatch.setattr(check, "render", lambda _scene, **_offset: wrong)
    assert check_scene(scene, mistake).verdict == "DIFFERS"


def moved_aside(window: Window) -> Window:
    """By a fifth of the picture."""
    return window._replace(center=window.center + np.array([0.2 * window.width, 0, 0]))


def larger(surface: Surface) -> Surface:
    """A ball that is 1 % too large, or a box as it was."""
    is_sphere = isinstance(surface, Sphere)
    return replace(surface, radius=surface.radius * 1.01) if is_sphere else surface


def sharper(surface: Surface) -> Surface:
    """With an exponent that is 1 % too large, if there is a highlight."""
    if not isinstance(shader := surface.shader, Phong):
        return surface
    return replace(surface, shader=replace(shader, exponent=1.01 * shader.exponent))


WRONG_SCENES: dict[str, Callable[[Scene], Scene]] = {
    "no light": lambda scene: replace(scene, lights=scene.lights[1:]),
    "radius": lambda scene: replace(scene, surfaces=[*map(larger, scene.surfaces)]),
    "exponent": lambda scene: replace(scene, surfaces=[*map(sharper, scene.surfaces)]),
}


@pytest.mark.parametrize("mistake", ["camera", *WRONG_SCENES])
def test_a_broken_converter_is_caught(monkeypatch, mistake):
    scene = replace(load_small(SCENES / "sticks-perspective.xml"), width=64, height=48)
    if mistake == "camera":
        monkeypatch.setattr(flavours, "window_of", lambda camera: moved_aside(window_of(camera)))
    else:
        monkeypatch.setattr(check, "exact", lambda scene: exact(WRONG_SCENES[mistake](scene)))
    result = check_scene(scene, mistake)
    assert result.verdict == "undecided"
    assert "Mitsuba or the converter is wrong" in result.report()
