"""Say what is wrong with a hand-in: which mistakes draw it, or where it differs.

With the scene, mistakes are drawn; a cause that was not drawn is never named.  With two pictures
alone, see `pictures`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from reference.handins.alignment import Codes, Diagnosis
from reference.handins.formulas import Array, Formulas
from reference.handins.mistakes import SINGLE_PRECISION, UNKNOWN
from reference.handins.pictures import AGREEING, agreement, featureless, worst_pixel
from reference.handins.reading import Picture
from reference.handins.search import Finding, SceneDrawings, Search
from tracer import Scene, SurfaceRef

# So many surfaces are named where a picture differs, and so many alternatives.
_NAMED = 3
# Lights are named that are wrong at this part of the pixels that differ.
_PART = 0.1
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
    @np.errstate(all="ignore")
    def right(self) -> Codes:
        """The right picture (h, w, 3)."""
        return _picture(self._drawn(self.scene).right, self.scene.width)

    def _drawn(self, scene: Scene, turn: str = "") -> SceneDrawings:
        key = scene.width, scene.height, turn
        if key not in self._drawings:
            base: Formulas = self._drawn(self.scene).table[turn] if turn else {}
            self._drawings[key] = SceneDrawings(scene, base, scene.height if turn else scene.width)
        return self._drawings[key]

    @np.errstate(all="ignore")
    def diagnose(self, picture: Picture) -> Diagnosis:
        """Name what draws a hand-in of any size, or say where it differs."""
        handin = picture.codes
        height, width = handin.shape[:2]
        if (height, width) == (self.scene.height, self.scene.width):
            return self._of_size(picture, self._drawn(self.scene))
        if flat := featureless(handin, handin):
            return flat
        tries = {"size": self._drawn(replace(self.scene, width=width, height=height))}
        if (height, width) == (self.scene.width, self.scene.height):
            tries |= {turn: self._drawn(self.scene, turn) for turn in _TURNS}
        codes = _flat(handin)
        kind = min(tries, key=lambda kind: int(Search(codes, tries[kind]).wrong.sum()))
        found = self._of_size(picture, tries[kind])
        size = f"The picture has {width}x{height} pixels in place of {self.scene.width}x"
        text = f"{size}{self.scene.height}."
        if kind != "size":
            text += f" {self._drawn(self.scene).text[kind]}"
        if found.kind not in AGREEING:
            return Diagnosis(f"{kind}+{found.kind}", f"{text} {found.text}")
        return Diagnosis(kind, text)

    def _of_size(self, picture: Picture, drawings: SceneDrawings) -> Diagnosis:
        handin, width = picture.codes, picture.codes.shape[1]
        right = _picture(drawings.right, width)
        if plain := agreement(handin, right) or featureless(handin, right):
            return plain
        saved = picture.saved
        search = Search(_flat(handin), drawings, picture.lossy,
                        saved and (lambda flat: _flat(saved(_picture(flat, width)))))  # fmt: skip
        if picture.lossy and search.wrong.mean() < 0.01:
            return Diagnosis("format", "It is the right picture.")
        found = search.find()
        if found.causes:
            return Diagnosis(_kinds(found), self._named(found, drawings))
        if search.near_ties():
            text = f"{found.wrong} pixels differ where rounding decides, as in single precision."
            return Diagnosis(SINGLE_PRECISION, text)
        return Diagnosis(UNKNOWN, f"No mistake of the table draws this. {self._where(search)}")

    def _named(self, found: Finding, drawings: SceneDrawings) -> str:
        common = [kind for kind in found.causes[0] if all(kind in c for c in found.causes)]
        texts = [drawings.text[kind] for kind in common]
        others = [" ".join(drawings.text[kind] for kind in cause if kind not in common)
                  for cause in found.causes if len(cause) > len(common)]  # fmt: skip
        texts += others[:1]
        if others[1:]:
            texts.append(
                f"(In this scene one cannot tell it from: {' Or: '.join(others[1:_NAMED])}"
            )
            more = len(others) - _NAMED
            texts[-1] += f" Or one of {more} more.)" if more > 0 else ")"
        if found.left:
            texts.append(f"That leaves {found.left} of {found.wrong} pixels that differ.")
        return " ".join(texts)

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
        x, y = worst_pixel(*(_picture(codes, d.columns) for codes in (search.handin, d.right)))
        pixel = y * d.columns + x
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
            few = _PART * search.wrong.sum()
            words += [f" It lacks {name} at {lacks}."] if lacks > few else []
            words += (
                [f" {name.capitalize()} is not kept out at {too_much}."] if too_much > few else []
            )
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
