"""Say what is wrong with a hand-in: which mistakes draw it, or where it differs.

With the scene, mistakes are drawn; a cause that was not drawn is never named.  With two pictures
alone, see `pictures`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from reference.handins.alignment import Codes, Diagnosis
from reference.handins.formulas import Array, Formulas
from reference.handins.mistakes import UNKNOWN
from reference.handins.pictures import agreement, featureless, worst_pixel
from reference.handins.search import Finding, SceneDrawings, Search
from tracer import Scene
from tracer.picture.explanation import SurfaceRef

__all__ = ["SceneDiagnosis"]

# So many surfaces are named where a picture differs, and so many alternatives.
_NAMED, _ALTERNATIVES = 3, 4
# Pictures of another size are compared with the scene drawn in theirs.
_TURNS = ("transposed", "turned-90", "turned-270")


class SceneDiagnosis:
    """A scene whose pictures were handed in; what is drawn of it serves all of them.

    `name` is what the scene's file is called on a command line.
    """

    def __init__(self, scene: Scene, name: str) -> None:
        self.scene, self.name = scene, name
        self._drawings: dict[tuple[int, int, str], SceneDrawings] = {}

    @property
    def right(self) -> Codes:
        """The right picture (h, w, 3)."""
        return _picture(self._drawn(self.scene).right, self.scene.width)

    def _drawn(self, scene: Scene, turn: str = "") -> SceneDrawings:
        key = scene.width, scene.height, turn
        if key not in self._drawings:
            base: Formulas = self._drawn(self.scene).table[turn] if turn else {}
            self._drawings[key] = SceneDrawings(scene, base)
        return self._drawings[key]

    @np.errstate(all="ignore")
    def diagnose(self, handin: Codes, *, lossy: bool = False) -> Diagnosis:
        """Name what draws a hand-in (h, w, 3) of any size, or say where it differs."""
        height, width = handin.shape[:2]
        if (height, width) == (self.scene.height, self.scene.width):
            return self._of_size(handin, self._drawn(self.scene), lossy)
        if flat := featureless(handin, handin):
            return flat
        tries = {"size": self._drawn(replace(self.scene, width=width, height=height))}
        if (height, width) == (self.scene.width, self.scene.height):
            tries |= {turn: self._drawn(self.scene, turn) for turn in _TURNS}
        codes = _flat(handin)
        kind = min(tries, key=lambda kind: int(Search(codes, tries[kind]).wrong.sum()))
        found = self._of_size(handin, tries[kind], lossy)
        size = f"The picture has {width}x{height} pixels in place of {self.scene.width}x"
        text = f"{size}{self.scene.height}."
        if kind != "size":
            text += f" {self._drawn(self.scene).text[kind]}"
        if found.kind not in ("identical", "rounding"):
            return Diagnosis(f"{kind}+{found.kind}", f"{text} {found.text}")
        return Diagnosis(kind, text)

    def _of_size(self, handin: Codes, drawings: SceneDrawings, lossy: bool) -> Diagnosis:
        right = _picture(drawings.right, handin.shape[1])
        if plain := agreement(handin, right) or featureless(handin, right):
            return plain
        search = Search(_flat(handin), drawings)
        found = search.find()
        if found.causes:
            return Diagnosis(_kinds(found), self._named(found, drawings))
        return Diagnosis(UNKNOWN, f"No mistake of the table draws this. {self._where(search)}")

    def _named(self, found: Finding, drawings: SceneDrawings) -> str:
        texts = [" ".join(drawings.text[kind] for kind in cause) for cause in found.causes]
        text = texts[0]
        if len(texts) > 1:
            others = " Or: ".join(texts[1:_ALTERNATIVES])
            more = len(texts) - _ALTERNATIVES
            text += f" This scene cannot tell it from: {others}"
            text += f" Or {more} more." if more > 0 else ""
        if found.left:
            text += f" That leaves {found.left} of {found.wrong} pixels that differ."
        return text

    def _where(self, search: Search) -> str:
        """Which pixels differ, in words of the scene."""
        d, wrong = search.drawings, search.wrong
        change = search.handin.astype(np.int16) - d.right
        found = []
        for k in np.unique(d.surface[wrong]):
            on = d.surface == k
            name = str(SurfaceRef.of(d.scene, int(k))) if k >= 0 else "the background"
            number = int((wrong & on).sum())
            found.append(
                (number, f"{number} of {on.sum()} on {name}{_brighter(change[:, wrong & on])}")
            )
        found.sort(key=lambda one: -one[0])
        words = ", ".join(text for _, text in found[:_NAMED])
        rest = sum(number for number, _ in found[_NAMED:])
        words += f", {rest} on others" if rest else ""
        x, y = worst_pixel(_picture(search.handin, d.scene.width), _picture(d.right, d.scene.width))
        pixel = y * d.scene.width + x
        here, right = (" ".join(map(str, codes[:, pixel])) for codes in (search.handin, d.right))
        return (
            f"{wrong.sum()} pixels differ: {words}.{self._lights(search)} The worst is {x},{y}:"
            f" {here} in place of {right}; tracer {self.name} --pixel {x},{y} explains it."
        )

    def _lights(self, search: Search) -> str:
        """Which lights the wrong pixels lack, or have too much of."""
        found = search.misplaced_lights()
        lights = [f"light {k}" + (f" (line {light.line})" if light.line else "")
                  for k, light in enumerate(search.drawings.scene.lights)]  # fmt: skip
        words = []
        for name, (lacks, too_much) in zip(lights, found, strict=False):
            words += [f" It lacks {name} at {lacks}."] if lacks else []
            words += [f" It has {name} where that is in shadow, at {too_much}."] if too_much else []
        return "".join(words)


def _flat(codes: Codes) -> Array:
    return np.ascontiguousarray(codes.reshape(-1, 3).T)


def _picture(flat: Array, width: int) -> Codes:
    return np.ascontiguousarray(flat.T.reshape(-1, width, 3))


def _kinds(found: Finding) -> str:
    return "|".join("+".join(cause) for cause in found.causes)


def _brighter(change: Array) -> str:
    """How codes (3, n) are changed, in a word if most are in the same way."""
    if (change >= -1).all(axis=0).mean() > 0.9:
        return " (brighter)"
    return " (darker)" if (change <= 1).all(axis=0).mean() > 0.9 else ""
