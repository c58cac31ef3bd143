"""Recognise what no formula causes: rounding, dark dots, parts not rendered, JPEG, borders.

A *submitted picture* is one that a student handed in; the *reference picture* is what it should be.
Pictures consist of 8-bit codes.  A pixel of a submission is *wrong* if it differs from the
reference picture by more than the submission's tolerance.

A recognised symptom is reported as a keyword, such as "border", and a sentence for the report.
"""

from __future__ import annotations

import io
from itertools import product
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np
from PIL import Image

from reference.handins.mistakes import make_sample_formulas, parse_formulas
from reference.handins.renderer import MAX_PIXELS, MistakeRenderer
from reference.handins.search import Submission
from reference.judges.arrays import Bools, Ints
from reference.pictures import Codes, compare_levels, to_rows

# Maximum number of lights for which all sets of lights are tried at each pixel.
_MAX_LIGHTS = 4
# Rounding may explain at most this share of the pixels.
_MAX_ROUNDED_SHARE = 0.001
# To test whether rounding explains a pixel, the pixel's sample is moved by this many pixels.
_SAMPLE_OFFSET = 0.05
# For the same test, the origins of its shadow rays are lifted from the surface by these multiples
# of their distance from the origin of coordinates.
_SHADOW_LIFTS = (-1e-3, 0, 1e-3)
# Speckles: minimum share of the picture that loses light.
_MIN_SPECKLE_SHARE = 0.005
# Maximum share of the lit pixels of the speckled surfaces that lose light: above, they are black.
_MAX_SPECKLE_SHARE = 0.97
# Maximum number of other wrong pixels, relative to the pixels that lose light.
_MAX_OTHER_ERRORS = 0.1
# In random dots, pixels that are two apart differ as often as neighbours; at the edges of a dark
# region, twice as often.  Limits of the ratio: acne had .68 to 1.05, other errors from 1.4.
_RANDOM_RATIOS = (0.5, 1.2)
# Minimum number of neighbours that differ: whole black surfaces have a few such at their edges.
_MIN_CHANGES = 10
# Qualities of JPEG to try.
_QUALITIES = (*range(50, 100, 5), 98, 100)
# Maximum size of a picture to try them on, in pixels.
_MAX_JPEG_PIXELS = 1_000_000
# Compression or smoothing must explain at least this share of the wrong pixels.
_MIN_SAME_SHARE = 0.9
# Maximum number of places at which to look for the reference picture in a larger picture.
_MAX_PLACES = 100
# Two pictures are similar if at most this share of the pixels differs by more than one level.
_MAX_WRONG_SHARE = 0.005
# At an edge, neighbouring pixels differ by more than this many levels.
_MIN_EDGE_LEVELS = 24
# Antialiasing changes at least this share of the pixels at edges.
_MIN_SMOOTHED_SHARE = 0.25
# Sides of tiles in which pictures are rendered, in pixels.
_TILE_SIDES = (128, 100, 64, 50, 32, 25, 20, 16, 10, 8)
# A palette has at most this many colours.
_PALETTE_SIZE = 256
# A palette changes nearly all levels by at most this much.
_MAX_PALETTE_LEVELS = 32
# A palette makes some levels higher and others lower: their mean changes by at most this share of
# the mean size of the changes.
_MAX_PALETTE_BIAS = 0.5
# How programs scale pictures.
_SCALINGS = (
    Image.Resampling.NEAREST,
    Image.Resampling.BOX,
    Image.Resampling.BILINEAR,
    Image.Resampling.BICUBIC,
    Image.Resampling.LANCZOS,
)


def find_symptom(submission: Submission) -> tuple[str, str] | None:
    """Recognise what is wrong with a picture as a whole; None if nothing is recognised.

    Return the keyword and the sentence of the symptom.
    """
    renderer, wrong_count = submission.renderer, submission.clearly_wrong_count
    both_codes = submission.codes, renderer.reference_codes
    if wrong_count and is_explained_by_rounding(submission):
        sentence = f"{format_count(wrong_count)} where rounding decides, as in single precision."
        return "single-precision", sentence
    submitted_codes, reference_codes = (to_rows(codes, renderer.width) for codes in both_codes)
    is_wrong = compare_levels(submitted_codes, reference_codes, axis=2) > 1
    if part := find_unrendered_part(submitted_codes, is_wrong):
        return "unrendered", f"It is the right picture, except that {part}."
    if is_speckled(submission):
        sentence = "Surfaces shadow themselves in dark dots: shadow rays need an epsilon."
        return "shadow-speckles", sentence
    if is_smoothed(submitted_codes, reference_codes):
        return "smoothed", "It is the right picture with smooth edges: antialiased or blurred."
    if has_palette(submitted_codes, reference_codes):
        return "palette", "It is the right picture in few colours, as from a palette."
    if is_jpeg_of_reference(submitted_codes, reference_codes):
        return "format", "It is the right picture after JPEG compression, which changes levels."
    if edge := find_wrong_edge(is_wrong):
        return "edge", f"It is the right picture, except in the {edge}."
    return None


class LightErrors(NamedTuple):
    """For each light of a scene and each pixel of a picture, whether the light is wrong."""

    is_missing: Shaped[Bools, "lights n"]  # should reach the pixel, but does not
    is_extra: Shaped[Bools, "lights n"]  # should be blocked, but reaches the pixel


def find_light_errors(submission: Submission) -> LightErrors | None:
    """Find the lights that wrongly shine, or fail to shine, on each wrong pixel.

    Each wrong pixel is rendered with every subset of the scene's lights.  If several subsets
    reproduce the submitted codes, the one with the fewest missing or extra lights is used; if none
    does, no light is missing or extra.

    The result is None if the scene is unknown, if the number of lights is 0 or above `_MAX_LIGHTS`,
    or if the number of wrong pixels is 0 or above `MAX_PIXELS`.
    """
    renderer, pixel_index = submission.renderer, np.flatnonzero(submission.is_wrong)
    # Without a scene, the renderer has no mistakes that concern lights.
    if not 0 < len(pixel_index) <= MAX_PIXELS or "light-first" not in renderer.mistakes:
        return None
    should_reach = renderer.evaluate([renderer.base_formulas], pixel_index, name="lit")[0]
    light_count = len(should_reach)
    if not 0 < light_count <= _MAX_LIGHTS:
        return None
    light_sets = [*product((False, True), repeat=light_count)]
    formula_maps = [
        parse_formulas(f"lit = array({[*light_set]})[:, None] & (distance > 0)")
        for light_set in light_sets
    ]
    codes = renderer.evaluate(formula_maps, pixel_index, submission.codes)
    # For each set and pixel, the number of missing and extra lights.
    is_in_set = np.array(light_sets)
    error_count = (should_reach != is_in_set[:, :, None]).sum(axis=1)
    # Sets that do not reproduce the submitted codes get a number larger than any other.
    error_count[compare_levels(codes, submission.codes[:, pixel_index]) > 1] = light_count + 1
    does_reach = is_in_set[error_count.argmin(axis=0)].T
    does_reach = np.where(error_count.min(axis=0) <= light_count, does_reach, should_reach)
    is_light_missing, is_light_extra = np.zeros((2, light_count, renderer.pixel_count), np.bool_)
    is_light_missing[:, pixel_index] = should_reach & ~does_reach
    is_light_extra[:, pixel_index] = does_reach & ~should_reach
    return LightErrors(is_light_missing, is_light_extra)


def find_black_surfaces(submission: Submission) -> list[int]:
    """Find the surfaces that are black in the submitted picture, if they have all wrong pixels.

    The result is empty if pixels of other surfaces, or of the background, are wrong, too.
    """
    surface_index = submission.renderer.surface_index
    wrong_surfaces = np.unique(surface_index[submission.is_wrong])
    codes = submission.codes[:, np.isin(surface_index, wrong_surfaces)]
    return [] if codes.any() or -1 in wrong_surfaces else [*map(int, wrong_surfaces)]


def is_speckled(submission: Submission) -> bool:
    """Test for shadow acne: dark dots where surfaces shadow themselves because of rounding.

    If there is shadow acne, nearly all wrong pixels lack light, and they are randomly scattered
    over some faces.  Rounding may darken other faces completely.
    """
    renderer = submission.renderer
    if renderer.pixel_count > MAX_PIXELS or not (light_errors := find_light_errors(submission)):
        return False
    is_light_missing, is_light_extra = light_errors
    is_dark = is_light_missing.any(axis=0) & ~is_light_extra.any(axis=0)
    dark_count = is_dark.sum()
    has_other_errors = submission.wrong_count - dark_count > _MAX_OTHER_ERRORS * dark_count
    if has_other_errors or dark_count <= _MIN_SPECKLE_SHARE * renderer.pixel_count:
        return False
    is_lit = renderer.evaluate_everywhere("lit").any(axis=0)
    face = np.where(is_lit, _number_faces(renderer), -1)
    has_dark_pixels = np.isin(renderer.surface_index, renderer.surface_index[is_dark])
    dark_share = dark_count / (is_lit & has_dark_pixels).sum()
    return dark_share <= _MAX_SPECKLE_SHARE and all(
        _is_random(is_dark.reshape(-1, renderer.width), face.reshape(-1, renderer.width), axis)
        for axis in (0, 1)
    )


def _number_faces(renderer: MistakeRenderer) -> Shaped[Ints, "n"]:
    """Number the faces of all surfaces; a sphere has one.  Return the face in each pixel."""
    normal = renderer.evaluate_everywhere("n")
    axis = np.abs(normal).argmax(axis=0)
    is_negative = np.take_along_axis(normal, axis[None], axis=0)[0] < 0
    face_of_box = 2 * axis + is_negative
    is_on_sphere = renderer.evaluate_everywhere("on_sphere")
    face: Ints = 6 * renderer.surface_index + np.where(is_on_sphere, 0, face_of_box)
    return face


def _is_random(is_dark: Shaped[Bools, "h w"], face: Shaped[Ints, "h w"], axis: int) -> bool:
    """Test whether dark pixels are scattered at random on their faces, along one axis.

    `face`: number of the face that each pixel shows; negative for pixels to ignore.
    """
    # How many neighbours differ, and how often pixels of one face differ that are 1 or 2 apart.
    neighbour_changes, frequencies = 0, []
    for shift in (1, 2):
        is_comparable = (face >= 0) & (face == np.roll(face, shift, axis))
        has_change = is_comparable & (is_dark != np.roll(is_dark, shift, axis))
        neighbour_changes = neighbour_changes or int(has_change.sum())
        frequencies.append(has_change.sum() / max(1, is_comparable.sum()))
    if neighbour_changes <= _MIN_CHANGES:
        return False
    low, high = _RANDOM_RATIOS
    return bool(low <= frequencies[1] / frequencies[0] <= high)


def is_explained_by_rounding(submission: Submission) -> bool:
    """Test whether rounding explains all pixels that differ by more than one level, if any.

    If there are few, they are rendered again several times, with slightly moved samples and shadow
    rays.  Rounding explains a pixel if its submitted codes lie between the smallest and the largest
    rendered codes, or within one level of them.
    """
    renderer = submission.renderer
    pixel_index = np.flatnonzero(compare_levels(renderer.reference_codes, submission.codes) > 1)
    if not 0 < len(pixel_index) <= max(1, _MAX_ROUNDED_SHARE * renderer.pixel_count):
        return False
    positions = 0.5 - _SAMPLE_OFFSET, 0.5, 0.5 + _SAMPLE_OFFSET
    formula_maps = [
        make_sample_formulas(x, y) | parse_formulas(f"shadow_p = p + {lift} * sqrt(dot(p, p)) * n")
        for x, y, lift in product(positions, positions, _SHADOW_LIFTS)
    ]
    codes = renderer.evaluate(formula_maps, pixel_index).astype(np.int16)
    min_codes, max_codes = codes.min(axis=0) - 1, codes.max(axis=0) + 1
    submitted_codes = submission.codes[:, pixel_index]
    return bool(((submitted_codes >= min_codes) & (submitted_codes <= max_codes)).all())


def is_jpeg_of_reference(
    submitted_codes: Shaped[Codes, "h w 3"], reference_codes: Shaped[Codes, "h w 3"]
) -> bool:
    """Test whether a submitted picture is the reference picture after JPEG compression.

    The reference picture is compressed at several qualities; one result must agree with the
    submitted picture in most pixels.  The test is false for pictures that are too large to try, or
    that agree within one level without compression.
    """
    is_wrong = compare_levels(submitted_codes, reference_codes, axis=2) > 1
    if is_wrong.size > _MAX_JPEG_PIXELS or not is_wrong.any():
        return False
    image = Image.fromarray(reference_codes)
    for quality, subsampling in product(_QUALITIES, (0, 2)):
        jpeg_file = io.BytesIO()
        image.save(jpeg_file, "JPEG", quality=quality, subsampling=subsampling)
        agrees = compare_levels(np.asarray(Image.open(jpeg_file)), submitted_codes, axis=2) <= 1
        # Most pixels must agree, including most of those that were wrong without compression.
        if min(agrees[is_wrong].mean(), agrees.mean()) >= _MIN_SAME_SHARE:
            return True
    return False


def _are_similar(first_codes: Shaped[Codes, "h w 3"], second_codes: Shaped[Codes, "h w 3"]) -> bool:
    """Test whether two pictures agree within one level in nearly all pixels."""
    return bool((compare_levels(first_codes, second_codes, axis=2) > 1).mean() <= _MAX_WRONG_SHARE)


def find_reference_within(
    submitted_codes: Shaped[Codes, "h w 3"], reference_codes: Shaped[Codes, "h2 w2 3"]
) -> tuple[str, str] | None:
    """Recognise the reference picture, enlarged or with a border, in a picture of another size."""
    height, width = reference_codes.shape[:2]
    factor = len(submitted_codes) // height
    # Compare the sizes first, because an enlarged picture might not fit in memory.
    if submitted_codes.shape[:2] == (factor * height, factor * width) and _are_similar(
        submitted_codes, reference_codes.repeat(factor, axis=0).repeat(factor, axis=1)
    ):
        return "enlarged", f"It is the right picture, enlarged {factor} times."
    size = submitted_codes.shape[1], len(submitted_codes)
    image = Image.fromarray(reference_codes)
    if any(
        _are_similar(submitted_codes, np.asarray(image.resize(size, scaling)))
        for scaling in _SCALINGS
    ):
        return "scaled", "It is the right picture, scaled."
    row_count = len(submitted_codes) - height + 1
    column_count = submitted_codes.shape[1] - width + 1
    if row_count <= 0 or column_count <= 0:
        return None
    # Find the possible positions of the reference picture's upper left corner: those at which 50
    # randomly chosen pixels agree.
    may_be_corner = np.ones((row_count, column_count), dtype=np.bool_)
    for row, column in np.random.default_rng(1).integers((height, width), size=(50, 2)):
        # The codes that the submitted picture has at this pixel, for each position of the corner.
        codes = submitted_codes[row : row + row_count, column : column + column_count]
        may_be_corner &= compare_levels(codes, reference_codes[row, column], axis=2) <= 1
    for row, column in np.argwhere(may_be_corner)[:_MAX_PLACES]:
        crop = submitted_codes[row : row + height, column : column + width]
        if _are_similar(crop, reference_codes):
            return "border", "It is the right picture, with a border."
    return None


def find_unrendered_part(
    submitted_codes: Shaped[Codes, "h w 3"], is_wrong: Shaped[Bools, "h w"]
) -> str:
    """Describe the rows, columns or tiles that are black and contain all wrong pixels.

    The result is empty if there are none, or if no pixel is wrong.
    """
    is_black = np.equal(submitted_codes.max(axis=2), 0)
    if not is_wrong.any() or (is_wrong & ~is_black).any():
        return ""
    return (
        _describe_black_lines(is_black, is_wrong, "row")
        or _describe_black_lines(is_black.T, is_wrong.T, "column")
        or _describe_black_tiles(is_black, is_wrong)
    )


def _describe_black_lines(
    is_black: Shaped[Bools, "lines n"], is_wrong: Shaped[Bools, "lines n"], noun: str
) -> str:
    """Describe the lines (rows or columns) that are black, if all wrong pixels lie in them.

    Return "" if a wrong pixel lies in a line that is not black, unless all pixels from the first
    wrong one on are black.
    """
    wrong_lines = np.flatnonzero(np.logical_or.reduce(is_wrong, axis=1))
    black_lines = {*np.flatnonzero(np.logical_and.reduce(is_black, axis=1)).tolist()}
    first, last = int(wrong_lines[0]), int(wrong_lines[-1])
    # Rendering may have ended within a line.
    if is_black.ravel()[is_wrong.ravel().argmax() :].all():
        return f"it is black from {noun} {first} on"
    if not black_lines.issuperset(wrong_lines.tolist()):
        return ""
    if first == last:
        return f"{noun} {first} is black"
    # Lines in between may be black in the right picture, too.
    if black_lines.issuperset(range(first, last + 1)):
        return f"{noun}s {first} to {last} are black"
    if {*np.diff(wrong_lines).tolist()} == {2}:
        return f"every second {noun} is black, from {noun} {first} on"
    return f"{len(wrong_lines)} {noun}s are black, the first of them {noun} {first}"


def _describe_black_tiles(is_black: Shaped[Bools, "h w"], is_wrong: Shaped[Bools, "h w"]) -> str:
    """Describe the largest tiles that are black and contain all wrong pixels."""
    height, width = is_black.shape
    for side in _TILE_SIDES:
        corners = product(range(0, height, side), range(0, width, side))
        tiles = [np.s_[row : row + side, column : column + side] for row, column in corners]
        wrong_tiles = [tile for tile in tiles if is_wrong[tile].any()]
        if all(is_black[tile].all() for tile in wrong_tiles):
            noun, verb = ("tile", "is") if len(wrong_tiles) == 1 else ("tiles", "are")
            return f"{len(wrong_tiles)} {noun} of {side} x {side} pixels {verb} black"
    return ""


def is_smoothed(
    submitted_codes: Shaped[Codes, "h w 3"], reference_codes: Shaped[Codes, "h w 3"]
) -> bool:
    """Test whether a picture is the reference picture, antialiased or blurred.

    All codes then lie between those of the neighbouring pixels, within one level, and many lie
    strictly between them.  Many pixels at edges change; in a picture whose highlights are a little
    off, these do not.
    """
    neighbours = np.pad(reference_codes.astype(np.int16), ((1, 1), (1, 1), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(neighbours, (3, 3), axis=(0, 1))
    low, high = windows.min(axis=(-1, -2)), windows.max(axis=(-1, -2))
    is_between = (submitted_codes >= low - 1) & (submitted_codes <= high + 1)
    is_wrong = compare_levels(submitted_codes, reference_codes, axis=2) > 1
    is_strictly_between = ((submitted_codes > low + 1) & (submitted_codes < high - 1)).any(axis=2)
    is_edge = (high - low > _MIN_EDGE_LEVELS).any(axis=2)
    return bool(
        is_wrong.any()
        and is_edge.any()
        and is_wrong[is_edge].mean() >= _MIN_SMOOTHED_SHARE
        and is_between.all(axis=2).mean() >= 1 - _MAX_WRONG_SHARE
        and is_strictly_between[is_wrong].mean() >= _MIN_SAME_SHARE
    )


def has_palette(
    submitted_codes: Shaped[Codes, "h w 3"], reference_codes: Shaped[Codes, "h w 3"]
) -> bool:
    """Test whether a picture is the reference picture, reduced to few colours.

    A picture shaded in steps has few colours, too, but it is darker than the reference picture.  So
    a picture whose mean is shifted has no palette.
    """
    color_counts = [
        len(np.unique(codes.reshape(-1, 3), axis=0)) for codes in (submitted_codes, reference_codes)
    ]
    levels = compare_levels(submitted_codes, reference_codes, axis=2)
    changes = submitted_codes.astype(np.int16) - reference_codes
    return bool(
        abs(changes.mean()) <= _MAX_PALETTE_BIAS * np.abs(changes).mean()
        and color_counts[0] <= _PALETTE_SIZE
        and color_counts[1] >= 2 * color_counts[0]
        and (levels <= _MAX_PALETTE_LEVELS).mean() >= 1 - _MAX_WRONG_SHARE
    )


def find_wrong_edge(is_wrong: Shaped[Bools, "h w"]) -> str:
    """Find the edge ("first row", "last column", ...) that contains all wrong pixels of a picture.

    The result is empty if there is none, or if no pixel is wrong.
    """
    edges = {
        "first row": is_wrong[0],
        "last row": is_wrong[-1],
        "first column": is_wrong[:, 0],
        "last column": is_wrong[:, -1],
    }
    return next((name for name, edge in edges.items() if edge.sum() == is_wrong.sum() > 0), "")


def format_count(count: int, singular: str = "differs", plural: str = "differ") -> str:
    """Format a number of pixels with a verb, as in "12 pixels differ"."""
    return f"One pixel {singular}" if count == 1 else f"{count:,} pixels {plural}"
