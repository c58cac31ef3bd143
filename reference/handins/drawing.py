"""Draw a scene with mistakes: the formulas of the right picture, some of them replaced."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np

from reference.figures import linear
from reference.handins.formulas import Array, Formulas, parameters
from reference.handins.mistakes import RIGHT, mistakes_of, offset
from reference.pictures import Codes
from tracer import Phong, Scene, Sphere


def given(scene: Scene | Codes) -> dict[str, Any]:
    """What formulas are computed from: a scene, or codes (h, w, 3) of a right picture alone."""
    if not isinstance(scene, Scene):
        return {"picture": linear(scene)}
    c, surfaces = scene.camera, list(scene.surfaces) or [Sphere()]
    shaders = [s.shader for s in surfaces]
    seen = 1 if len(scene.surfaces) else np.nan  # formulas need a surface, if one that rays miss

    def of_each(things: Sequence[Any], name: str, default: Any) -> Array:
        return np.array([getattr(each, name, default) for each in things])

    def vectors(things: Sequence[Any], name: str, default: Any = (0.0, 0, 0)) -> Array:
        return of_each(things, name, default).reshape(-1, 3).T

    return {
        "view_point": np.array(c.view_point), "view_dir": np.array(c.view_dir),
        "view_up": np.array(c.view_up), "normal": np.array(c.proj_normal or c.view_dir),
        "proj_distance": c.proj_distance, "view_width": c.view_width,
        "view_height": c.view_height,
        "is_sphere": np.array([isinstance(s, Sphere) for s in surfaces]),
        "center": vectors(surfaces, "center")[:, :, None],
        "min_pt": vectors(surfaces, "min_pt", (-1.0, -1, -1))[:, :, None],
        "max_pt": vectors(surfaces, "max_pt", (1.0, 1, 1))[:, :, None],
        "radius": of_each(surfaces, "radius", 1.0)[:, None] * seen,
        "phong": np.array([isinstance(s, Phong) for s in shaders]),
        "diffuse": vectors(shaders, "diffuse"), "specular": vectors(shaders, "specular"),
        "exponent": of_each(shaders, "exponent", 1.0),
        "position": vectors(scene.lights, "position").T[:, :, None],
        "color": vectors(scene.lights, "intensity").T[:, :, None],
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
    Those of the right picture are kept, and as many of others as the capacity.
    """

    def __init__(self, given: dict[str, Any], capacity: int = 3000) -> None:
        self._given, self._capacity = given, capacity
        self._values: dict[int, Any] = dict(enumerate(given.values()))
        self._recipes: list[Any] = [None] * len(given)
        self._numbers: dict[Any, int] = {}
        self._right = self._versions(RIGHT, {name: k for k, name in enumerate(given)}, {})
        self._kept = len(self._recipes)

    def _versions(
        self, names: Iterable[str], known: dict[str, int], changes: Formulas
    ) -> dict[str, int]:
        """Versions of formulas, and of what is `known`; none of what cannot be computed."""
        for name in names:
            if name in self._given:
                continue
            formula = changes.get(name, RIGHT[name])
            try:
                recipe = (formula, *[known[used] for used in parameters(formula)])
            except KeyError:  # what was known of it holds no longer
                known.pop(name, None)
                continue
            number = self._numbers.get(recipe)
            if number is None:
                number = self._numbers[recipe] = len(self._recipes)
                self._recipes.append(recipe)
            known[name] = number
        return known

    def able(self, changes: Formulas) -> bool:
        """Whether codes can be computed from what is given."""
        return "codes" in self._changed(changes)

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
            formula, *used = self._recipes[version]
            known = self._values
            value = formula(*[known[v] if v in known else self._value(v) for v in used])
            if len(self._values) > self._kept + self._capacity:
                self._values = {v: self._values[v] for v in range(self._kept) if v in known}
            self._values[version] = value
        return self._values[version]

    def pixels(self, changes: Formulas, names: Sequence[str] = PER_PIXEL) -> dict[str, Any]:
        """Compute those formulas that can be, each of which looks at each pixel by itself."""
        if "samples" not in changes or "radiance" not in names:
            known = self._changed(changes)
            return {name: self._value(known[name]) for name in names if name in known}
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


@np.errstate(all="ignore")
def draw(scene: Scene, *kinds: str, formula: str = "codes") -> Array:
    """Draw a picture (h, w, 3) with mistakes, named as in `mistakes_of`: 8-bit codes, or a formula.

    Raises KeyError for a name that is not in the table, ValueError if two exclude each other.
    """
    table, number = mistakes_of(scene), scene.width * scene.height
    changes = join(table[kind].formulas for kind in kinds)
    if changes is None:
        raise ValueError(f"{' and '.join(kinds)} change the same formula")
    j, i = np.divmod(np.arange(number), scene.width)
    size = {"width": scene.width, "height": scene.height}
    blank = np.zeros((3, number), dtype=np.uint8)
    drawing = Drawing(given(scene) | size | {"i": i, "j": j, "handin": blank})
    values = drawing.codes(changes) if formula == "codes" else drawing.get(formula, changes)
    return np.nan_to_num(values.T.reshape(scene.height, scene.width, 3))
