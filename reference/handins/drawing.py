"""Render a scene with mistakes: formulas of the right picture, some of which are replaced.

The problem is speed: tens of thousands of combinations of mistakes are rendered, and most share
most of their formulas.  `FormulaCache` therefore computes each combination of formulas once for a
set of pixels.  The formulas themselves are in `mistakes.md`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np

from reference.figures import decode_to_linear
from reference.handins.formulas import Array, Formulas, parameter_names
from reference.handins.mistakes import FITTED, RIGHT, list_mistakes, sample_position_formulas
from reference.pictures import Codes
from tracer import Phong, Scene, Sphere

# Maximum size of the cached values in bytes, in addition to those of the right picture.
_MAX_CACHED_BYTES = 60_000_000
# With several samples per pixel, the formulas that are averaged, or needed for later ones.
_AVERAGED = ("radiance", "kd", "hit", "n")


def scene_values(scene: Scene | Codes) -> dict[str, Any]:
    """Convert a scene to the arrays from which the formulas of a picture are computed.

    Parameters
    ----------
    scene : Scene or (h, w, 3) uint8 array
        A scene; or, if there is no scene, the codes of a right picture.  From a picture, only
        formulas that need nothing but its light can be computed.

    Returns
    -------
    dict of str to array or float
        The values by the names that formulas use, such as "view_dir" (3,), "center"
        (3, surfaces, 1), "diffuse" (3, surfaces) and "position" (lights, 3, 1).  For a picture, it
        contains only the linear light "picture" (h, w, 3).
    """
    if not isinstance(scene, Scene):
        return {"picture": decode_to_linear(scene)}
    camera, surfaces = scene.camera, list(scene.surfaces) or [Sphere()]
    shaders = [surface.shader for surface in surfaces]
    # Formulas need a surface.  In an empty scene, its radius is NaN, so that all rays miss it.
    radius_factor = 1 if len(scene.surfaces) else np.nan
    distinct = [*dict.fromkeys(shaders)]  # about as in the file: in the order of their first use
    shader_by_number = [distinct[k % len(distinct)] for k in range(len(surfaces))]

    def numbers(items: Sequence[Any], attribute: str, default: Any) -> Array:
        return np.array([getattr(item, attribute, default) for item in items])

    def vectors(items: Sequence[Any], attribute: str, default: Any = (0.0, 0, 0)) -> Array:
        return numbers(items, attribute, default).reshape(-1, 3).T

    return {
        "view_point": np.array(camera.view_point), "view_dir": np.array(camera.view_dir),
        "view_up": np.array(camera.view_up),
        "normal": np.array(camera.proj_normal or camera.view_dir),
        "proj_distance": camera.proj_distance, "view_width": camera.view_width,
        "view_height": camera.view_height,
        "is_sphere": np.array([isinstance(surface, Sphere) for surface in surfaces]),
        "center": vectors(surfaces, "center")[:, :, None],
        "min_pt": vectors(surfaces, "min_pt", (-1.0, -1, -1))[:, :, None],
        "max_pt": vectors(surfaces, "max_pt", (1.0, 1, 1))[:, :, None],
        "radius": numbers(surfaces, "radius", 1.0)[:, None] * radius_factor,
        "phong": np.array([isinstance(shader, Phong) for shader in shaders]),
        "diffuse": vectors(shaders, "diffuse"), "specular": vectors(shaders, "specular"),
        "exponent": numbers(shaders, "exponent", 1.0),
        "shader_of_number": np.array([shaders.index(shader) for shader in shader_by_number]),
        "position": vectors(scene.lights, "position").T[:, :, None],
        "color": vectors(scene.lights, "intensity").T[:, :, None],
    }  # fmt: skip


@cache
def _with_dependents(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the formulas `names`, and all formulas that are computed from them.

    The result is in the order in which the formulas of the right picture are computed.  Formulas
    that are computed indirectly, from other results, are included.
    """
    affected = {*names}
    for name, function in RIGHT.items():
        if not affected.isdisjoint(parameter_names(function)):
            affected.add(name)
    return tuple(name for name in RIGHT if name in affected)


class FormulaCache:
    """The values of formulas for a set of pixels, each computed when it is first requested.

    A picture is defined by formulas (functions for values such as the radiance), and a mistake by
    the formulas that it replaces.  Pictures with different mistakes share those values that are
    computed in the same way.  The *version* of a value is the index of its *recipe*: the tuple of
    its formula and of the versions of the formula's arguments.

    Parameters
    ----------
    inputs : dict of str to array or number
        The values of `scene_values`; the `width` and `height` of the picture in pixels; and for
        the n pixels their columns `i` (n,), rows `j` (n,), and the codes `handin` (3, n) of the
        picture that was handed in.
    fitted_pixels : FormulaCache, optional
        The pixels from which the numbers `FITTED` are computed, such as the largest radiance in
        the whole picture.  By default, they are computed from the pixels of this cache itself.
    """

    def __init__(self, inputs: dict[str, Any], fitted_pixels: FormulaCache | None = None) -> None:
        self._inputs, self._fitted_pixels = inputs, fitted_pixels
        self._values: dict[int, Any] = dict(enumerate(inputs.values()))
        self._recipes: list[Any] = [None] * len(inputs)
        self._version_of: dict[Any, int] = {}
        self._right = self._update_versions(RIGHT, {name: k for k, name in enumerate(inputs)}, {})
        self._right_count, self._cached_bytes = len(self._recipes), 0

    def _update_versions(
        self, names: Iterable[str], versions: dict[str, int], changes: Formulas
    ) -> dict[str, int]:
        """Determine the versions of formulas, and register recipes that are new.

        The version of a value is the index of its recipe: the tuple of its formula and of the
        versions of the formula's arguments.

        Parameters
        ----------
        names : iterable of str
            The formulas whose versions are determined, in the order of computation.
        versions : dict of str to int
            Versions of formulas by their names.  It is changed: the versions of `names` are
            replaced, or removed if an argument of the formula has no version.
        changes : dict of str to callable
            Formulas that replace those of the right picture.

        Returns
        -------
        dict of str to int
            The argument `versions`.
        """
        for name in names:
            if name in self._inputs:
                continue
            formula = changes.get(name, RIGHT[name])
            try:
                recipe = (formula, *map(versions.__getitem__, parameter_names(formula)))
            except KeyError:  # an argument cannot be computed, so neither can this formula
                versions.pop(name, None)
                continue
            version = self._version_of.get(recipe)
            if version is None:
                version = self._version_of[recipe] = len(self._recipes)
                self._recipes.append(recipe)
            versions[name] = version
        return versions

    def _versions_with(self, changes: Formulas) -> dict[str, int]:
        """Return the versions of all formulas, by name, if `changes` replace several formulas."""
        return self._update_versions(_with_dependents(tuple(changes)), dict(self._right), changes)

    def is_computable(self, changes: Formulas) -> bool:
        """Test whether the picture's codes can be computed from the inputs of this cache.

        Parameters
        ----------
        changes : dict of str to callable
            Formulas, by name, that replace those of the right picture.
        """
        return "codes" in self._versions_with(changes)

    def get(self, name: str, changes: Formulas) -> Any:
        """Compute one formula for all pixels, or return its cached value.

        Parameters
        ----------
        name : str
            Name of the formula, such as "radiance".
        changes : dict of str to callable
            Formulas, by name, that replace those of the right picture.

        Returns
        -------
        array or number
            The value of the formula, with one column for each of the n pixels if it differs from
            pixel to pixel.

        Raises
        ------
        KeyError
            If the formula cannot be computed from the inputs of this cache.
        """
        return self._value(self._versions_with(changes)[name])

    def _value(self, version: int) -> Any:
        """Return the value with the index `version`, computed from its recipe if necessary.

        If the cached values take more than `_MAX_CACHED_BYTES`, those that do not belong to the
        right picture are first deleted; they are computed anew when they are next requested.
        """
        if version not in self._values:
            formula, *argument_versions = self._recipes[version]
            cached = self._values
            arguments = [cached[k] if k in cached else self._value(k) for k in argument_versions]
            value = formula(*arguments)
            self._cached_bytes += getattr(value, "nbytes", 0)
            if self._cached_bytes > _MAX_CACHED_BYTES:
                self._values = {k: cached[k] for k in range(self._right_count) if k in cached}
                self._cached_bytes = 0
            self._values[version] = value
        return self._values[version]

    def codes(self, changes: Formulas) -> Array:
        """Compute the 8-bit codes of all pixels of a picture with mistakes.

        If the mistakes include several samples per pixel, the radiance is clipped for each sample,
        and then averaged.

        Parameters
        ----------
        changes : dict of str to callable
            Formulas, by name, that replace those of the right picture.

        Returns
        -------
        codes : (3, n) array
        """
        if self._fitted_pixels:
            used = {name for formula in changes.values() for name in parameter_names(formula)}
            for name in FITTED & used:
                changes = changes | {name: _constant(self._fitted_pixels.get(name, changes))}
        if "samples" not in changes:
            return self.get("codes", changes)
        side = changes["samples"]()
        positions = [(k + 0.5) / side for k in range(side)]
        versions = [self._versions_with(changes | sample_position_formulas(x, y))
                    for x in positions for y in positions]  # fmt: skip
        samples = [{name: self._value(known[name]) for name in _AVERAGED if name in known}
                   for known in versions]  # fmt: skip
        light = [np.where(sample["hit"], np.clip(np.nan_to_num(sample["radiance"]), 0, 1), 0)
                 for sample in samples]  # fmt: skip
        is_hit = np.any([sample["hit"] for sample in samples], 0)
        means = {"radiance": sum(light) / side**2, "hit": is_hit}
        return FormulaCache(self._inputs | samples[0] | means).get("codes", changes)

    def codes_of_pairs(self, first: Formulas, others: Iterable[Formulas]) -> Iterator[Array]:
        """Yield the codes (3, n) of pictures with two mistakes, of which the first is the same.

        Parameters
        ----------
        first : dict of str to callable
            The formulas, by name, that the first mistake replaces.
        others : iterable of dict of str to callable
            The formulas of each second mistake.  One array of codes is yielded for each.
        """
        versions = self._versions_with(first)
        for other in others:
            dependents = _with_dependents(tuple(other))
            both = self._update_versions(dependents, dict(versions), first | other)
            yield self._value(both["codes"])


def _constant(value: Any) -> Any:
    """Return a function without parameters that returns `value`."""
    return lambda: value


def join_formulas(formula_sets: Iterable[Formulas]) -> Formulas | None:
    """Combine the formulas that several mistakes replace.

    Parameters
    ----------
    formula_sets : iterable of dict of str to callable
        For each mistake, the replaced formulas by name.

    Returns
    -------
    dict of str to callable, or None
        All replaced formulas; None if two mistakes replace the same formula.
    """
    joined: Formulas = {}
    for formulas in formula_sets:
        if joined.keys() & formulas.keys():
            return None
        joined |= formulas
    return joined


@np.errstate(all="ignore")
def render_with_mistakes(scene: Scene, *kinds: str, formula: str = "codes") -> Array:
    """Render a scene as a tracer with the given mistakes would.

    Parameters
    ----------
    scene : Scene
    *kinds : str
        Keywords of the mistakes, such as "gamma-none"; without any, the right picture is rendered.
        The keywords are those of `list_mistakes(scene)`.
    formula : str
        Name of the formula whose values are returned, such as "radiance".

    Returns
    -------
    (h, w, 3) array
        The values of the formula at each pixel, with 0 in place of NaN; by default, the picture's
        8-bit codes.

    Raises
    ------
    KeyError
        If a keyword is unknown.
    ValueError
        If two mistakes replace the same formula, and so exclude each other.
    """
    table, pixel_count = list_mistakes(scene), scene.width * scene.height
    changes = join_formulas(table[kind].formulas for kind in kinds)
    if changes is None:
        raise ValueError(f"{' and '.join(kinds)} change the same formula")
    row, column = np.divmod(np.arange(pixel_count), scene.width)
    size = {"width": scene.width, "height": scene.height}
    pixels = {"i": column, "j": row, "handin": np.zeros((3, pixel_count), dtype=np.uint8)}
    formulas = FormulaCache(scene_values(scene) | size | pixels)
    values = formulas.codes(changes) if formula == "codes" else formulas.get(formula, changes)
    return np.nan_to_num(values.T.reshape(scene.height, scene.width, 3))
