"""Name the kinds of difference between two pictures, in words: geometry first, shading next.

Geometry: B is turned over, moved or stretched until A is like it, whatever curve maps the levels of
one to the other's, so that a wrong gamma hides nothing.  Levels: a curve that explains nearly all
of them is named.  What is still unexplained is told by where it lies, which sign it has, and how it
ends.  Two faults are told one after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from reference.alignment import EDGE, Bools, Codes, Diagnosis, Floats, Pair, align, edges_of, shared

__all__ = ["GAMMA", "Diagnosis", "diagnose", "linear"]

GAMMA = 2.2
# A lossy format changes levels by up to so many, but for a few per cent of them.
_LOSSY = 6


def linear(codes: NDArray[np.generic]) -> Floats:
    """Linear light of 8-bit codes: the inverse of the format's gamma of 2.2."""
    light: Floats = (np.arange(256) / 255) ** GAMMA
    return np.asarray(light[codes])


def diagnose(a: Codes, b: Codes, *, lossy: bool = False) -> Diagnosis:
    """Tell which kinds of difference lie between A and the right picture, B, of any sizes.

    Both are (h, w, 3) uint8.  `lossy`: whether the format of one changes levels, as JPEG does.
    """
    if a.shape != b.shape:
        return _sizes(a.shape, b.shape)
    noise = _LOSSY if lossy else 1
    difference = np.maximum(a, b) - np.minimum(a, b)
    count = int(np.count_nonzero((difference > noise).any(axis=2)))
    if difference.max() <= 1:
        return _rounding(a, b)
    for name, image, other in (("A", a, "B"), ("B", b, "A")):
        if image.max() < noise:
            return Diagnosis("black", f"{name} is black, and {other} is not.")
        if np.ptp(image, axis=(0, 1)).max() < noise:
            return Diagnosis("flat", f"{name} has one colour everywhere.")
    if (np.abs(255 - b.astype(np.int16) - a) <= noise).mean() > 0.98:
        return Diagnosis("inverted", "A is the negative of B.")
    if not count:
        return Diagnosis("noise", f"No level is off by more than {noise}: noise of the format.")
    if lossy:
        # Half the size keeps little of what compression does.
        a, b = (np.asarray(Image.fromarray(np.ascontiguousarray(x)).reduce(2)) for x in (a, b))
    pair, found = align(a, b, noise)
    pair, encoded = _encoded(pair)
    found += encoded
    left = pair.misfit()
    # At edges the amount of a shift is never quite known, and a format changes most.
    spare = 0.03 * (bool(found) + lossy)
    if not spare or left.sum() > spare * pair.shown.sum():
        found.append(_shading(pair, left, count))
    if not found:
        text = f"{_differ(count)}, as the format of one of the pictures may make them."
        return Diagnosis("noise", text)
    return Diagnosis(" + ".join(f.kind for f in found), " ".join(f.text for f in found))


def _sizes(a: tuple[int, ...], b: tuple[int, ...]) -> Diagnosis:
    more = ""
    if a[:2] == b[1::-1]:
        more = "; width and height are swapped"
    elif a[0] * b[1] == a[1] * b[0]:
        more = f"; of the same shape, A {a[0] / b[0]:.3g} times as large"
    text = f"Different sizes: A has {a[1]}x{a[0]} pixels, B {b[1]}x{b[0]}{more}."
    return Diagnosis("size", text)


def _rounding(a: Codes, b: Codes) -> Diagnosis:
    """At most one level apart."""
    count, lit = (int(np.count_nonzero(x.any(axis=2))) for x in (a != b, b))
    if not count:
        return Diagnosis("identical", "The pictures are identical.")
    if count < 0.01 * lit:
        few = f"{_differ(count)} by one level: rounding, nothing to worry about."
        return Diagnosis("rounding", few)
    how = "up and down: the factor is not 255"
    if (a <= b).all():
        how = "downwards: A is cut off where it should be rounded"
    elif (a >= b).all():
        how = "only upwards: A's factor is more than 255, or B is cut off"
    return Diagnosis("cut off", f"One level of rounding, {how}.")


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
    _Tone("gamma", "A lacks gamma: its levels are linear in light.", lambda x: x),
    _Tone("gamma", "A has gamma twice: the power 1 / 2.2 is to be taken once.",
          lambda x: x ** GAMMA**-2),
    _Tone("gamma", "A has gamma the wrong way round: the power 2.2 in place of 1 / 2.2.",
          lambda x: x**GAMMA),
    _Tone("gamma", "A is encoded with the sRGB curve in place of gamma 2.2.",
          lambda x: np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)),
    _Tone("unclipped", "A differs only where B is 255: light beyond 1 is to be clipped, not to wrap"
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
        curve = pair.curve()
        if np.ptp(curve) > 32 and _palette(b[sure.any(axis=2)]) > 16:
            sample = ", ".join(f"{k} to {curve[k]:.0f}" for k in (64, 128, 192))
            text = f"A's levels are those of B through another curve, which takes {sample}."
            levels = np.linspace(0, 1, 256) ** GAMMA
            yield _Tone("curve", text, lambda x: np.interp(x, levels, curve / 255), True)


def _encoded(pair: Pair) -> tuple[Pair, list[Diagnosis]]:
    """The same, B's levels mapped as A's are."""
    # B's light is known to within the half level by which it was rounded, unless it is clipped.
    lights = [(np.maximum(np.arange(256) + half, 0) / 255) ** GAMMA for half in (-0.5, 0.5)]
    lights[1][255] = np.inf
    shown, tried = max(1, int(pair.shown.sum())), []
    for tone in (*_TONES, *_fitted(pair)):
        ends = [np.round(255 * np.clip(tone.encode(light), 0, 1)) for light in lights]
        tried.append((int(pair.misfit(*ends).sum()) / shown, tone, ends))
    left, tone, ends = min(tried, key=lambda t: (t[0] > 0.03, t[1].kind == "curve", t[0]))
    before = int(pair.misfit().sum()) / shown
    if not (
        left <= min(0.03, 0.3 * before) < before - (0.05 if pair.noise > 1 else 0)
        or (not tone.fitted and left < 0.5 < 0.8 < before)
    ):
        return pair, []
    mapped = ends[0][pair.low], ends[1][pair.high]
    low, high = (f(*mapped).astype(np.uint8) for f in (np.minimum, np.maximum))
    return pair._replace(low=low, high=high), [Diagnosis(tone.kind, tone.text)]


def _shading(pair: Pair, wrong: Bools, count: int) -> Diagnosis:
    """Tell what is left by where it lies, its sign, and how it ends: the first rule that holds."""
    few = Diagnosis("few", f"{_differ(count)}: too few to tell why.")
    if not wrong.any():
        return few
    a, low, high, clean = pair.a, pair.low, pair.high, pair.noise == 1
    b = np.asarray((low.astype(np.int16) + high) // 2, dtype=np.uint8)
    shown, part = pair.shown, float(wrong.sum() / pair.shown.sum())
    change = (a.astype(np.int16) - np.clip(a, low, high))[wrong]
    brighter, darker = (
        bool((sign * change >= -2 * pair.noise).all(axis=1).mean() > 0.9) for sign in (1, -1)
    )
    word = "brighter" if brighter else "darker" if darker else "brighter or darker"
    one_way, all_over = brighter or darker, part > 0.9
    kept, common = shared(a, b)
    peak, right_peak = a.max(axis=2), b.max(axis=2)
    black, full = (float(found[wrong].mean()) for found in (peak <= pair.noise, peak == 255))
    colours, right_colours = (_palette(image[shown]) for image in (a, b))
    # How A's light differs from B's: by which factors, how much more where B is bright, in hue.
    least, most, rise, tint = 0.0, np.inf, 0.0, 0.0
    middle = wrong & (right_peak > 20) & (right_peak < 250) & (peak < 250) & (peak > 4)
    if middle.sum() > 20:
        mine, right = linear(a[middle]), linear(b[middle])
        light, right_light = mine.sum(axis=1), right.sum(axis=1)
        least, most = np.percentile(light / right_light, [5, 95])
        ends, more = np.percentile(right_light, [25, 75]), light - right_light
        dim, bright = (
            np.median(more[right_light <= ends[0]]),
            np.median(more[right_light >= ends[1]]),
        )
        rise = bright / dim if dim else 0.0
        hues = mine / light[:, None] - right / right_light[:, None]
        tint = float(np.abs(hues).max(axis=1).mean())
    # A difference ends sharply if, where it ends, it is larger than this part of its maximum.
    sharp = _sharpness(a, b, wrong) > (0.22 if clean else 0.12)
    fades, even = one_way and not sharp, all_over and 0.5 < rise < 2
    specks = 1 - ndimage.binary_opening(wrong, np.ones((3, 3))).sum() / wrong.sum()
    unlit = brighter and high[wrong].max(axis=1).max() <= pair.noise
    at_edges = (edges_of(a) & edges_of(b))[wrong].mean() > 0.95
    flat = colours == 1 or (colours <= 16 and 4 * colours < right_colours and full < 0.8)
    share, factors = f"in {part:.1%} of what is shown", f"by factors from {least:.2g} to {most:.2g}"
    levels = np.percentile(np.abs(change).max(axis=1), 95)
    rules = (
        (at_edges and (count < 0.001 * wrong.size or not one_way), "edges",
         "Only edges differ: A's samples lie elsewhere in the pixel, or are several a pixel."),
        (count < 0.001 * wrong.size, *few),
        (all_over and right_colours > 8 and np.isin(a[shown], (0, 255)).all(), "whole numbers",
         "A's levels are 0 and 255 alone: light is made a whole number before it is encoded."),
        (all_over and darker and black > 0.7 and kept > 0.5, "normals",
         f"A is black in {black:.0%} of what B shows: n.l is negative, as of normals inwards."),
        (part > 0.8 and flat and colours < right_colours and a.max() > 64, "unshaded",
         f"A shows silhouettes in {'one colour' if colours == 1 else f'{colours} colours'}: nothing"
         " is shaded."),
        (max(kept, common) < (0.8 if clean else 0.6), "geometry",
         f"The geometry differs: of B's edges, A has {common:.0%}.  Check the camera first."),
        (brighter and part > 0.5 and full > 0.8, "overexposed",
         f"A is overexposed {share}: a vector in the shading is not of length 1."),
        (brighter and all_over and tint > 0.025, "colours",
         "Everything is brighter, and of another hue: diffuseColor is not used as it should be."),
        (even and ((brighter and least < 1.25) or (darker and most > 0.8)), "ambient",
         f"A is {word} by the same light everywhere: an ambient term too"
         f" {'many' if brighter else 'few'}."),
        (darker and all_over and most < 0.3, "falls off",
         f"Everything is darker, {factors}: light is not to fall off with distance."),
        (all_over and one_way, "uneven", f"Everything is {word}, {factors} in linear light."),
        (darker and specks > 0.4 and part > 0.02 and clean, "speckled",
         f"A is speckled with dark dots, {share}: surfaces shadow themselves."),
        (darker and part > 0.5, "missing light",
         f"A is darker {share}, and the same elsewhere: it lacks a light."),
        (darker and ((sharp and kept < 0.97) or black > 0.8), "extra shadows",
         f"A is darker {share}, within sharp borders: it has shadows that B has not."),
        (brighter and sharp and common < 0.95 and part > 0.6, "extra light",
         f"A is brighter {share}, and the same elsewhere: it has a light too many."),
        (brighter and sharp and common < 0.95, "missing shadows",
         f"Shadows are missing in A: it is brighter {share}, within sharp borders."),
        (fades and rise > 2.2, "highlights" if brighter else "missing highlight",
         f"Highlights are {'stronger or larger' if brighter else 'missing, or weaker,'} in A,"
         f" {share}."),
        (clean and (unlit or (fades and rise < 1)), "facing",
         f"A is {word} {share}, where surfaces turn away from a light: n.l below 0 is 0."),
        (sharp and not one_way and tint > 0.2, "nearest",
         f"Another surface is seen {share}: the nearest hit is the one to show."),
        (True, "other", f"The geometry agrees, the shading differs: A is {word} {share}, mostly"
         f" in the {_place(wrong)}, by up to {levels:.0f} levels."),
    )  # fmt: skip
    return next(Diagnosis(kind, text) for holds, kind, text in rules if holds)


def _place(wrong: Bools) -> str:
    """The ninth of the picture in which most of these pixels are, in words."""
    thirds = [np.array_split(part, 3, axis=1) for part in np.array_split(wrong, 3)]
    row, column = divmod(int(np.argmax([part.sum() for row in thirds for part in row])), 3)
    return f"{('upper', 'middle', 'lower')[row]} {('left', 'centre', 'right')[column]}"


def _palette(colours: Codes) -> int:
    """How many colours 95 % of these (n, 3) have, told apart by steps of 4 levels."""
    _, count = np.unique((colours >> 2).astype(np.intp) @ [65536, 256, 1], return_counts=True)
    return int(np.searchsorted(np.sort(count)[::-1].cumsum(), 0.95 * count.sum())) + 1


def _sharpness(a: Codes, b: Codes, differs: Bools) -> float:
    """How large the difference is where it ends, other than at a silhouette, part of its most."""
    size, values = np.abs(linear(a) - linear(b)).mean(axis=2), [np.empty(0)]
    for axis in (0, 1) if min(differs.shape) > 1 else ():
        steps = [np.abs(np.diff(image.astype(np.int16), axis=axis)).max(axis=2) for image in (a, b)]
        ends = np.diff(differs, axis=axis) & (np.minimum(*steps) <= EDGE)
        pairs = np.lib.stride_tricks.sliding_window_view(size, 2, axis=axis)
        values.append(pairs.max(axis=2)[ends])
    found = np.concatenate(values)
    return float(np.median(found) / np.percentile(size[differs], 90)) if found.size else 1.0
