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
from reference.handins.formulas import Array, Formulas, parameter_names, used_names
from reference.handins.mistakes import (
    REFERENCE_FORMULAS,
    WHOLE_PICTURE_FORMULAS,
    list_mistakes,
    sample_position_formulas,
)
from reference.pictures import Codes
from tracer import Phong, Scene, Sphere

# Maximum size of the cached values in bytes, in addition to those of the reference picture.
_MAX_CACHED_BYTES = 60_000_000


def make_formula_inputs(scene: Scene | Codes) -> dict[str, Any]:
    """Convert a scene to the arrays from which formulas compute its picture.

    Parameters
    ----------
    scene : Scene or (h, w, 3) uint8 array
        A scene; or, if there is no scene, the codes (levels from 0 to 255) of the reference
        picture.

    Returns
    -------
    dict of str to array or float
        The arrays by the names that formulas use, such as "view_dir" (3,), "center"
        (3, surfaces, 1), "diffuse" (3, surfaces) and "position" (lights, 3, 1).  If there is no
        scene, only "picture" (h, w, 3): the reference picture in linear light.
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
    """Return the formulas `names`, and all formulas that depend on them, directly or indirectly.

    Returns
    -------
    tuple of str
        The names of these formulas, in the order in which they are computed.
    """
    affected = {*names}
    for name, formula in REFERENCE_FORMULAS.items():
        if not affected.isdisjoint(parameter_names(formula)):
            affected.add(name)
    return tuple(name for name in REFERENCE_FORMULAS if name in affected)


class FormulaCache:
    """The values of formulas at some pixels, each computed when it is first requested.

    A picture is defined by formulas (functions for values such as the radiance), and a mistake by
    the formulas that it replaces.  Pictures with different mistakes share those values that are
    computed in the same way.  The *version* of a value is the index of its *recipe*: the tuple of
    its formula and of the versions of the formula's arguments.

    Parameters
    ----------
    inputs : dict of str to array or number
        The values of `make_formula_inputs`; the `width` and `height` of the picture in pixels; and
        for the n pixels their columns `i` (n,), rows `j` (n,), and the codes `handin` (3, n) of the
        picture that a student handed in.
    fitting_cache : FormulaCache, optional
        The cache for those pixels from which values of the whole picture are computed, such as its
        largest radiance.  By default, they are computed from the pixels of this cache.
    """

    def __init__(self, inputs: dict[str, Any], fitting_cache: FormulaCache | None = None) -> None:
        self._inputs, self._fitting_cache = inputs, fitting_cache
        self._values: dict[int, Any] = dict(enumerate(inputs.values()))
        self._recipes: list[Any] = [None] * len(inputs)
        self._version_of: dict[Any, int] = {}
        self._reference_versions = {name: version for version, name in enumerate(inputs)}
        self._reference_versions = self._versions(REFERENCE_FORMULAS)
        self._reference_count, self._cached_bytes = len(self._recipes), 0

    def _versions(self, changes: Formulas) -> dict[str, int]:
        """Return the version of each formula, if some formulas are replaced.

        The version of a value is the index of its recipe: the tuple of its formula and of the
        versions of the formula's arguments.  New recipes are registered.

        Parameters
        ----------
        changes : dict of str to callable
            The formulas, by name, that replace those of the reference picture.

        Returns
        -------
        dict of str to int
            The versions by the names of the formulas.  Formulas that cannot be computed from the
            inputs of this cache are missing.
        """
        versions = self._reference_versions.copy()
        for name in _with_dependents(tuple(changes)):
            if name in self._inputs:
                continue
            formula = changes.get(name, REFERENCE_FORMULAS[name])
            try:
                recipe = (formula, *map(versions.__getitem__, parameter_names(formula)))
            except KeyError:  # an argument cannot be computed, so neither can this formula
                versions.pop(name, None)
                continue
            versions[name] = self._version_of.setdefault(recipe, len(self._recipes))
            if versions[name] == len(self._recipes):
                self._recipes.append(recipe)
        return versions

    def is_computable(self, changes: Formulas) -> bool:
        """Test whether the codes of a picture can be computed from the inputs of this cache.

        Parameters
        ----------
        changes : dict of str to callable
            The formulas, by name, that replace those of the reference picture.
        """
        return "codes" in self._versions(changes)

    def get(self, name: str, changes: Formulas) -> Any:
        """Compute a formula for all pixels, or return its cached value.

        If each pixel is the mean of several samples, the radiance of each sample is clipped, and
        then averaged.

        Parameters
        ----------
        name : str
            Name of the formula, such as "radiance"; "codes" for the 8-bit codes.
        changes : dict of str to callable
            The formulas, by name, that replace those of the reference picture.

        Returns
        -------
        array or number
            The value of the formula; an array has one column for each of the n pixels if its values
            differ from pixel to pixel.  The codes are an array (3, n).

        Raises
        ------
        KeyError
            If the formula cannot be computed from the inputs of this cache.
        """
        if self._fitting_cache:
            for fitted in WHOLE_PICTURE_FORMULAS & used_names(changes):
                changes = changes | {fitted: _constant(self._fitting_cache.get(fitted, changes))}
        if "samples" in changes:
            changes = changes.copy()
            samples_per_side = changes.pop("samples")()
            offsets = [(k + 0.5) / samples_per_side for k in range(samples_per_side)]
            clipped = sum(self.get("clipped", changes | sample_position_formulas(x, y))
                          for x in offsets for y in offsets)  # fmt: skip
            changes["clipped"] = _constant(clipped / samples_per_side**2)
        return self._value(self._versions(changes)[name])

    def _value(self, version: int) -> Any:
        """Return a value, which is computed from its recipe unless it is cached.

        If the cached values take more than `_MAX_CACHED_BYTES`, those that do not belong to the
        reference picture are first deleted; they are computed anew when they are next requested.

        Parameters
        ----------
        version : int
            Index of the recipe: a formula and the versions of its arguments.
        """
        if version not in self._values:
            formula, *argument_versions = self._recipes[version]
            cached = self._values
            arguments = [cached[k] if k in cached else self._value(k) for k in argument_versions]
            value = formula(*arguments)
            self._cached_bytes += getattr(value, "nbytes", 0)
            if self._cached_bytes > _MAX_CACHED_BYTES:
                self._values = {k: cached[k] for k in range(self._reference_count) if k in cached}
                self._cached_bytes = 0
            self._values[version] = value
        return self._values[version]


def _constant(value: Any) -> Any:
    """Return a function without parameters that returns `value`."""
    return lambda: value


def join_formulas(formula_sets: Sequence[Formulas]) -> Formulas:
    """Join the formulas that several mistakes replace.

    Parameters
    ----------
    formula_sets : sequence of dict of str to callable
        For each mistake, the formulas by name.

    Returns
    -------
    dict of str to callable
        All formulas.  Empty if two mistakes replace the same formula, and so exclude each other.
    """
    joined = {name: formulas[name] for formulas in formula_sets for name in formulas}
    return joined if len(joined) == sum(map(len, formula_sets)) else {}


@np.errstate(all="ignore")
def render_with_mistakes(scene: Scene, *keywords: str, formula: str = "codes") -> Array:
    """Render a scene as a tracer with some mistakes would.

    Parameters
    ----------
    scene : Scene
        The scene.
    *keywords : str
        Keywords of the mistakes, such as "gamma-none", as in `list_mistakes(scene)`.  Without
        keywords, the reference picture is rendered.
    formula : str
        Name of the formula whose values are returned, such as "radiance".

    Returns
    -------
    (h, w, 3) array
        The values of the formula at each pixel, with 0 in place of NaN; by default, the 8-bit codes
        of the picture.

    Raises
    ------
    KeyError
        If a keyword is unknown.
    ValueError
        If two mistakes replace the same formula, and so exclude each other.
    """
    table, pixel_count = list_mistakes(scene), scene.width * scene.height
    changes = join_formulas([table[keyword].formulas for keyword in keywords])
    if keywords and not changes:
        raise ValueError(f"{' and '.join(keywords)} change the same formula")
    row, column = np.divmod(np.arange(pixel_count), scene.width)
    size = {"width": scene.width, "height": scene.height}
    pixels = {"i": column, "j": row, "handin": np.zeros((3, pixel_count), dtype=np.uint8)}
    values = FormulaCache(make_formula_inputs(scene) | size | pixels).get(formula, changes)
    return np.nan_to_num(values.T.reshape(scene.height, scene.width, 3))
