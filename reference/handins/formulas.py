"""Compile the formulas of `mistakes.md`, and define the functions that they call.

A formula is a Python expression.  It becomes a function whose parameters are the names in the
expression, so that `reference.handins.drawing` can compute it from the values of other formulas.
Vectors are (3, n) for n pixels, (lights, 3, n) for lights and (3, surfaces, 1) for surfaces.  Rays
are o + t d, with origins `o` and directions `d`.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import cache, partial
from typing import Annotated as Shaped
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

Array: TypeAlias = NDArray[Any]
Formulas: TypeAlias = dict[str, Callable[..., Any]]

# Minimum t of a hit: a camera ray ignores surfaces that are closer to its origin.
_MIN_T = 1e-9
# Minimum light of the highlights from which an exponent is estimated.
_MIN_WEIGHT = 0.05
# Maximum number of pixels from which it is estimated.
_MAX_FITTED_PIXELS = 1000
# A whole number may fit this much worse than the best one: codes are rounded.
_WHOLE_MARGIN = 1.02


def normalize(vectors: Array, axis: int = 0) -> Array:
    """Scale vectors to length 1.

    Parameters
    ----------
    vectors : array
        Vectors of any length other than 0.
    axis : int
        Array axis that holds the three components of each vector.

    Returns
    -------
    array
        Unit vectors, in an array of the same shape.
    """
    lengths: Array = np.sqrt((vectors * vectors).sum(axis=axis, keepdims=True))
    return vectors / lengths


def dot(vectors_a: Array, vectors_b: Array) -> Array:
    """Compute the dot products of pairs of vectors.

    Parameters
    ----------
    vectors_a, vectors_b : (..., 3, n) arrays
        The vectors to multiply.

    Returns
    -------
    products : (..., n) array
    """
    products: Array = (vectors_a * vectors_b).sum(axis=-2)
    return products


def select_vectors(surface_vectors: Array, surface_index: Array) -> Array:
    """Look up a vector for each of n pixels, by the surface that the pixel shows.

    Parameters
    ----------
    surface_vectors : (3, surfaces, 1) array
        One vector for each surface of the scene, such as its centre.
    surface_index : (n,) int array
        Index of the surface that each pixel shows.

    Returns
    -------
    pixel_vectors : (3, n) array
    """
    return surface_vectors[:, surface_index, 0]


def intersect_spheres(
    centers: Array, radii: Array, o: Array, d: Array, *, assume_unit_d: bool = False
) -> Array:
    """Intersect each of n rays o + t d with each sphere.

    Parameters
    ----------
    centers, radii : (3, spheres, 1) and (spheres, 1) arrays
        Centres and radii of the spheres.
    o, d : (3, n) arrays
        Origins and directions of the rays.
    assume_unit_d : bool
        Whether to simulate the mistake of treating all directions as unit vectors.

    Returns
    -------
    roots : (2, spheres, n) array
        The smaller and the larger t at which each ray crosses each sphere; NaN if the ray's line
        misses the sphere.
    """
    # The ray's line crosses the sphere along a chord.  From its midpoint to its ends, t changes by
    # `half_chord_t`.  Names that end in 2 hold squares.
    to_center = [centers[axis] - o[axis] for axis in range(3)]
    midpoint_t = sum(to_center[axis] * d[axis] for axis in range(3))
    if assume_unit_d:
        center_distance2 = sum(to_center[axis] * to_center[axis] for axis in range(3))
        half_chord_t = np.sqrt(midpoint_t * midpoint_t - center_distance2 + radii * radii)
    else:
        d_length2 = (d * d).sum(axis=0)
        midpoint_t = midpoint_t / d_length2
        line_distance2 = sum((to_center[axis] - midpoint_t * d[axis]) ** 2 for axis in range(3))
        half_chord_t = np.sqrt((radii * radii - line_distance2) / d_length2)
    return np.stack([midpoint_t - half_chord_t, midpoint_t + half_chord_t])


def intersect_boxes(
    min_pt: Shaped[Array, "3 boxes 1"],
    max_pt: Shaped[Array, "3 boxes 1"],
    o: Shaped[Array, "3 n"],
    d: Shaped[Array, "3 n"],
    *,
    sort_crossings: bool = True,
    missing_face: int | None = None,
) -> Shaped[Array, "2 boxes n"]:
    """Intersect each of n rays o + t d with each axis-aligned box.

    The result is the smaller and the larger t at which each ray crosses each box; NaN if the ray's
    line misses the box.

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
    """Make a faulty intersection function, which returns the correct results times a factor.

    Parameters
    ----------
    intersect : callable
        The correct function.  It returns the values of t at which rays o + t d cross surfaces.
    factor : float
        The factor, such as 2.

    Returns
    -------
    callable
        A function with the same arguments as `intersect`.
    """
    return lambda *arguments: factor * intersect(*arguments)


def make_far_intersect(intersect: Callable[..., Array]) -> Callable[..., Array]:
    """Make a faulty intersection function, which returns the far crossing in place of the near one.

    Parameters
    ----------
    intersect : callable
        The correct function.  It returns an array (2, ...) with the smaller and the larger t at
        which rays o + t d cross surfaces.

    Returns
    -------
    callable
        A function with the same arguments, which returns the larger t in both rows.
    """
    return lambda *arguments: intersect(*arguments)[[1, 1]]


def make_intersect(
    is_sphere: Array, centers: Array, radii: Array, min_pt: Array, max_pt: Array, is_present: Array,
    intersect_sphere: Callable[..., Array], intersect_box: Callable[..., Array],
) -> Callable[[Array, Array], Array]:  # fmt: skip
    """Make a function that intersects rays o + t d with the spheres and boxes of a scene.

    Parameters
    ----------
    is_sphere : (surfaces,) bool array
        True for spheres, false for boxes.
    centers, radii : (3, surfaces, 1) and (surfaces, 1) arrays
        Centres and radii of the spheres; the entries of boxes are ignored.
    min_pt, max_pt : (3, surfaces, 1) arrays
        Opposite corners of the boxes; the entries of spheres are ignored.
    is_present : (surfaces,) bool array
        False for surfaces to leave out, which no ray hits.
    intersect_sphere, intersect_box : callable
        `intersect_spheres` and `intersect_boxes`, or faulty functions that replace them.

    Returns
    -------
    intersect : callable
        Takes the origins and directions (3, n) of rays.  Returns an array (2, surfaces, n) with the
        smaller and the larger t at which each ray crosses each surface; NaN where the ray's line
        misses the surface.
    """
    sphere_index = np.flatnonzero(is_sphere & is_present)
    box_index = np.flatnonzero(~is_sphere & is_present)

    def intersect(o: Array, d: Array) -> Array:
        """Return the two values of t (2, surfaces, n) at which each ray crosses each surface."""
        roots = np.full((2, len(is_sphere), d.shape[1]), np.nan)
        centers_and_radii = centers[:, sphere_index], radii[sphere_index]
        roots[:, sphere_index] = intersect_sphere(*centers_and_radii, o, d)
        roots[:, box_index] = intersect_box(min_pt[:, box_index], max_pt[:, box_index], o, d)
        return roots

    return intersect


def find_first_crossing(roots: Array) -> Array:
    """Find the smallest positive t at which each ray o + t d crosses each surface.

    Parameters
    ----------
    roots : (2, ...) array
        The smaller and the larger t at which a ray crosses a surface; NaN if the ray's line misses
        the surface.

    Returns
    -------
    t : (...) array
        The first of the two roots that exceeds `_MIN_T`, a tiny positive number; infinity if
        neither does.
    """
    near_t, far_t = roots
    t = np.where(near_t > _MIN_T, near_t, far_t)
    return np.where(t > _MIN_T, t, np.inf)


def intersect_shadow_rays(
    intersect: Callable[[Array, Array], Array], hits: Array, shadow_directions: Array
) -> Array:
    """Find where the shadow rays from n hits to all lights cross the surfaces.

    Parameters
    ----------
    intersect : callable
        A function returned by `make_intersect`.
    hits : (3, n) array
        Points on surfaces, where the shadow rays begin.
    shadow_directions : (lights, 3, n) array
        Vectors from each hit to each light.

    Returns
    -------
    roots : (lights, 2, surfaces, n) array
        The smaller and the larger t at which each shadow ray crosses each surface.  Empty if there
        are no lights.
    """
    roots = [intersect(hits, directions) for directions in shadow_directions]
    return np.array(roots) if roots else np.zeros((0, 2, 1, 1))


def find_blocking_surfaces(
    shadow_roots: Array, min_t: Array, max_t: Array, is_tested: Array,
    min_far_t: float | None = None,
) -> Array:  # fmt: skip
    """Find the surfaces that stand between each of n hits and each light.

    A shadow ray o + t d leads from each hit to each light.  A surface blocks the light if the ray
    crosses the surface between `min_t` and `max_t`.

    Parameters
    ----------
    shadow_roots : (lights, 2, surfaces, n) array
        The smaller and the larger t at which each shadow ray crosses each surface.
    min_t, max_t : (lights, n) arrays
        Limits of t for each shadow ray.
    is_tested : (surfaces, n) bool array
        False for surfaces to ignore at a hit, such as the surface that the hit lies on.
    min_far_t : float, optional
        Replaces `min_t` for the larger t of each surface, to simulate a mistake.

    Returns
    -------
    is_blocking : (lights, surfaces, n) bool array
        True if the surface stands between the hit and the light.
    """
    far_limits = min_t if min_far_t is None else np.full_like(min_t, min_far_t)
    is_blocking, rays_by_light = [], zip(shadow_roots, min_t, far_limits, max_t, strict=True)
    for (near_t, far_t), near_limit, far_limit, upper_limit in rays_by_light:
        first_t = np.where(near_t > near_limit, near_t, np.where(far_t > far_limit, far_t, np.nan))
        is_blocking.append((first_t < upper_limit) & is_tested)
    return np.array(is_blocking, dtype=bool).reshape(len(shadow_roots), *is_tested.shape)


def select_last_value(values: Array, is_chosen: Array) -> Array:
    """Select the value of the last chosen surface.

    Parameters
    ----------
    values : (..., surfaces) array
        One value or vector for each surface, such as its specular colour.
    is_chosen : (surfaces,) bool array
        True for the chosen surfaces.

    Returns
    -------
    value : (..., 1) array
        Zero if no surface is chosen.
    """
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
    """Compute the unit normals of boxes at n hits, correctly or with a simulated mistake.

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


def convert_to_grey(weights: tuple[float, float, float], channels: Array) -> Array:
    """Convert a picture to grey: replace each channel with the weighted mean of all channels.

    Parameters
    ----------
    weights : tuple of 3 floats
        Weights of red, green and blue.
    channels : (3, n) array
        Red, green and blue of n pixels.

    Returns
    -------
    (3, n) array
        Three equal rows.
    """
    # Without the tiny addend, rounding could make the mean of equal integers slightly too small.
    grey: Array = np.tensordot(weights, channels, 1) + 1e-9 + 0 * channels
    return grey


def compute_median(is_selected: Array, values: Array, default: float) -> float:
    """Compute the median of the selected values.

    Parameters
    ----------
    is_selected : (3, n) bool array
        True for the values to use.
    values : (3, n) array
        One value for each channel of n pixels.
    default : float
        The result if no value is selected.

    Returns
    -------
    float
    """
    selected_values = values[is_selected]
    return float(np.median(selected_values)) if selected_values.size else default


def fit_exponent(
    is_typical: Shaped[Array, "3 n"],
    measured_light: Shaped[Array, "3 n"],
    weights: Shaped[Array, "lights 3 n"],
    nh: Shaped[Array, "lights n"],
) -> float:
    """Estimate the exponent of all highlights of a submitted picture.

    `measured_light` is that of highlights alone, and `weights` their light where `nh` is 1.
    The result is a whole number if that fits as well.
    """
    # Use typical pixels with strong highlights, as many as show the exponent.
    has_highlight = is_typical.all(axis=0) & (weights > _MIN_WEIGHT).any(axis=(0, 1))
    pixel_index = np.flatnonzero(has_highlight)[:_MAX_FITTED_PIXELS]
    measured_light, weights = measured_light[:, pixel_index], weights[..., pixel_index]
    cosine = np.maximum(nh[:, None, pixel_index], 0)
    if not pixel_index.size:
        return 1.0

    def compute_error(exponent: float) -> float:
        light = (weights * cosine**exponent).sum(axis=0)
        return float(np.abs(measured_light - light).mean())

    exponents, step = np.geomspace(0.1, 5000, 40), (5000 / 0.1) ** (1 / 39)
    for _ in range(5):
        exponent = float(min(exponents, key=compute_error))
        exponents, step = exponent * np.geomspace(1 / step, step, 9), step**0.25
    whole = float(round(exponent))
    is_whole = compute_error(whole) <= _WHOLE_MARGIN * compute_error(exponent)
    return whole if is_whole else exponent


def find_background_color(is_hit: Array, submitted_codes: Array) -> Array:
    """Find the most frequent background colour of a submitted picture.

    Parameters
    ----------
    is_hit : (n,) bool array
        True for pixels that show a surface, false for background pixels.
    submitted_codes : (3, n) uint8 array
        8-bit codes of the picture.

    Returns
    -------
    color : (3, 1) uint8 array
        Black if there is no background.
    """
    if is_hit.all():
        return np.zeros((3, 1), dtype=np.uint8)
    colors, counts = np.unique(submitted_codes[:, ~is_hit], axis=1, return_counts=True)
    return colors[:, [counts.argmax()]]


def interpolate_light(picture: Array, x: Array, y: Array) -> Array:
    """Interpolate a picture linearly at n positions.

    Parameters
    ----------
    picture : (h, w, 3) array
        Linear light at the centre of each pixel.
    x, y : (n,) arrays
        The positions: -0.5 at the left and lower edges of the picture, and 0.5 at the right and
        upper edges.

    Returns
    -------
    light : (3, n) array
        Linear light at each position; outside the picture, the light of the nearest pixel.
    """
    height, width = picture.shape[:2]
    row_and_column = (0.5 - y) * height - 0.5, (x + 0.5) * width - 0.5
    return np.array([map_coordinates(channel, row_and_column, np.float64, order=1, mode="nearest")
                     for channel in np.moveaxis(picture, 2, 0)])  # fmt: skip


def guess_hits(reference_picture: Array, x: Array, y: Array, submitted_codes: Array) -> Array:
    """Guess which pixels of a submitted picture show a surface when the scene is unknown.

    A pixel counts as background if it is black in the reference picture, but not in the submitted
    picture.

    Parameters
    ----------
    reference_picture : (h, w, 3) array
        Linear light of the reference picture.
    x, y : (n,) arrays
        For each pixel, the position in the reference picture: -0.5 at the left and lower edges, and
        0.5 at the right and upper edges.
    submitted_codes : (3, n) uint8 array
        8-bit codes of the submitted picture.

    Returns
    -------
    is_surface : (n,) bool array
        False for background pixels.
    """
    is_bright = interpolate_light(reference_picture, x, y).any(axis=0)
    is_surface: Array = np.logical_or(is_bright, ~submitted_codes.any(axis=0))
    return is_surface


_OWN_FUNCTIONS: tuple[Callable[..., Any], ...] = (
    normalize, dot, select_vectors, intersect_spheres, intersect_boxes, make_scaled_intersect,
    make_far_intersect, make_intersect, find_first_crossing, intersect_shadow_rays,
    find_blocking_surfaces, select_last_value, compute_box_normals, convert_to_grey,
    find_background_color, compute_median, fit_exponent, interpolate_light, guess_hits,
    len, partial,
)  # fmt: skip
_NUMPY_NAMES = """abs arange arccos array ceil clip cos cross exp floor full_like inf int64
    isfinite log logical_and maximum minimum nan_to_num pi repeat round sign sin sqrt
    take_along_axis trunc uint8 where zeros"""
_FUNCTIONS = {function.__name__: function for function in _OWN_FUNCTIONS}
_FUNCTIONS |= {name: getattr(np, name) for name in _NUMPY_NAMES.split()}


@cache
def compile_formula(expression: str) -> Callable[..., Any]:
    """Compile a Python expression into a function of the variables that it contains.

    Parameters
    ----------
    expression : str
        The expression, such as "dot(n, l)".  It can call the functions in `_FUNCTIONS`, such as
        `dot`; all other names are variables.

    Returns
    -------
    callable
        Takes the values of the variables, in alphabetical order, and returns the value of the
        expression.  Equal expressions give the same function object.

    Raises
    ------
    SyntaxError
        If the text is not a Python expression.
    """
    nodes = ast.walk(ast.parse(expression, mode="eval"))
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    variables = ", ".join(sorted(names - _FUNCTIONS.keys()))
    function: Callable[..., Any] = eval(f"lambda {variables}: {expression}", _FUNCTIONS)
    return function


@cache
def list_parameters(function: Callable[..., Any]) -> tuple[str, ...]:
    """List the parameter names, in order, of a function returned by `compile_formula`."""
    code = function.__code__
    return code.co_varnames[: code.co_argcount]


def collect_parameters(formulas: Formulas) -> set[str]:
    """Collect the parameters of several formulas: the names of the values that they use.

    Parameters
    ----------
    formulas : dict of str to callable
        The formulas by name: functions returned by `compile_formula`.
    """
    return {name for formula in formulas.values() for name in list_parameters(formula)}
