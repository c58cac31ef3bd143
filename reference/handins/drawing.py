"""Draw a scene with mistakes: the formulas of the right picture, some of them replaced."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reference.handins.formulas import Array, Formulas, parameters
from reference.handins.mistakes import RIGHT, mistakes_of, offset
from tracer import Phong, Scene, Sphere


def given(scene: Scene, columns: Array, rows: Array, handin: Array) -> dict[str, Any]:
    """What formulas are computed from: the scene, pixels (n,), and a hand-in's codes (3, n)."""
    c, surfaces = scene.camera, list(scene.surfaces) or [Sphere()]
    shaders = [s.shader for s in surfaces]
    seen = 1 if len(scene.surfaces) else np.nan  # formulas need a surface, if one that rays miss

    def vectors(name: str, default: float) -> Array:
        found = [getattr(s, name, 3 * (default,)) for s in surfaces]
        return np.array(found, dtype=float).reshape(-1, 3).T[:, :, None]

    return {
        "view_point": np.array(c.view_point), "view_dir": np.array(c.view_dir),
        "view_up": np.array(c.view_up), "normal": np.array(c.proj_normal or c.view_dir),
        "proj_distance": c.proj_distance, "view_width": c.view_width,
        "view_height": c.view_height, "width": scene.width, "height": scene.height,
        "i": columns, "j": rows, "handin": handin,
        "is_sphere": np.array([isinstance(s, Sphere) for s in surfaces], dtype=bool),
        "center": vectors("center", 0), "min_pt": vectors("min_pt", -1),
        "max_pt": vectors("max_pt", 1),
        "radius": np.array([getattr(s, "radius", 1.0) for s in surfaces])[:, None] * seen,
        "phong": np.array([isinstance(s, Phong) for s in shaders], dtype=bool),
        "diffuse": np.array([s.diffuse for s in shaders]).reshape(-1, 3).T,
        "specular": np.array([getattr(s, "specular", (0, 0, 0)) for s in shaders]).reshape(-1, 3).T,
        "exponent": np.array([getattr(s, "exponent", 1.0) for s in shaders]),
        "position": np.array([a.position for a in scene.lights]).reshape(-1, 3, 1),
        "color": np.array([a.intensity for a in scene.lights]).reshape(-1, 3, 1),
    }  # fmt: skip


PER_PIXEL = ("radiance", "kd", "hit", "n")
"""Formulas that look at each pixel by itself: all that `image` and later ones are computed from."""


@cache
def _dependents(names: tuple[str, ...]) -> tuple[str, ...]:
    """What is computed from some formulas, these included, in the order of computation."""
    found = {*names}
    for name, function in RIGHT.items():
        if not found.isdisjoint(parameters(function)):
            found.add(name)
    return tuple(name for name in RIGHT if name in found)


class Drawing:
    """Values of formulas for some pixels; each is computed once for all mistakes that share it.

    A value's version is the number of its recipe: its formula and the versions of its arguments.
    """

    def __init__(self, given: dict[str, Any], capacity: int = 3000) -> None:
        self._given, self._capacity = given, capacity
        self._values: dict[int, Any] = dict(enumerate(given.values()))
        self._recipes: list[Any] = [None] * len(given)
        self._numbers: dict[Any, int] = {}
        self._right = self._versions(RIGHT, {name: k for k, name in enumerate(given)}, {})

    def _versions(
        self, names: Iterable[str], known: dict[str, int], changes: Formulas
    ) -> dict[str, int]:
        """Versions of formulas, and of what is `known`; none of what cannot be computed."""
        for name in names:
            formula = changes.get(name, RIGHT[name])
            used = parameters(formula)
            if name not in self._given and all(one in known for one in used):
                recipe = (formula, *[known[one] for one in used])
                known[name] = self._numbers.setdefault(recipe, len(self._recipes))
                if known[name] == len(self._recipes):
                    self._recipes.append(recipe)
        return known

    def get(self, name: str, changes: Formulas) -> Any:
        """Compute a formula, some formulas being replaced."""
        return self._value(self._changed(changes)[name])

    def _changed(self, changes: Formulas) -> dict[str, int]:
        return self._versions(_dependents(tuple(changes)), dict(self._right), changes)

    def pairs(self, first: Formulas, others: Iterable[Formulas]) -> Iterator[Array]:
        """Compute codes (3, n) with some changes and each of others."""
        known = self._changed(first)
        for other in others:
            both = self._versions(_dependents(tuple(other)), dict(known), first | other)
            yield self._value(both["codes"])

    def _value(self, version: int) -> Any:
        if version not in self._values:
            formula, *arguments = self._recipes[version]
            value = formula(*map(self._value, arguments))
            if len(self._values) > self._capacity:
                self._values = dict(enumerate(self._given.values()))
            self._values[version] = value
        return self._values[version]

    def pixels(self, changes: Formulas, names: Sequence[str] = PER_PIXEL) -> dict[str, Any]:
        """Compute formulas that look at each pixel by itself."""
        if "samples" not in changes or "radiance" not in names:
            return {name: self.get(name, changes) for name in names}
        count = changes["samples"]()
        places = [(k + 0.5) / count for k in range(count)]
        once = {name: formula for name, formula in changes.items() if name != "samples"}
        parts = [self.pixels(once | offset(x, y)) for x in places for y in places]
        shown = [np.where(p["hit"], np.clip(np.nan_to_num(p["radiance"]), 0, 1), 0) for p in parts]
        hit = np.any([part["hit"] for part in parts], axis=0)
        return {**parts[0], "radiance": sum(shown) / count**2, "hit": hit}

    def codes(self, changes: Formulas) -> Array:
        """Compute 8-bit codes (3, n)."""
        if "samples" in changes:
            return Drawing(self._given | self.pixels(changes)).get("codes", changes)
        return self.get("codes", changes)


def join(parts: Iterable[Formulas]) -> Formulas | None:
    """The formulas of several mistakes; None if two change the same."""
    found: Formulas = {}
    for formulas in parts:
        if found.keys() & formulas.keys():
            return None
        found |= formulas
    return found


def _whole(scene: Scene, kinds: tuple[str, ...]) -> tuple[Drawing, Formulas]:
    table = mistakes_of(scene)
    changes = join(table[kind].formulas for kind in kinds)
    if changes is None:
        raise ValueError(f"{' and '.join(kinds)} change the same formula")
    rows, columns = np.indices((scene.height, scene.width)).reshape(2, -1)
    return Drawing(given(scene, columns, rows, np.zeros((3, rows.size), np.uint8))), changes


@np.errstate(all="ignore")
def draw(scene: Scene, *kinds: str) -> NDArray[np.uint8]:
    """Draw a picture (h, w, 3) of 8-bit codes with mistakes, named as in `mistakes_of`.

    Raises KeyError for a name that is not in the table, ValueError if two exclude each other.
    """
    drawing, changes = _whole(scene, kinds)
    return np.ascontiguousarray(drawing.codes(changes).T.reshape(scene.height, scene.width, 3))


@np.errstate(all="ignore")
def radiance(scene: Scene, *kinds: str) -> NDArray[np.float64]:
    """Compute linear radiance (h, w, 3) with mistakes, before it is clipped; see `draw`."""
    drawing, changes = _whole(scene, kinds)
    light = np.nan_to_num(drawing.get("image", changes))
    return np.ascontiguousarray(light.T.reshape(scene.height, scene.width, 3))
