"""Render a scene with mistakes: formulas of the reference picture, some of which are replaced.

A picture is defined by *formulas* (functions for values such as the radiance), and a mistake by the
formulas that it replaces, its *replacements* (see `mistakes.md`).

The problem is speed: tens of thousands of combinations of mistakes are rendered, and most of them
share most of their formulas.  `FormulaCache` therefore computes each combination of formulas once
for a set of pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import product
from typing import Annotated as Shaped
from typing import Any

import numpy as np

from reference.figures import decode_to_linear
from reference.handins import mistakes
from reference.handins.formulas import Array, Formulas, collect_parameters, list_parameters
from reference.handins.mistakes import REFERENCE_FORMULAS, make_sample_formulas
from reference.pictures import Codes
from tracer import Phong, Scene, Sphere

# Maximum size of the cached values and recipes in bytes, without those of the reference picture.
_MAX_CACHED_BYTES = 60_000_000
# Approximate size of a recipe.
_BYTES_PER_RECIPE = 500


def make_formula_inputs(source: Scene | Shaped[Codes, "height width 3"]) -> dict[str, Any]:
    """Convert a scene to the arrays and numbers from which formulas compute its picture, by name.

    Examples are "view_dir" (3,), "center" (3, surfaces, 1), "diffuse" (3, surfaces) and "position"
    (lights, 3, 1).  If there is no scene, the source is the reference picture, and the only array
    is "picture" (height, width, 3), in linear light.
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

    def to_array(items: Sequence[Any], attribute: str, default: Any) -> Shaped[Array, "items ..."]:
        """Collect an attribute of all items; items that lack it get the default."""
        return np.array([getattr(item, attribute, default) for item in items])

    def to_vectors(
        items: Sequence[Any], attribute: str, default: Any = (0.0, 0, 0)
    ) -> Shaped[Array, "3 items"]:
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
    """List the replaced formulas and all that depend on them, in the order of computation."""
    affected_names = {*replaced_names}
    for name, formula in REFERENCE_FORMULAS.items():
        if not affected_names.isdisjoint(list_parameters(formula)):
            affected_names.add(name)
    return tuple(name for name in REFERENCE_FORMULAS if name in affected_names)


class FormulaCache:
    """A cache of formula values at some pixels, each computed when it is first requested.

    Pictures with different mistakes share the values that are computed in the same way.  A *recipe*
    tells how to compute a value: it is a tuple of a formula and, for each argument, the index of
    the argument's recipe.  The indices of inputs, which have no recipe, come first.

    Parameters
    ----------
    inputs
        The result of `make_formula_inputs`; the `width` and `height` of the picture in pixels; and,
        for the n pixels of the cache, their columns `i` (n,), their rows `j` (n,) and their codes
        in the submitted picture, `submitted_codes` (3, n).
    fitting_cache
        The cache whose pixels are used to compute values of the whole picture, such as its largest
        radiance.  By default, the pixels of this cache are used.
    """

    def __init__(self, inputs: dict[str, Any], fitting_cache: FormulaCache | None = None) -> None:
        self._inputs = inputs
        self._fitting_cache = fitting_cache
        self._values: dict[int, Any] = dict(enumerate(inputs.values()))
        self._recipes: list[Any] = [None] * len(inputs)
        self._cached_bytes = 0
        self._index_by_recipe: dict[Any, int] = {}
        self._reference_recipe_indices = {name: index for index, name in enumerate(inputs)}
        self._reference_recipe_indices = self._add_recipes(REFERENCE_FORMULAS)
        self._reference_recipe_count = len(self._recipes)

    def _add_recipes(self, replacements: Formulas) -> dict[str, int]:
        """Add the recipes of a picture's formulas, and return their indices by the formulas' names.

        Formulas that cannot be computed from the inputs of this cache are omitted.
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

        A replacement that the picture does not need must be computable, too.
        """
        return self._add_recipes(replacements).keys() >= {"codes", *replacements}

    def get_value(self, name: str, replacements: Formulas) -> Any:
        """Return the value of a formula, such as "radiance" or "codes", for the n pixels.

        The result is an array whose last axis has length n; for the codes, it is (3, n).  A value
        that is the same for all pixels is a number or an array of any shape.  Raise KeyError if the
        inputs of this cache do not suffice.
        """
        if self._fitting_cache:
            for fitted_name in mistakes.WHOLE_PICTURE_FORMULAS & collect_parameters(replacements):
                fitted_value = self._fitting_cache.get_value(fitted_name, replacements)
                replacements = replacements | {fitted_name: _make_constant_function(fitted_value)}
        if "samples" in replacements:
            clipped = self._average_samples(replacements)
            replacements = replacements | {"clipped": _make_constant_function(clipped)}
            del replacements["samples"]
        if self._cached_bytes > _MAX_CACHED_BYTES:
            self._discard_mistakes()
        return self._evaluate_recipe(self._add_recipes(replacements)[name])

    def _average_samples(self, replacements: Formulas) -> Shaped[Array, "3 n"]:
        """Average the clipped radiance over a square grid of samples in each pixel."""
        replacements = replacements.copy()
        samples_per_side = replacements.pop("samples")()
        distances = [(k + 0.5) / samples_per_side for k in range(samples_per_side)]
        radiance_sum = sum(
            self.get_value("clipped", replacements | make_sample_formulas(x, y))
            for x, y in product(distances, distances)
        )
        mean_radiance: Array = radiance_sum / samples_per_side**2
        return mean_radiance

    def _discard_mistakes(self) -> None:
        """Keep only the recipes and values that the reference picture needs."""
        del self._recipes[self._reference_recipe_count :]
        self._values = {k: self._values[k] for k in self._values if k < len(self._recipes)}
        self._index_by_recipe = {recipe: k for k, recipe in enumerate(self._recipes)}
        self._cached_bytes = 0

    def _evaluate_recipe(self, index: int) -> Any:
        """Return the value of a recipe; compute and cache it if it is not yet in the cache."""
        if index not in self._values:
            formula, *argument_indices = self._recipes[index]
            values, evaluate = self._values, self._evaluate_recipe
            arguments = [values[k] if k in values else evaluate(k) for k in argument_indices]
            value = formula(*arguments)
            self._cached_bytes += getattr(value, "nbytes", 0)
            self._values[index] = value
        return self._values[index]


def _make_constant_function(value: Any) -> Any:
    return lambda: value


def join_formulas(formula_maps: Sequence[Formulas]) -> Formulas:
    """Merge the replacements of several mistakes.

    Empty if two mistakes replace the same formula, and so exclude each other.
    """
    joined_formulas = {name: formulas[name] for formulas in formula_maps for name in formulas}
    return joined_formulas if len(joined_formulas) == sum(map(len, formula_maps)) else {}
