"""Find the mistakes with which a scene renders as a hand-in: first single ones, then all pairs.

A *hand-in* is a picture that a student handed in, the *reference picture* is what it should be, and
a *cause* is a tuple of keywords of mistakes that are made together.

The problem is that there are tens of thousands of pairs of mistakes, and that rendering a picture
with each pair would take hours.  A few pixels refute almost all pairs, so the search is successive
halving (Jamieson and Talwalkar 2016): it renders all causes at few pixels, the best of them at more
pixels, and only the last few in full.

A cause is reported only if the scene, rendered with it, gives the hand-in, except for at most 3 %
of the pixels in which the hand-in differs from the reference picture.  If there is no such cause,
the cause with the most similar picture is returned as a hint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from itertools import combinations
from typing import NamedTuple, TypeAlias

import numpy as np

from reference.handins import mistakes
from reference.handins.drawing import FormulaCache, join_formulas, make_formula_inputs
from reference.handins.formulas import Array, Formulas, used_names
from reference.pictures import Codes, level_difference
from tracer import Scene

# A cause is reported if it leaves at most this part of the wrong pixels unexplained, or at most
# this number of pixels.
_MAX_UNEXPLAINED_SHARE, _MAX_UNEXPLAINED = 0.03, 10
# Minimum ratio between the numbers of pixels that two causes leave unexplained, if only the better
# cause is reported; and between what a mistake of a pair explains and what the pair does not.
_MIN_RATIO = 5
# Number of pixels at which the pictures of mistakes are compared with each other.
_GROUPING_PIXELS = 2400
# Pixels of the first round, and causes after it.  Each further round has four times the pixels, and
# a quarter of the causes, but not fewer than the last number.
_FIRST_PIXELS, _MAX_CAUSES, _MIN_CAUSES = 240, 256, 16
# A cause that is not the best may leave this many more pixels of a round unexplained by chance.
# The search ends if the best cause leaves more than this part of the wrong pixels unexplained.
_MAX_CHANCE_PIXELS, _MAX_HOPELESS_SHARE = 4, 0.75
# Maximum numbers of pixels, and of pixels times surfaces, at which many causes are rendered.  A
# random subset represents a larger picture.  After lossy compression, the complete picture is
# rendered, with fewer causes.
MAX_PIXELS, _MAX_INTERSECTIONS = 131_072, 2_000_000
# Number of intersections in one batch of pixels: their arrays take about a megabyte each.
_INTERSECTIONS_PER_BATCH = 100_000
# In scenes of more surfaces, mistakes that concern a single surface are not tried in pairs.
_MAX_PAIRED_SURFACES = 40
# After lossy compression, differences of more levels count as this many.
_MAX_LEVELS = 32
# With a mistake of the camera, a pair must show this many surfaces, if the scene has them.
_MIN_SHOWN_SURFACES = 3

Cause: TypeAlias = tuple[str, ...]


class Finding(NamedTuple):
    """The result of searching for the mistakes in a hand-in.

    A cause is a tuple of keywords of mistakes that are made together, such as
    ("mirrored", "gamma-none").

    Attributes
    ----------
    causes : tuple of tuples of str
        The causes with which the scene renders as the hand-in.  If there are several, their
        pictures of this scene are nearly the same.  Empty if there is no such cause.
    unexplained_count : int
        Number of pixels in which the hand-in differs from the picture with the first cause; if
        there is no cause, from the picture with the hint.
    hint : tuple of str
        If `causes` is empty, the cause with the most similar picture.  Empty if that picture
        explains less than half of the wrong pixels.
    """

    causes: tuple[Cause, ...]
    unexplained_count: int
    hint: Cause = ()


def choose_stratified(stratum: Array, max_count: int) -> Array:
    """Choose items at random, about equally many from each stratum.

    Parameters
    ----------
    stratum : (n,) int array
        The stratum to which each item belongs.
    max_count : int
        Maximum number of items to choose.

    Returns
    -------
    item_index : (k,) int array
        Indices of the chosen items; k is the smaller of n and `max_count`.  A call with a smaller
        `max_count` returns the first indices of this array.
    """
    item_index = np.arange(len(stratum), dtype=np.int32)  # int64 takes much memory
    shuffled = np.random.default_rng(1).permutation(item_index)
    by_stratum = shuffled[np.argsort(stratum[shuffled], kind="stable")]
    count = np.unique(stratum, return_counts=True)[1].astype(np.int32)
    place_in_stratum = item_index - np.repeat(count.cumsum(dtype=np.int32) - count, count)
    return by_stratum[np.argsort(place_in_stratum, kind="stable")[:max_count]]


class MistakeRenderer:
    """Renders one scene at one size with mistakes.

    A picture is defined by formulas (functions for values such as the radiance), and a mistake by
    the formulas that it replaces.  A cause is a tuple of keywords of mistakes that are made
    together.

    Parameters
    ----------
    scene : Scene or (h, w, 3) uint8 array
        The scene at this size; or, if there is no scene, the codes of the reference picture.
    reference_codes : (3, n) uint8 array
        Codes of the reference picture, with one column for each of the n pixels.
    surface_index : (n,) int array
        Index of the surface that each pixel shows; -1 for the background.
    width : int
        Width of the picture in pixels.
    base_formulas : dict of str to callable
        Formulas, by name, that all pictures have in place of the usual ones.

    Attributes
    ----------
    pixel_count, surface_count : int
        Numbers of pixels in the picture, and of surfaces in the scene.
    mistakes : dict of str to Mistake
        The mistakes that can be rendered, by keyword, in the order of the table of mistakes.
    sample : (m,) int array
        Indices of pixels in a random order.  All surfaces, lit and in shadow, are among the first.
    """

    def __init__(
        self, scene: Scene | Codes, reference_codes: Array, surface_index: Array, width: int,
        base_formulas: Formulas,
    ) -> None:  # fmt: skip
        self.reference_codes, self.surface_index = reference_codes, surface_index
        self.width, self.base_formulas = width, base_formulas
        self.pixel_count = reference_codes.shape[1]
        self._blank_codes = np.zeros_like(reference_codes)
        size = {"width": width, "height": self.pixel_count // width}
        self._inputs = make_formula_inputs(scene) | size
        table_scene = scene if isinstance(scene, Scene) else Scene(**size)
        self.surface_count = len(table_scene.surfaces)
        self.mistakes = mistakes.list_mistakes(table_scene)
        first_pixel = self.new_cache(np.array([0]), self._blank_codes)
        self.mistakes = {
            keyword: mistake for keyword, mistake in self.mistakes.items()
            if (formulas := self.formulas_of((keyword,))) and first_pixel.is_computable(formulas)
        }  # fmt: skip
        subset = choose_stratified(surface_index, MAX_PIXELS // 32)
        stratum = surface_index[subset]
        if isinstance(scene, Scene):
            for is_lit in self.evaluate([base_formulas], subset, name="lit")[0][:4]:
                stratum = 2 * stratum + is_lit
        self.sample = subset[choose_stratified(stratum, len(subset))]

    def formulas_of(self, cause: Cause) -> Formulas:
        """Return the formulas with which to render the picture of a cause.

        Parameters
        ----------
        cause : tuple of str
            Keywords of mistakes that are made together.

        Returns
        -------
        dict of str to callable
            The formulas, by name, that replace those of the reference picture.  Empty if two of the
            mistakes exclude each other, because they replace the same formula.
        """
        return join_formulas([self.base_formulas, *(self.mistakes[k].formulas for k in cause)])

    def is_fitted(self, keyword: str) -> bool:
        """Test whether a mistake contains a number that is estimated from the hand-in.

        An example is a wrong gamma of unknown size, the formula `fitted_gamma`.

        Parameters
        ----------
        keyword : str
            Keyword of the mistake, such as "gamma".
        """
        names = used_names(self.mistakes[keyword].formulas)
        return any(name.startswith("fitted_") for name in names)

    def new_cache(
        self, pixels: Array, handin_codes: Array, fitting_cache: FormulaCache | None = None
    ) -> FormulaCache:
        """Return a new cache that computes formulas (such as the radiance) at some pixels.

        Parameters
        ----------
        pixels : (k,) int array
            Indices of the pixels.
        handin_codes : (3, n) uint8 array
            Codes of all n pixels of the hand-in.
        fitting_cache : FormulaCache, optional
            The cache for those pixels from which numbers such as a gamma are estimated.  By
            default, they are estimated from `pixels`.
        """
        row, column = np.divmod(pixels, self.width)
        inputs = {"i": column, "j": row, "handin": handin_codes[:, pixels]}
        return FormulaCache(self._inputs | inputs, fitting_cache)

    def pixel_batches(self, pixels: Array) -> Iterator[Array]:
        """Divide an array of pixel indices into batches that take little memory to render."""
        batch_size = max(500, _INTERSECTIONS_PER_BATCH // max(1, self.surface_count))
        return (pixels[k : k + batch_size] for k in range(0, len(pixels), batch_size))

    def evaluate(
        self, formula_sets: Sequence[Formulas], pixels: Array, handin_codes: Array | None = None,
        fitting_cache: FormulaCache | None = None, name: str = "codes",
    ) -> Array:  # fmt: skip
        """Compute a formula, such as the codes, at some pixels for each of several pictures.

        Parameters
        ----------
        formula_sets : sequence of dict of str to callable
            For each picture, the formulas, by name, that replace those of the reference picture.
        pixels : (k,) int array
            Indices of the pixels.
        handin_codes : (3, n) uint8 array, optional
            Codes of all n pixels of the hand-in; by default, black.
        fitting_cache : FormulaCache, optional
            The cache for those pixels from which numbers such as a gamma are estimated.
        name : str
            Name of the formula to compute; by default, the 8-bit codes.

        Returns
        -------
        values : (pictures, ..., k) array
            The values of the formula; for the codes, (pictures, 3, k).
        """
        handin_codes = self._blank_codes if handin_codes is None else handin_codes
        caches = (self.new_cache(batch, handin_codes, fitting_cache)
                  for batch in self.pixel_batches(pixels))  # fmt: skip
        values = [[cache.get(name, formulas) for formulas in formula_sets] for cache in caches]
        return np.concatenate(values, axis=-1)

    @cached_property
    def groups(self) -> dict[Cause, list[Cause]]:
        """Mistakes that change the picture, grouped by the picture that they give.

        Each key is the first cause of a group, and the value is the list of all its causes.  Each
        mistake is also rendered in those variants of a correct tracer with which it gives another
        picture; the cause then consists of the keywords of the mistake and of the variant.

        A mistake that shows only together with another one forms a group of its own.  Mistakes with
        numbers that are estimated from a hand-in are skipped, as are, in a scene of many surfaces,
        those that concern one surface or light.
        """
        variants = ((), *((keyword,) for keyword in mistakes.VARIANTS if keyword in self.mistakes))
        has_many_surfaces = self.surface_count > _MAX_PAIRED_SURFACES
        causes = [
            cause for keyword, mistake in self.mistakes.items() for variant in variants
            if keyword not in mistakes.VARIANTS and not self.is_fitted(keyword)
            and not (has_many_surfaces and mistake.concerns_one_object)
            and self.formulas_of(cause := (keyword, *variant))
        ]  # fmt: skip
        causes.sort(key=len)  # a group begins with a cause without a variant, if it contains one
        pixels = next(self.pixel_batches(self.sample[:_GROUPING_PIXELS]))
        pictures = self.evaluate([self.formulas_of(cause) for cause in causes], pixels)
        # Some mistakes show only where another mistake brings about radiance beyond 1.
        groups: dict[bytes, list[Cause]] = {
            keyword.encode(): [(keyword,)]
            for keyword in mistakes.OVEREXPOSED if keyword in self.mistakes
        }  # fmt: skip
        for cause, codes in zip(causes, pictures, strict=True):
            group = groups.setdefault(codes.tobytes(), [])
            if cause[:1] not in group:
                group.append(cause)
        groups.pop(self.reference_codes[:, pixels].tobytes(), None)
        return {group[0]: group for group in groups.values()}

    @cached_property
    def single_mistakes(self) -> list[Cause]:
        """All causes that consist of one mistake, some with a variant of a correct tracer."""
        causes: list[Cause] = [(k,) for k in self.mistakes if k not in mistakes.VARIANTS]
        return causes + [cause for group in self.groups.values() for cause in group if cause[1:]]

    @cached_property
    def rendered_pairs(self) -> tuple[dict[Cause, tuple[Cause, Cause]], Array, Array]:
        """All pairs of mistakes that change the picture, rendered at a few pixels.

        Item 0 maps the cause of each pair to the two causes of which it consists.  Item 1 contains
        the codes (pairs, 3, k) of each pair at k pixels.  Item 2 contains the indices (k,) of these
        pixels.
        """
        share = min(1.0, _MAX_PAIRED_SURFACES / max(1, self.surface_count))
        pixels = self.sample[: max(40, int(share * _FIRST_PIXELS))]
        # Several samples per pixel would take too long, and rounding is determined in the end.
        skipped = {k for k in self.mistakes if "samples" in self.mistakes[k].formulas}
        skipped |= {*mistakes.ROUNDINGS}
        candidates = [cause for cause in self.groups if skipped.isdisjoint(cause)]
        pairs = {cause: (first, second) for first, second in combinations(candidates, 2)
                 if (cause := self.join_causes(first, second))}  # fmt: skip
        if not pairs:
            return pairs, np.zeros((0, 3, len(pixels)), dtype=np.uint8), pixels
        return pairs, self.evaluate([self.formulas_of(cause) for cause in pairs], pixels), pixels

    def join_causes(self, first: Cause, second: Cause) -> Cause:
        """Join two causes (tuples of keywords of mistakes) into one.

        Returns
        -------
        tuple of str
            The keywords of both causes; if one of them has a variant of a correct tracer, the
            variant's keyword is the last.  Empty if the mistakes exclude each other, or if both
            causes have a variant.
        """
        variants = [keyword for keyword in (*first, *second) if keyword in mistakes.VARIANTS]
        cause = (*remove_variants((*first, *second)), *variants)
        return cause if len(variants) < 2 and self.formulas_of(cause) else ()


class Search:
    """The search for the causes of one hand-in.

    A *cause* is a tuple of keywords of mistakes that are made together.  A *wrong* pixel differs
    from the reference picture.  A cause leaves a pixel *unexplained* if the pixel differs from the
    picture that is rendered with the cause.

    Parameters
    ----------
    handin_codes : (3, n) uint8 array
        Codes of the hand-in, with one column for each of the n pixels.
    renderer : MistakeRenderer
        Renders the scene with mistakes at the size of the hand-in.
    lossy_levels : int
        Number of levels by which the file format of the hand-in, or of the reference picture, may
        have changed codes.
    save : callable, optional
        Takes codes (3, n) and returns what this file format makes of them.

    Attributes
    ----------
    tolerance : int
        Differences of at most this many levels are ignored.
    is_wrong : (n,) bool array
        True for pixels that differ from the reference picture by more than the tolerance.
    wrong_count, clearly_wrong_count : int
        Number of wrong pixels, and of pixels that differ by more than one level.
    fitting_cache : FormulaCache
        The cache for those pixels from which numbers such as a gamma are estimated: a sample of the
        picture, and the brightest pixel.
    """

    def __init__(
        self, handin_codes: Array, renderer: MistakeRenderer, lossy_levels: int = 0,
        save: Callable[[Array], Array] | None = None,
    ) -> None:  # fmt: skip
        self.handin_codes, self.renderer, self.lossy_levels = handin_codes, renderer, lossy_levels
        self._save, reference_codes = save, renderer.reference_codes
        levels = level_difference(save(reference_codes) if save else reference_codes, handin_codes)
        self.clearly_wrong_count = int((levels > 1).sum())
        # If at most two pixels differ by more than rounding, single levels count as wrong.
        self.tolerance = lossy_levels or int(self.clearly_wrong_count > 2)
        self.is_wrong = levels > self.tolerance
        self.wrong_count, pixel_count = int(self.is_wrong.sum()), renderer.pixel_count
        color = np.zeros(pixel_count, dtype=np.uint32)
        for channel in handin_codes:
            color = color << 8 | channel
        foreground_count = pixel_count - int(np.unique(color, return_counts=True)[1].max())
        max_share = int(_MAX_UNEXPLAINED_SHARE * min(self.wrong_count, foreground_count))
        self._max_unexplained = max(_MAX_UNEXPLAINED, max_share)
        order = np.random.default_rng(1).permutation(np.arange(pixel_count, dtype=np.int32))
        self._wrong_and_right = order[self.is_wrong[order]], order[~self.is_wrong[order]]
        max_pixels = min(MAX_PIXELS, _MAX_INTERSECTIONS // max(1, renderer.surface_count))
        final_count = pixel_count if lossy_levels else max_pixels
        self._final_pixels, self._final_weights = self._choose_pixels(final_count)
        # For each measured cause, the numbers of pixels that it leaves unexplained and inexact.
        self._counts = dict[Cause, list[int]]()
        brightest = reference_codes.sum(axis=0, dtype=np.int16).argmax()
        pixels = np.append(next(renderer.pixel_batches(renderer.sample)), brightest)
        self.fitting_cache = renderer.new_cache(pixels, handin_codes)

    def _choose_pixels(self, count: int) -> tuple[Array, Array]:
        """Choose random pixels, half of which differ from the reference picture.

        If there are too few pixels that differ, or that do not, more of the others are chosen.

        Parameters
        ----------
        count : int
            Number of pixels to choose; a smaller picture gives fewer.

        Returns
        -------
        pixels : (k,) int array
            Indices of the chosen pixels, sorted.
        weights : (k,) float array
            Number of pixels of the picture that each chosen pixel represents.
        """
        wrong, right = self._wrong_and_right
        chosen_wrong = wrong[: max(count // 2, count - len(right))]
        chosen_right = right[: count - len(chosen_wrong)]
        pixels = np.sort(np.concatenate([chosen_wrong, chosen_right]))
        wrong_weight = len(wrong) / max(1, len(chosen_wrong))
        right_weight = len(right) / max(1, len(chosen_right))
        return pixels, np.where(self.is_wrong[pixels], wrong_weight, right_weight)

    def _differences(self, causes: Sequence[Cause], pixels: Array) -> Array:
        """Compare the hand-in with the pictures of several causes.

        Parameters
        ----------
        causes : sequence of tuples of str
            At least one cause, as keywords of mistakes that are made together.
        pixels : (k,) int array
            Indices of the pixels to compare.  If these are all pixels, lossy compression is applied
            to the rendered pictures, if it was to the hand-in.

        Returns
        -------
        levels : (causes, k) array
            For each cause and pixel, the largest difference between the channels, in levels.
        """
        formula_sets = [self.renderer.formulas_of(cause) for cause in causes]
        codes = self.renderer.evaluate(formula_sets, pixels, self.handin_codes, self.fitting_cache)
        if self._save and len(pixels) == self.renderer.pixel_count:
            codes = np.array([self._save(picture) for picture in codes])
        return level_difference(codes, self.handin_codes[:, pixels])

    def _measure(self, causes: Sequence[Cause]) -> None:
        """Count the pixels that each cause leaves unexplained or inexact, and cache the numbers.

        A pixel is unexplained if it differs from the picture of the cause by more than the
        tolerance, and inexact if it differs at all, except for lossy compression.  In a large
        picture, the numbers are estimates from a subset of the pixels.

        Parameters
        ----------
        causes : sequence of tuples of str
            Causes, as keywords of mistakes that are made together.
        """
        if unmeasured := [cause for cause in dict.fromkeys(causes) if cause not in self._counts]:
            all_levels = self._differences(unmeasured, self._final_pixels)
            limits = self.tolerance, self.lossy_levels
            for cause, levels in zip(unmeasured, all_levels, strict=True):
                counts = ((levels > limit) @ self._final_weights for limit in limits)
                self._counts[cause] = [*map(round, counts)]

    def _count_unexplained(self, cause: Cause) -> int:
        """Count the pixels in which the hand-in differs from the picture of a cause.

        Parameters
        ----------
        cause : tuple of str
            Keywords of mistakes that are made together.

        Returns
        -------
        int
            The number of pixels; in a large picture, it is estimated from a subset.
        """
        self._measure([cause])
        return self._counts[cause][0]

    def _count_inexact(self, cause: Cause) -> int:
        """Count the pixels in which the hand-in differs by even one level from a cause's picture.

        Levels that lossy compression may have changed are ignored.

        Parameters
        ----------
        cause : tuple of str
            Keywords of mistakes that are made together.

        Returns
        -------
        int
            The number of pixels; in a large picture, it is estimated from a subset.
        """
        self._measure([cause])
        return self._counts[cause][1]

    def _select_best(self, causes: list[Cause]) -> list[Cause]:
        """Select the causes that leave the fewest pixels unexplained, by successive halving.

        Successive halving compares all causes at few pixels, then the best of them at more pixels,
        and so on.  A cause leaves a pixel unexplained if the hand-in differs there from the picture
        that is rendered with the cause.

        Parameters
        ----------
        causes : list of tuples of str
            Causes, as keywords of mistakes that are made together.

        Returns
        -------
        list of tuples of str
            At most `_MIN_CAUSES` causes, the best first.  Empty if none explains a quarter of the
            wrong pixels.
        """
        pixel_count, max_causes = _FIRST_PIXELS, _MAX_CAUSES
        max_rendered = _MIN_CAUSES * MAX_PIXELS // len(self._final_pixels)
        min_causes = max(1, min(_MIN_CAUSES, max_rendered))
        while len(causes) > min_causes and pixel_count < len(self._final_pixels):
            causes = self._run_round(causes, pixel_count, max(min_causes, max_causes))
            pixel_count, max_causes = 4 * pixel_count, max_causes // 4
        self._measure(causes[:_MIN_CAUSES])
        return sorted(causes[:_MIN_CAUSES], key=self._count_unexplained)

    def _run_round(self, causes: list[Cause], pixel_count: int, max_causes: int) -> list[Cause]:
        """Run one round of successive halving: render causes at some pixels, and keep the best.

        The best causes leave the fewest pixels unexplained.  After lossy compression, nearly all
        pixels differ, so the best causes are those with the smallest sum of differences.

        Parameters
        ----------
        causes : list of tuples of str
            The causes to compare.
        pixel_count : int
            Number of pixels at which the causes are rendered.
        max_causes : int
            Maximum number of causes to keep.

        Returns
        -------
        list of tuples of str
            The best causes, the best first.  Empty if each leaves more than `_MAX_HOPELESS_SHARE`
            of the wrong pixels unexplained.
        """
        pixels, weights = self._choose_pixels(pixel_count)
        levels = self._differences(causes, pixels)
        if self.lossy_levels:
            order = np.argsort(np.minimum(levels, _MAX_LEVELS) @ weights, kind="stable")
            return [causes[k] for k in order[:max_causes]]
        is_unexplained = levels > self.tolerance
        if is_unexplained[:, self.is_wrong[pixels]].mean(axis=1).min() > _MAX_HOPELESS_SHARE:
            return []
        count = is_unexplained @ weights
        max_count = 1.5 * count.min() + _MAX_CHANCE_PIXELS * weights.max()
        order = np.argsort(count, kind="stable")[:max_causes]
        return [causes[k] for k in order if count[k] <= max_count]

    def find(self) -> Finding:
        """Search for the mistakes with which the scene renders as the hand-in.

        Single mistakes are tried first.  Pairs are tried only if no single mistake explains the
        hand-in almost exactly.

        Returns
        -------
        Finding
            The causes (tuples of keywords of mistakes that are made together); or, if no cause
            explains the hand-in, the cause with the most similar picture as a hint.
        """
        singles = self._add_rounding(self._select_best(self.renderer.single_mistakes))
        pairs = list[Cause]()
        causes = self._select_reportable(singles)
        min_count: float = self._count_unexplained(causes[0]) if causes else np.inf
        if min_count > _MAX_UNEXPLAINED:
            pairs = self._add_rounding(self._select_best_pairs())
            needed = self._select_reportable(list(filter(self._needs_each_mistake, pairs)))
            if needed and _MIN_RATIO * self._count_unexplained(needed[0]) <= min_count:
                causes = needed
        if (
            causes
            and (count := self._count_unexplained_in_full(causes[0])) <= self._max_unexplained
        ):
            return Finding(tuple(dict.fromkeys(map(remove_variants, causes))), count)
        # A pair is the hint only if it leaves less than half the pixels of a single mistake.
        hint = min(causes[:1] or singles + pairs, default=(), key=lambda cause: (
            (1 + (cause in pairs)) * self._count_unexplained(cause)))  # fmt: skip
        count = self._count_unexplained_in_full(hint)
        if 2 * count > self.wrong_count:
            return Finding((), self.wrong_count)
        return Finding((), count, remove_variants(hint))

    def _count_unexplained_in_full(self, cause: Cause) -> int:
        """Count the pixels in which the hand-in differs from the full picture of a cause."""
        every_pixel = np.arange(self.renderer.pixel_count, dtype=np.int32)
        levels = self._differences([cause], every_pixel)
        return int((levels > self.tolerance).sum())

    def _select_best_pairs(self) -> list[Cause]:
        """Select the pairs of mistakes whose pictures are most similar to the hand-in.

        If several mistakes have the same picture, only the first of them is tried in pairs.  The
        others are tried in its place if a pair with it is among the best.

        Returns
        -------
        list of tuples of str
            At most `_MIN_CAUSES` causes, the best first; each contains the keywords of two
            mistakes.
        """
        renderer, background = self.renderer, mistakes.BACKGROUND
        rendered, codes, pixels = renderer.rendered_pairs
        is_unexplained = level_difference(codes, self.handin_codes[:, pixels]) > self.tolerance
        order, causes = np.argsort(is_unexplained.sum(axis=1), kind="stable"), [*rendered]
        pairs = {causes[k]: rendered[causes[k]] for k in order[:_MAX_CAUSES]}
        if self.handin_codes[:, renderer.surface_index < 0].any():
            pairs |= {cause: (background, other) for other in renderer.groups
                      if (cause := renderer.join_causes(background, other))}  # fmt: skip
        best, groups = self._select_best([*pairs]), {background: [background]} | renderer.groups
        members = {joined: None for cause in best
                   for first in groups[pairs[cause][0]] for second in groups[pairs[cause][1]]
                   if (joined := renderer.join_causes(first, second))}  # fmt: skip
        return self._select_best([*members]) if len(members) > len(best) else best

    def _needs_each_mistake(self, cause: Cause) -> bool:
        """Test whether each mistake of a pair explains far more pixels than the pair leaves.

        If one of them is a mistake of the camera, the picture of the pair must also show at least
        `_MIN_SHOWN_SURFACES` surfaces, or all surfaces that the reference picture shows: a picture
        with fewer surfaces may agree by chance.

        Parameters
        ----------
        cause : tuple of str
            Keywords of two mistakes.  Two keywords may follow: a variant of a correct tracer, in
            which the mistakes have another picture, and a mistake of rounding.
        """
        unexplained, keywords = self._count_unexplained(cause), remove_variants(cause)
        for keyword in set(keywords).difference(mistakes.ROUNDINGS):
            others = tuple(other for other in cause if other != keyword)
            if self._count_unexplained(others) - unexplained < max(_MIN_RATIO * unexplained, 1):
                return False
        renderer = self.renderer
        if not renderer.surface_count or mistakes.CAMERA.isdisjoint(renderer.formulas_of(keywords)):
            return True
        pixels = next(renderer.pixel_batches(renderer.sample))
        shown = renderer.evaluate([renderer.formulas_of(cause)], pixels, name="shown_surface")[0]
        counts = [len(np.unique(surface_index[surface_index >= 0]))
                  for surface_index in (shown, renderer.surface_index[pixels])]  # fmt: skip
        return counts[0] >= min(_MIN_SHOWN_SURFACES, counts[1])

    def _select_reportable(self, causes: list[Cause]) -> list[Cause]:
        """Select the causes that may be reported.

        A cause may be reported if (1) it leaves at most 3 % of the wrong pixels unexplained; (2) no
        other cause leaves far fewer; and (3) no other cause is exact, to a single level, in far
        more pixels.  A cause that contains a number estimated from the hand-in, such as a gamma, is
        reported only if there is no other.

        Parameters
        ----------
        causes : list of tuples of str
            Causes, as keywords of mistakes that are made together.

        Returns
        -------
        list of tuples of str
            The selected causes, in the order of the table of mistakes.
        """
        max_unexplained = min(self._max_unexplained, self.wrong_count - 1)
        causes = [cause for cause in causes if self._count_unexplained(cause) <= max_unexplained]
        if not causes:
            return []
        limit = _MIN_RATIO * max(1, min(map(self._count_unexplained, causes)))
        causes = [cause for cause in causes if self._count_unexplained(cause) < limit]
        max_inexact = _MIN_RATIO * max(min(map(self._count_inexact, causes)), _MAX_UNEXPLAINED)
        causes = [cause for cause in causes if self._count_inexact(cause) <= max_inexact]
        causes = [c for c in causes if not any(map(self.renderer.is_fitted, c))] or causes
        table_order = [*self.renderer.mistakes]
        return sorted(causes, key=lambda cause: [table_order.index(k) for k in cause])

    def _add_rounding(self, causes: list[Cause]) -> list[Cause]:
        """Add a mistake of rounding to those causes whose picture it makes far more exact.

        A mistake of rounding, such as cutting levels off, changes codes by at most one level.

        Parameters
        ----------
        causes : list of tuples of str
            Causes, as keywords of mistakes that are made together.

        Returns
        -------
        list of tuples of str
            Each cause, unchanged or with one more keyword.  If single levels count as wrong, or
            after lossy compression, all causes are unchanged.
        """
        if not self.tolerance or self.lossy_levels:
            return causes
        join, roundings = self.renderer.join_causes, mistakes.ROUNDINGS
        choices = [[cause, *filter(None, (join(cause, (keyword,)) for keyword in roundings))]
                   for cause in causes]  # fmt: skip
        self._measure([cause for choice in choices for cause in choice])
        chosen = list[Cause]()
        for cause, choice in zip(causes, choices, strict=True):
            rounded = min(choice, key=self._count_inexact)
            max_inexact = _MIN_RATIO * max(self._count_inexact(rounded), _MAX_UNEXPLAINED)
            chosen.append(rounded if max_inexact < self._count_inexact(cause) else cause)
        return chosen


def remove_variants(cause: Cause) -> Cause:
    """Remove, from the keywords of a cause, those that are no mistakes.

    Parameters
    ----------
    cause : tuple of str
        Keywords of mistakes that are made together, and of variants of a correct tracer, with which
        some mistakes have another picture.

    Returns
    -------
    tuple of str
        The keywords of the mistakes.
    """
    return tuple(keyword for keyword in cause if keyword not in mistakes.VARIANTS)
