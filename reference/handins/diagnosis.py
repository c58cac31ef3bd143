"""Say what is wrong with a hand-in: with which mistakes a scene renders so, or where it differs.

A cause (a tuple of mistakes that are made together) is reported only if the scene, rendered with
it, gives the hand-in.  With a scene, all mistakes of the table can be rendered; with a right
picture alone, only some mistakes of the camera and of the encoding can be.
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
"""Keywords of the diagnoses of right pictures."""
UNKNOWN = "unknown"
"""Keyword of the diagnosis of a picture that no known mistake explains."""
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
    """The verdict on a picture that was handed in, or the mistakes that explain its difference.

    Attributes
    ----------
    causes : tuple of dict of str to str
        The alternatives, at least one.  Each contains the mistakes that are made together: their
        keywords, and for each keyword its sentence, as in
        ``{"gamma-none": "Gamma is missing."}``.  A verdict, such as "identical", is an alternative
        with one keyword, and then the only one.
    before, after : str
        Sentences that the report contains before and after those of the causes; may be empty.
    hint : str
        If no cause is known, the keywords of the cause with the most similar picture, joined by
        ``+``; otherwise empty.
    """

    causes: tuple[dict[str, str], ...]
    before: str = ""
    after: str = ""
    hint: str = ""

    @property
    def kind(self) -> str:
        """All keywords: those of one cause joined by ``+``, and the alternatives by ``|``."""
        return "|".join("+".join(cause) for cause in self.causes)

    @property
    def first(self) -> str:
        """The sentences of the first alternative, joined by spaces."""
        return " ".join(self.causes[0].values())

    def __str__(self) -> str:
        """Return the report: all sentences, with at most `_MAX_NAMED` alternatives in brackets."""
        alternatives = [
            " ".join(sentence for kind, sentence in cause.items() if kind not in self.causes[0])
            for cause in self.causes[1:]
        ]
        alternatives = [text for text in alternatives if text]
        note = ""
        if alternatives:
            unnamed_count = len(alternatives) - _MAX_NAMED + 1
            note = " Or: ".join(alternatives[: _MAX_NAMED - 1])
            note += f" Or one of {unnamed_count} more." if unnamed_count > 0 else ""
            note = f"(In this scene one cannot tell it from: {note})"
        return _join_sentences(self.before, self.first, note, self.after)

    def preceded_by(self, sentence: str) -> Diagnosis:
        """Return a copy whose report begins with another sentence; an empty one adds nothing."""
        return replace(self, before=_join_sentences(sentence, self.before))

    def with_mistake(self, kind: str, sentence: str, before: str = "") -> Diagnosis:
        """Return a copy in which each cause has one more mistake, at its beginning.

        If this diagnosis states that the picture is right, the mistake becomes the only cause.

        Parameters
        ----------
        kind, sentence : str
            Keyword of the mistake, and the sentence that describes it.
        before : str
            Sentence with which the report begins.
        """
        other_causes = () if self.kind in AGREEING else self.causes
        causes = tuple({kind: sentence} | cause for cause in other_causes)
        return replace(self, causes=causes or ({kind: sentence},)).preceded_by(before)

    def preferring(self, preferred: Iterable[str]) -> Diagnosis:
        """Return a copy with the causes in another order: preferred ones first.

        Parameters
        ----------
        preferred : iterable of str
            Causes, the most preferred first, as their keywords joined by ``+``.  Other causes
            follow in the order of this diagnosis.
        """
        place = {cause: k for k, cause in enumerate(preferred)}
        order = sorted(self.causes, key=lambda cause: place.get("+".join(cause), len(place)))
        return replace(self, causes=tuple(order))


def _join_sentences(*sentences: str) -> str:
    """Join sentences by spaces; empty ones are skipped."""
    return " ".join(filter(None, sentences))


def _verdict(
    kind: str, sentence: str, before: str = "", after: str = "", hint: str = ""
) -> Diagnosis:
    """Return a diagnosis with one keyword; the other arguments are those of `Diagnosis`."""
    return Diagnosis(({kind: sentence},), before, after, hint)


class Solution:
    """The right picture of a task, with which pictures that were handed in are compared.

    Parameters
    ----------
    scene : Scene or Picture
        The scene; or, if there is no scene, a right picture.
    name : str
        The scene's file as a user types it on a command line; it appears in reports.

    Attributes
    ----------
    scene : Scene or None
        None if only a right picture is known.
    picture : Picture
        The right picture.
    codes : (h, w, 3) uint8 array
        The codes of the right picture.
    """

    def __init__(self, scene: Scene | Picture, name: str = "") -> None:
        self.name, self._known = name, dict[tuple[int, int], KnownPictures]()
        self.scene = scene if isinstance(scene, Scene) else None
        self.picture = Picture(_render_codes(scene)) if isinstance(scene, Scene) else scene
        self.codes: Codes = self.picture.codes
        self.height, self.width = self.codes.shape[:2]

    def _known_pictures(self, height: int, width: int) -> KnownPictures:
        """Return the known pictures, right and with mistakes, of a size in pixels.

        Those of the right size and of one more size are cached; more would take too much memory.
        Without a scene, only the size of the right picture is possible.
        """
        size = height, width
        if size not in self._known:
            right_size = self.height, self.width
            self._known = {k: known for k, known in self._known.items() if k == right_size}
            scene = self.scene and replace(self.scene, width=width, height=height)
            codes = self.codes if size == right_size or not scene else _render_codes(scene)
            surface = _visible_surfaces(scene) if scene else codes.any(axis=2).ravel() - 1
            formulas = {} if scene else OF_PICTURE
            known = KnownPictures(scene or codes, _to_columns(codes), surface, width, formulas)
            self._known[size] = known
        return self._known[size]

    @np.errstate(all="ignore")
    def diagnose(self, picture: Picture) -> Diagnosis:
        """Find the mistakes with which the scene renders as a picture, or say where they differ.

        Parameters
        ----------
        picture : Picture
            The picture that was handed in.  Another size than the right one is a mistake; for a
            turned picture, the picture that is turned back is diagnosed.
        """
        codes = picture.codes
        height, width = codes.shape[:2]
        if (height, width) == (self.height, self.width):
            return self._diagnose_at_own_size(picture)
        size = f"The picture has {width}x{height} pixels in place of {self.width}x{self.height}."
        if diagnosis := diagnose_single_color(codes):
            return diagnosis
        if keyword_and_sentence := symptoms.find_right_picture_within(codes, self.codes):
            return _verdict(*keyword_and_sentence, before=size)
        if (height, width) == (self.width, self.height):
            upright = {turn: np.ascontiguousarray(turned(codes)) for turn, turned in _TURNS.items()}
            turn = min(upright, key=lambda turn: int(_distance(upright[turn], self.codes).sum()))
            sentence = self._known_pictures(self.height, self.width).text[turn]
            diagnosis = self._diagnose_at_own_size(picture._replace(codes=upright[turn]))
            if diagnosis.kind != UNKNOWN:
                return diagnosis.with_mistake(turn, sentence, size)
        return self._diagnose_at_own_size(picture).with_mistake("size", size)

    def _diagnose_at_own_size(self, picture: Picture) -> Diagnosis:
        """Diagnose a picture, compared with the right picture that has the size of `picture`."""
        codes, picture_save = picture.codes, picture.save
        height, width = codes.shape[:2]
        known = self._known_pictures(height, width)
        right_codes = _to_picture(known.right_codes, width)
        if diagnosis := diagnose_agreement(codes, right_codes) or diagnose_single_color(codes):
            return diagnosis
        codes = self.picture.save(codes) if self.picture.save else codes
        lossy_levels = max(picture.lossy_levels, self.picture.lossy_levels)
        search = Search(
            _to_columns(codes),
            known,
            lossy_levels or _PICTURE_LEVELS * (self.scene is None),
            picture_save and (lambda flat: _to_columns(picture_save(_to_picture(flat, width)))),
        )
        if lossy_levels and search.is_wrong.mean() < 0.01:
            return _verdict("format", "It is the right picture.")
        finding = search.find()
        if finding.causes:
            causes = tuple(_sentences_of(cause, search) for cause in finding.causes)
            after = (
                f"That leaves {finding.remaining_count:,} of {search.wrong_count:,} pixels"
                " that differ."
            )
            return Diagnosis(causes, after=after if finding.remaining_count else "")
        if not search.lossy_levels and (keyword_and_sentence := _find_symptom(search)):
            return _verdict(*keyword_and_sentence)
        return self._diagnose_unknown(search, finding)

    def _diagnose_unknown(self, search: Search, finding: Finding) -> Diagnosis:
        """Describe a picture that no known mistake explains.

        Parameters
        ----------
        search : Search
            The picture that was handed in, with its wrong pixels.
        finding : Finding
            The result of the search: no cause, and perhaps a hint (the cause with the most similar
            picture).

        Returns
        -------
        Diagnosis
            Of the kind "unknown".  Its sentences describe the hint, and which pixels differ.
        """
        if not search.clearly_wrong_count:
            count_text = _count_pixels(search.wrong_count, "is", "are")
            sentence = f"{count_text} one level off; no known mistake does this."
            return _verdict(UNKNOWN, sentence)
        count = len(search.known.table)
        sentence, nearest = f"None of the {count} known mistakes explains this picture.", ""
        if finding.hint:
            nearest = " ".join(_sentences_of(finding.hint, search).values())
            numbers = f"{finding.remaining_count:,} of {search.wrong_count:,} pixels"
            nearest = f"The nearest that is known: {nearest} It does not explain {numbers}."
        after = _join_sentences(nearest, self._describe_differences(search, finding.hint))
        return _verdict(UNKNOWN, sentence, after=after, hint="+".join(finding.hint))

    def _describe_differences(self, search: Search, hint: Cause) -> str:
        """Return sentences that state where a picture differs from the right one.

        They name the surfaces with most of the wrong pixels, the lights that are wrong there, and
        the worst pixel.  If there is a hint, or if outlines differ, the lights and the worst pixel
        are omitted, because they would mislead.

        Parameters
        ----------
        search : Search
            The picture that was handed in, with its wrong pixels.
        hint : tuple of str
            Keywords of the mistakes with the most similar picture; may be empty.
        """
        known = search.known
        is_wrong = difference(known.right_codes, search.handin) > 1
        pictures = (_to_picture(codes, known.width) for codes in (search.handin, known.right_codes))
        x, y = worst_pixel(*pictures)
        pixel = y * known.width + x
        handin_code, right_code = (" ".join(map(str, codes[:, pixel]))
                                   for codes in (search.handin, known.right_codes))  # fmt: skip
        worst = f" The worst is {x},{y}: {handin_code} in place of {right_code}"
        count_text = _count_pixels(is_wrong.sum())
        if not self.scene:
            return (
                f"{count_text}.{worst}. With the scene in place of the right picture, more can be"
                " said."
            )
        surfaces = _wrong_surfaces(self.scene, search, is_wrong)
        has_wrong_outlines = (is_wrong & (known.surface < 0)).sum() > 0.02 * is_wrong.sum()
        if has_wrong_outlines or hint:
            return f"{count_text}: {surfaces}."
        height = known.pixel_count // known.width
        is_scene_size = (self.scene.width, self.scene.height) == (known.width, height)
        option = "" if is_scene_size else f" --size {known.width}x{height}"
        return (
            f"{count_text}: {surfaces}.{_wrong_lights(self.scene, search, is_wrong)}{worst};"
            f" tracer {self.name}{option} --pixel {x},{y} explains it."
        )


def _wrong_surfaces(scene: Scene, search: Search, is_wrong: Array) -> str:
    """Return words that name the surfaces with most of the wrong pixels, and the numbers of these.

    Parameters
    ----------
    scene : Scene
        The scene, for the names of its surfaces.
    search : Search
        The picture that was handed in, with the known pictures of the scene.
    is_wrong : (n,) bool array
        Which pixels differ from the right picture by more than one level.
    """
    change = search.handin.astype(np.int16) - search.known.right_codes
    counts_and_texts = []
    for k in np.unique(search.known.surface[is_wrong]):
        is_on_surface = search.known.surface == k
        name = str(SurfaceRef.from_index(scene, int(k))) if k >= 0 else "the background"
        is_wrong_here = is_wrong & is_on_surface
        count, brightness = int(is_wrong_here.sum()), _brightness_note(change[:, is_wrong_here])
        text = f"{count:,} of {is_on_surface.sum():,} on {name}{brightness}"
        counts_and_texts.append((count, text))
    counts_and_texts.sort(key=lambda item: -item[0])
    words = ", ".join(text for _, text in counts_and_texts[:_MAX_NAMED])
    other_count = sum(count for count, _ in counts_and_texts[_MAX_NAMED:])
    return words + (f", {other_count:,} on others" if other_count else "")


def _wrong_lights(scene: Scene, search: Search, is_wrong: Array) -> str:
    """Return a sentence for each light that is missing, or wrongly present, at many wrong pixels.

    Parameters
    ----------
    scene : Scene
        The scene, for the line numbers of its lights.
    search : Search
        The picture that was handed in, with the known pictures of the scene.
    is_wrong : (n,) bool array
        Which pixels differ from the right picture by more than one level.

    Returns
    -------
    str
        The sentences, each after a space; empty if there are none.
    """
    changes = symptoms.find_light_changes(search)
    if not changes:
        return ""
    sentences = ""
    for k, light in enumerate(scene.lights):
        name = f"light {k}" + (f" (line {light.line})" if light.line else "")
        for is_changed, verb in ((changes.is_lost, "should shine but does not"),
                                 (changes.is_extra, "should be blocked but shines")):  # fmt: skip
            count = int((is_changed[k] & is_wrong[changes.pixels]).sum())
            if count > _MIN_LIGHT_SHARE * is_wrong.sum():
                sentences += f" At {count:,} of these pixels {name} {verb}."
    return sentences


def _render_codes(scene: Scene) -> Codes:
    """Render a scene as 8-bit codes (h, w, 3).

    Warnings are suppressed, such as that about pixels that are not square.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        codes: Codes = to_codes(render(scene))
    return codes


def _visible_surfaces(scene: Scene) -> Array:
    """Return, for each of the n pixels of a scene's picture, the index of the surface it shows.

    The result is an array (n,), row by row; -1 stands for the background.
    """
    surfaces = []
    for start in range(0, scene.width * scene.height, MAX_PIXELS):
        pixels = np.arange(start, min(start + MAX_PIXELS, scene.width * scene.height))
        row, column = np.divmod(pixels, scene.width)
        surfaces.append(first_hits(scene, column + 0.5, row + 0.5).surface.astype(np.int32))
    return np.concatenate(surfaces)


def _find_symptom(search: Search) -> tuple[str, str] | None:
    """Recognise a difference that does not come from a wrong formula, such as rounding or JPEG.

    Parameters
    ----------
    search : Search
        The picture that was handed in, with the known pictures of the scene.

    Returns
    -------
    tuple or None
        A keyword, such as "single-precision", and a sentence for the report; None if no such
        difference is recognised.
    """
    known = search.known
    if search.clearly_wrong_count and symptoms.is_decided_by_rounding(search):
        count_text = _count_pixels(search.clearly_wrong_count)
        sentence = f"{count_text} where rounding decides, as in single precision."
        return "single-precision", sentence
    if symptoms.is_speckled(symptoms.find_light_changes(search), known):
        sentence = "Surfaces shadow themselves in dark dots: shadow rays need an epsilon."
        return "shadow-speckles", sentence
    pictures = (_to_picture(codes, known.width) for codes in (search.handin, known.right_codes))
    if symptoms.is_after_jpeg(*pictures):
        return "format", "It is the right picture, after JPEG, which changes levels."
    is_wrong = (difference(known.right_codes, search.handin) > 1).reshape(-1, known.width)
    if edge := symptoms.edge_with_all(is_wrong):
        return "edge", f"It is the right picture, except in the {edge}."
    return None


def _distance(a: Codes, b: Codes) -> Array:
    """Return, for each pixel, the largest difference between the channels of two pictures.

    Parameters
    ----------
    a, b : (h, w, 3) uint8 arrays
        The pictures' codes.

    Returns
    -------
    (h, w) int16 array
        Differences in levels.
    """
    return np.abs(a.astype(np.int16) - b).max(axis=2)


def worst_pixel(a: Codes, b: Codes) -> tuple[int, int]:
    """Find the pixel in which two pictures differ most.

    Parameters
    ----------
    a, b : (h, w, 3) uint8 arrays
        The pictures' codes.

    Returns
    -------
    column, row : int
    """
    row, column = np.unravel_index(_distance(a, b).argmax(), a.shape[:2])
    return int(column), int(row)


def diagnose_agreement(a: Codes, b: Codes) -> Diagnosis | None:
    """Return a diagnosis if two pictures agree, except for one level in few pixels.

    Parameters
    ----------
    a, b : (h, w, 3) uint8 arrays
        The pictures' codes.

    Returns
    -------
    Diagnosis or None
        Of the kind "identical" or "rounding"; None if the pictures do not agree.
    """
    count = int((a != b).any(axis=2).sum())
    if not count:
        return _verdict("identical", "The pictures are identical.")
    max_count = max(10, 0.01 * a.shape[0] * a.shape[1])
    if count <= max_count and _distance(a, b).max() == 1:
        sentence = f"{_count_pixels(count)} by one level: rounding, nothing to worry about."
        return _verdict("rounding", sentence)
    return None


def diagnose_single_color(codes: Codes) -> Diagnosis | None:
    """Return a diagnosis if all pixels of a picture have the same colour.

    Parameters
    ----------
    codes : (h, w, 3) uint8 array
        The picture's codes.

    Returns
    -------
    Diagnosis or None
        Of the kind "black" or "flat"; None if the picture has several colours.
    """
    if np.ptp(codes, axis=(0, 1)).any():
        return None
    if codes.any():
        return _verdict("flat", "The picture has one colour everywhere.")
    return _verdict("black", "The picture is black.")


def _count_pixels(count: int, singular: str = "differs", plural: str = "differ") -> str:
    """Return the subject and verb of a sentence on some pixels, such as "12 pixels differ".

    Parameters
    ----------
    count : int
        Number of pixels.
    singular, plural : str
        The verb for one pixel, and for several.
    """
    return f"One pixel {singular}" if count == 1 else f"{count:,} pixels {plural}"


def _sentences_of(cause: Cause, search: Search) -> dict[str, str]:
    """Return the sentence that describes each mistake of a cause.

    Parameters
    ----------
    cause : tuple of str
        Keywords of mistakes that are made together.
    search : Search
        The search that has found the cause.

    Returns
    -------
    dict of str to str
        The sentences by the keywords.  In each sentence, placeholders such as ``{fitted_gamma}``
        are replaced by the numbers that are fitted to the hand-in.
    """
    sentences, formulas = {}, search.known.formulas_of(cause) or {}
    for kind in cause:
        sentence = search.known.text[kind]
        for name in search.known.fitted_names(kind):
            placeholder = "{" + name + "}"
            if placeholder in sentence:
                number = search.fitted_pixels.get(name, formulas)
                sentence = sentence.replace(placeholder, f"{number:.3g}")
        sentences[kind] = sentence
    return sentences


def _to_columns(codes: Codes) -> Array:
    """Convert a picture (h, w, 3) to an array (3, n) with one column for each of the n pixels."""
    return np.ascontiguousarray(codes.reshape(-1, 3).T)


def _to_picture(columns: Array, width: int) -> Codes:
    """Convert an array (3, n) with one column per pixel to a picture (n / width, width, 3)."""
    return np.ascontiguousarray(columns.T.reshape(-1, width, 3))


def _brightness_note(change: Array) -> str:
    """Return a note if nearly all pixels become brighter, or nearly all darker.

    Parameters
    ----------
    change : (3, n) int array
        Difference of each channel of each pixel from the right one, in levels.

    Returns
    -------
    str
        " (brighter)" or " (darker)"; empty otherwise.
    """
    if (change >= -1).all(axis=0).mean() > 0.9:
        return " (brighter)"
    return " (darker)" if (change <= 1).all(axis=0).mean() > 0.9 else ""
