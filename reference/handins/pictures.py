"""Name what two pictures show of a difference: geometry and encoding; and describe the rest.

Geometry: B is turned over, moved or stretched until A is like it, whatever curve maps the levels of
one to the other's, so that a wrong gamma hides nothing.  Levels: a curve that explains nearly all
of them is named.  What is left is told by where it lies: its cause takes the scene to find.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from PIL import Image

from reference.figures import GAMMA, linear
from reference.handins.alignment import Bools, Codes, Diagnosis, Floats, Pair, align, shared

AGREEING = ("identical", "rounding", "format")
"""Kinds of pictures that are right."""
# A lossy format changes levels by up to so many, but for a few per cent of them.
_LOSSY = 6


def worst_pixel(a: Codes, b: Codes) -> tuple[int, int]:
    """Column and row of the pixel whose codes differ most."""
    y, x = np.unravel_index(np.abs(a.astype(np.int16) - b).max(axis=2).argmax(), a.shape[:2])
    return int(x), int(y)


def agreement(a: Codes, b: Codes) -> Diagnosis | None:
    """Whether pictures of one size agree, but for one level in some pixels."""
    count = int(np.count_nonzero((a != b).any(axis=2)))
    if not count:
        return Diagnosis("identical", "The pictures are identical.")
    few = count < 0.01 * a.shape[0] * a.shape[1]
    if few and np.abs(a.astype(np.int16) - b).max() == 1:
        text = f"{_differ(count)} by one level: rounding, nothing to worry about."
        return Diagnosis("rounding", text)
    return None


def compare_pictures(a: Codes, b: Codes, *, lossy: bool = False) -> Diagnosis:
    """Name geometry and encoding that differ between A and the right picture, B, of any sizes.

    Both are (h, w, 3) uint8.  `lossy`: whether the format of one changes levels, as JPEG does.
    """
    if a.shape != b.shape:
        return _sizes(a.shape, b.shape)
    if found := agreement(a, b) or featureless(a, b):
        return found
    noise = _LOSSY if lossy else 1
    difference = np.maximum(a, b) - np.minimum(a, b)
    count = int(np.count_nonzero((difference > noise).any(axis=2)))
    if not count and lossy:
        return Diagnosis(
            "format", f"No level is off by more than {noise}, as its format may make it."
        )
    if not count:
        return _rounding(a, b)
    if (np.abs(255 - b.astype(np.int16) - a) <= noise).mean() > 0.98:
        return Diagnosis("negative", "A is the negative of B.")
    if lossy:
        # Half the size keeps little of what compression does.
        a, b = (np.asarray(Image.fromarray(np.ascontiguousarray(x)).reduce(2)) for x in (a, b))
    pair, named = align(a, b, noise)
    pair, encoded = _encoded(pair)
    named += encoded
    left = pair.misfit()
    # At edges the amount of a shift is never quite known, and a format changes most.
    spare = 0.03 * (bool(named) + lossy)
    if not spare or left.sum() > spare * pair.shown.sum():
        named.append(_rest(pair, left))
    if not named:
        text = f"{_differ(count)}, as the format of one of the pictures may make them."
        return Diagnosis("format", text)
    return Diagnosis("+".join(f.kind for f in named), " ".join(f.text for f in named))


def featureless(a: Codes, b: Codes) -> Diagnosis | None:
    """Whether A or B has one colour: no cause is looked for."""
    for name, image, other in (("A", a, "B"), ("B", b, "A")):
        if not image.any():
            return Diagnosis("black", f"{name} is black, and {other} is not.")
        if not np.ptp(image, axis=(0, 1)).any():
            return Diagnosis("flat", f"{name} has one colour everywhere.")
    return None


def _sizes(a: tuple[int, ...], b: tuple[int, ...]) -> Diagnosis:
    more = ""
    if a[:2] == b[1::-1]:
        more = "; width and height are swapped"
    elif a[0] * b[1] == a[1] * b[0]:
        more = f"; of the same shape, A {a[0] / b[0]:.3g} times as large"
    text = f"Different sizes: A has {a[1]}x{a[0]} pixels, B {b[1]}x{b[0]}{more}."
    return Diagnosis("size", text)


def _rounding(a: Codes, b: Codes) -> Diagnosis:
    """One level apart in many pixels."""
    if (a <= b).all() and (a < b).mean() > 0.25 * (b > 0).mean():
        return Diagnosis("levels-truncated", "A's levels are cut off; they are to be rounded.")
    text = f"{_differ(int((a != b).any(axis=2).sum()))} by one level."
    return Diagnosis("unknown", f"{text} With the scene in place of B, more can be said.")


def _differ(count: int) -> str:
    return "One pixel differs" if count == 1 else f"{count} pixels differ"


class _Tone(NamedTuple):
    """What light is encoded as; where nothing was `fitted`, other faults may hide half of it."""

    kind: str
    text: str
    encode: Callable[[Floats], Floats]
    fitted: bool = False


# IEC 61966-2-1 is sRGB.
_TONES = (
    _Tone("gamma-none", "A lacks gamma: its levels are linear in light.", lambda x: x),
    _Tone("gamma-twice", "A has gamma twice: the power 1 / 2.2 is to be taken once.",
          lambda x: x ** GAMMA**-2),
    _Tone("gamma-inverse", "A has gamma the wrong way round: the power 2.2 in place of 1 / 2.2.",
          lambda x: x**GAMMA),
    _Tone("gamma-srgb", "A is encoded with the sRGB curve in place of gamma 2.2.",
          lambda x: np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)),
    _Tone("wrapped", "A differs only where B is 255: light beyond 1 is to be clipped, not to wrap"
          " round.", lambda x: np.where(x > 1, 0, x ** (1 / GAMMA))),
)  # fmt: skip


def _fitted(pair: Pair) -> Iterator[_Tone]:
    a, b = pair.a, pair.low
    sure = pair.shown[:, :, None] & (pair.high - b <= pair.noise)
    sure = sure & (b > 20) & (b < 240) & (a > 8) & (a < 248)
    if sure.sum() > 50:
        x, y = linear(a[sure]), linear(b[sure])
        by, power = float(np.median(x / y)), float(np.median(np.log(x) / np.log(y))) / GAMMA
        text = f"A is {'brighter' if by > 1 else 'darker'} by a factor of {by:.3g} in linear light."
        yield _Tone("brightness", text, lambda x: (by * x) ** (1 / GAMMA), True)
        text = f"A is encoded with a gamma of about {1 / power:.2f} in place of 2.2."
        yield _Tone("gamma", text, lambda x: x**power, True)


def _encoded(pair: Pair) -> tuple[Pair, list[Diagnosis]]:
    """The same, B's levels mapped as A's are."""
    # B's light is known to within the half level by which it was rounded, unless it is clipped.
    lights = [(np.maximum(np.arange(256) + half, 0) / 255) ** GAMMA for half in (-0.5, 0.5)]
    lights[1][255] = np.inf
    shown, tried = max(1, int(pair.shown.sum())), []
    for tone in (*_TONES, *_fitted(pair)):
        ends = [np.round(255 * np.clip(tone.encode(light), 0, 1)) for light in lights]
        tried.append((int(pair.misfit(*ends).sum()) / shown, tone, ends))
    left, tone, ends = min(tried, key=lambda one: one[0])
    before = int(pair.misfit().sum()) / shown
    if not (
        left <= min(0.03, 0.3 * before) < before - (0.05 if pair.noise > 1 else 0)
        or (not tone.fitted and left < 0.5 < 0.8 < before)
    ):
        return pair, []
    mapped = ends[0][pair.low], ends[1][pair.high]
    low, high = (f(*mapped).astype(np.uint8) for f in (np.minimum, np.maximum))
    return pair._replace(low=low, high=high), [Diagnosis(tone.kind, tone.text)]


def _rest(pair: Pair, wrong: Bools) -> Diagnosis:
    """Describe what no geometry and no encoding explains."""
    a, b = pair.a, np.clip(pair.a, pair.low, pair.high)
    change = a.astype(np.int16) - b
    ups, downs = ((sign * change[wrong] >= -1).all(axis=1).mean() for sign in (1, -1))
    word = "brighter" if ups > 0.9 else "darker" if downs > 0.9 else "brighter or darker"
    part, levels = wrong.sum() / max(1, pair.shown.sum()), np.abs(change).max()
    text = (
        f"A is {word} in {part:.1%} of what is shown, mostly in the {_place(wrong)},"
        f" by up to {levels} levels."
    )
    if min(kept := shared(pair.a, pair.low)) < 0.8:
        text += f" Of B's edges, A has {kept[1]:.0%}: check the camera and the surfaces first."
    return Diagnosis("unknown", f"{text} With the scene in place of B, more can be said.")


def _place(wrong: Bools) -> str:
    """The ninth of the picture in which most of these pixels are, in words."""
    thirds = [np.array_split(part, 3, axis=1) for part in np.array_split(wrong, 3)]
    row, column = divmod(int(np.argmax([part.sum() for row in thirds for part in row])), 3)
    return f"{('upper', 'middle', 'lower')[row]} {('left', 'centre', 'right')[column]}"
