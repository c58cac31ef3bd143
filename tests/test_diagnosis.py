"""The diagnosis: it recognises how a picture is wrong, and says so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import permutations

import numpy as np
import pytest
from mistakes import no_highlights, no_shadows
from numpy.typing import NDArray
from scene_files import codes

import tracer
from reference.command import SCENES
from reference.diagnosis import diagnose
from tracer.arrays import Floats

Image8 = NDArray[np.uint8]


def scene(name: str) -> tracer.Scene:
    return tracer.load_scene(SCENES / f"{name}.xml")


@cache
def light_of(name: str) -> Floats:
    return tracer.render(scene(name))


@cache
def right_codes(name: str) -> Image8:
    return codes(light_of(name))


@pytest.fixture
def light() -> Floats:
    return light_of("four-spheres")


@pytest.fixture
def right() -> Image8:
    return right_codes("four-spheres")


def srgb(light: Floats) -> Floats:
    """Light from 0 to 1, encoded (IEC 61966-2-1)."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def both_ways(a: Image8, b: Image8) -> tuple[str, str]:
    """The kinds of difference that A has from B, and B from A."""
    return diagnose(a, b).kind, diagnose(b, a).kind


WHOLE: dict[str, Callable[[Image8], Image8]] = {
    "identical": lambda right: right,
    "mirrored": lambda right: right[:, ::-1],
    "flipped": lambda right: right[::-1],
    "turned": lambda right: right[::-1, ::-1],
    "transposed": lambda right: right.transpose(1, 0, 2),
    "inverted": lambda right: 255 - right,
    "flat": lambda right: np.full_like(right, 255),
    "background": lambda right: np.where(right.any(axis=2, keepdims=True), right, np.uint8(70)),
}


@pytest.mark.parametrize("kind", WHOLE)
def test_all_pixels_changed_alike(right: Image8, kind: str) -> None:
    assert diagnose(WHOLE[kind](right), right).kind == kind


def test_cut_off(light: Floats, right: Image8) -> None:
    cut = (255 * np.clip(light, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    diagnosis = diagnose(cut, right)
    assert diagnosis.kind == "cut off"
    assert "A is cut off where it should be rounded" in diagnosis.text
    assert "B is cut off" in diagnose(right, cut).text


def test_factor_of_256(light: Floats, right: Image8) -> None:
    other = np.minimum(np.round(256 * np.clip(light, 0, 1) ** (1 / 2.2)), 255).astype(np.uint8)
    assert "A's factor is more than 255" in diagnose(other, right).text


def test_a_handful_of_levels(right: Image8) -> None:
    other = right.copy()
    other[150, 150] += 1
    assert diagnose(other, right).text == (
        "One pixel differs by one level: rounding, nothing to worry about."
    )


@pytest.mark.parametrize(
    ("curve", "words"),
    [
        (lambda x: x, "lacks gamma"),
        (srgb, "sRGB curve"),
        (lambda x: x ** (1 / 1.8), "gamma of about 1.80"),
        (lambda x: x ** (1 / 4.84), "gamma of about 4.84"),
    ],
    ids=["none", "srgb", "1.8", "twice"],
)
def test_gamma(light: Floats, right: Image8, curve: Callable[[Floats], Floats], words: str) -> None:
    wrong = np.round(255 * curve(np.clip(light, 0, 1))).astype(np.uint8)
    diagnosis = diagnose(wrong, right)
    assert diagnosis.kind == "gamma"
    assert words in diagnosis.text


# Where B is 255, as on highlights, its light may be any that is brighter.
@pytest.mark.parametrize(
    ("name", "factor", "words"),
    [
        ("four-spheres", 1.02, "brighter by a factor of 1.02"),
        ("four-spheres", 0.5, "darker by a factor of 0.5"),
        *(("highlights", factor, f"darker by a factor of {factor} in") for factor in (0.95, 0.318)),
    ],
)
def test_brightness(name: str, factor: float, words: str) -> None:
    diagnosis = diagnose(codes(factor * light_of(name)), right_codes(name))
    assert diagnosis.kind == "brightness"
    assert words in diagnosis.text


@pytest.mark.parametrize("name", ["highlights", "sunflower"])
def test_not_clipped(name: str) -> None:
    levels = np.round(255 * light_of(name) ** (1 / 2.2)).astype(int)
    assert levels.max() > 255
    diagnosis = diagnose((levels % 256).astype(np.uint8), right_codes(name))
    assert "light beyond 1 is to be clipped" in diagnosis.text


# Samples that lie to the right move the picture to the left.
@pytest.mark.parametrize("name", ["four-spheres", "one-box", "sticks-perspective", "room"])
@pytest.mark.parametrize(
    ("offset", "words"),
    [
        ((-0.5, 0.0), "half a pixel to the right:"),
        ((0.0, 0.5), "half a pixel up:"),
        ((0.5, 0.5), "half a pixel to the left and half a pixel up:"),
        ((1.0, 0.0), "one pixel to the left."),
        ((0.0, -2.0), "two pixels down."),
        ((-1.0, 0.5), "one pixel to the right and half a pixel up:"),
    ],
)
def test_shifted(name: str, offset: tuple[float, float], words: str) -> None:
    diagnosis = diagnose(codes(tracer.render(scene(name), offset=offset)), right_codes(name))
    assert diagnosis.kind == "shifted"
    assert words in diagnosis.text


def zoomed(scene: tracer.Scene, across: float, down: float) -> Image8:
    """A scene's picture through a window so many times as wide and as high."""
    camera = scene.camera
    width, height = across * camera.view_width, down * camera.view_height
    window = replace(camera, view_width=width, view_height=height)
    return codes(tracer.render(replace(scene, camera=window)))


def test_stretched(right: Image8) -> None:
    """Columns and rows divided by width - 1 and height - 1, the commonest half-pixel error."""
    full = scene("four-spheres")
    factor = full.width / (full.width - 1)
    diagnosis = diagnose(zoomed(full, factor, factor), right)
    assert diagnosis.kind == "stretched"
    assert "a pixel smaller" in diagnosis.text


@pytest.mark.parametrize("order", list(permutations(range(3)))[1:])
def test_exchanged_channels(right: Image8, order: tuple[int, ...]) -> None:
    names = ", ".join(("red", "green", "blue")[channel] for channel in order)
    text = f"A's channels are in another order: {names}."
    assert diagnose(right[:, :, order], right).text == text


def test_black(right: Image8) -> None:
    assert diagnose(0 * right, right).text == "A is black."
    assert diagnose(right, 0 * right).text == "B is black, and A is not."


@pytest.mark.parametrize("name", ["four-spheres", "two-boxes", "touching", "sticks-perspective"])
def test_missing_shadows(name: str) -> None:
    wrong = codes(no_shadows(scene(name)))
    assert both_ways(wrong, right_codes(name)) == ("missing shadows", "extra shadows")


@pytest.mark.parametrize("name", ["four-spheres", "highlights", "sticks-shifted", "sunflower"])
def test_missing_highlights(name: str) -> None:
    wrong = codes(no_highlights(scene(name)))
    assert both_ways(wrong, right_codes(name)) == ("missing highlight", "highlights")


@pytest.mark.parametrize("name", ["highlights", "sunflower", "four-spheres"])
def test_missing_light(name: str) -> None:
    full = scene(name)
    wrong = codes(tracer.render(replace(full, lights=full.lights[1:])))
    assert "or it lacks a light" in diagnose(wrong, right_codes(name)).text
    assert "or it has a light" in diagnose(right_codes(name), wrong).text


def test_lights_that_fall_off(light: Floats, right: Image8) -> None:
    """As one over the squared distance from the top of the picture."""
    distance = 1 + np.arange(light.shape[0])[:, None, None] / light.shape[0]
    diagnosis = diagnose(codes(light / distance**2), right)
    assert diagnosis.kind == "brightness"
    assert "fall off" in diagnosis.text


def test_ambient(light: Floats, right: Image8) -> None:
    ambient = np.where(light.any(axis=2, keepdims=True), light + 0.05, 0)
    assert "ambient" in diagnose(codes(ambient), right).text


@pytest.mark.parametrize("name", ["four-spheres", "room", "touching"])
def test_ambient_in_black_shadows(name: str) -> None:
    full = scene(name)
    from_the_eye = (tracer.PointLight(position=full.camera.view_point),)
    seen = tracer.render(replace(full, lights=from_the_eye)).any(axis=2, keepdims=True)
    assert "ambient" in diagnose(codes(light_of(name) + 0.05 * seen), right_codes(name)).text


@pytest.mark.parametrize("name", ["one-sphere", "four-spheres", "room"])
def test_a_missing_ambient_term(name: str) -> None:
    wrong = diagnose(right_codes(name), codes(light_of(name) + 0.05))
    assert "ambient term that A lacks" in wrong.text


@pytest.mark.parametrize(
    ("part", "word"), [(0.95, "Objects are larger"), (1.05, "Objects are smaller")]
)
def test_a_matt_ball_of_another_size_has_no_highlights(part: float, word: str) -> None:
    full = scene("one-sphere")
    eye = tuple(part * x for x in full.camera.view_point)
    near = codes(tracer.render(replace(full, camera=replace(full.camera, view_point=eye))))
    for wrong in (near, zoomed(full, part, part)):
        assert diagnose(wrong, right_codes("one-sphere")).text.startswith(word)


def test_a_box_of_another_size_may_lack_shadows() -> None:
    found = diagnose(zoomed(scene("one-box"), 0.95, 1), right_codes("one-box"))
    assert "Or objects are larger in A" in found.text


def test_grey(right: Image8) -> None:
    grey = np.repeat(right.mean(axis=2, keepdims=True).astype(np.uint8), 3, axis=2)
    assert diagnose(grey, right).kind == "grey"
    assert diagnose(right, grey).kind != "grey"


def test_a_grey_picture_that_lacks_a_colour_for_another_reason() -> None:
    white = tracer.Scene(
        width=60,
        height=40,
        lights=[tracer.PointLight(position=(0, 5, 9))],
        surfaces=[tracer.Sphere(center=(-0.5, 0, -3), radius=0.5)],
    )
    red = tracer.Lambertian(diffuse=(1, 0.2, 0.2))
    both = [*white.surfaces, tracer.Sphere(center=(0.8, 0, -3), radius=0.5, shader=red)]
    right = codes(tracer.render(replace(white, surfaces=both)))
    found = diagnose(codes(tracer.render(white)), right)
    assert found.kind != "grey"
    assert "lacks" in found.text


def test_antialiased(right: Image8) -> None:
    smooth = tracer.render(scene("four-spheres"), samples=16)
    assert diagnose(codes(smooth), right).kind == "edges"


@pytest.mark.parametrize("name", ["one-box", "four-spheres", "highlights"])
def test_a_few_pixels_at_edges(name: str) -> None:
    """Samples a thousandth of a pixel away: up to three pixels differ, all in one direction."""
    moved = codes(tracer.render(scene(name), offset=(1e-3, 1e-3)))
    assert both_ways(moved, right_codes(name)) == ("edges", "edges")


def test_a_few_pixels_elsewhere(right: Image8) -> None:
    other = right.copy()
    other[280, 150:153] //= 2
    assert diagnose(other, right).text == "3 pixels differ: too few to tell why."


def test_noise(right: Image8) -> None:
    """Both brighter and darker, and with edges of its own."""
    noise = np.random.default_rng(1).integers(-20, 21, right.shape)
    assert diagnose(np.clip(right + noise, 0, 255).astype(np.uint8), right).kind == "other"


@pytest.mark.parametrize("shape", [(2000, 1, 3), (1, 2000, 3), (2, 2, 3)])
def test_a_shift_leaves_most_of_the_picture(shape: tuple[int, ...]) -> None:
    """One by the whole width would explain any picture."""
    a, b = np.random.default_rng(1).integers(0, 256, (2, *shape), dtype=np.uint8)
    assert diagnose(a, b).kind != "shifted"


def test_two_faults(light: Floats, right: Image8) -> None:
    """Mirrored and without gamma: nearly all is darker, but not in every channel."""
    wrong = np.round(255 * np.clip(light, 0, 1)).astype(np.uint8)[:, ::-1]
    assert both_ways(wrong, right) == ("other", "other")


def test_another_scene(right: Image8) -> None:
    assert diagnose(right_codes("two-boxes"), right).kind == "other"


def test_sizes(right: Image8) -> None:
    assert diagnose(right[::2, ::2], right).text == (
        "Different sizes: A has 150x150 pixels, B 300x300; of the same shape, A 0.5 times as large."
    )
    assert "swapped" in diagnose(right[:200], right[:, :200]).text


@pytest.mark.parametrize("shape", [(5, 9, 3), (1, 1, 3)])
@pytest.mark.parametrize("level", [0, 255])
def test_flat_pictures(level: int, shape: tuple[int, ...]) -> None:
    """No gradient and no middle level: nothing to estimate, and no warning."""
    flat = np.full(shape, level, dtype=np.uint8)
    assert diagnose(flat, flat).kind == "identical"
    spot = flat.copy()
    spot[shape[0] // 2, shape[1] // 3] = 100
    assert diagnose(spot, flat).kind not in ("identical", "rounding", "cut off")
