"""The diagnosis: it recognises how a picture is wrong, and says so."""

from __future__ import annotations

import io
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from mistakes import Image8, picture
from PIL import Image

from reference.command import SCENES
from reference.diagnosis import diagnose
from tracer import Scene, load_scene, render, to_codes


@cache
def scene(name: str) -> Scene:
    full = load_scene(SCENES / f"{name}.xml")
    return replace(full, width=200, height=200) if full.width == full.height else full


@cache
def right(name: str) -> Image8:
    return to_codes(render(scene(name)))


STICKS = ("viewHeight ignored", "window's sides exchanged")
# Kinds that mistakes of beginners are told as, on two scenes or more, and these mistakes.
KINDS: dict[str, tuple[str, ...]] = {
    "mirrored": ("mirrored",),
    "flipped": ("upside down",),
    "transposed|size": ("transposed",),
    "shifted": ("corners",),
    "stretched": ("ends",),
    "zoomed": (*STICKS, "window ignored", "viewDir not normalised"),
    "rolled": ("viewUp ignored",),
    "channels": ("BGR",),
    "gamma": ("no gamma", "gamma 1.8", "gamma twice", "gamma upside down", "sRGB"),
    "cut off": ("cut off",),
    "unclipped": ("wraps",),
    "whole numbers|black": ("whole numbers",),
    "brightness": ("darker", "scaled"),
    "background": ("background",),
    "unshaded|flat": ("one colour", "no shading"),
    "colours": ("white",),
    "ambient": ("ambient",),
    "falls off|uneven": ("falls off",),
    "missing shadows": ("no shadows",),
    "extra shadows": ("shadows behind the light",),
    "speckled": ("acne",),
    "normals": ("normals inwards",),
    "overexposed": ("light not normalised",),
    "highlights|overexposed": ("half vector not normalised", "exponent ignored"),
    "missing highlight": ("no highlights", "Phong"),
    "facing": ("absolute cosine", "no clamp"),
    "missing light": ("first light only",),
    "nearest": ("last surface wins",),
}
MISTAKES = {mistake: kind for kind, mistakes in KINDS.items() for mistake in mistakes}
# What a scene does not show of a mistake, or too little of to tell: the sentence then says where.
UNSEEN = {
    "four-spheres": {"window's sides exchanged", "viewHeight ignored", "viewUp ignored"}
    | {"shadows behind the light", "last surface wins"},
    "room": {"transposed", "background", "wraps", "viewUp ignored", "last surface wins"},
}
PAIRS = [
    *(
        pytest.param(name, mistake, marks=() if name == "four-spheres" else pytest.mark.slow)
        for name, unseen in UNSEEN.items()
        for mistake in MISTAKES
        if mistake not in unseen
    ),
    *(pytest.param("sticks-perspective", one, marks=pytest.mark.slow) for one in STICKS),
]


@pytest.mark.parametrize(("name", "mistake"), PAIRS)
def test_a_mistake_is_told_as_what_it_is(name: str, mistake: str) -> None:
    found = diagnose(picture(scene(name), mistake), right(name))
    assert found.kind in MISTAKES[mistake].split("|"), found.text


@pytest.mark.parametrize(
    ("mistakes", "words"),
    [
        ("corners", "half a pixel to the right and half a pixel down: samples belong at"),
        ("ends", "A is a pixel smaller"),
        ("gamma 1.8", "a gamma of about 1.80 in place"),
        ("darker", "darker by a factor of 0.5 in"),
        ("BGR", "in another order: blue, green, red."),
        ("one colour", "silhouettes in one colour: nothing is shaded"),
        ("background", "it has the levels 90, 123, 186."),
        ("window ignored", "as wide and 4.8 times as high as B, about its centre"),
    ],
)
def test_words(mistakes: str, words: str) -> None:
    assert words in diagnose(picture(scene("four-spheres"), mistakes), right("four-spheres")).text


@pytest.mark.parametrize(
    ("name", "mistakes", "kinds"),
    [
        ("four-spheres", ("gamma 1.8", "corners"), "shifted + gamma"),
        ("four-spheres", ("no gamma", "upside down"), "flipped + gamma"),
        ("four-spheres", ("no gamma", "no shadows"), "gamma + missing shadows"),
        ("four-spheres", ("mirrored", "no shadows"), "mirrored + missing shadows"),
        ("four-spheres", ("upside down", "no highlights"), "flipped + missing highlight"),
        ("four-spheres", ("BGR", "corners"), "channels + shifted"),
        ("four-spheres", ("background", "no shadows"), "background + missing shadows"),
        ("room", ("viewHeight ignored", "no gamma"), "zoomed + gamma"),
        ("room", ("ends", "no gamma"), "stretched + gamma"),
    ],
)
def test_two_faults_are_told_one_after_the_other(
    name: str, mistakes: tuple[str, str], kinds: str
) -> None:
    assert diagnose(picture(scene(name), *mistakes), right(name)).kind == kinds


def jpeg(codes: Image8) -> Image8:
    data = io.BytesIO()
    Image.fromarray(codes).save(data, "JPEG", quality=80)
    return np.asarray(Image.open(data))


@pytest.mark.parametrize(
    "name", ["four-spheres", pytest.param("sticks-perspective", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(
    "mistake", ["mirrored", "upside down", "corners", "gamma 1.8", "no shadows", "darker"]
)
def test_a_jpeg_hides_none_of_them(name: str, mistake: str) -> None:
    found = diagnose(jpeg(picture(scene(name), mistake)), right(name), lossy=True)
    assert found.kind == MISTAKES[mistake], found.text


@pytest.mark.parametrize("name", ["four-spheres", "room", "sticks-perspective"])
def test_a_jpeg_of_the_right_picture_is_only_noisy(name: str) -> None:
    assert diagnose(jpeg(right(name)), right(name), lossy=True).kind == "noise"


def test_a_few_levels() -> None:
    b = right("four-spheres")
    one, three = b.copy(), b.copy()
    one[100, 100] += 1
    three[185, 100:103] //= 2
    for a, words in (
        (b, "The pictures are identical."),
        (one, "One pixel differs by one level: rounding, nothing to worry about."),
        (three, "3 pixels differ: too few to tell why."),
        (0 * b, "A is black, and B is not."),
        (255 - b, "A is the negative of B."),
    ):
        assert diagnose(a, b).text == words


def test_factor_of_256() -> None:
    light = np.clip(render(scene("four-spheres")), 0, 1)
    other = np.minimum(np.round(256 * light ** (1 / 2.2)), 255).astype(np.uint8)
    assert "A's factor is more than 255" in diagnose(other, right("four-spheres")).text


def test_antialiased_or_sampled_a_little_elsewhere() -> None:
    for name, a in (
        ("four-spheres", render(scene("four-spheres"), samples=16)),
        ("highlights", render(scene("highlights"), offset=(1e-3, 1e-3))),
    ):
        assert diagnose(to_codes(a), right(name)).kind == "edges"


def test_a_shift_by_many_pixels() -> None:
    moved = to_codes(render(scene("sticks-perspective"), offset=(12.0, -7.0)))
    found = diagnose(moved, right("sticks-perspective"))
    assert found.text == "A is shifted by 12 pixels to the left and 7 pixels down: check viewDir."


def test_noise_and_another_scene_are_named_with_no_confidence() -> None:
    b = right("four-spheres")
    noise = np.random.default_rng(1).integers(-20, 21, b.shape)
    noisy = np.clip(b + noise, 0, 255).astype(np.uint8)
    for a in (noisy, right("two-boxes")):
        assert diagnose(a, b).kind in ("other", "geometry")


def test_an_object_of_another_size_is_not_taken_for_a_light() -> None:
    full = scene("one-sphere")
    window = replace(full.camera, view_width=0.95 * full.camera.view_width)
    found = diagnose(to_codes(render(replace(full, camera=window))), right("one-sphere"))
    assert "1.05 times as wide as B, about its centre: check viewWidth" in found.text


@pytest.mark.parametrize(
    ("up", "words"), [(0.4, "19 degrees clockwise"), (-0.4, "18 degrees anticlockwise")]
)
def test_view_up_that_is_ignored(up: float, words: str) -> None:
    full = scene("room")
    tilted = replace(full, camera=replace(full.camera, view_up=(up, 1, 0)))
    found = diagnose(right("room"), to_codes(render(tilted)))
    assert found.kind == "rolled"
    assert words in found.text, found.text


def test_sizes() -> None:
    b = right("four-spheres")
    assert diagnose(b[::2, ::2], b).text == (
        "Different sizes: A has 100x100 pixels, B 200x200; of the same shape, A 0.5 times as large."
    )
    assert "swapped" in diagnose(b[:150], b[:, :150]).text


@pytest.mark.parametrize("shape", [(5, 9, 3), (1, 1, 3), (2000, 1, 3), (1, 2000, 3), (2, 2, 3)])
def test_small_and_narrow_pictures(shape: tuple[int, ...]) -> None:
    """Nothing to estimate, and no warning; a shift by the whole width would explain anything."""
    a, b = np.random.default_rng(1).integers(0, 256, (2, *shape), dtype=np.uint8)
    assert diagnose(a, b).kind not in ("identical", "shifted", "rounding")
    for level in (0, 255):
        flat = np.full(shape, level, dtype=np.uint8)
        assert diagnose(flat, flat).kind == "identical"
        spot = flat.copy()
        spot[shape[0] // 2, shape[1] // 3] = 100
        assert diagnose(spot, flat).kind not in ("identical", "rounding", "cut off")
