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

from reference.figures import linear
from reference.handins.formulas import Array, Formulas, parameters
from reference.handins.mistakes import FITTED, RIGHT, mistakes_of, offset
from reference.pictures import Codes
from tracer import Phong, Scene, Sphere

# Maximum size of the cached values in bytes, in addition to those of the right picture.
_MAX_CACHED_BYTES = 60_000_000
# With several samples per pixel, the formulas that are averaged, or needed for later ones.
_AVERAGED = ("radiance", "kd", "hit", "n")


def scene_values(scene: Scene | Codes) -> dict[str, Any]:
    """Return the values that formulas are computed from, by name.

    Parameters
    ----------
    scene : Scene or (h, w, 3) uint8 array
        A scene; or the codes of a right picture, if there is no scene.  From a picture, only
        formulas that need nothing but its light can be computed.
    """
    if not isinstance(scene, Scene):
        return {"picture": linear(scene)}
    c, surfaces = scene.camera, list(scene.surfaces) or [Sphere()]
    shaders = [s.shader for s in surfaces]
    # Formulas need a surface: in an empty scene, one that all rays miss.
    radius_factor = 1 if len(scene.surfaces) else np.nan
    listed = [*dict.fromkeys(shaders)]  # about as in the file: in the order of their first use
    by_number = [listed[k % len(listed)] for k in range(len(surfaces))]

    def column(items: Sequence[Any], name: str, default: Any) -> Array:
        return np.array([getattr(item, name, default) for item in items])

    def vectors(items: Sequence[Any], name: str, default: Any = (0.0, 0, 0)) -> Array:
        return column(items, name, default).reshape(-1, 3).T

    return {
        "view_point": np.array(c.view_point), "view_dir": np.array(c.view_dir),
        "view_up": np.array(c.view_up), "normal": np.array(c.proj_normal or c.view_dir),
        "proj_distance": c.proj_distance, "view_width": c.view_width,
        "view_height": c.view_height,
        "is_sphere": np.array([isinstance(s, Sphere) for s in surfaces]),
        "center": vectors(surfaces, "center")[:, :, None],
        "min_pt": vectors(surfaces, "min_pt", (-1.0, -1, -1))[:, :, None],
        "max_pt": vectors(surfaces, "max_pt", (1.0, 1, 1))[:, :, None],
        "radius": column(surfaces, "radius", 1.0)[:, None] * radius_factor,
        "phong": np.array([isinstance(s, Phong) for s in shaders]),
        "diffuse": vectors(shaders, "diffuse"), "specular": vectors(shaders, "specular"),
        "exponent": column(shaders, "exponent", 1.0),
        "shader_of_number": np.array([shaders.index(shader) for shader in by_number]),
        "position": vectors(scene.lights, "position").T[:, :, None],
        "color": vectors(scene.lights, "intensity").T[:, :, None],
    }  # fmt: skip


@cache
def _dependents(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the formulas that depend on some of `names`, and these, in order of computation."""
    dependents = {*names}
    for name, function in RIGHT.items():
        if not dependents.isdisjoint(parameters(function)):
            dependents.add(name)
    return tuple(name for name in RIGHT if name in dependents)


class FormulaCache:
    """Compute formulas for a set of pixels; combinations of formulas share their values.

    The version of a value is the index of its recipe: its formula, and the versions of the
    formula's arguments.  Two mistakes share a value where it has the same version in both.

    Parameters
    ----------
    values : dict
        The values of `scene_values`, `width` and `height` of the picture in pixels, and for the n
        pixels their columns `i` (n,), rows `j` (n,), and the `handin`'s codes (3, n).
    fitted_pixels : FormulaCache, optional
        The pixels from which the numbers `FITTED` are computed, such as the brightest radiance of
        the whole picture.  By default, the pixels of this cache itself.
    """

    def __init__(self, values: dict[str, Any], fitted_pixels: FormulaCache | None = None) -> None:
        self._given, self._fitted_pixels = values, fitted_pixels
        self._values: dict[int, Any] = dict(enumerate(values.values()))
        self._recipes: list[Any] = [None] * len(values)
        self._version_of: dict[Any, int] = {}
        self._right = self._versions(RIGHT, {name: k for k, name in enumerate(values)}, {})
        self._right_count, self._cached_bytes = len(self._recipes), 0

    def _versions(
        self, names: Iterable[str], known: dict[str, int], changes: Formulas
    ) -> dict[str, int]:
        """Update and return the versions `known`, by the formulas' names.

        Parameters
        ----------
        names : iterable of str
            Formulas whose versions have to be determined anew, in the order of computation.
        known : dict of str to int
            Versions of other formulas; of a formula that cannot be computed, none.
        changes : dict
            Formulas that replace those of the right picture.
        """
        for name in names:
            if name in self._given:
                continue
            formula = changes.get(name, RIGHT[name])
            try:
                recipe = (formula, *map(known.__getitem__, parameters(formula)))
            except KeyError:  # an argument cannot be computed, so neither can this
                known.pop(name, None)
                continue
            version = self._version_of.get(recipe)
            if version is None:
                version = self._version_of[recipe] = len(self._recipes)
                self._recipes.append(recipe)
            known[name] = version
        return known

    def _changed(self, changes: Formulas) -> dict[str, int]:
        return self._versions(_dependents(tuple(changes)), dict(self._right), changes)

    def is_computable(self, changes: Formulas) -> bool:
        """Return whether the codes depend only on values that are known."""
        return "codes" in self._changed(changes)

    def get(self, name: str, changes: Formulas) -> Any:
        """Compute the formula `name`, where `changes` replace formulas of the right picture."""
        return self._value(self._changed(changes)[name])

    def _value(self, version: int) -> Any:
        if version not in self._values:
            formula, *used = self._recipes[version]
            known = self._values
            value = formula(*[known[v] if v in known else self._value(v) for v in used])
            self._cached_bytes += getattr(value, "nbytes", 0)
            if self._cached_bytes > _MAX_CACHED_BYTES:
                self._values = {v: known[v] for v in range(self._right_count) if v in known}
                self._cached_bytes = 0
            self._values[version] = value
        return self._values[version]

    def codes(self, changes: Formulas) -> Array:
        """Compute 8-bit codes (3, n), where `changes` replace formulas of the right picture."""
        if self._fitted_pixels:
            used = {name for formula in changes.values() for name in parameters(formula)}
            for name in FITTED & used:
                changes = changes | {name: _constant(self._fitted_pixels.get(name, changes))}
        if "samples" not in changes:
            return self.get("codes", changes)
        count = changes["samples"]()
        positions = [(k + 0.5) / count for k in range(count)]
        versions = [self._changed(changes | offset(x, y)) for x in positions for y in positions]
        values = [{name: self._value(known[name]) for name in _AVERAGED if name in known}
                  for known in versions]  # fmt: skip
        light = [np.where(v["hit"], np.clip(np.nan_to_num(v["radiance"]), 0, 1), 0) for v in values]
        means = {"radiance": sum(light) / count**2, "hit": np.any([v["hit"] for v in values], 0)}
        return FormulaCache(self._given | values[0] | means).get("codes", changes)

    def pairs(self, first: Formulas, others: Iterable[Formulas]) -> Iterator[Array]:
        """Yield, for each of `others`, the codes (3, n) with its formulas and those of `first`."""
        known = self._changed(first)
        for other in others:
            both = self._versions(_dependents(tuple(other)), dict(known), first | other)
            yield self._value(both["codes"])


def _constant(value: Any) -> Any:
    return lambda: value


def join(parts: Iterable[Formulas]) -> Formulas | None:
    """Return the formulas of several mistakes together; None if two change the same formula."""
    joined: Formulas = {}
    for formulas in parts:
        if joined.keys() & formulas.keys():
            return None
        joined |= formulas
    return joined


@np.errstate(all="ignore")
def draw(scene: Scene, *kinds: str, formula: str = "codes") -> Array:
    """Render a scene with mistakes.

    Parameters
    ----------
    scene : Scene
    kinds : str
        The mistakes' names, as in `mistakes_of`.
    formula : str
        The formula to return for each pixel.

    Returns
    -------
    (h, w, 3) array
        By default, the picture's 8-bit codes.

    Raises
    ------
    KeyError
        For a name that is not in the table.
    ValueError
        If two mistakes exclude each other.
    """
    table, count = mistakes_of(scene), scene.width * scene.height
    changes = join(table[kind].formulas for kind in kinds)
    if changes is None:
        raise ValueError(f"{' and '.join(kinds)} change the same formula")
    j, i = np.divmod(np.arange(count), scene.width)
    size = {"width": scene.width, "height": scene.height}
    pixels = {"i": i, "j": j, "handin": np.zeros((3, count), dtype=np.uint8)}
    formulas = FormulaCache(scene_values(scene) | size | pixels)
    values = formulas.codes(changes) if formula == "codes" else formulas.get(formula, changes)
    return np.nan_to_num(values.T.reshape(scene.height, scene.width, 3))
