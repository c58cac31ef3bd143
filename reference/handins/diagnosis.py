"""Diagnose hand-ins: name the mistakes that they contain, or state where they differ.

A *hand-in* is a picture that a student handed in; the *reference picture* is what it should be.  A
*cause* is a tuple of keywords of mistakes that are made together.  A cause is reported only if the
scene, rendered with these mistakes, gives the hand-in.  Without the scene, a reference picture
alone shows only some mistakes of the camera and of the encoding.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from reference.handins import symptoms
from reference.handins.formulas import Array
from reference.handins.mistakes import OF_PICTURE
from reference.handins.search import MAX_PIXELS, Cause, Finding, MistakeRenderer, Submission
from reference.pictures import Codes, Picture, level_difference, to_columns, to_picture
from tracer import Scene, SurfaceRef, first_hits, render, to_codes

AGREEING = ("identical", "rounding", "format")
"""Keywords of the diagnoses of right pictures."""
UNKNOWN = "unknown"
"""Keyword of the diagnosis of a picture that no known mistake explains."""
# Maximum number of surfaces, and of alternative causes, that a report names.
_MAX_NAMED = 3
# A light is named if it is wrong at more than this part of the wrong pixels.
_MIN_LIGHT_SHARE = 0.1
# Light that is read from a picture is off by at most this many levels, as its codes were rounded.
_PICTURE_LEVELS = 3
# How pictures that are turned are turned back, by the keywords of the mistakes.
_TURN_BACK: dict[str, Callable[[Codes], Codes]] = {
    "transposed": lambda codes: codes.swapaxes(0, 1),
    "turned-90": lambda codes: np.rot90(codes, -1),
    "turned-270": np.rot90,
}


@dataclass(frozen=True)
class Diagnosis:
    """The verdict on a picture that a student handed in, or the mistakes that it contains.

    Attributes
    ----------
    causes : tuple of dict of str to str
        The alternative causes, at least one.  Each contains the mistakes that are made together:
        the key is the keyword of a mistake, and the value is its sentence, as in
        ``{"gamma-none": "Gamma is missing."}``.  A verdict, such as "identical", is a cause with
        one keyword, and then the only one.
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
        """All keywords: those of one cause are joined by ``+``, alternative causes by ``|``."""
        return "|".join("+".join(cause) for cause in self.causes)

    @property
    def first(self) -> str:
        """The sentences of the first cause, joined by spaces."""
        return " ".join(self.causes[0].values())

    def __str__(self) -> str:
        """Return the report: all sentences, with a few alternative causes in brackets."""
        first_cause, *others = self.causes
        sentences = [" ".join(cause[keyword] for keyword in cause if keyword not in first_cause)
                     for cause in others]  # fmt: skip
        alternatives, note = [*filter(None, sentences)], ""
        if alternatives:
            unnamed_count = len(alternatives) - _MAX_NAMED + 1
            note = " Or: ".join(alternatives[: _MAX_NAMED - 1])
            note += f" Or one of {unnamed_count} more." if unnamed_count > 0 else ""
            note = f"(In this scene one cannot tell it from: {note})"
        return " ".join(filter(None, (self.before, self.first, note, self.after)))

    def preceded_by(self, sentence: str) -> Diagnosis:
        """Return a copy whose report begins with another sentence, which may be empty."""
        return replace(self, before=f"{sentence} {self.before}".strip())

    def with_mistake(self, keyword: str, sentence: str) -> Diagnosis:
        """Return a copy in which each cause begins with one more mistake.

        If this diagnosis states that the picture is right, the mistake becomes the only cause.

        Parameters
        ----------
        keyword, sentence : str
            Keyword of the mistake, and the sentence that describes it.
        """
        other_causes = ({},) if self.kind in AGREEING else self.causes
        return replace(self, causes=tuple({keyword: sentence} | cause for cause in other_causes))

    def most_frequent_first(self, frequency: Counter[str]) -> Diagnosis:
        """Return a copy whose causes are sorted by frequency, the most frequent first.

        Parameters
        ----------
        frequency : Counter of str
            The frequency of each cause; the key is the cause's keywords, joined by ``+``.
        """
        causes = sorted(self.causes, key=lambda cause: -frequency["+".join(cause)])
        return replace(self, causes=tuple(causes))


def _verdict(keyword: str, sentence: str) -> Diagnosis:
    """Return a diagnosis with one keyword, such as "identical", and a sentence that explains it."""
    return Diagnosis(({keyword: sentence},))


class Solution:
    """The solution of a task: a scene or a reference picture, with which hand-ins are compared.

    A hand-in is a picture that a student handed in.

    Parameters
    ----------
    scene : Scene or Picture
        The scene; or, if there is no scene, the reference picture.
    name : str
        The scene's file as a user types it on a command line; it appears in reports.

    Attributes
    ----------
    scene : Scene or None
        None if only a reference picture is known.
    picture : Picture
        The reference picture.
    codes : (h, w, 3) uint8 array
        The codes of the reference picture.
    """

    def __init__(self, scene: Scene | Picture, name: str = "") -> None:
        self.name, self.scene = name, scene if isinstance(scene, Scene) else None
        self.picture = Picture(_render_codes(scene)) if isinstance(scene, Scene) else scene
        self.codes: Codes = self.picture.codes
        # Renderers of two sizes are cached: those of all sizes of a class would fill the memory.
        self._renderer = lru_cache(maxsize=2)(self._new_renderer)

    def _new_renderer(self, height: int, width: int) -> MistakeRenderer:
        """Create the renderer of pictures with mistakes for one size.

        Parameters
        ----------
        height, width : int
            Size of the pictures in pixels.  Without a scene, it must be the size of the reference
            picture.

        Returns
        -------
        MistakeRenderer
            Renders the scene, or transforms the reference picture, as a tracer with mistakes would.
        """
        codes = self.codes
        if not self.scene:
            surface_index = codes.any(axis=2).ravel() - 1
            return MistakeRenderer(codes, to_columns(codes), surface_index, width, OF_PICTURE)
        scene = replace(self.scene, width=width, height=height)
        codes = codes if codes.shape[:2] == (height, width) else _render_codes(scene)
        return MistakeRenderer(scene, to_columns(codes), _find_visible_surfaces(scene), width, {})

    @np.errstate(all="ignore")
    def diagnose(self, picture: Picture) -> Diagnosis:
        """Find the mistakes with which the scene renders as a picture, or say where they differ.

        Parameters
        ----------
        picture : Picture
            The picture that a student handed in.  A wrong size is reported as a mistake.  A turned
            picture is turned back and then diagnosed.

        Returns
        -------
        Diagnosis
            The mistakes; or the verdict that the picture is right, or "unknown".
        """
        (height, width), (right_height, right_width) = picture.codes.shape[:2], self.codes.shape[:2]
        if (height, width) == (right_height, right_width):
            return self._diagnose_at_own_size(picture)
        right_size = f"{right_width}x{right_height}"
        size_sentence = f"The picture has {width}x{height} pixels in place of {right_size}."
        if diagnosis := diagnose_single_color(picture.codes):
            return diagnosis
        if keyword_and_sentence := symptoms.find_reference_within(picture.codes, self.codes):
            return _verdict(*keyword_and_sentence).preceded_by(size_sentence)
        if (height, width) == (right_width, right_height):
            upright = {keyword: np.ascontiguousarray(turn_back(picture.codes))
                       for keyword, turn_back in _TURN_BACK.items()}  # fmt: skip
            turn = min(
                upright, key=lambda turn: level_difference(upright[turn], self.codes, 2).sum()
            )
            diagnosis = self._diagnose_at_own_size(picture._replace(codes=upright[turn]))
            if diagnosis.kind != UNKNOWN:
                sentence = self._renderer(right_height, right_width).mistakes[turn].sentence
                return diagnosis.with_mistake(turn, sentence).preceded_by(size_sentence)
        if not self.scene:
            return _verdict("size", size_sentence)
        return self._diagnose_at_own_size(picture).with_mistake("size", size_sentence)

    def _diagnose_at_own_size(self, picture: Picture) -> Diagnosis:
        """Diagnose a picture, compared with the reference picture of the same size.

        Parameters
        ----------
        picture : Picture
            The picture that a student handed in.  Without a scene, it has the size of the reference
            picture.

        Returns
        -------
        Diagnosis
            The mistakes; or the verdict that the picture is right, or "unknown".
        """
        codes, save = picture.codes, picture.save
        height, width = codes.shape[:2]
        renderer = self._renderer(height, width)
        reference_codes = to_picture(renderer.reference_codes, width)
        if diagnosis := diagnose_agreement(codes, reference_codes) or diagnose_single_color(codes):
            return diagnosis
        codes = self.picture.save(codes) if self.picture.save else codes
        lossy_levels = max(picture.lossy_levels, self.picture.lossy_levels)
        submission = Submission(
            to_columns(codes),
            renderer,
            lossy_levels or _PICTURE_LEVELS * (self.scene is None),
            save and (lambda columns: to_columns(save(to_picture(columns, width)))),
        )
        if lossy_levels and submission.is_wrong.mean() < 0.01:
            return _verdict("format", "It is the right picture.")
        finding = submission.find_mistakes()
        if finding.causes:
            numbers = f"{finding.unexplained_count:,} of {submission.wrong_count:,}"
            remainder = f"That leaves {numbers} pixels that differ."
            causes = (_fill_in_sentences(cause, submission) for cause in finding.causes)
            return Diagnosis(tuple(causes), after=remainder if finding.unexplained_count else "")
        if not submission.lossy_levels and (
            keyword_and_sentence := symptoms.find_symptom(submission)
        ):
            return _verdict(*keyword_and_sentence)
        return self._diagnose_unknown(submission, finding)

    def _diagnose_unknown(self, submission: Submission, finding: Finding) -> Diagnosis:
        """Describe a picture that no known mistake explains.

        Parameters
        ----------
        submission : Submission
            The picture that a student handed in, and its wrong pixels.
        finding : Finding
            The result of the search: no cause, and perhaps a hint (the mistakes with the most
            similar picture).

        Returns
        -------
        Diagnosis
            Of the kind "unknown".  Its sentences describe the hint, and which pixels differ.
        """
        if not submission.clearly_wrong_count:
            pixels = symptoms.count_pixels(submission.wrong_count, "is", "are")
            return _verdict(UNKNOWN, f"{pixels} one level off; no known mistake does this.")
        mistake_count = len(submission.renderer.mistakes)
        sentence, after = f"None of the {mistake_count} known mistakes explains this picture.", ""
        if finding.hint:
            nearest = " ".join(_fill_in_sentences(finding.hint, submission).values())
            numbers = f"{finding.unexplained_count:,} of {submission.wrong_count:,} pixels"
            after = f"The nearest that is known: {nearest} It does not explain {numbers}. "
        after += self._describe_differences(submission, finding.hint)
        return Diagnosis(({UNKNOWN: sentence},), after=after, hint="+".join(finding.hint))

    def _describe_differences(self, submission: Submission, hint: Cause) -> str:
        """Describe in sentences where a picture differs from the reference picture.

        The sentences name the surfaces with most of the wrong pixels, the lights that are wrong
        there, and the worst pixel.  If there is a hint, or if outlines differ, the lights and the
        worst pixel are omitted, because they would mislead.

        Parameters
        ----------
        submission : Submission
            The picture that a student handed in, and the renderer of its scene.
        hint : tuple of str
            Keywords of the mistakes with the most similar picture; may be empty.
        """
        renderer = submission.renderer
        both_codes = submission.codes, renderer.reference_codes
        width, height = renderer.width, renderer.pixel_count // renderer.width
        levels = level_difference(*both_codes)
        is_wrong = levels > 1
        y, x = divmod(int(levels.argmax()), width)
        handin_code, reference_code = (" ".join(map(str, codes[:, levels.argmax()]))
                                       for codes in both_codes)  # fmt: skip
        worst = f" The worst is {x},{y}: {handin_code} in place of {reference_code}"
        count = symptoms.count_pixels(is_wrong.sum())
        if not self.scene:
            advice = "With the scene in place of the right picture, more can be said."
            return f"{count}.{worst}. {advice}"
        count_and_surfaces = (
            f"{count}: {_describe_wrong_surfaces(self.scene, submission, is_wrong)}."
        )
        on_background = is_wrong & (renderer.surface_index < 0)
        if hint or on_background.sum() > 0.02 * is_wrong.sum():
            return count_and_surfaces
        is_scene_size = (self.scene.width, self.scene.height) == (width, height)
        option = "" if is_scene_size else f" --size {width}x{height}"
        command = f"tracer {self.name}{option} --pixel {x},{y}"
        lights = _describe_wrong_lights(self.scene, submission, is_wrong)
        return f"{count_and_surfaces}{lights}{worst}; {command} explains it."


def _describe_wrong_surfaces(scene: Scene, submission: Submission, is_wrong: Array) -> str:
    """Name the surfaces that most of the wrong pixels show, with the numbers of these pixels.

    Parameters
    ----------
    scene : Scene
        The scene, for the names of its surfaces.
    submission : Submission
        The picture that a student handed in, and the renderer of its scene.
    is_wrong : (n,) bool array
        True for pixels that differ from the reference picture by more than one level.

    Returns
    -------
    str
        Words such as "12 of 345 on sphere 1 (line 8) (darker), 6 on others".
    """
    all_surfaces = submission.renderer.surface_index
    change = submission.codes.astype(np.int16) - submission.renderer.reference_codes
    surfaces, counts = np.unique(all_surfaces[is_wrong], return_counts=True)
    order, parts = np.argsort(-counts, kind="stable"), []
    for surface, count in zip(surfaces[order[:_MAX_NAMED]], counts[order], strict=False):
        name = str(SurfaceRef.from_index(scene, int(surface))) if surface >= 0 else "the background"
        is_here = all_surfaces == surface
        note = _brightness_note(change[:, is_wrong & is_here])
        parts.append(f"{count:,} of {is_here.sum():,} on {name}{note}")
    if other_count := counts[order[_MAX_NAMED:]].sum():
        parts.append(f"{other_count:,} on others")
    return ", ".join(parts)


def _describe_wrong_lights(scene: Scene, submission: Submission, is_wrong: Array) -> str:
    """Return a sentence for each light that is missing, or wrongly present, at many wrong pixels.

    Parameters
    ----------
    scene : Scene
        The scene, for the line numbers of its lights.
    submission : Submission
        The picture that a student handed in, and the renderer of its scene.
    is_wrong : (n,) bool array
        True for pixels that differ from the reference picture by more than one level.

    Returns
    -------
    str
        The sentences, each after a space; empty if there are none.
    """
    verbs = "should shine but does not", "should be blocked but shines"
    sentences = ""
    for verb, is_changed in zip(verbs, symptoms.find_light_changes(submission) or (), strict=False):
        for k, count in enumerate((is_changed & is_wrong).sum(axis=1)):
            if count > _MIN_LIGHT_SHARE * is_wrong.sum():
                line = f" (line {scene.lights[k].line})" if scene.lights[k].line else ""
                sentences += f" At {count:,} of these pixels light {k}{line} {verb}."
    return sentences


def _render_codes(scene: Scene) -> Codes:
    """Render a scene as 8-bit codes (h, w, 3), without warnings, such as of non-square pixels."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        codes: Codes = to_codes(render(scene))
    return codes


def _find_visible_surfaces(scene: Scene) -> Array:
    """Find the surface that each of the n pixels of a scene's picture shows.

    Returns
    -------
    surface_index : (n,) int32 array
        Indices of the surfaces, row by row; -1 for the background.
    """
    pixel_count = scene.width * scene.height
    batches = np.array_split(np.arange(pixel_count), pixel_count // MAX_PIXELS + 1)
    hits = (first_hits(scene, batch % scene.width + 0.5, batch // scene.width + 0.5)
            for batch in batches)  # fmt: skip
    return np.concatenate([hit.surface.astype(np.int32) for hit in hits])


def find_worst_pixel(first: Codes, second: Codes) -> tuple[int, int]:
    """Find the pixel in which two pictures differ most.

    Parameters
    ----------
    first, second : (h, w, 3) uint8 arrays
        Codes of the pictures.

    Returns
    -------
    column, row : int
    """
    levels = level_difference(first, second, 2)
    row, column = np.unravel_index(levels.argmax(), levels.shape)
    return int(column), int(row)


def diagnose_agreement(submitted_codes: Codes, reference_codes: Codes) -> Diagnosis | None:
    """Return a diagnosis if two pictures agree, except for one level in few pixels.

    Parameters
    ----------
    submitted_codes, reference_codes : (h, w, 3) uint8 arrays
        Codes of the picture that a student handed in, and of the reference picture.

    Returns
    -------
    Diagnosis or None
        Of the kind "identical" or "rounding"; None if the pictures do not agree.
    """
    levels = level_difference(submitted_codes, reference_codes, 2)
    count = int(np.count_nonzero(levels))
    if not count:
        return _verdict("identical", "The pictures are identical.")
    if count <= max(10, 0.01 * levels.size) and levels.max() == 1:
        sentence = f"{symptoms.count_pixels(count)} by one level: rounding, nothing to worry about."
        return _verdict("rounding", sentence)
    return None


def diagnose_single_color(codes: Codes) -> Diagnosis | None:
    """Return a diagnosis if all pixels of a picture have the same colour.

    Parameters
    ----------
    codes : (h, w, 3) uint8 array
        Codes of the picture.

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


def _fill_in_sentences(cause: Cause, submission: Submission) -> dict[str, str]:
    """Map each mistake of a cause to its sentence, with estimated numbers filled in.

    Parameters
    ----------
    cause : tuple of str
        Keywords of mistakes that are made together.
    submission : Submission
        The search that found the cause.

    Returns
    -------
    dict of str to str
        The sentences by keyword.  Each placeholder such as ``{fitted_gamma}`` is replaced by a
        number that is estimated from the picture that was handed in.
    """
    formulas = submission.renderer.replacements_for(cause)

    def number_of(placeholder: re.Match[str]) -> str:
        return f"{submission.fitting_cache.get_value(placeholder[1], formulas):.3g}"

    mistakes = submission.renderer.mistakes
    return {k: re.sub(r"\{(\w+)\}", number_of, mistakes[k].sentence) for k in cause}


def _brightness_note(change: Array) -> str:
    """Return a note if nearly all pixels of a region became brighter, or nearly all darker.

    Parameters
    ----------
    change : (3, n) int array
        Difference of each channel of the region's n pixels from the reference picture, in levels.

    Returns
    -------
    str
        " (brighter)" or " (darker)"; empty if neither applies.
    """
    if (change >= -1).all(axis=0).mean() > 0.9:
        return " (brighter)"
    return " (darker)" if (change <= 1).all(axis=0).mean() > 0.9 else ""
