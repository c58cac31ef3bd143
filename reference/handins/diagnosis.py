"""Say what is wrong with a hand-in: with which mistakes a scene renders so, or where it differs.

A cause is reported only if the scene, rendered with it, gives the hand-in.  With a scene, all
mistakes of the table can be rendered; with a right picture alone, only some mistakes of the camera
and of the encoding can be.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from reference.handins import symptoms
from reference.handins.formulas import Array
from reference.handins.mistakes import OF_PICTURE
from reference.handins.search import MAX_PIXELS, Cause, Finding, KnownPictures, Search, difference
from reference.pictures import Codes, Picture
from tracer import Scene, SurfaceRef, first_hits, render, to_codes

AGREEING = ("identical", "rounding", "format")
"""Kinds of pictures that are right."""
UNKNOWN = "unknown"
# Maximum number of surfaces, and of alternatives, that a text names.
_MAX_NAMED = 3
# Lights are named that are wrong at this part of the pixels that differ.
_MIN_LIGHT_SHARE = 0.1
# Light read from a picture is off by at most this many levels, as its codes were rounded.
_PICTURE_LEVELS = 3
# How pictures that are turned are turned back, by the keywords of the mistakes.
_TURNS: dict[str, Callable[[Codes], Codes]] = {
    "transposed": lambda codes: codes.swapaxes(0, 1),
    "turned-90": lambda codes: np.rot90(codes, -1),
    "turned-270": np.rot90,
}


@dataclass(frozen=True)
class Diagnosis:
    """The verdict on a hand-in, or the causes of its difference, in keywords and sentences.

    Attributes
    ----------
    causes : tuple of dict
        The alternatives, each with its keywords and their sentences: ``{"gamma-none": "Gamma is
        missing."}``.  A verdict such as "identical" is the only one.
    before, after : str
        Sentences before and after those of the causes.
    hint : str
        If no cause is known, the keywords of the nearest, joined by ``+``.
    """

    causes: tuple[dict[str, str], ...]
    before: str = ""
    after: str = ""
    hint: str = ""

    @property
    def kind(self) -> str:
        """The keywords: those of one cause are joined by ``+``, alternatives by ``|``."""
        return "|".join("+".join(cause) for cause in self.causes)

    @property
    def first(self) -> str:
        """The sentences of the first cause."""
        return " ".join(self.causes[0].values())

    def __str__(self) -> str:
        alternatives = [" ".join(text for kind, text in cause.items() if kind not in self.causes[0])
                        for cause in self.causes[1:]]  # fmt: skip
        ways = [text for text in alternatives if text]
        words = ""
        if ways:
            more = len(ways) - _MAX_NAMED + 1
            words = " Or: ".join(ways[: _MAX_NAMED - 1])
            words += f" Or one of {more} more." if more > 0 else ""
            words = f"(In this scene one cannot tell it from: {words})"
        return " ".join(filter(None, (self.before, self.first, words, self.after)))

    def preceded_by(self, text: str) -> Diagnosis:
        """Return the same with another sentence at the beginning."""
        return replace(self, before=" ".join(filter(None, (text, self.before))))

    def with_cause(self, kind: str, text: str, before: str = "") -> Diagnosis:
        """Return the same with one more mistake, which is the only one if the rest agrees."""
        own = () if self.kind in AGREEING else self.causes
        causes = tuple({kind: text} | cause for cause in own) or ({kind: text},)
        return replace(self, causes=causes).preceded_by(before)

    def preferring(self, kinds: Iterable[str]) -> Diagnosis:
        """Return the same with the causes of these keywords first, in this order."""
        place = {kind: k for k, kind in enumerate(kinds)}
        order = sorted(self.causes, key=lambda cause: place.get("+".join(cause), len(place)))
        return replace(self, causes=tuple(order))


def _verdict(kind: str, text: str, **more: str) -> Diagnosis:
    return Diagnosis(({kind: text},), **more)


class Solution:
    """A scene, or a right picture, with which hand-ins of any size are compared.

    Parameters
    ----------
    scene : Scene or Picture
    name : str
        The scene's file as it is written on a command line.
    """

    def __init__(self, scene: Scene | Picture, name: str = "") -> None:
        self.name, self._known = name, dict[tuple[int, int], KnownPictures]()
        self.scene = scene if isinstance(scene, Scene) else None
        self.picture = Picture(_rendered(scene)) if isinstance(scene, Scene) else scene
        self.codes: Codes = self.picture.codes
        """The right picture (h, w, 3)."""
        self.height, self.width = self.codes.shape[:2]

    def _known_pictures(self, height: int, width: int) -> KnownPictures:
        """Return the known pictures of one size.

        Those of the right size and of one more size are cached; more would take too much memory.
        """
        key = height, width
        if key not in self._known:
            own = {(self.height, self.width)}
            self._known = {k: known for k, known in self._known.items() if k in own}
            scene = self.scene and replace(self.scene, width=width, height=height)
            codes = self.codes if key in own or not scene else _rendered(scene)
            surface = _surfaces(scene) if scene else codes.any(axis=2).ravel() - 1
            base = {} if scene else OF_PICTURE
            self._known[key] = KnownPictures(scene or codes, _flat(codes), surface, width, base)
        return self._known[key]

    @np.errstate(all="ignore")
    def diagnose(self, picture: Picture) -> Diagnosis:
        """Find the mistakes with which the scene renders as a hand-in, or say where it differs."""
        codes = picture.codes
        height, width = codes.shape[:2]
        if (height, width) == (self.height, self.width):
            return self._compare(picture)
        size = f"The picture has {width}x{height} pixels in place of {self.width}x{self.height}."
        if flat := featureless(codes):
            return flat
        if disguise := symptoms.disguise(codes, self.codes):
            return _verdict(*disguise, before=size)
        if (height, width) == (self.width, self.height):
            upright = {turn: np.ascontiguousarray(turned(codes)) for turn, turned in _TURNS.items()}
            turn = min(upright, key=lambda turn: int(_distance(upright[turn], self.codes).sum()))
            text = self._known_pictures(self.height, self.width).text[turn]
            diagnosis = self._compare(picture._replace(codes=upright[turn]))
            if diagnosis.kind != UNKNOWN:
                return diagnosis.with_cause(turn, text, size)
        return self._compare(picture).with_cause("size", size)

    def _compare(self, picture: Picture) -> Diagnosis:
        """Diagnose a picture, compared with the right one of its own size."""
        handin, saved = picture.codes, picture.saved
        height, width = handin.shape[:2]
        known = self._known_pictures(height, width)
        plain = agreement(handin, _picture(known.right, width)) or featureless(handin)
        if plain:
            return plain
        handin = self.picture.saved(handin) if self.picture.saved else handin
        lossy = max(picture.lossy, self.picture.lossy)
        search = Search(_flat(handin), known, lossy or _PICTURE_LEVELS * (self.scene is None),
                        saved and (lambda flat: _flat(saved(_picture(flat, width)))))  # fmt: skip
        if lossy and search.is_wrong.mean() < 0.01:
            return _verdict("format", "It is the right picture.")
        finding = search.find()
        if finding.causes:
            causes = tuple(_sentences(cause, search) for cause in finding.causes)
            after = f"That leaves {finding.remaining:,} of {search.wrong:,} pixels that differ."
            return Diagnosis(causes, after=after if finding.remaining else "")
        if not search.lossy and (text := _symptom(search)):
            return _verdict(*text)
        return self._unknown(search, finding)

    def _unknown(self, search: Search, finding: Finding) -> Diagnosis:
        """Describe a picture that no known mistake explains: the nearest, and where it differs."""
        if not search.beyond:
            text = (
                f"{_pixels(search.wrong, 'is', 'are')} one level off; no known mistake does this."
            )
            return _verdict(UNKNOWN, text)
        count = len(search.known.table)
        text, nearest = f"None of the {count} known mistakes explains this picture.", ""
        if finding.hint:
            nearest = " ".join(_sentences(finding.hint, search).values())
            nearest = (f"The nearest that is known: {nearest} It does not explain"
                       f" {finding.remaining:,} of {search.wrong:,} pixels.")  # fmt: skip
        after = " ".join(filter(None, (nearest, self._where(search, finding.hint))))
        return _verdict(UNKNOWN, text, after=after, hint="+".join(finding.hint))

    def _where(self, search: Search, hint: Cause) -> str:
        """Say which pixels differ: on which surfaces, by which lights, and where most.

        Lights and the worst pixel are omitted if there is a hint, or if outlines differ: they would
        mislead.
        """
        known, wrong = search.known, difference(search.known.right, search.handin) > 1
        x, y = worst_pixel(*(_picture(c, known.columns) for c in (search.handin, known.right)))
        pixel = y * known.columns + x
        wrong_code, code = (" ".join(map(str, c[:, pixel])) for c in (search.handin, known.right))
        worst = f" The worst is {x},{y}: {wrong_code} in place of {code}"
        if not self.scene:
            more = "With the scene in place of the right picture, more can be said."
            return f"{_pixels(wrong.sum())}.{worst}. {more}"
        change = search.handin.astype(np.int16) - known.right
        lines = []
        for k in np.unique(known.surface[wrong]):
            on = known.surface == k
            name = str(SurfaceRef.from_index(self.scene, int(k))) if k >= 0 else "the background"
            count = int((wrong & on).sum())
            text = f"{count:,} of {on.sum():,} on {name}{_brighter(change[:, wrong & on])}"
            lines.append((count, text))
        lines.sort(key=lambda line: -line[0])
        words = ", ".join(text for _, text in lines[:_MAX_NAMED])
        others = sum(count for count, _ in lines[_MAX_NAMED:])
        words += f", {others:,} on others" if others else ""
        outlines = (wrong & (known.surface < 0)).sum() > 0.02 * wrong.sum()
        if outlines or hint:
            return f"{_pixels(wrong.sum())}: {words}."
        size = (self.scene.width, self.scene.height)
        shown = (known.columns, known.count // known.columns)
        option = "" if size == shown else f" --size {shown[0]}x{shown[1]}"
        return (
            f"{_pixels(wrong.sum())}: {words}.{self._lights(search, wrong)}{worst};"
            f" tracer {self.name}{option} --pixel {x},{y} explains it."
        )

    def _lights(self, search: Search, wrong: Array) -> str:
        """Name the lights that many of the wrong pixels (n,) lack, or have in spite of a shadow."""
        words, changes = "", symptoms.lights(search)
        if not changes or not self.scene:
            return words
        for k, light in enumerate(self.scene.lights):
            name = f"light {k}" + (f" (line {light.line})" if light.line else "")
            for wrongly, verb in ((changes.lost, "should shine but does not"),
                                  (changes.extra, "should be blocked but shines")):  # fmt: skip
                count = int((wrongly[k] & wrong[changes.pixels]).sum())
                if count > _MIN_LIGHT_SHARE * wrong.sum():
                    words += f" At {count:,} of these pixels {name} {verb}."
        return words


def _rendered(scene: Scene) -> Codes:
    """Render a scene as codes, without warnings about a window that its size stretches."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        codes: Codes = to_codes(render(scene))
    return codes


def _surfaces(scene: Scene) -> Array:
    """Return the index (n,) of the surface that each pixel shows, or -1."""
    surface = []
    for start in range(0, scene.width * scene.height, MAX_PIXELS):
        pixels = np.arange(start, min(start + MAX_PIXELS, scene.width * scene.height))
        row, column = np.divmod(pixels, scene.width)
        surface.append(first_hits(scene, column + 0.5, row + 0.5).surface.astype(np.int32))
    return np.concatenate(surface)


def _symptom(search: Search) -> tuple[str, str] | None:
    """Return a keyword and a sentence for a difference that no mistake in a formula causes."""
    known = search.known
    if search.beyond and symptoms.is_decided_by_rounding(search):
        text = f"{_pixels(search.beyond)} where rounding decides, as in single precision."
        return "single-precision", text
    if symptoms.is_speckled(symptoms.lights(search), known):
        text = "Surfaces shadow themselves in dark dots: shadow rays need an epsilon."
        return "shadow-speckles", text
    pictures = (_picture(codes, known.columns) for codes in (search.handin, known.right))
    if symptoms.is_after_jpeg(*pictures):
        return "format", "It is the right picture, after JPEG, which changes levels."
    wrong = (difference(known.right, search.handin) > 1).reshape(-1, known.columns)
    if edge := symptoms.edges(wrong):
        return "edge", f"It is the right picture, except in the {edge}."
    return None


def _distance(a: Codes, b: Codes) -> Array:
    """Return the maximum over the channels of the difference (h, w) of two pictures."""
    return np.abs(a.astype(np.int16) - b).max(axis=2)


def worst_pixel(a: Codes, b: Codes) -> tuple[int, int]:
    """Return column and row of the pixel whose codes differ most."""
    y, x = np.unravel_index(_distance(a, b).argmax(), a.shape[:2])
    return int(x), int(y)


def agreement(a: Codes, b: Codes) -> Diagnosis | None:
    """Return a diagnosis if pictures of one size agree, but for one level in few pixels."""
    count = int((a != b).any(axis=2).sum())
    if not count:
        return _verdict("identical", "The pictures are identical.")
    few = count <= max(10, 0.01 * a.shape[0] * a.shape[1])
    if few and _distance(a, b).max() == 1:
        text = f"{_pixels(count)} by one level: rounding, nothing to worry about."
        return _verdict("rounding", text)
    return None


def featureless(codes: Codes) -> Diagnosis | None:
    """Return a diagnosis if a picture has one colour: no cause is searched for."""
    if np.ptp(codes, axis=(0, 1)).any():
        return None
    if codes.any():
        return _verdict("flat", "The picture has one colour everywhere.")
    return _verdict("black", "The picture is black.")


def _pixels(count: int, singular: str = "differs", plural: str = "differ") -> str:
    return f"One pixel {singular}" if count == 1 else f"{count:,} pixels {plural}"


def _sentences(cause: Cause, search: Search) -> dict[str, str]:
    """Return the keywords of a cause and their sentences, with the numbers that are fitted."""
    sentences, changes = {}, search.known.changes(cause) or {}
    for kind in cause:
        text = search.known.text[kind]
        for name in search.known.fitted_names(kind):
            if "{" + name + "}" in text:
                text = text.replace("{" + name + "}", f"{search.fit.get(name, changes):.3g}")
        sentences[kind] = text
    return sentences


def _flat(codes: Codes) -> Array:
    return np.ascontiguousarray(codes.reshape(-1, 3).T)


def _picture(flat: Array, width: int) -> Codes:
    return np.ascontiguousarray(flat.T.reshape(-1, width, 3))


def _brighter(change: Array) -> str:
    """Return a word if most of the changes (3, n) of codes have the same sign, or nothing."""
    if (change >= -1).all(axis=0).mean() > 0.9:
        return " (brighter)"
    return " (darker)" if (change <= 1).all(axis=0).mean() > 0.9 else ""
