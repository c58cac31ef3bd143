"""Render a scene with mistakes: formulas of the reference picture, some of which are replaced.

The problem is speed: tens of thousands of combinations of mistakes are rendered, and most of them
share most of their formulas.  `FormulaCache` therefore computes each combination of formulas once
for a set of pixels.  The formulas themselves are in `mistakes.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from reference.figures import decode_to_linear
from reference.handins import mistakes
from reference.handins.formulas import Array, Formulas, collect_parameters, list_parameters
from reference.handins.mistakes import REFERENCE_FORMULAS, make_sample_formulas
from reference.pictures import Codes
from tracer import Phong, Scene, Sphere

# Maximum size of the cached values and recipes in bytes, in addition to those of the reference
# picture; and approximate size of a recipe.
_MAX_CACHED_BYTES, _BYTES_PER_RECIPE = 60_000_000, 500


def make_formula_inputs(source: Scene | Codes) -> dict[str, Any]:
    """Convert a scene to the arrays from which formulas compute its picture.

    Parameters
    ----------
    source : Scene or (h, w, 3) uint8 array
        A scene; or, if there is no scene, the 8-bit codes of the reference picture.

    Returns
    -------
    dict of str to array or float
        The arrays by name, such as "view_dir" (3,), "center" (3, surfaces, 1), "diffuse"
        (3, surfaces) and "position" (lights, 3, 1).  Without a scene, the only array is "picture"
        (h, w, 3), the reference picture in linear light.
    """
    if not isinstance(source, Scene):
        light_by_code = decode_to_linear(np.arange(256)).astype(np.float32)
        return {"picture": light_by_code[source]}  # float64 would take too much memory
    camera, surfaces, lights = source.camera, list(source.surfaces) or [Sphere()], source.lights
    shaders = [surface.shader for surface in surfaces]
    # Formulas need a surface: an empty scene gets a sphere with radius NaN, which all rays miss.
    radius_factor = 1 if len(source.surfaces) else np.nan
    # The shaders in the order of first use, which is nearly their order in the file.
    distinct_shaders = [*dict.fromkeys(shaders)]
    shader_by_number = [distinct_shaders[k % len(distinct_shaders)] for k in range(len(surfaces))]

    def to_array(items: Sequence[Any], attribute: str, default: Any) -> Array:
        """Collect an attribute of all items; items that lack it get the default."""
        return np.array([getattr(item, attribute, default) for item in items])

    def to_vectors(items: Sequence[Any], attribute: str, default: Any = (0.0, 0, 0)) -> Array:
        """Collect a vector or colour from each item, as an array (3, items)."""
        return to_array(items, attribute, default).reshape(-1, 3).T

    return {
        "view_point": np.array(camera.view_point), "view_dir": np.array(camera.view_dir),
        "view_up": np.array(camera.view_up),
        "normal": np.array(camera.proj_normal or camera.view_dir),
        "proj_distance": camera.proj_distance, "view_width": camera.view_width,
        "view_height": camera.view_height,
        "is_sphere": np.array([isinstance(surface, Sphere) for surface in surfaces]),
        "center": to_vectors(surfaces, "center")[:, :, None],
        "min_pt": to_vectors(surfaces, "min_pt", (-1.0, -1, -1))[:, :, None],
        "max_pt": to_vectors(surfaces, "max_pt", (1.0, 1, 1))[:, :, None],
        "radius": to_array(surfaces, "radius", 1.0)[:, None] * radius_factor,
        "is_phong": np.array([isinstance(shader, Phong) for shader in shaders]),
        "diffuse": to_vectors(shaders, "diffuse"), "specular": to_vectors(shaders, "specular"),
        "exponent": to_array(shaders, "exponent", 1.0),
        "shader_of_number": np.array([shaders.index(shader) for shader in shader_by_number]),
        "position": to_vectors(lights, "position").T[:, :, None],
        "color": to_vectors(lights, "intensity").T[:, :, None],
    }  # fmt: skip


@cache
def _list_affected_formulas(replaced_names: tuple[str, ...]) -> tuple[str, ...]:
    """List the formulas whose values change if certain formulas are replaced.

    Parameters
    ----------
    replaced_names : tuple of str
        Names of the replaced formulas.

    Returns
    -------
    tuple of str
        Names of the replaced formulas, and of all formulas that depend on them, in the order of
        computation.
    """
    affected_names = {*replaced_names}
    for name, formula in REFERENCE_FORMULAS.items():
        if not affected_names.isdisjoint(list_parameters(formula)):
            affected_names.add(name)
    return tuple(name for name in REFERENCE_FORMULAS if name in affected_names)


class FormulaCache:
    """A cache of formula values at some pixels, each computed when it is first requested.

    A picture is defined by formulas (functions for values such as the radiance), and a mistake by
    the formulas that it replaces.  Pictures with different mistakes share the values that are
    computed in the same way.  A *recipe* tells how to compute a value: it is a tuple of a formula
    and, for each argument, the index of the argument's recipe.

    Parameters
    ----------
    inputs : dict of str to array or number
        The result of `make_formula_inputs`; the `width` and `height` of the picture in pixels; and,
        for the n pixels of the cache, their columns `i` (n,), their rows `j` (n,) and their codes
        in the submitted picture, `submitted_codes` (3, n).
    fitting_cache : FormulaCache, optional
        The cache whose pixels are used to compute values of the whole picture, such as its largest
        radiance.  By default, the pixels of this cache are used.
    """

    def __init__(self, inputs: dict[str, Any], fitting_cache: FormulaCache | None = None) -> None:
        self._inputs, self._fitting_cache = inputs, fitting_cache
        self._values: dict[int, Any] = dict(enumerate(inputs.values()))
        self._recipes: list[Any] = [None] * len(inputs)
        self._cached_bytes = 0
        self._index_by_recipe: dict[Any, int] = {}
        self._reference_recipe_indices = {name: index for index, name in enumerate(inputs)}
        self._reference_recipe_indices = self._add_recipes(REFERENCE_FORMULAS)
        self._reference_recipe_count = len(self._recipes)

    def _add_recipes(self, replacements: Formulas) -> dict[str, int]:
        """Add the recipes of a picture's formulas to this cache, and look up their indices.

        A recipe tells how to compute a value.  It consists of a formula and, for each argument, the
        index of the argument's recipe.  Values that are computed in the same way share a recipe.

        Parameters
        ----------
        replacements : dict of str to callable
            The formulas, by name, that replace those of the reference picture.

        Returns
        -------
        dict of str to int
            The index of each formula's recipe, by the formula's name.  Formulas that cannot be
            computed from the inputs of this cache are omitted.
        """
        index_by_name = self._reference_recipe_indices.copy()
        for name in _list_affected_formulas(tuple(replacements)):
            if name in self._inputs:
                continue
            formula = replacements.get(name, REFERENCE_FORMULAS[name])
            try:
                recipe = (formula, *map(index_by_name.__getitem__, list_parameters(formula)))
            except KeyError:  # an argument cannot be computed, so neither can this formula
                index_by_name.pop(name, None)
                continue
            index_by_name[name] = self._index_by_recipe.setdefault(recipe, len(self._recipes))
            if index_by_name[name] == len(self._recipes):
                self._recipes.append(recipe)
                self._cached_bytes += _BYTES_PER_RECIPE
        return index_by_name

    def can_compute_codes(self, replacements: Formulas) -> bool:
        """Test whether the inputs of this cache suffice to compute a picture and its replacements.

        Parameters
        ----------
        replacements : dict of str to callable
            The formulas, by name, that replace those of the reference picture.
        """
        return self._add_recipes(replacements).keys() >= {"codes", *replacements}

    def get_value(self, name: str, replacements: Formulas) -> Any:
        """Return the value of a formula for all n pixels of this cache.

        Parameters
        ----------
        name : str
            Name of the formula, such as "radiance", or "codes" for the 8-bit codes.
        replacements : dict of str to callable
            The formulas, by name, that replace those of the reference picture.

        Returns
        -------
        array or number
            An array whose last axis has length n; for the codes, (3, n).  A value that is the same
            for all pixels is a number or an array of any shape.

        Raises
        ------
        KeyError
            If the formula cannot be computed from the inputs of this cache.
        """
        if self._fitting_cache:
            for fitted_name in mistakes.WHOLE_PICTURE_FORMULAS & collect_parameters(replacements):
                fitted_value = self._fitting_cache.get_value(fitted_name, replacements)
                replacements = replacements | {fitted_name: _make_constant_function(fitted_value)}
        if "samples" in replacements:  # average the clipped radiance over the samples of a pixel
            replacements = replacements.copy()
            samples_per_side = replacements.pop("samples")()
            positions = [(k + 0.5) / samples_per_side for k in range(samples_per_side)]
            radiance_sum = sum(self.get_value("clipped", replacements | make_sample_formulas(x, y))
                               for x in positions for y in positions)  # fmt: skip
            replacements["clipped"] = _make_constant_function(radiance_sum / samples_per_side**2)
        if self._cached_bytes > _MAX_CACHED_BYTES:  # keep only what the reference picture needs
            del self._recipes[self._reference_recipe_count :]
            self._values = {k: self._values[k] for k in self._values if k < len(self._recipes)}
            self._index_by_recipe = {recipe: k for k, recipe in enumerate(self._recipes)}
            self._cached_bytes = 0
        return self._evaluate_recipe(self._add_recipes(replacements)[name])

    def _evaluate_recipe(self, index: int) -> Any:
        """Return the value of a recipe; compute and cache it if it is not yet in the cache.

        A recipe consists of a formula and, for each argument, the index of the argument's recipe.

        Parameters
        ----------
        index : int
            Index of the recipe.
        """
        if index not in self._values:
            formula, *argument_indices = self._recipes[index]
            values, evaluate = self._values, self._evaluate_recipe
            arguments = [values[k] if k in values else evaluate(k) for k in argument_indices]
            value = formula(*arguments)
            self._cached_bytes += getattr(value, "nbytes", 0)
            self._values[index] = value
        return self._values[index]


def _make_constant_function(value: Any) -> Any:
    """Return a function that takes no arguments and returns `value`."""
    return lambda: value


def join_formulas(formula_maps: Sequence[Formulas]) -> Formulas:
    """Merge the formulas of several mistakes into one dictionary.

    Parameters
    ----------
    formula_maps : sequence of dict of str to callable
        For each mistake, the formulas, by name, that replace those of the reference picture.

    Returns
    -------
    dict of str to callable
        All formulas by name.  Empty if two mistakes replace the same formula, and so exclude each
        other.
    """
    joined_formulas = {name: formulas[name] for formulas in formula_maps for name in formulas}
    return joined_formulas if len(joined_formulas) == sum(map(len, formula_maps)) else {}
