"""Recognise differences that no formula makes: rounding, speckles, JPEG, borders, missing lights.

A *submitted picture* is one that a student handed in; the *reference picture* is what it should be.
"""

from __future__ import annotations

import io
from itertools import product

import numpy as np
from PIL import Image

from reference.handins.formulas import Array
from reference.handins.mistakes import parse_formulas, sample_position_formulas
from reference.handins.search import MAX_PIXELS, Submission
from reference.pictures import Codes, level_difference, to_picture

# Maximum number of lights for which all sets of lights are tried at each pixel.
_MAX_LIGHTS = 4
# Rounding is assumed to decide at most this share of the pixels.  To test a pixel, its sample is
# moved by this many pixels, and the origins of its shadow rays are lifted from the surface by these
# multiples of their distance from the origin of coordinates.
_MAX_TIES, _TIE_OFFSET, _TIE_LIFTS = 0.001, 0.05, (-1e-3, 0, 1e-3)
# Speckles: the minimum share of the picture that loses light; the maximum number of other wrong
# pixels, relative to the pixels that lose light; and the minimum frequency with which neighbours in
# a row or column differ, relative to that of independent pixels.
_MIN_SPECKLES, _MAX_OTHERS, _MIN_RANDOMNESS = 0.005, 0.1, 0.3
# JPEG: the qualities to try, the minimum share of the wrong pixels that it must explain, and the
# maximum size of the pictures in pixels.
_QUALITIES, _MIN_SAME, _MAX_JPEG_PIXELS = (*range(50, 100, 5), 98, 100), 0.9, 1_000_000
# Maximum number of places at which to look for the reference picture in a larger picture, and
# maximum share of its pixels that may differ by more than one level there.
_MAX_PLACES, _MAX_DIFFERENT = 100, 0.005


def find_light_changes(submission: Submission) -> tuple[Array, Array] | None:
    """Find the lights that are missing, or wrongly present, at each wrong pixel of a submission.

    Each wrong pixel is rendered with every set of lights.  Among the sets that give the submitted
    codes within one level, the set closest to that of the reference picture is used.

    Parameters
    ----------
    submission : Submission
        The picture that a student submitted, and the renderer of its scene.

    Returns
    -------
    is_lost : (lights, n) bool array
        For each light of the scene and each of the n pixels of the picture, true if the light
        should reach the pixel, but does not.
    is_extra : (lights, n) bool array
        True if the light should be blocked, but reaches the pixel.

    Both arrays are false at pixels that are right, or that no set of lights explains.  The result
    is None if no pixels or more than `MAX_PIXELS` are wrong, if the scene is unknown, or if it has
    no lights or more than `_MAX_LIGHTS`.
    """
    renderer, pixels = submission.renderer, np.flatnonzero(submission.is_wrong)
    if not 0 < len(pixels) <= MAX_PIXELS or "light-first" not in renderer.mistakes:
        return None
    is_lit = renderer.evaluate([renderer.base_formulas], pixels, formula="lit")[0]
    light_count = len(is_lit)
    if not 0 < light_count <= _MAX_LIGHTS:
        return None
    light_sets = [*product((False, True), repeat=light_count)]
    formula_sets = [
        parse_formulas(f"lit = array({[*lights]})[:, None] & (distance > 0)")
        for lights in light_sets
    ]
    codes = renderer.evaluate(formula_sets, pixels, submission.codes)
    # For each set and pixel, the number of lights that differ from the right ones; more than the
    # number of all lights if the set does not give the submitted codes.
    set_has_light = np.array(light_sets)
    change_count = (is_lit != set_has_light[:, :, None]).sum(axis=1)
    change_count[level_difference(codes, submission.codes[:, pixels]) > 1] = light_count + 1
    has_light = set_has_light[change_count.argmin(axis=0)].T
    has_light = np.where(change_count.min(axis=0) <= light_count, has_light, is_lit)
    is_lost, is_extra = np.zeros((2, light_count, renderer.pixel_count), dtype=np.bool_)
    is_lost[:, pixels], is_extra[:, pixels] = is_lit & ~has_light, has_light & ~is_lit
    return is_lost, is_extra


def is_speckled(submission: Submission) -> bool:
    """Test whether rounding causes shadow acne: random dark dots where surfaces shadow themselves.

    Surfaces have such dots if (1) nearly all wrong pixels lack light; and (2) along rows and along
    columns, neighbouring pixels of a surface differ nearly as often as if each pixel were dark by
    chance.

    Parameters
    ----------
    submission : Submission
        The picture that a student submitted, and the renderer of its scene.
    """
    renderer = submission.renderer
    if renderer.pixel_count > MAX_PIXELS or not (changes := find_light_changes(submission)):
        return False
    is_lost, is_extra = changes
    is_dark = is_lost.any(axis=0) & ~is_extra.any(axis=0)
    dark_count = is_dark.sum()
    has_other_errors = submission.wrong_count - dark_count > _MAX_OTHERS * dark_count
    if has_other_errors or dark_count <= _MIN_SPECKLES * renderer.pixel_count:
        return False
    every_pixel, surface = np.arange(renderer.pixel_count), renderer.surface_index
    is_lit = renderer.evaluate([renderer.base_formulas], every_pixel, formula="lit")[0].any(axis=0)
    is_lit &= np.isin(surface, surface[is_dark])
    dark_share = dark_count / is_lit.sum()
    maps = (pixels.reshape(-1, renderer.width) for pixels in (is_lit, is_dark, surface))
    is_lit, is_dark, surface = maps
    for axis in (0, 1):
        has_same_surface = surface == np.roll(surface, 1, axis)
        are_both_lit = is_lit & np.roll(is_lit, 1, axis) & has_same_surface
        differing_count = (are_both_lit & (is_dark != np.roll(is_dark, 1, axis))).sum()
        independent_count = 2 * dark_share * (1 - dark_share) * are_both_lit.sum()
        if differing_count <= _MIN_RANDOMNESS * independent_count:
            return False
    return True


def is_decided_by_rounding(submission: Submission) -> bool:
    """Test whether rounding explains all pixels that differ by more than one level.

    Rounding explains these pixels if (1) they are few; and (2) the codes of each lie between those
    that a correct tracer gives when the sample in the pixel, or the origin of its shadow rays, is
    moved slightly.

    Parameters
    ----------
    submission : Submission
        The picture that a student submitted, and the renderer of its scene.
    """
    renderer = submission.renderer
    pixels = np.flatnonzero(level_difference(renderer.reference_codes, submission.codes) > 1)
    if not 0 < len(pixels) <= max(1, _MAX_TIES * renderer.pixel_count):
        return False
    offsets = 0.5 - _TIE_OFFSET, 0.5, 0.5 + _TIE_OFFSET
    formula_sets = [
        sample_position_formulas(x, y)
        | parse_formulas(f"shadow_p = p + {lift} * sqrt(dot(p, p)) * n")
        for x, y, lift in product(offsets, offsets, _TIE_LIFTS)
    ]
    codes = renderer.evaluate(formula_sets, pixels).astype(np.int16)
    low, high = codes.min(axis=0) - 1, codes.max(axis=0) + 1
    submitted_codes = submission.codes[:, pixels]
    return bool(((submitted_codes >= low) & (submitted_codes <= high)).all())


def is_jpeg_of_reference(submitted_codes: Codes, reference_codes: Codes) -> bool:
    """Test whether a submitted picture is the reference picture after JPEG compression.

    The reference picture is compressed with several qualities.  One of the results must agree with
    the submitted picture within one level, both in most of all pixels and in most of those in which
    the submitted picture differs from the original reference picture.

    Parameters
    ----------
    submitted_codes, reference_codes : (h, w, 3) uint8 arrays
        Codes of both pictures.

    Returns
    -------
    bool
        False if the pictures are too large to try, or if they agree within one level.
    """
    is_wrong = level_difference(submitted_codes, reference_codes, 2) > 1
    if is_wrong.size > _MAX_JPEG_PIXELS or not is_wrong.any():
        return False
    image = Image.fromarray(reference_codes)
    for quality, subsampling in product(_QUALITIES, (0, 2)):
        jpeg_file = io.BytesIO()
        image.save(jpeg_file, "JPEG", quality=quality, subsampling=subsampling)
        agrees = level_difference(np.asarray(Image.open(jpeg_file)), submitted_codes, 2) <= 1
        if min(agrees[is_wrong].mean(), agrees.mean()) >= _MIN_SAME:
            return True
    return False


def _nearly_agree(first: Codes, second: Codes) -> bool:
    """Test whether two pictures differ by more than one level in at most one pixel in 200.

    Parameters
    ----------
    first, second : (h, w, 3) uint8 arrays
        Codes of two pictures of equal size.
    """
    return bool((level_difference(first, second, 2) > 1).mean() <= _MAX_DIFFERENT)


def find_reference_within(submitted_codes: Codes, reference_codes: Codes) -> tuple[str, str] | None:
    """Recognise a submitted picture that is the reference picture, enlarged or with a border.

    Parameters
    ----------
    submitted_codes : (h, w, 3) uint8 array
        Codes of the submitted picture.
    reference_codes : (h', w', 3) uint8 array
        Codes of the reference picture, which has another size.

    Returns
    -------
    tuple of 2 str, or None
        The keyword "enlarged" or "border", and a sentence for the report.  None if the submitted
        picture does not contain the reference picture.
    """
    height, width = reference_codes.shape[:2]
    factor = len(submitted_codes) // height
    # Compare the sizes first, because an enlarged picture might not fit in memory.
    if submitted_codes.shape[:2] == (factor * height, factor * width) and _nearly_agree(
        submitted_codes, reference_codes.repeat(factor, axis=0).repeat(factor, axis=1)
    ):
        return "enlarged", f"It is the right picture, enlarged {factor} times."
    row_count = len(submitted_codes) - height + 1
    column_count = submitted_codes.shape[1] - width + 1
    if row_count <= 0 or column_count <= 0:
        return None
    # Find the places of the upper left corner where a random selection of pixels agrees.
    agrees = np.ones((row_count, column_count), dtype=np.bool_)
    for row, column in np.random.default_rng(1).integers((height, width), size=(50, 2)):
        window = submitted_codes[row : row + row_count, column : column + column_count]
        agrees &= level_difference(window, reference_codes[row, column], 2) <= 1
    for row, column in np.argwhere(agrees)[:_MAX_PLACES]:
        crop = submitted_codes[row : row + height, column : column + width]
        if _nearly_agree(crop, reference_codes):
            return "border", "It is the right picture, with a border."
    return None


def find_edge_with_all_wrong(is_wrong: Array) -> str:
    """Name the outermost row or column of a picture that contains all wrong pixels.

    Parameters
    ----------
    is_wrong : (h, w) bool array
        True for pixels that differ from the reference picture.

    Returns
    -------
    str
        "first row", "last row", "first column" or "last column"; empty if none of them contains all
        wrong pixels, or if no pixel is wrong.
    """
    edges = {"first row": is_wrong[0], "last row": is_wrong[-1],
             "first column": is_wrong[:, 0], "last column": is_wrong[:, -1]}  # fmt: skip
    return next((name for name, edge in edges.items() if edge.sum() == is_wrong.sum() > 0), "")


def find_symptom(submission: Submission) -> tuple[str, str] | None:
    """Recognise a difference that no wrong formula causes, such as rounding or JPEG compression.

    Parameters
    ----------
    submission : Submission
        The picture that a student submitted, and the renderer of its scene.

    Returns
    -------
    tuple of 2 str, or None
        A keyword, such as "single-precision", and a sentence for the report.  None if no such
        difference is recognised.
    """
    renderer, wrong_count = submission.renderer, submission.clearly_wrong_count
    width, both_codes = renderer.width, (submission.codes, renderer.reference_codes)
    if wrong_count and is_decided_by_rounding(submission):
        sentence = f"{count_pixels(wrong_count)} where rounding decides, as in single precision."
        return "single-precision", sentence
    if is_speckled(submission):
        sentence = "Surfaces shadow themselves in dark dots: shadow rays need an epsilon."
        return "shadow-speckles", sentence
    if is_jpeg_of_reference(*(to_picture(codes, width) for codes in both_codes)):
        return "format", "It is the right picture, after JPEG, which changes levels."
    if edge := find_edge_with_all_wrong((level_difference(*both_codes) > 1).reshape(-1, width)):
        return "edge", f"It is the right picture, except in the {edge}."
    return None


def count_pixels(count: int, singular: str = "differs", plural: str = "differ") -> str:
    """Put a number of pixels and a verb into words, as in "12 pixels differ".

    Parameters
    ----------
    count : int
        Number of pixels.
    singular, plural : str
        The verb for one pixel, and for several.
    """
    return f"One pixel {singular}" if count == 1 else f"{count:,} pixels {plural}"
