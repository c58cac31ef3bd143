"""Diagnose submitted pictures: name the mistakes that they contain, or state where they differ.

A *submitted picture* is one that a student handed in; the *reference picture* is what it should be.
A *cause* is a tuple of keywords of mistakes that are made together.  A cause is reported only if
the scene, rendered with these mistakes, gives the submitted picture.  Without the scene, only some
mistakes of the camera and of the encoding can be recognised from the reference picture.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from reference.handins import symptoms
from reference.handins.formula_functions import Array
from reference.handins.mistakes import PICTURE_FORMULAS
from reference.handins.renderer import MAX_PIXELS, Cause, MistakeRenderer
from reference.handins.search import Finding, Submission
from reference.judges.arrays import Bools
from reference.pictures import Codes, Picture, compare_levels, to_columns
from tracer import Scene, SurfaceRef, first_hits, render, to_codes

IDENTICAL = "identical"
"""Keyword of the diagnosis of a picture whose codes all equal those of the reference picture."""
AGREEING_KINDS = (IDENTICAL, "rounding", "format")
"""Keywords of the diagnoses of right pictures."""
UNKNOWN = "unknown"
"""Keyword of the diagnosis of a picture that no known mistake explains."""
# Maximum number of surfaces, and of alternative causes, to name in a report.
_MAX_NAMED = 3
# A light is named if it is wrong at more than this share of the wrong pixels.
_MIN_LIGHT_SHARE = 0.1
# Light computed from the rounded codes of a picture is off by at most this many levels.
_PICTURE_NOISE = 3
# Functions that turn a picture back, by the keyword of the mistake that turned it.
_TURN_BACK_FUNCTIONS: dict[str, Callable[[Codes], Codes]] = {
    "transposed": lambda codes: codes.swapaxes(0, 1),
    "turned-90": lambda codes: np.rot90(codes, -1),
    "turned-270": np.rot90,
}


@dataclass(frozen=True)
class Diagnosis:
    """The verdict on a submitted picture, or the mistakes that it contains."""

    # The alternative causes, at least one.  Each maps the keywords of mistakes that are made
    # together to sentences, as in ``{"gamma-none": "Gamma is missing."}``.  A verdict, such as
    # "identical", is a single cause with one keyword.
    causes: tuple[dict[str, str], ...]
    # Text of the report before and after the sentences of the causes; may be empty.
    text_before: str = ""
    text_after: str = ""
    # If no cause is known, the keywords of the mistakes that come closest to explaining the
    # picture, joined by ``+``; otherwise empty.
    hint: str = ""
    # If no cause is known, a few words on where the picture differs, for tables; otherwise empty.
    summary: str = ""

    @property
    def kind(self) -> str:
        """All keywords, joined by ``+`` within a cause and by ``|`` between alternative causes."""
        return "|".join("+".join(cause) for cause in self.causes)

    @property
    def first_cause_text(self) -> str:
        """The sentences of the first cause, joined by spaces."""
        return " ".join(self.causes[0].values())

    def __str__(self) -> str:
        """Format the report: the first cause, then a few of the other causes in parentheses."""
        alternatives = [" ".join(cause.values()) for cause in self.causes[1:]]
        note = ""
        if alternatives:
            omitted_count = len(alternatives) - _MAX_NAMED + 1
            note = " Or: ".join(alternatives[: _MAX_NAMED - 1])
            note += f" Or one of {omitted_count} more." if omitted_count > 0 else ""
            note = f"(In this scene, it looks the same as: {note})"
        texts = self.text_before, self.first_cause_text, note, self.text_after
        return " ".join(filter(None, texts))

    def prepend_text(self, sentence: str) -> Diagnosis:
        """Return a copy whose report begins with the given sentence, which may be empty."""
        return replace(self, text_before=f"{sentence} {self.text_before}".strip())

    def add_mistake(self, keyword: str, sentence: str) -> Diagnosis:
        """Return a copy with one more mistake at the beginning of each cause.

        If the diagnosis was that the picture is right, the mistake becomes the only cause.
        """
        causes = ({},) if self.kind in AGREEING_KINDS else self.causes
        return replace(self, causes=tuple({keyword: sentence} | cause for cause in causes))

    def sort_by_frequency(self, cause_counts: Counter[str]) -> Diagnosis:
        """Return a copy with the most frequent causes first.

        The keys of `cause_counts` are keywords, joined by ``+``.
        """
        causes = sorted(self.causes, key=lambda cause: -cause_counts["+".join(cause)])
        return replace(self, causes=tuple(causes))


def make_verdict(keyword: str, sentence: str) -> Diagnosis:
    """Make a diagnosis of one keyword, such as "identical", and a sentence that explains it."""
    return Diagnosis(({keyword: sentence},))


class Reference:
    """A scene or a reference picture to compare students' pictures with.

    Parameters
    ----------
    source
        The scene, or the reference picture if there is no scene.
    name
        The scene's file name as typed on a command line; it appears in reports.
    load_other_codes
        Returns pictures of other scenes, by file name, with which a student may have mixed it up.
    """

    name: str
    scene: Scene | None  # None if only a reference picture is known
    picture: Picture
    codes: Shaped[Codes, "h w 3"]

    def __init__(
        self,
        source: Scene | Picture,
        name: str = "",
        load_other_codes: Callable[[], Mapping[str, Codes]] = dict,
    ) -> None:
        self.name, self.scene = name, source if isinstance(source, Scene) else None
        self._load_other_codes = load_other_codes
        self.picture = Picture(_render_codes(source)) if isinstance(source, Scene) else source
        self.codes = self.picture.codes
        # Cache only two renderers: those for all picture sizes in a class would fill the memory.
        self._get_renderer = lru_cache(maxsize=2)(self._make_renderer)

    def _make_renderer(self, height: int, width: int) -> MistakeRenderer:
        """Create the renderer that simulates mistakes in pictures of one size.

        Without a scene, it alters the reference picture, whose size must be given.
        """
        codes = self.codes
        if not self.scene:
            surface_index = codes.any(axis=2).ravel() - np.int8(1)  # 0, or -1 for black pixels
            return MistakeRenderer(codes, to_columns(codes), surface_index, width, PICTURE_FORMULAS)
        scene = replace(self.scene, width=width, height=height)
        codes = codes if codes.shape[:2] == (height, width) else _render_codes(scene)
        return MistakeRenderer(scene, to_columns(codes), _find_visible_surfaces(scene), width, {})

    @np.errstate(all="ignore")
    def diagnose(self, picture: Picture) -> Diagnosis:
        """Find the mistakes that explain a submitted picture, or describe where it is wrong."""
        has_same_size = picture.codes.shape == self.codes.shape
        return self._diagnose_pixels(picture) if has_same_size else self._diagnose_size(picture)

    def _diagnose_size(self, picture: Picture) -> Diagnosis:
        """Diagnose a submitted picture of another size than the reference picture.

        The size is reported as a mistake, together with those that are found in the scene, rendered
        at this size.
        """
        height, width = picture.codes.shape[:2]
        reference_height, reference_width = self.codes.shape[:2]
        expected_size = f"{reference_width}x{reference_height}"
        sentence = f"The picture has {width}x{height} pixels in place of {expected_size}."
        if diagnosis := diagnose_single_color(picture.codes):
            return diagnosis
        if symptom := symptoms.find_reference_within(picture.codes, self.codes):
            return make_verdict(*symptom).prepend_text(sentence)
        if (width, height) == (reference_height, reference_width) and (
            diagnosis := self._diagnose_turned(picture)
        ):
            return diagnosis.prepend_text(sentence)
        if diagnosis := self._diagnose_other_scene(picture):
            return diagnosis
        if not self.scene:
            return make_verdict("size", sentence)
        return self._diagnose_pixels(picture).add_mistake("size", sentence)

    def _diagnose_turned(self, picture: Picture) -> Diagnosis | None:
        """Diagnose a submitted picture that is turned by 90 degrees or transposed.

        It is turned back in the way that makes it most similar to the reference picture.  None if
        no known mistake explains the result.
        """
        upright_codes = {
            keyword: turn_back(picture.codes) for keyword, turn_back in _TURN_BACK_FUNCTIONS.items()
        }
        differences = {
            keyword: compare_levels(codes, self.codes, axis=2).sum()
            for keyword, codes in upright_codes.items()
        }
        keyword = min(differences, key=differences.__getitem__)
        codes = np.ascontiguousarray(upright_codes[keyword])
        diagnosis = self._diagnose_pixels(picture._replace(codes=codes))
        if diagnosis.kind == UNKNOWN:
            return None
        mistakes = self._get_renderer(*self.codes.shape[:2]).mistakes
        return diagnosis.add_mistake(keyword, mistakes[keyword].sentence)

    def _diagnose_other_scene(self, picture: Picture) -> Diagnosis | None:
        """Diagnose a submitted picture that shows another scene; None if it shows none."""
        for name, codes in self._load_other_codes().items():
            if np.array_equal(codes, picture.codes):
                return make_verdict("other-scene", f"It is the picture of {name}.")
        return None

    def _diagnose_pixels(self, picture: Picture) -> Diagnosis:
        """Diagnose a submitted picture by comparing it with a reference picture of the same size.

        Without a scene, it must have the size of the reference picture.
        """
        codes, renderer = picture.codes, self._get_renderer(*picture.codes.shape[:2])
        agreement = diagnose_agreement(to_columns(codes), renderer.reference_codes)
        if diagnosis := agreement or diagnose_single_color(codes):
            return diagnosis
        codes = self.picture.reencode(codes) if self.picture.reencode else codes
        format_noise = max(picture.format_noise, self.picture.format_noise)
        noise = format_noise or _PICTURE_NOISE * (self.scene is None)
        submission = Submission(to_columns(codes), renderer, noise, picture.reencode)
        if format_noise and submission.is_wrong.mean() < 0.01:
            return make_verdict("format", "It is the right picture.")
        black_surfaces = symptoms.find_black_surfaces(submission) if self.scene else []
        # Symptoms come before pairs of mistakes, whose search takes seconds.
        if not submission.good_singles:
            if diagnosis := self._diagnose_other_scene(picture):
                return diagnosis
            if self.scene and black_surfaces:
                return _describe_black_surfaces(self.scene, black_surfaces)
            if not noise and (symptom := symptoms.find_symptom(submission)):
                return make_verdict(*symptom)
        # Why surfaces are black, their pixels cannot tell: pairs of mistakes would be guesses.
        # Pairs change some levels by more than one.
        may_be_pair = not black_surfaces and submission.clearly_wrong_count > 0
        finding = submission.find_mistakes(may_be_pair=may_be_pair)
        if not finding.causes:
            return self._diagnose_unknown(submission, finding)
        counts = f"{finding.unexplained_count:,} of {submission.wrong_count:,}"
        sentence = f"That leaves {counts} wrong pixels unexplained."
        causes = (_format_sentences(cause, submission) for cause in finding.causes)
        return Diagnosis(tuple(causes), "", sentence if finding.unexplained_count else "")

    def _diagnose_unknown(self, submission: Submission, finding: Finding) -> Diagnosis:
        """Describe a picture that no known mistake explains: the nearest, and the wrong pixels."""
        if not submission.clearly_wrong_count:
            clause = symptoms.format_count(submission.wrong_count, "is", "are")
            return make_verdict(UNKNOWN, f"{clause} one level off; no known mistake does this.")
        mistake_count = len(submission.renderer.mistakes)
        sentence, details = f"None of the {mistake_count} known mistakes explains this picture.", ""
        if finding.hint:
            hint_text = " ".join(_format_sentences(finding.hint, submission).values())
            counts = f"{finding.unexplained_count:,} of {submission.wrong_count:,} pixels"
            details = f"The nearest that is known: {hint_text} It does not explain {counts}. "
        details += self._describe_differences(submission, finding.hint)
        return Diagnosis(
            ({UNKNOWN: sentence},),
            text_after=details,
            hint="+".join(finding.hint),
            summary=self._summarize_differences(submission),
        )

    def _summarize_differences(self, submission: Submission) -> str:
        """Say in a few words how many pixels are wrong, and which surface has most of them."""
        is_wrong = compare_levels(submission.codes, submission.renderer.reference_codes) > 1
        count_text = symptoms.format_count(is_wrong.sum())
        if not self.scene:
            return f"{count_text}."
        regions = _find_wrong_surfaces(self.scene, submission, is_wrong)
        return f"{count_text}, most on {regions[0].name}{regions[0].note}."

    def _describe_differences(self, submission: Submission, hint: Cause) -> str:
        """Describe in one or more sentences where a submitted picture differs.

        They name the surfaces with the most wrong pixels.  If there is no hint and the background
        is nearly right, they also name the worst pixel, and any lights that wrongly shine or fail
        to shine.  If the scene is unknown, they name only the worst pixel.
        """
        renderer = submission.renderer
        width, height = renderer.width, renderer.pixel_count // renderer.width
        differences = compare_levels(submission.codes, renderer.reference_codes)
        is_wrong = differences > 1
        worst_index = int(differences.argmax())
        y, x = divmod(worst_index, width)
        submitted_text = " ".join(map(str, submission.codes[:, worst_index]))
        reference_text = " ".join(map(str, renderer.reference_codes[:, worst_index]))
        pixel_text = f" The worst is {x},{y}: {submitted_text} in place of {reference_text}"
        count_text = symptoms.format_count(is_wrong.sum())
        if not self.scene:
            return f"{count_text}.{pixel_text}. Compare with the scene to learn more."
        surfaces_text = _describe_wrong_surfaces(self.scene, submission, is_wrong)
        is_wrong_background = is_wrong & (renderer.surface_index < 0)
        if hint or is_wrong_background.sum() > 0.02 * is_wrong.sum():
            return f"{count_text}: {surfaces_text}."
        has_scene_size = (self.scene.width, self.scene.height) == (width, height)
        option = "" if has_scene_size else f" --size {width}x{height}"
        command = f"tracer {self.name}{option} --pixel {x},{y}"
        lights_text = _describe_light_errors(self.scene, submission, is_wrong)
        return f"{count_text}: {surfaces_text}.{lights_text}{pixel_text}; {command} explains it."


def _describe_black_surfaces(scene: Scene, surface_indices: list[int]) -> Diagnosis:
    names = [str(SurfaceRef.from_index(scene, index)) for index in surface_indices[:_MAX_NAMED]]
    if other_count := len(surface_indices) - len(names):
        names.append(f"{other_count} more")
    verb = "is" if len(names) == 1 else "are"
    return make_verdict("black-surfaces", f"{' and '.join(names)} {verb} black or missing.")


class _WrongSurface(NamedTuple):
    """A surface with wrong pixels, or the background."""

    name: str
    note: str  # " (brighter)", " (darker)" or empty
    wrong_count: int
    pixel_count: int  # of all pixels that show the surface


def _find_wrong_surfaces(
    scene: Scene, submission: Submission, is_wrong: Shaped[Bools, "n"]
) -> list[_WrongSurface]:
    """Find the surfaces that have wrong pixels, those with the most of them first."""
    surface_index = submission.renderer.surface_index
    wrong_surface_index = surface_index[is_wrong]
    differences = submission.codes[:, is_wrong].astype(np.int16)
    differences -= submission.renderer.reference_codes[:, is_wrong]
    indices, counts = np.unique(wrong_surface_index, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return [
        _WrongSurface(
            name=str(SurfaceRef.from_index(scene, int(index))) if index >= 0 else "the background",
            note=_describe_brightness(differences[:, wrong_surface_index == index]),
            wrong_count=int(count),
            pixel_count=int((surface_index == index).sum()),
        )
        for index, count in zip(indices[order], counts[order], strict=True)
    ]


def _describe_wrong_surfaces(
    scene: Scene, submission: Submission, is_wrong: Shaped[Bools, "n"]
) -> str:
    """List the surfaces with the most wrong pixels.

    The result is such as "12 of 345 on Sphere 1 (line 8) (darker), 6 on others".
    """
    surfaces = _find_wrong_surfaces(scene, submission, is_wrong)
    phrases = [
        f"{surface.wrong_count:,} of {surface.pixel_count:,} on {surface.name}{surface.note}"
        for surface in surfaces[:_MAX_NAMED]
    ]
    if other_count := sum(surface.wrong_count for surface in surfaces[_MAX_NAMED:]):
        phrases.append(f"{other_count:,} on others")
    return ", ".join(phrases)


def _describe_light_errors(
    scene: Scene, submission: Submission, is_wrong: Shaped[Bools, "n"]
) -> str:
    """Describe the lights that wrongly shine, or fail to shine, on many of the wrong pixels.

    Each sentence is preceded by a space.
    """
    faults = "should shine but does not", "should be blocked but shines"
    sentences = ""
    for fault, has_fault in zip(faults, symptoms.find_light_errors(submission) or (), strict=False):
        for light_index, count in enumerate((has_fault & is_wrong).sum(axis=1)):
            if count > _MIN_LIGHT_SHARE * is_wrong.sum():
                note = f" (line {line})" if (line := scene.lights[light_index].line) else ""
                sentences += f" At {count:,} of these pixels light {light_index}{note} {fault}."
    return sentences


def _render_codes(scene: Scene) -> Shaped[Codes, "h w 3"]:
    """Render a scene as 8-bit codes (h, w, 3), and suppress warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        codes: Codes = to_codes(render(scene))
    return codes


def _find_visible_surfaces(scene: Scene) -> Shaped[Array, "n"]:
    """Find the surface that is visible in each pixel, row by row; -1 for the background."""
    surface_index = np.empty(scene.width * scene.height, dtype=np.int32)
    for start in range(0, len(surface_index), MAX_PIXELS):
        pixel_index = np.arange(start, min(start + MAX_PIXELS, len(surface_index)))
        row, column = np.divmod(pixel_index, scene.width)
        surface_index[pixel_index] = first_hits(scene, column + 0.5, row + 0.5).surface
    return surface_index


def find_worst_pixel(
    first_codes: Shaped[Codes, "h w 3"], second_codes: Shaped[Codes, "h w 3"]
) -> tuple[int, int]:
    """Find the column and the row of the pixel where two pictures differ most."""
    differences = compare_levels(first_codes, second_codes, axis=2)
    row, column = np.unravel_index(differences.argmax(), differences.shape)
    return int(column), int(row)


def diagnose_agreement(
    submitted_codes: Shaped[Codes, "3 n"], reference_codes: Shaped[Codes, "3 n"]
) -> Diagnosis | None:
    """Diagnose a picture that is "identical" or differs by "rounding"; None if it does neither.

    Rounding is a difference of at most one level, only in a few pixels.
    """
    differences = compare_levels(submitted_codes, reference_codes)
    count = int(np.count_nonzero(differences))
    if not count:
        return make_verdict(IDENTICAL, "The pictures are identical.")
    if count <= max(10, 0.01 * differences.size) and differences.max() == 1:
        sentence = f"{symptoms.format_count(count)} by one level: rounding, nothing to worry about."
        return make_verdict("rounding", sentence)
    return None


def diagnose_single_color(codes: Shaped[Codes, "h w 3"]) -> Diagnosis | None:
    """Diagnose a picture that is "black" or "flat"; None if it has several colours."""
    if np.ptp(codes, axis=(0, 1)).any():
        return None
    if codes.any():
        return make_verdict("flat", "The picture has one colour everywhere.")
    return make_verdict("black", "The picture is black.")


def _format_sentences(cause: Cause, submission: Submission) -> dict[str, str]:
    """Format the sentences that describe the mistakes of a cause, by keyword.

    Placeholders such as ``{fitted_gamma}`` are replaced with numbers estimated from the submitted
    picture.
    """
    formulas = submission.renderer.get_formulas(cause)

    def format_number(placeholder: re.Match[str]) -> str:
        """Compute and format the number that replaces a placeholder."""
        return f"{submission.fitting_cache.get_value(placeholder[1], formulas):.3g}"

    mistakes = submission.renderer.mistakes
    return {key: re.sub(r"\{(\w+)\}", format_number, mistakes[key].sentence) for key in cause}


def _describe_brightness(differences: Shaped[Array, "3 n"]) -> str:
    """Return " (brighter)" or " (darker)" if nearly all wrong pixels are so; otherwise "".

    `differences` are submitted minus reference codes.
    """
    if (differences >= -1).all(axis=0).mean() > 0.9:
        return " (brighter)"
    return " (darker)" if (differences <= 1).all(axis=0).mean() > 0.9 else ""
