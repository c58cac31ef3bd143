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
from typing import Any, TypeAlias

import numpy as np
from scipy.ndimage import map_coordinates

Array: TypeAlias = Any
Formulas: TypeAlias = dict[str, Callable[..., Any]]

# Minimum t of a hit: a camera ray ignores surfaces that are closer to its origin.
_MIN_T = 1e-9


def normalize(vectors: Array, axis: int = 0) -> Array:
    """Scale vectors to length 1.

    Parameters
    ----------
    vectors : array
        Vectors of any length other than 0.
    axis : int
        The axis of the array along which the three components lie.

    Returns
    -------
    array
        Unit vectors, in an array of the same shape.
    """
    return vectors / np.sqrt((vectors * vectors).sum(axis=axis, keepdims=True))


def dot(first: Array, second: Array) -> Array:
    """Return the scalar products of vectors.

    Parameters
    ----------
    first, second : (..., 3, n) arrays
        The vectors to multiply.

    Returns
    -------
    (..., n) array
    """
    return (first * second).sum(axis=-2)


def select_vectors(surface_vectors: Array, surface: Array) -> Array:
    """Select, for each of n pixels, the vector of the surface that the pixel shows.

    Parameters
    ----------
    surface_vectors : (3, surfaces, 1) array
        One vector for each surface of the scene, such as its centre.
    surface : (n,) int array
        Index of the surface that each pixel shows.

    Returns
    -------
    (3, n) array
        The vector for each pixel.
    """
    return surface_vectors[:, surface, 0]


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
        If true, compute as if all directions had length 1.  This simulates a mistake if they have
        other lengths.

    Returns
    -------
    roots : (2, spheres, n) array
        The smaller and the larger t at which each ray crosses each sphere; NaN if the ray's line
        misses the sphere.
    """
    # The ray's line cuts a chord out of the sphere; t is that of its midpoint -+ half its length.
    to_center = [centers[axis] - o[axis] for axis in range(3)]
    midpoint_t = sum(to_center[axis] * d[axis] for axis in range(3))
    if assume_unit_d:
        distance2 = sum(to_center[axis] * to_center[axis] for axis in range(3))
        half_chord = np.sqrt(midpoint_t * midpoint_t - distance2 + radii * radii)
    else:
        length2 = (d * d).sum(axis=0)
        midpoint_t = midpoint_t / length2
        offset2 = sum((to_center[axis] - midpoint_t * d[axis]) ** 2 for axis in range(3))
        half_chord = np.sqrt((radii * radii - offset2) / length2)
    return np.stack([midpoint_t - half_chord, midpoint_t + half_chord])


def intersect_boxes(
    low: Array, high: Array, o: Array, d: Array, *, sort_slabs: bool = True
) -> Array:
    """Intersect each of n rays o + t d with each axis-aligned box.

    Parameters
    ----------
    low, high : (3, boxes, 1) arrays
        Corners of the boxes with the smallest and with the largest coordinates.
    o, d : (3, n) arrays
        Origins and directions of the rays.
    sort_slabs : bool
        If true, sort the two t at which a ray crosses each pair of parallel faces.  False simulates
        a mistake.

    Returns
    -------
    roots : (2, boxes, n) array
        The smaller and the larger t at which each ray crosses each box; NaN if the ray's line
        misses the box.
    """
    near, far = -np.inf, np.inf
    for axis in range(3):
        crossings = (low[axis] - o[axis]) / d[axis], (high[axis] - o[axis]) / d[axis]
        entry, leave = (np.minimum(*crossings), np.maximum(*crossings)) if sort_slabs else crossings
        near, far = np.maximum(near, entry), np.minimum(far, leave)
    return np.where(near <= far, np.stack([near, far]), np.nan)


def scale_roots(intersect: Callable[..., Array], factor: float) -> Callable[..., Array]:
    """Return an intersection function with a mistake: all results are multiplied by a factor.

    Parameters
    ----------
    intersect : callable
        Returns the t at which rays o + t d cross surfaces, as an array.
    factor : float
        The factor by which the new function multiplies these t.
    """
    return lambda *arguments: factor * intersect(*arguments)


def replace_near_roots(intersect: Callable[..., Array]) -> Callable[..., Array]:
    """Return an intersection function with a mistake: it returns the far intersection twice.

    Parameters
    ----------
    intersect : callable
        Returns an array (2, ...) with the smaller and the larger t at which rays o + t d cross
        surfaces.  The new function returns the larger t in both rows.
    """
    return lambda *arguments: intersect(*arguments)[[1, 1]]


def make_intersect(
    is_sphere: Array, centers: Array, radii: Array, low: Array, high: Array, is_present: Array,
    sphere_function: Callable[..., Array], box_function: Callable[..., Array],
) -> Callable[[Array, Array], Array]:  # fmt: skip
    """Return a function that intersects rays o + t d with the spheres and boxes of a scene.

    Parameters
    ----------
    is_sphere : (surfaces,) bool array
        True for spheres, false for boxes.
    centers, radii : (3, surfaces, 1) and (surfaces, 1) arrays
        Centres and radii of the spheres; the entries of boxes are not used.
    low, high : (3, surfaces, 1) arrays
        Opposite corners of the boxes; the entries of spheres are not used.
    is_present : (surfaces,) bool array
        False for surfaces that no ray hits, because they are missing from the picture.
    sphere_function, box_function : callable
        Functions with the arguments and the result of `intersect_spheres` and `intersect_boxes`.

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
        roots = np.full((2, len(is_sphere), d.shape[1]), np.nan)
        spheres = centers[:, sphere_index], radii[sphere_index]
        roots[:, sphere_index] = sphere_function(*spheres, o, d)
        roots[:, box_index] = box_function(low[:, box_index], high[:, box_index], o, d)
        return roots

    return intersect


def first_positive(roots: Array) -> Array:
    """Return the t of the closest hit of each ray o + t d on each surface.

    Parameters
    ----------
    roots : (2, ...) array
        The smaller and the larger t at which a ray crosses a surface; NaN if the ray's line misses
        the surface.

    Returns
    -------
    t : (...) array
        The smallest t that is greater than `_MIN_T`, a tiny positive number; infinity if there is
        none.
    """
    near, far = roots
    t = np.where(near > _MIN_T, near, far)
    return np.where(t > _MIN_T, t, np.inf)


def intersect_for_lights(
    intersect: Callable[[Array, Array], Array], hits: Array, light_vectors: Array
) -> Array:
    """Intersect the shadow rays from each hit to each light with all surfaces.

    Parameters
    ----------
    intersect : callable
        The function that `make_intersect` returns.
    hits : (3, n) array
        Origins of the shadow rays, on surfaces.
    light_vectors : (lights, 3, n) array
        Directions of the shadow rays.

    Returns
    -------
    roots : (lights, 2, surfaces, n) array
        The smaller and the larger t of each shadow ray and surface; without lights, an empty array.
    """
    roots = [intersect(hits, directions) for directions in light_vectors]
    return np.array(roots) if roots else np.zeros((0, 2, 1, 1))


def find_blocking(
    shadow_roots: Array, t_min: Array, t_max: Array, is_tested: Array,
    far_t_min: float | None = None,
) -> Array:  # fmt: skip
    """Test which surfaces block each light from each hit.

    The shadow ray from a hit to a light is o + t d.  A surface blocks the light if the first t >
    `t_min` at which the ray crosses the surface is less than `t_max`.

    Parameters
    ----------
    shadow_roots : (lights, 2, surfaces, n) array
        The smaller and the larger t at which each shadow ray crosses each surface.
    t_min, t_max : (lights, n) arrays
        Limits of t for each shadow ray.
    is_tested : (surfaces, n) bool array
        True for surfaces that are tested as occluders of each hit.
    far_t_min : float, optional
        Replaces `t_min` in the test of the larger t.

    Returns
    -------
    is_blocking : (lights, surfaces, n) bool array
        True if the surface blocks the light from the hit.
    """
    far_limits = t_min if far_t_min is None else np.full_like(t_min, far_t_min)
    limits = zip(shadow_roots, t_min, far_limits, t_max, strict=True)
    is_blocking = [
        (np.where(near > low, near, np.where(far > far_low, far, np.nan)) < high) & is_tested
        for (near, far), low, far_low, high in limits
    ]
    return np.array(is_blocking, dtype=bool).reshape(len(shadow_roots), *is_tested.shape)


def last_chosen(values: Array, is_chosen: Array) -> Array:
    """Return the value of the last chosen surface, in the order of the scene file.

    Parameters
    ----------
    values : (..., surfaces) array
        One value or vector for each surface, such as its specular colour.
    is_chosen : (surfaces,) bool array
        True for the surfaces among which the last is searched for.

    Returns
    -------
    (..., 1) array
        The value; zero if no surface is chosen.
    """
    chosen_index = np.flatnonzero(is_chosen)
    return values[..., chosen_index[-1:]] if chosen_index.size else 0 * values[..., :1]


def box_normals(
    hits: Array, low: Array, high: Array, axis_shift: int = 0, forced_sign: float | None = None
) -> Array:
    """Compute the unit normals of boxes at hits: outward ones, or wrong ones.

    Parameters
    ----------
    hits : (3, n) array
        Points on the boxes' faces.
    low, high : (3, n) arrays
        Opposite corners of the box at each hit.
    axis_shift : int
        Number of axes by which each normal is turned, from x to y to z to x.  Any value but 0
        simulates a mistake.
    forced_sign : float, optional
        The sign of all normals, 1 or -1, which simulates a mistake.  By default, normals point
        outward.

    Returns
    -------
    normals : (3, n) array
    """
    from_center, half_size = hits - (low + high) / 2, (high - low) / 2
    face_axis = np.abs(np.abs(from_center) - half_size).argmin(axis=0)
    coordinate = np.take_along_axis(from_center, face_axis[None], axis=0)[0]
    sign = np.where(coordinate < 0, -1.0, 1.0) if forced_sign is None else forced_sign
    return np.eye(3)[:, (face_axis + axis_shift) % 3] * sign


def mix_channels(weights: tuple[float, float, float], channels: Array) -> Array:
    """Convert a picture to grey: replace each channel by the weighted mean of all channels.

    Parameters
    ----------
    weights : tuple of 3 floats
        Weights of red, green and blue.
    channels : (3, n) array
        Red, green and blue of n pixels.

    Returns
    -------
    (3, n) array
        Three equal rows.  A tiny number is added to each mean: without it, rounding could make the
        mean of three equal integers a little smaller than the integers.
    """
    return np.tensordot(weights, channels, 1) + 1e-9 + 0 * channels


def median_where(is_selected: Array, values: Array, default: float) -> float:
    """Return the median of selected values.

    Parameters
    ----------
    is_selected : (3, n) bool array
        True for the values to use.
    values : (3, n) array
        One value for each channel of n pixels.
    default : float
        The result if no value is selected.
    """
    selected = values[is_selected]
    return float(np.median(selected)) if selected.size else default


def commonest_color(is_hit: Array, handin: Array) -> Array:
    """Return the most frequent colour in the background of a picture that was handed in.

    Parameters
    ----------
    is_hit : (n,) bool array
        True for the n pixels that show a surface, false for those of the background.
    handin : (3, n) uint8 array
        Codes (levels from 0 to 255) of the picture.

    Returns
    -------
    color : (3, 1) uint8 array
        The colour as codes; black if there is no background.
    """
    if is_hit.all():
        return np.zeros((3, 1), dtype=np.uint8)
    colors, counts = np.unique(handin[:, ~is_hit], axis=1, return_counts=True)
    return colors[:, [counts.argmax()]]


def interpolate_light(picture: Array, x: Array, y: Array) -> Array:
    """Interpolate the light of a picture linearly at n positions between its pixels' centres.

    Parameters
    ----------
    picture : (h, w, 3) array
        Linear light.
    x, y : (n,) arrays
        The positions: from -0.5 at the left and lower edges of the picture to 0.5 at the right and
        upper edges.

    Returns
    -------
    light : (3, n) array
        Red, green and blue light at each position.  Outside the picture, this is the light of the
        nearest pixel.
    """
    height, width = picture.shape[:2]
    positions = (0.5 - y) * height - 0.5, (x + 0.5) * width - 0.5
    channels = np.moveaxis(picture, 2, 0)
    return np.array([map_coordinates(c, positions, order=1, mode="nearest") for c in channels])


def shows_surface(picture: Array, x: Array, y: Array, handin: Array) -> Array:
    """Guess which pixels show a surface, from a reference picture without its scene.

    A pixel is assumed to be background if the reference picture is black there, but the hand-in
    (the picture that a student handed in) is not.

    Parameters
    ----------
    picture : (h, w, 3) array
        Linear light of the reference picture.
    x, y : (n,) arrays
        Positions of the pixels: from -0.5 at the left and lower edges to 0.5 at the right and upper
        edges.
    handin : (3, n) uint8 array
        Codes of the hand-in.

    Returns
    -------
    is_hit : (n,) bool array
        False for the pixels of the background.
    """
    return interpolate_light(picture, x, y).any(axis=0) | ~handin.any(axis=0)


_OWN: tuple[Callable[..., Any], ...] = (
    normalize, dot, select_vectors, intersect_spheres, intersect_boxes, scale_roots,
    replace_near_roots, make_intersect, first_positive, intersect_for_lights, find_blocking,
    last_chosen, box_normals, mix_channels, commonest_color, median_where, interpolate_light,
    shows_surface, len, partial,
)  # fmt: skip
_NUMPY = """abs arange arccos array ceil clip cos cross exp floor full_like inf int64 isfinite log
    logical_and maximum minimum nan_to_num pi repeat round sign sin sqrt take_along_axis trunc uint8
    where zeros"""
_FUNCTIONS = {function.__name__: function for function in _OWN}
_FUNCTIONS |= {name: getattr(np, name) for name in _NUMPY.split()}


@cache
def compile_formula(expression: str) -> Callable[..., Any]:
    """Convert a Python expression to a function whose parameters are the names in the expression.

    The parameters are in alphabetical order.  They exclude the functions of this module and of
    NumPy that formulas can call.  Equal expressions give the same function object.

    Parameters
    ----------
    expression : str
        The expression, such as "dot(n, l)", which becomes a function of `l` and `n`.

    Returns
    -------
    callable
        Takes the values of the parameters, and returns that of the expression.

    Raises
    ------
    SyntaxError
        If the text is not a Python expression.
    """
    nodes = ast.walk(ast.parse(expression, mode="eval"))
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    arguments = sorted(names - _FUNCTIONS.keys())
    function: Callable[..., Any] = eval(f"lambda {', '.join(arguments)}: {expression}", _FUNCTIONS)
    return function


@cache
def parameter_names(function: Callable[..., Any]) -> tuple[str, ...]:
    """Return the parameter names, in order, of a function that `compile_formula` returned."""
    code = function.__code__
    return code.co_varnames[: code.co_argcount]


def used_names(formulas: Formulas) -> set[str]:
    """Return the names of all values from which several formulas are computed.

    Parameters
    ----------
    formulas : dict of str to callable
        The formulas by their names: functions, as `compile_formula` returns them.
    """
    return {name for formula in formulas.values() for name in parameter_names(formula)}
