"""Define the functions that the formulas of `mistakes.md` call.

Vectors are (3, n) for n pixels, (lights, 3, n) for lights and (3, surfaces, 1) for surfaces.  A
*hit* is the point of a surface that a pixel shows.  Rays are o + t d, with origins `o` and
directions `d` of any length.  The *roots* of a ray and a surface are the smaller and the larger t
at which the ray's line crosses the surface; NaN if it misses it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated as Shaped
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from reference.pictures import Codes

Array: TypeAlias = NDArray[Any]

# Minimum t of a hit: a camera ray ignores surfaces that are closer to its origin.
_MIN_T = 1e-9

# An exponent is estimated only from pixels whose highlights could have more light than this.
_MIN_PEAK_LIGHT = 0.05

# Maximum number of pixels from which an exponent is estimated.
_MAX_FITTED_PIXELS = 1000

# The mean error of a whole exponent may be larger than that of the best exponent by this factor,
# because codes are rounded.
_MAX_ERROR_RATIO = 1.02

# Range of the exponents that are tried.
_MIN_EXPONENT = 0.1
_MAX_EXPONENT = 5000

# Number of exponents that are tried first, at equal ratios.
_FIRST_TRIAL_COUNT = 40


def normalize(vectors: Shaped[Array, "..."], axis: int = 0) -> Shaped[Array, "..."]:
    """Scale vectors, whose components are along an axis of the array, to length 1."""
    lengths: Array = np.sqrt((vectors * vectors).sum(axis=axis, keepdims=True))
    return vectors / lengths


def dot(
    vectors_a: Shaped[Array, "... 3 #n"], vectors_b: Shaped[Array, "... 3 #n"]
) -> Shaped[Array, "... #n"]:
    products: Array = (vectors_a * vectors_b).sum(axis=-2)
    return products


def select_vectors(
    surface_vectors: Shaped[Array, "3 surfaces 1"], surface_index: Shaped[Array, "n"]
) -> Shaped[Array, "3 n"]:
    """Look up a vector for each pixel, such as a centre, by the surface that the pixel shows."""
    return surface_vectors[:, surface_index, 0]


def intersect_spheres(
    centers: Shaped[Array, "3 spheres 1"],
    radii: Shaped[Array, "spheres 1"],
    o: Shaped[Array, "3 #n"],
    d: Shaped[Array, "3 #n"],
    *,
    assume_unit_d: bool = False,
) -> Shaped[Array, "2 spheres n"]:
    """Compute the roots of rays and spheres.

    `assume_unit_d` simulates the mistake of treating all directions as unit vectors.
    """
    # The ray's line crosses the sphere along a chord.  From its midpoint to its ends, t changes by
    # `half_chord_t`.
    to_center = [centers[axis] - o[axis] for axis in range(3)]
    midpoint_t = sum(to_center[axis] * d[axis] for axis in range(3))
    if assume_unit_d:
        squared_center_distance = sum(to_center[axis] * to_center[axis] for axis in range(3))
        half_chord_t = np.sqrt(midpoint_t * midpoint_t - squared_center_distance + radii * radii)
    else:
        squared_d_length = (d * d).sum(axis=0)
        midpoint_t = midpoint_t / squared_d_length
        squared_line_distance = sum(
            (to_center[axis] - midpoint_t * d[axis]) ** 2 for axis in range(3)
        )
        half_chord_t = np.sqrt((radii * radii - squared_line_distance) / squared_d_length)
    return np.stack([midpoint_t - half_chord_t, midpoint_t + half_chord_t])


def intersect_boxes(
    min_pt: Shaped[Array, "3 boxes 1"],
    max_pt: Shaped[Array, "3 boxes 1"],
    o: Shaped[Array, "3 #n"],
    d: Shaped[Array, "3 #n"],
    *,
    sort_crossings: bool = True,
    missing_face: int | None = None,
) -> Shaped[Array, "2 boxes n"]:
    """Compute the roots of rays and axis-aligned boxes.

    Parameters
    ----------
    sort_crossings
        False simulates the mistake of not sorting the values of t at two opposite faces.
    missing_face
        Simulates a box that lacks a face: 0 for that at the smallest x, 1 for that at the largest
        x, 2 and 3 for y, 4 and 5 for z.
    """
    entry_t, exit_t = -np.inf, np.inf
    for axis in range(3):
        first_t, second_t = (min_pt[axis] - o[axis]) / d[axis], (max_pt[axis] - o[axis]) / d[axis]
        if sort_crossings:
            first_t, second_t = np.minimum(first_t, second_t), np.maximum(first_t, second_t)
        entry_t, exit_t = np.maximum(entry_t, first_t), np.minimum(exit_t, second_t)
    roots = np.stack([entry_t, exit_t])
    if missing_face is not None:
        axis, is_max = divmod(missing_face, 2)
        face_t = ((max_pt if is_max else min_pt)[axis] - o[axis]) / d[axis]
        # Where a ray would cross the missing face, it crosses only the opposite one.
        roots = np.where(roots == face_t, roots[::-1], roots)
    return np.where(entry_t <= exit_t, roots, np.nan)


def make_scaled_intersect(intersect: Callable[..., Array], factor: float) -> Callable[..., Array]:
    """Make a faulty intersection function, which returns the correct roots times a factor."""
    return lambda *arguments: factor * intersect(*arguments)


def make_far_intersect(intersect: Callable[..., Array]) -> Callable[..., Array]:
    """Make a faulty intersection function, which returns the larger root in place of both."""
    return lambda *arguments: intersect(*arguments)[[1, 1]]


def make_intersect(
    is_sphere: Shaped[Array, "surfaces"],
    centers: Shaped[Array, "3 surfaces 1"],
    radii: Shaped[Array, "surfaces 1"],
    min_pt: Shaped[Array, "3 surfaces 1"],
    max_pt: Shaped[Array, "3 surfaces 1"],
    is_present: Shaped[Array, "surfaces"],
    intersect_sphere: Callable[..., Array],
    intersect_box: Callable[..., Array],
) -> Callable[[Array, Array], Array]:
    """Make a function that computes the roots of rays and the surfaces of a scene.

    It takes origins and directions (3, n), and returns roots (2, surfaces, n).  Rays miss surfaces
    that are not present.  `intersect_sphere` and `intersect_box` compute the roots; they have the
    parameters of `intersect_spheres` and `intersect_boxes`, but may be faulty.
    """
    sphere_index = np.flatnonzero(is_sphere & is_present)
    box_index = np.flatnonzero(~is_sphere & is_present)

    def intersect(
        o: Shaped[Array, "3 #n"], d: Shaped[Array, "3 #n"]
    ) -> Shaped[Array, "2 surfaces n"]:
        roots = np.full((2, len(is_sphere), d.shape[1]), np.nan)
        centers_and_radii = centers[:, sphere_index], radii[sphere_index]
        roots[:, sphere_index] = intersect_sphere(*centers_and_radii, o, d)
        roots[:, box_index] = intersect_box(min_pt[:, box_index], max_pt[:, box_index], o, d)
        return roots

    return intersect


def find_first_crossing(roots: Shaped[Array, "2 ..."]) -> Shaped[Array, "..."]:
    """Return the first of two roots that exceeds `_MIN_T`; infinity if neither does."""
    near_t, far_t = roots
    t = np.where(near_t > _MIN_T, near_t, far_t)
    return np.where(t > _MIN_T, t, np.inf)


def intersect_shadow_rays(
    intersect: Callable[[Array, Array], Array],
    hits: Shaped[Array, "3 n"],
    shadow_directions: Shaped[Array, "lights 3 n"],
) -> Shaped[Array, "lights 2 surfaces k"]:
    """Compute the roots of the surfaces and of the shadow rays from all hits to all lights.

    `intersect` is a result of `make_intersect`.  Without lights, `surfaces` and `k` are 1, and the
    array is empty.
    """
    roots = [intersect(hits, directions) for directions in shadow_directions]
    return np.array(roots) if roots else np.zeros((0, 2, 1, 1))


def find_blocking_surfaces(
    shadow_roots: Shaped[Array, "lights 2 #surfaces #n"],
    min_t: Shaped[Array, "lights n"],
    max_t: Shaped[Array, "lights n"],
    is_tested: Shaped[Array, "surfaces n"],
    min_far_t: float | None = None,
) -> Shaped[Array, "lights surfaces n"]:
    """Test for each surface whether it stands between each hit and each light.

    It does if a root of the hit's shadow ray and the surface lies between `min_t` and `max_t`.

    Parameters
    ----------
    is_tested
        Whether a surface may block the light of a hit.  The surface that the hit lies on is one of
        those that may have to be ignored.
    min_far_t
        Replaces `min_t` for the larger root, to simulate a mistake.
    """
    is_blocking = []
    far_limits = min_t if min_far_t is None else np.full_like(min_t, min_far_t)
    rays_by_light = zip(shadow_roots, min_t, far_limits, max_t, strict=True)
    for (near_t, far_t), near_limit, far_limit, upper_limit in rays_by_light:
        first_t = np.where(near_t > near_limit, near_t, np.where(far_t > far_limit, far_t, np.nan))
        is_blocking.append((first_t < upper_limit) & is_tested)
    return np.array(is_blocking, dtype=bool).reshape(len(shadow_roots), *is_tested.shape)


def select_last_value(
    values: Shaped[Array, "... surfaces"], is_chosen: Shaped[Array, "surfaces"]
) -> Shaped[Array, "... 1"]:
    """Select the number or vector of the last chosen surface; zero if no surface is chosen."""
    chosen_index = np.flatnonzero(is_chosen)
    return values[..., chosen_index[-1:]] if chosen_index.size else 0 * values[..., :1]


def compute_box_normals(
    hits: Shaped[Array, "3 n"],
    min_pt: Shaped[Array, "3 n"],
    max_pt: Shaped[Array, "3 n"],
    axis_shift: int = 0,
    forced_sign: float | None = None,
    *,
    as_cube: bool = False,
) -> Shaped[Array, "3 n"]:
    """Compute the unit normals of boxes at hits, correctly or with a simulated mistake.

    Parameters
    ----------
    min_pt, max_pt
        Opposite corners of the box at each hit, in any order.
    axis_shift
        Simulates confused axes: with 1, normals of x-faces lie along y; with 2, along z.
    forced_sign
        Simulates the mistake of giving all normals this sign, 1 or -1.  By default, normals point
        outward.
    as_cube
        Simulates the mistake of taking the axis along which a hit is farthest from the centre.
    """
    from_center = hits - (min_pt + max_pt) / 2
    half_size = np.abs(max_pt - min_pt) / 2
    distances = np.abs(from_center)
    face_axis = (distances if as_cube else -np.abs(distances - half_size)).argmax(axis=0)
    face_coordinate = np.take_along_axis(from_center, face_axis[None], axis=0)[0]
    sign = np.where(face_coordinate < 0, -1.0, 1.0) if forced_sign is None else forced_sign
    return np.eye(3)[:, (face_axis + axis_shift) % 3] * sign


def convert_to_grey(
    weights: tuple[float, float, float], channels: Shaped[Array, "3 n"]
) -> Shaped[Array, "3 n"]:
    """Replace each channel with the weighted mean of all channels."""
    # Without the tiny addend, rounding could make the mean of equal integers slightly too small.
    grey: Array = np.tensordot(weights, channels, 1) + 1e-9 + 0 * channels
    return grey


def compute_median(
    is_selected: Shaped[Array, "3 n"], values: Shaped[Array, "3 n"], default: float
) -> float:
    """Compute the median of the selected values; the default if none is selected."""
    selected_values = values[is_selected]
    return float(np.median(selected_values)) if selected_values.size else default


def fit_exponent(
    is_typical: Shaped[Array, "3 n"],
    highlight_light: Shaped[Array, "3 n"],
    peak_light: Shaped[Array, "lights 3 n"],
    n_dot_h: Shaped[Array, "lights n"],
) -> float:
    """Estimate the exponent that all highlights of a submitted picture share.

    The result is a whole number if that fits nearly as well, and 1 if no highlight is strong
    enough.

    Parameters
    ----------
    is_typical
        Whether the code of a channel is precise enough to be used.
    highlight_light
        The light of the highlights alone in the submitted picture.
    peak_light
        The light of each highlight where `n_dot_h` is 1.
    n_dot_h
        Cosine of the angle between the normal and the direction halfway between eye and light.
    """
    has_highlight = is_typical.all(axis=0) & (peak_light > _MIN_PEAK_LIGHT).any(axis=(0, 1))
    pixel_index = np.flatnonzero(has_highlight)[:_MAX_FITTED_PIXELS]
    if not pixel_index.size:
        return 1.0
    fitted_light = highlight_light[:, pixel_index]
    fitted_peak_light = peak_light[..., pixel_index]
    cosine = np.maximum(n_dot_h[:, None, pixel_index], 0)

    def compute_error(exponent: float) -> float:
        light = (fitted_peak_light * cosine**exponent).sum(axis=0)
        return float(np.abs(fitted_light - light).mean())

    exponents = np.geomspace(_MIN_EXPONENT, _MAX_EXPONENT, _FIRST_TRIAL_COUNT)
    step = exponents[1] / exponents[0]
    for _ in range(5):
        exponent = float(min(exponents, key=compute_error))
        # Nine trials between the neighbours of the best one are a quarter of a step apart.
        exponents = exponent * np.geomspace(1 / step, step, 9)
        step = step**0.25
    whole = float(round(exponent))
    is_whole = compute_error(whole) <= _MAX_ERROR_RATIO * compute_error(exponent)
    return whole if is_whole else exponent


def find_background_color(
    is_hit: Shaped[Array, "n"], submitted_codes: Shaped[Codes, "3 n"]
) -> Shaped[Codes, "3 1"]:
    """Find the most frequent colour of the pixels without a hit; black if there are none."""
    if is_hit.all():
        return np.zeros((3, 1), dtype=np.uint8)
    colors, counts = np.unique(submitted_codes[:, ~is_hit], axis=1, return_counts=True)
    return colors[:, [counts.argmax()]]


def interpolate_light(
    picture: Shaped[Array, "height width 3"], x: Shaped[Array, "n"], y: Shaped[Array, "n"]
) -> Shaped[Array, "3 n"]:
    """Interpolate a picture in linear light at some positions.

    `x` and `y` are -0.5 at the left and lower edges of the picture, and 0.5 at the right and upper
    edges.  Positions outside the picture get the light of the nearest pixel.
    """
    height, width = picture.shape[:2]
    row_and_column = (0.5 - y) * height - 0.5, (x + 0.5) * width - 0.5
    channels = [
        map_coordinates(channel, row_and_column, np.float64, order=1, mode="nearest")
        for channel in np.moveaxis(picture, 2, 0)
    ]
    return np.array(channels)


def guess_hits(
    reference_picture: Shaped[Array, "height width 3"],
    x: Shaped[Array, "n"],
    y: Shaped[Array, "n"],
    submitted_codes: Shaped[Codes, "3 n"],
) -> Shaped[Array, "n"]:
    """Guess which pixels of a submitted picture show a surface when the scene is unknown.

    A pixel counts as background if it is black in the reference picture, in linear light, but not
    in the submitted picture.  `x` and `y` are as in `interpolate_light`.
    """
    is_bright = interpolate_light(reference_picture, x, y).any(axis=0)
    is_surface: Array = np.logical_or(is_bright, ~submitted_codes.any(axis=0))
    return is_surface
