"""Say what is wrong with a hand-in: which mistakes draw it, or where it differs.

Mistakes are drawn, and a cause that was not drawn is never named.  Of a scene any can be drawn; of
a right picture alone, some of geometry and encoding.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from reference.handins.formulas import Array, Formulas
from reference.handins.mistakes import OF_PICTURE
from reference.handins.search import Drawings, Finding, Search
from reference.pictures import Codes, Picture
from tracer import Scene, SurfaceRef

AGREEING = ("identical", "rounding", "format")
"""Kinds of pictures that are right."""
# So many surfaces are named where a picture differs, and so many alternatives.
_NAMED = 3
# Lights are named that are wrong at this part of the pixels that differ.
_PART = 0.1
# Levels that light read from a picture may be off: they were rounded.
_ROUNDED = 3
# Pictures of another size are compared with the scene drawn in theirs.
_TURNS = ("transposed", "turned-90", "turned-270")


class Diagnosis(NamedTuple):
    """A keyword, such as ``"gamma-none"``, and a sentence.

    Of several mistakes, keywords are joined by ``+``; those that draw the same, by ``|``.
    """

    kind: str
    text: str


class Solution:
    """A scene, or a right picture, that hand-ins are held against; its drawings serve all of them.

    `name` is what the scene's file is called on a command line.
    """

    def __init__(self, scene: Scene | Picture, name: str = "") -> None:
        self.name, self._drawings = name, dict[tuple[int, int, str], Drawings]()
        self.scene = scene if isinstance(scene, Scene) else None
        self.right = scene if isinstance(scene, Scene) else scene.codes
        self.lossy = 0 if isinstance(scene, Scene) else scene.lossy
        self.saved = None if isinstance(scene, Scene) else scene.saved
        if isinstance(scene, Scene):
            self.height, self.width = scene.height, scene.width
        else:
            self.height, self.width = scene.codes.shape[:2]

    @property
    def codes(self) -> Codes:
        """The right picture (h, w, 3)."""
        return _picture(self._drawn(self.height, self.width).right, self.width)

    @np.errstate(all="ignore")
    def _drawn(self, height: int, width: int, turn: str = "") -> Drawings:
        key = height, width, turn
        if key not in self._drawings:
            base: Formulas = {} if self.scene else OF_PICTURE
            if turn:
                base = self._drawn(height, width).table[turn]
            columns = height if turn else width
            self._drawings[key] = Drawings(self.right, height, width, columns, base)
        return self._drawings[key]

    @np.errstate(all="ignore")
    def diagnose(self, picture: Picture) -> Diagnosis:
        """Name what draws a hand-in of any size, or say where it differs."""
        height, width = picture.codes.shape[:2]
        if (height, width) == (self.height, self.width):
            return self._of_size(picture, self._drawn(height, width))
        size = f"The picture has {width}x{height} pixels in place of {self.width}x{self.height}."
        if flat := featureless(picture.codes):
            return flat
        tries = {"size": self._drawn(height, width)}
        if (height, width) == (self.width, self.height):
            tries |= {turn: self._drawn(self.height, self.width, turn) for turn in _TURNS}
        codes = _flat(picture.codes)
        kind = min(tries, key=lambda kind: int(Search(codes, tries[kind]).wrong.sum()))
        found = self._of_size(picture, tries[kind])
        text = size if kind == "size" else f"{size} {tries['size'].text[kind]}"
        if found.kind not in AGREEING:
            return Diagnosis(f"{kind}+{found.kind}", f"{text} {found.text}")
        return Diagnosis(kind, text)

    def _of_size(self, picture: Picture, drawings: Drawings) -> Diagnosis:
        handin, width = picture.codes, picture.codes.shape[1]
        if plain := agreement(handin, _picture(drawings.right, width)) or featureless(handin):
            return plain
        handin = self.saved(handin) if self.saved else handin
        saved, lossy = picture.saved, max(picture.lossy, self.lossy)
        search = Search(_flat(handin), drawings, lossy or _ROUNDED * (self.scene is None),
                        saved and (lambda flat: _flat(saved(_picture(flat, width)))))  # fmt: skip
        if lossy and search.wrong.mean() < 0.01:
            return Diagnosis("format", "It is the right picture.")
        found, wrong = search.find(), search.wrong.sum()
        if found.causes:
            text = _named(found, drawings)
            if found.left:
                text += f" That leaves {found.left} of {wrong} pixels that differ."
            return Diagnosis("|".join("+".join(cause) for cause in found.causes), text)
        if not search.lossy and search.speckled():
            text = "Surfaces shadow themselves in dark dots: shadow rays need an epsilon."
            return Diagnosis("shadow-speckles", text)
        if not search.lossy and search.near_ties():
            text = f"{_differ(wrong)} where rounding decides, as in single precision."
            return Diagnosis("single-precision", text)
        return Diagnosis("unknown", f"No mistake of the table draws this. {self._where(search)}")

    def _where(self, search: Search) -> str:
        """Which pixels differ, in words of the scene."""
        d, wrong = search.drawings, search.wrong
        x, y = worst_pixel(*(_picture(codes, d.columns) for codes in (search.handin, d.right)))
        pixel = y * d.columns + x
        here, right = (" ".join(map(str, codes[:, pixel])) for codes in (search.handin, d.right))
        worst = f" The worst is {x},{y}: {here} in place of {right}"
        if not self.scene:
            more = "With the scene in place of the right picture, more can be said."
            return f"{_differ(wrong.sum())}.{worst}. {more}"
        change = search.handin.astype(np.int16) - d.right
        found = []
        for k in np.unique(d.surface[wrong]):
            on = d.surface == k
            name = str(SurfaceRef.from_index(self.scene, int(k))) if k >= 0 else "the background"
            number = int((wrong & on).sum())
            text = f"{number} of {on.sum()} on {name}{_brighter(change[:, wrong & on])}"
            found.append((number, text))
        found.sort(key=lambda one: -one[0])
        words = ", ".join(text for _, text in found[:_NAMED])
        rest = sum(number for number, _ in found[_NAMED:])
        words += f", {rest} on others" if rest else ""
        return (
            f"{_differ(wrong.sum())}: {words}.{self._lights(search)}{worst};"
            f" tracer {self.name} --pixel {x},{y} explains it."
        )

    def _lights(self, search: Search) -> str:
        """Which lights the wrong pixels lack, or have too much of."""
        words = ""
        for k, (lacks, too_much) in enumerate(zip(*search.lights[:2], strict=True)):
            line = self.scene.lights[k].line if self.scene else None
            name = f"ight {k}" + (f" (line {line})" if line else "")
            few = _PART * search.wrong.sum()
            if (number := (lacks & search.wrong).sum()) > few:
                words += f" It lacks l{name} at {number}."
            if (number := (too_much & search.wrong).sum()) > few:
                words += f" L{name} is not kept out at {number}."
        return words


def worst_pixel(a: Codes, b: Codes) -> tuple[int, int]:
    """Column and row of the pixel whose codes differ most."""
    y, x = np.unravel_index(np.abs(a.astype(np.int16) - b).max(axis=2).argmax(), a.shape[:2])
    return int(x), int(y)


def agreement(a: Codes, b: Codes) -> Diagnosis | None:
    """Whether pictures of one size agree, but for one level in some pixels."""
    count = int((a != b).any(axis=2).sum())
    if not count:
        return Diagnosis("identical", "The pictures are identical.")
    if count < 0.01 * a.shape[0] * a.shape[1] and np.abs(a.astype(np.int16) - b).max() == 1:
        text = f"{_differ(count)} by one level: rounding, nothing to worry about."
        return Diagnosis("rounding", text)
    return None


def featureless(codes: Codes) -> Diagnosis | None:
    """Whether a picture has one colour: no cause is looked for."""
    if np.ptp(codes, axis=(0, 1)).any():
        return None
    if codes.any():
        return Diagnosis("flat", "The picture has one colour everywhere.")
    return Diagnosis("black", "The picture is black.")


def _differ(count: int) -> str:
    return "One pixel differs" if count == 1 else f"{count} pixels differ"


def _named(found: Finding, drawings: Drawings) -> str:
    """What is common to all causes, and of the rest some."""
    common = [kind for kind in found.causes[0] if all(kind in cause for cause in found.causes)]
    texts = [drawings.text[kind] for kind in common]
    first, *others = [" ".join(drawings.text[kind] for kind in cause if kind not in common)
                      for cause in found.causes]  # fmt: skip
    if first:
        texts.append(first)
    if others:
        more = len(others) - _NAMED + 1
        ways = " Or: ".join(others[: _NAMED - 1]) + (f" Or one of {more} more." * (more > 0))
        texts.append(f"(In this scene one cannot tell it from: {ways})")
    return " ".join(texts)


def _flat(codes: Codes) -> Array:
    return np.ascontiguousarray(codes.reshape(-1, 3).T)


def _picture(flat: Array, width: int) -> Codes:
    return np.ascontiguousarray(flat.T.reshape(-1, width, 3))


def _brighter(change: Array) -> str:
    """How codes (3, n) are changed, in a word if most are in the same way."""
    if (change >= -1).all(axis=0).mean() > 0.9:
        return " (brighter)"
    return " (darker)" if (change <= 1).all(axis=0).mean() > 0.9 else ""
