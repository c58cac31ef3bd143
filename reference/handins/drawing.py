"""Compute the formulas of a picture, some of which are replaced to simulate mistakes.

Formulas are functions for values such as the radiance (see `mistakes.md`).  The formulas that a
mistake puts in the place of those of the reference picture are its *replacements*, by name.

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
from reference.handins.formula_functions import Array
from reference.handins.formulas import Formulas, collect_parameters, list_parameters
from reference.handins.mistakes import REFERENCE_FORMULAS, make_sample_formulas
from reference.pictures import Codes
from tracer import Phong, Scene, Sphere

# Maximum size in bytes of what a cache stores for mistakes, besides the reference picture's values.
_MAX_CACHED_BYTES = 60_000_000
# Approximate size in bytes of the description of how a value is computed.
_BYTES_PER_RECIPE = 500


def make_formula_inputs(source: Scene | Shaped[Codes, "height width 3"]) -> dict[str, Any]:
    """Convert a scene to the arrays and numbers that formulas use, by the names that they use.

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

    Each input and each value has an *id*, a whole number from 0; inputs have the first ones.  The
    *recipe* of a value is a tuple of its formula and of the ids of the formula's arguments.
    Pictures with different mistakes share the values with the same recipe.

    Parameters
    ----------
    inputs
        The result of `make_formula_inputs`; the `width` and `height` of the picture in pixels; and,
        for the n pixels of the cache, their columns `i` (n,), their rows `j` (n,) and their codes
        in the submitted picture, `submitted_codes` (3, n).
    fitting_cache
        The cache from whose pixels values of the whole picture are computed, such as its largest
        radiance.  By default, they are computed from the pixels of this cache.
    """

    def __init__(self, inputs: dict[str, Any], fitting_cache: FormulaCache | None = None) -> None:
        self._fitting_cache = fitting_cache
        self._values: dict[int, Any] = dict(enumerate(inputs.values()))
        self._recipes: list[Any] = [None] * len(inputs)  # by id; inputs have none
        self._id_by_recipe: dict[Any, int] = {}
        self._cached_bytes = 0
        # The ids of the inputs and of the reference picture's values, by name.  The values'
        # recipes can only be added once the inputs have ids.
        self._reference_ids = {name: input_id for input_id, name in enumerate(inputs)}
        self._reference_ids |= self._add_recipes(REFERENCE_FORMULAS)
        self._reference_recipe_count = len(self._recipes)

    def _add_recipes(self, replacements: Formulas) -> dict[str, int]:
        """Add the recipes of a picture's values, and return the ids of these values by name.

        Values that cannot be computed from the inputs of this cache are omitted.
        """
        id_by_name = self._reference_ids.copy()
        for name in _list_affected_formulas(tuple(replacements)):
            formula = replacements.get(name, REFERENCE_FORMULAS[name])
            try:
                recipe = (formula, *map(id_by_name.__getitem__, list_parameters(formula)))
            except KeyError:  # an argument cannot be computed, so neither can this value
                id_by_name.pop(name, None)
                continue
            id_by_name[name] = self._id_by_recipe.setdefault(recipe, len(self._recipes))
            if id_by_name[name] == len(self._recipes):
                self._recipes.append(recipe)
                self._cached_bytes += _BYTES_PER_RECIPE
        return id_by_name

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
        if self._cached_bytes > _MAX_CACHED_BYTES:
            self._discard_mistakes()
        replacements = replacements | self._fit_whole_picture(replacements)
        if "samples" in replacements:
            replacements = self._average_samples(replacements)
        return self._evaluate(self._add_recipes(replacements)[name])

    def _fit_whole_picture(self, replacements: Formulas) -> Formulas:
        """Make the formulas of values of the whole picture that replacements use, by name.

        Each formula returns a value that is computed from the fitting cache.  The result is empty
        if there is no fitting cache.
        """
        if not self._fitting_cache:
            return {}
        names = mistakes.WHOLE_PICTURE_FORMULAS & collect_parameters(replacements)
        fitted_values = {name: self._fitting_cache.get_value(name, replacements) for name in names}
        return {name: _make_constant_function(value) for name, value in fitted_values.items()}

    def _average_samples(self, replacements: Formulas) -> Formulas:
        """Replace the clipped radiance of each pixel by its mean over a square grid of samples.

        `replacements` contains "samples", whose value is their number along a side of the grid; the
        result does not contain it.
        """
        others = {name: replacements[name] for name in replacements if name != "samples"}
        samples_per_side = replacements["samples"]()
        distances = [(k + 0.5) / samples_per_side for k in range(samples_per_side)]
        radiance_sum = sum(
            self.get_value("clipped", others | make_sample_formulas(x, y))
            for x, y in product(distances, distances)
        )
        return others | {"clipped": _make_constant_function(radiance_sum / samples_per_side**2)}

    def _discard_mistakes(self) -> None:
        """Keep only the recipes and values that the reference picture needs."""
        del self._recipes[self._reference_recipe_count :]
        self._values = {k: self._values[k] for k in self._values if k < len(self._recipes)}
        self._id_by_recipe = {recipe: k for k, recipe in enumerate(self._recipes)}
        self._cached_bytes = 0

    def _evaluate(self, value_id: int) -> Any:
        """Return the value with an id; compute and cache it if it is not yet in the cache."""
        if value_id not in self._values:
            formula, *argument_ids = self._recipes[value_id]
            values, evaluate = self._values, self._evaluate
            arguments = [values[k] if k in values else evaluate(k) for k in argument_ids]
            value = formula(*arguments)
            self._cached_bytes += getattr(value, "nbytes", 0)
            self._values[value_id] = value
        return self._values[value_id]


def _make_constant_function(value: Any) -> Any:
    return lambda: value


def join_formulas(formula_maps: Sequence[Formulas]) -> Formulas:
    """Merge the formulas, by name, of several mistakes that are made together.

    The result is empty if two mistakes replace the same formula, and so exclude each other.
    """
    joined_formulas = {name: formulas[name] for formulas in formula_maps for name in formulas}
    return joined_formulas if len(joined_formulas) == sum(map(len, formula_maps)) else {}
