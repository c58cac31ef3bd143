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
# Maximum number of places at which the right picture is searched for in a larger one, and the
# maximum part of the pixels that may differ by more than one level there.
_MAX_PLACES, _MAX_DIFFERENT = 100, 0.005


class LightChanges(NamedTuple):
    """Lights that are missing, or wrongly present, at the n wrong pixels of a hand-in.

    Attributes
    ----------
    pixels : (n,) int array
        Indices of the wrong pixels.
    is_lost : (lights, n) bool array
        True if the hand-in lacks a light that should reach the pixel.
    is_extra : (lights, n) bool array
        True if the hand-in has a light that should be blocked.
    is_known : (n,) bool array
        True if some set of lights gives the hand-in's codes.  For other pixels, nothing is lost and
        nothing is extra.
    """

    pixels: Array
    is_lost: Array
    is_extra: Array
    is_known: Array


def find_light_changes(search: Search) -> LightChanges | None:
    """Find the lights that are missing, or wrongly present, at each wrong pixel of a hand-in.

    Each wrong pixel is rendered with every set of lights.  Among the sets that give the
    hand-in's codes within one level, the set that differs least from the right one is chosen.

    Parameters
    ----------
    search : Search
        The hand-in, with its wrong pixels and the known pictures of the scene.

    Returns
    -------
    LightChanges or None
        None if no pixel is wrong, if more than `MAX_PIXELS` pixels are, or if the scene is unknown,
        or has no light or more than `_MAX_LIGHTS`.
    """
    known, pixels = search.known, np.flatnonzero(search.is_wrong)
    if not 0 < len(pixels) <= MAX_PIXELS or "light-first" not in known.table:
        return None
    is_lit = known.compute("lit", pixels)
    light_count = len(is_lit)
    if not 0 < light_count <= _MAX_LIGHTS:
        return None
    light_sets = [*product((False, True), repeat=light_count)]
    assignments = [f"lit = array({[*lights]})[:, None] & (distance > 0)" for lights in light_sets]
    formulas = [known.shared_formulas | mistakes.parse_formulas(text) for text in assignments]
    caches = (known.formula_cache(batch, search.handin) for batch in known.pixel_batches(pixels))
    codes = np.concatenate(
        [[cache.codes(changed) for changed in formulas] for cache in caches], axis=-1
    )
    # For each set and pixel, the number of lights that differ from the right ones; more than all
    # lights if the set does not give the hand-in's codes.
    change_count = (is_lit != np.array(light_sets)[:, :, None]).sum(axis=1)
    gives_handin = difference(codes, search.handin[:, pixels]) <= 1
    change_count = np.where(gives_handin, change_count, light_count + 1)
    has_light = np.array(light_sets)[change_count.argmin(axis=0)].T
    is_known = change_count.min(axis=0) <= light_count
    return LightChanges(
        pixels, is_lit & ~has_light & is_known, has_light & ~is_lit & is_known, is_known
    )


def is_speckled(changes: LightChanges | None, known: KnownPictures) -> bool:
    """Test whether surfaces shadow themselves in dots that depend on rounding.

    Two conditions hold for such dots.  (1) Light is lost, and little else is wrong.  (2) Along rows
    as along columns, neighbours on the affected surfaces differ nearly as often as if chance
    decided on each pixel.

    Parameters
    ----------
    changes : LightChanges or None
        The lights that the hand-in lacks; if they are unknown, the result is false.
    known : KnownPictures
        The known pictures of the scene, of which the surfaces and lights are used.
    """
    if changes is None or known.pixel_count > MAX_PIXELS:
        return False
    loses_light = changes.is_lost.any(axis=0)
    other_count = (changes.is_extra.any(axis=0) | ~changes.is_known).sum()
    min_count = _MIN_SPECKLES * known.pixel_count
    if other_count > _MAX_OTHERS * loses_light.sum() or loses_light.sum() <= min_count:
        return False
    is_lit = known.compute("lit", np.arange(known.pixel_count))
    is_lost = np.zeros_like(is_lit)
    is_lost[:, changes.pixels] = changes.is_lost
    # The probability that light is lost, which differs from surface to surface.
    surface = known.surface + 1
    lost_count, lit_count = (np.array([np.bincount(surface, row) for row in mask])
                             for mask in (is_lost, is_lit))  # fmt: skip
    probability = (lost_count / np.maximum(lit_count, 1))[:, surface]
    is_lit, is_lost, probability = (
        array.reshape(len(is_lit), -1, known.width) for array in (is_lit, is_lost, probability)
    )
    surface = surface.reshape(-1, known.width)
    for axis in (1, 2):
        has_same_surface = surface == np.roll(surface, 1, axis - 1)
        are_both_lit = is_lit & np.roll(is_lit, 1, axis) & has_same_surface
        differ = are_both_lit & (is_lost != np.roll(is_lost, 1, axis))
        expected_count = (2 * probability * (1 - probability))[are_both_lit].sum()
        if differ.sum() <= _MIN_RANDOMNESS * expected_count:
            return False
    return True


def is_decided_by_rounding(search: Search) -> bool:
    """Test whether rounding explains all pixels in which a hand-in differs by more than one level.

    This is so if few pixels differ, and if the codes of each lie between those that the right
    tracer gives when the sample, or the origin of shadow rays, is moved a little.

    Parameters
    ----------
    search : Search
        The hand-in, with the known pictures of the scene.
    """
    known = search.known
    pixels = np.flatnonzero(difference(known.right_codes, search.handin) > 1)
    if not 0 < len(pixels) <= max(1, _MAX_TIES * known.pixel_count):
        return False
    cache, offsets = known.formula_cache(pixels, search.handin), (-_TIE_OFFSET, 0, _TIE_OFFSET)
    samples = [mistakes.sample_position_formulas(0.5 + x, 0.5 + y)
               for x, y in product(offsets, repeat=2)]  # fmt: skip
    origins = [mistakes.parse_formulas(f"shadow_p = p + {lift} * sqrt(dot(p, p)) * n")
               for lift in _TIE_LIFTS]  # fmt: skip
    codes = np.array([cache.codes(known.shared_formulas | sample | origin)
                      for sample in samples for origin in origins]).astype(np.int16)  # fmt: skip
    handin, low, high = search.handin[:, pixels], codes.min(axis=0) - 1, codes.max(axis=0) + 1
    return bool(((handin >= low) & (handin <= high)).all())


def is_after_jpeg(handin: Codes, right: Codes) -> bool:
    """Test whether a hand-in is the right picture after JPEG compression of some quality.

    Several qualities are tried.  One of them must explain most pixels, and most of those that
    differ from the right picture, within one level.  Large pictures are not tried.

    Parameters
    ----------
    handin, right : (h, w, 3) uint8 arrays
        The codes of the picture that was handed in, and of the right picture.
    """
    is_wrong = np.abs(handin.astype(np.int16) - right).max(axis=2) > 1
    if is_wrong.size > _MAX_JPEG_PIXELS or not is_wrong.any():
        return False
    for quality, subsampling in product(_QUALITIES, (0, 2)):
        data = io.BytesIO()
        Image.fromarray(right).save(data, "JPEG", quality=quality, subsampling=subsampling)
        compressed = np.asarray(Image.open(data)).astype(np.int16)
        agrees = np.abs(compressed - handin).max(axis=2) <= 1
        if min(agrees[is_wrong].mean(), agrees.mean()) >= _MIN_SAME:
            return True
    return False


def _nearly_agree(a: Codes, b: Codes) -> bool:
    """Test whether two pictures have the same shape and nearly the same codes.

    At most one pixel in 200 may differ by more than one level.

    Parameters
    ----------
    a, b : (h, w, 3) uint8 arrays
        The pictures' codes.
    """
    if a.shape != b.shape:
        return False
    differs = (np.abs(a.astype(np.int16) - b) > 1).any(axis=2)
    return bool(differs.mean() <= _MAX_DIFFERENT)


def find_right_picture_within(handin: Codes, right: Codes) -> tuple[str, str] | None:
    """Recognise the right picture in a hand-in of another size: enlarged, or with a border.

    Parameters
    ----------
    handin, right : (h, w, 3) uint8 arrays
        The codes of the picture that was handed in, and of the right picture.  Their shapes differ.

    Returns
    -------
    tuple or None
        The keyword "enlarged" or "border", and a sentence for the report; None if the hand-in does
        not contain the right picture.
    """
    (height, width), (handin_height, handin_width) = right.shape[:2], handin.shape[:2]
    factor = handin_height // height
    # The sizes are compared first, because an enlarged picture could exceed the memory.
    if handin.shape[:2] == (factor * height, factor * width) and _nearly_agree(
        handin, right.repeat(factor, axis=0).repeat(factor, axis=1)
    ):
        return "enlarged", f"It is the right picture, enlarged {factor} times."
    extra_rows, extra_columns = handin_height - height, handin_width - width
    if extra_rows < 0 or extra_columns < 0:
        return None
    # Places of the right picture's upper left corner at which a random choice of pixels agrees.
    agrees = np.ones((extra_rows + 1, extra_columns + 1), dtype=np.bool_)
    for y, x in np.random.default_rng(1).integers((height, width), size=(50, 2)):
        window = handin[y : y + extra_rows + 1, x : x + extra_columns + 1].astype(np.int16)
        agrees &= np.abs(window - right[y, x]).max(axis=2) <= 1
    for y, x in np.argwhere(agrees)[:_MAX_PLACES]:
        if _nearly_agree(handin[y : y + height, x : x + width], right):
            return "border", "It is the right picture, with a border."
    return None


def edge_with_all(is_wrong: Array) -> str:
    """Return the name of the picture's edge that contains all wrong pixels.

    Parameters
    ----------
    is_wrong : (h, w) bool array

    Returns
    -------
    str
        "first row", "last row", "first column" or "last column"; empty if none of these contains
        all wrong pixels, or if no pixel is wrong.
    """
    edges = {"first row": is_wrong[0], "last row": is_wrong[-1],
             "first column": is_wrong[:, 0], "last column": is_wrong[:, -1]}  # fmt: skip
    return next((name for name, edge in edges.items() if edge.sum() == is_wrong.sum() > 0), "")
