"""Describe hand-ins that no known mistake renders: by lights, speckles, ties, files and edges."""

from __future__ import annotations

import io
from itertools import product
from typing import NamedTuple

import numpy as np
from PIL import Image

from reference.handins import mistakes
from reference.handins.formulas import Array
from reference.handins.search import MAX_PIXELS, KnownPictures, Search, difference
from reference.pictures import Codes

# Maximum number of lights for which all sets of lights are tried at each pixel.
_MAX_LIGHTS = 4
# Rounding decides at most this part of the pixels: each is rendered so at most this many pixels
# from its centre, or with shadow rays that start this far from the surface, relative to the
# distance from the origin.
_MAX_TIES, _TIE_OFFSET, _TIE_LIFTS = 0.001, 0.05, (-1e-3, 0, 1e-3)
# Speckles: the minimum part of the picture that loses light; the maximum number of other wrong
# pixels, relative to these; and the minimum frequency with which neighbours in a row, and in a
# column, differ, relative to that of independent pixels.
_MIN_SPECKLES, _MAX_OTHERS, _MIN_RANDOMNESS = 0.005, 0.1, 0.3
# JPEG: the qualities that are tried, the minimum part of the wrong pixels that it explains, and the
# maximum size of pictures that are tried, in pixels.
_QUALITIES, _MIN_SAME, _MAX_JPEG_PIXELS = (*range(50, 100, 5), 98, 100), 0.9, 1_000_000
# Maximum number of places at which the right picture is searched for in a larger one.
_MAX_PLACES = 100


class Lights(NamedTuple):
    """Changes of the lights at the n wrong pixels of a hand-in.

    Attributes
    ----------
    pixels : (n,) int array
        Indices of the pixels.
    lost, extra : (lights, n) bool arrays
        Whether the hand-in lacks the light; whether it has the light in spite of a shadow.
    is_known : (n,) bool array
        Whether some set of lights gives the hand-in's levels.
    """

    pixels: Array
    lost: Array
    extra: Array
    is_known: Array


def lights(search: Search) -> Lights | None:
    """Find, for each wrong pixel, the fewest lights to remove or add for the hand-in's levels.

    Returns None if more than `MAX_PIXELS` pixels are wrong, or if the scene has too many lights.
    """
    known, pixels = search.known, np.flatnonzero(search.is_wrong)
    if not 0 < len(pixels) <= MAX_PIXELS or "light-first" not in known.table:
        return None
    lit = known.in_batches("lit", pixels)
    if not 0 < len(lit) <= _MAX_LIGHTS:
        return None
    choices = [*product((False, True), repeat=len(lit))]
    lit_formulas = (f"lit = array({[*choice]})[:, None] & (distance > 0)" for choice in choices)
    changes = [known.base | mistakes.parse_formulas(formula) for formula in lit_formulas]
    batches = (known.formulas(batch, search.handin) for batch in known.batches(pixels))
    codes = np.concatenate([[f.codes(one) for one in changes] for f in batches], axis=-1)
    changed = (lit != np.array(choices)[:, :, None]).sum(axis=1)  # (choices, n)
    changed = np.where(difference(codes, search.handin[:, pixels]) <= 1, changed, len(lit) + 1)
    best = np.array(choices)[changed.argmin(axis=0)].T
    is_known = changed.min(axis=0) <= len(lit)
    return Lights(pixels, lit & ~best & is_known, best & ~lit & is_known, is_known)


def is_speckled(changes: Lights | None, known: KnownPictures) -> bool:
    """Test whether surfaces shadow themselves in dots that depend on rounding.

    Two conditions hold of such dots.  (1) Light is lost, and hardly anything else is wrong.
    (2) Along rows as along columns, neighbours on the affected surfaces differ nearly as often as
    if chance decided on each pixel.
    """
    if changes is None or known.count > MAX_PIXELS:
        return False
    is_lost = changes.lost.any(axis=0)
    others = (changes.extra.any(axis=0) | ~changes.is_known).sum()
    if others > _MAX_OTHERS * is_lost.sum() or is_lost.sum() <= _MIN_SPECKLES * known.count:
        return False
    lit = known.in_batches("lit", np.arange(known.count))
    lost = np.zeros_like(lit)
    lost[:, changes.pixels] = changes.lost
    # The probability that light is lost, which differs from surface to surface.
    surface = known.surface + 1
    lost_count, lit_count = (np.array([np.bincount(surface, row) for row in mask])
                             for mask in (lost, lit))  # fmt: skip
    chance = (lost_count / np.maximum(lit_count, 1))[:, surface]
    lit, lost, chance = (a.reshape(len(lit), -1, known.columns) for a in (lit, lost, chance))
    surface = surface.reshape(-1, known.columns)
    for axis in (1, 2):
        same = surface == np.roll(surface, 1, axis - 1)
        both = lit & np.roll(lit, 1, axis) & same
        different = (both & (lost != np.roll(lost, 1, axis))).sum()
        if different <= _MIN_RANDOMNESS * (2 * chance * (1 - chance))[both].sum():
            return False
    return True


def is_decided_by_rounding(search: Search) -> bool:
    """Test whether few pixels are wrong, and each would be right a tiny distance away."""
    known = search.known
    pixels = np.flatnonzero(difference(known.right, search.handin) > 1)
    if not 0 < len(pixels) <= max(1, _MAX_TIES * known.count):
        return False
    formulas, offsets = known.formulas(pixels, search.handin), (-_TIE_OFFSET, 0, _TIE_OFFSET)
    positions = [
        mistakes.sample_position_formulas(0.5 + x, 0.5 + y) for x, y in product(offsets, repeat=2)
    ]
    starts = [
        mistakes.parse_formulas(f"shadow_p = p + {lift} * sqrt(dot(p, p)) * n")
        for lift in _TIE_LIFTS
    ]
    codes = np.array([formulas.codes(known.base | a | b) for a in positions for b in starts])
    codes, handin = codes.astype(np.int16), search.handin[:, pixels]
    return bool(((handin >= codes.min(axis=0) - 1) & (handin <= codes.max(axis=0) + 1)).all())


def is_after_jpeg(handin: Codes, right: Codes) -> bool:
    """Test whether a picture is the right one as a JPEG of some quality changes it."""
    wrong = np.abs(handin.astype(np.int16) - right).max(axis=2) > 1
    if wrong.size > _MAX_JPEG_PIXELS or not wrong.any():
        return False
    for quality, subsampling in product(_QUALITIES, (0, 2)):
        data = io.BytesIO()
        Image.fromarray(right).save(data, "JPEG", quality=quality, subsampling=subsampling)
        off = np.abs(np.asarray(Image.open(data)).astype(np.int16) - handin).max(axis=2)
        if min((off <= 1)[wrong].mean(), (off <= 1).mean()) >= _MIN_SAME:
            return True
    return False


def is_same(a: Codes, b: Codes) -> bool:
    """Test whether pictures of one shape agree within a level, except for one pixel in 200."""
    return a.shape == b.shape and (np.abs(a.astype(np.int16) - b) > 1).any(axis=2).mean() <= 0.005


def disguise(handin: Codes, right: Codes) -> tuple[str, str] | None:
    """Return a keyword and a sentence if a picture of another size contains the right picture."""
    (height, width), (tall, wide) = right.shape[:2], handin.shape[:2]
    factor = tall // height
    if (tall, wide) == (factor * height, factor * width) and is_same(
        handin, right.repeat(factor, axis=0).repeat(factor, axis=1)
    ):
        return "enlarged", f"It is the right picture, enlarged {factor} times."
    if (rows := tall - height) < 0 or (columns := wide - width) < 0:
        return None
    # Places of the upper left corner at which some pixels agree.
    agree = np.ones((rows + 1, columns + 1), dtype=np.bool_)
    for y, x in np.random.default_rng(1).integers((height, width), size=(50, 2)):
        window = handin[y : y + rows + 1, x : x + columns + 1].astype(np.int16)
        agree &= np.abs(window - right[y, x]).max(axis=2) <= 1
    for y, x in np.argwhere(agree)[:_MAX_PLACES]:
        if is_same(handin[y : y + height, x : x + width], right):
            return "border", "It is the right picture, with a border."
    return None


def edges(is_wrong: Array) -> str:
    """Return the edge that contains all wrong pixels (h, w), such as "last row", or nothing."""
    lines = {"first row": is_wrong[0], "last row": is_wrong[-1],
             "first column": is_wrong[:, 0], "last column": is_wrong[:, -1]}  # fmt: skip
    return next((name for name, line in lines.items() if line.sum() == is_wrong.sum() > 0), "")
