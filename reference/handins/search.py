"""Find the mistakes with which a scene renders as a hand-in: first single ones, then all pairs.

The problem is that there are tens of thousands of pairs, and that a picture of each would take
hours.  Almost all pairs are refuted by a few pixels, so the search is successive halving (Jamieson
and Talwalkar 2016): all candidates are rendered at few pixels, the best of them at more pixels,
and only the last few in full.  A *cause* is a tuple of keywords of mistakes that are made together.

A cause is reported only if the scene, rendered with it, gives the hand-in, except for at most 3 %
of the pixels in which the hand-in differs from the right picture.  If there is no such cause, the
nearest one is returned as a hint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence, Set
from functools import cached_property
from itertools import combinations
from typing import NamedTuple, TypeAlias

import numpy as np

from reference.handins import mistakes
from reference.handins.drawing import FormulaCache, join_formulas, scene_values
from reference.handins.formulas import Array, Formulas, parameter_names
from reference.pictures import Codes
from tracer import Scene

# A cause is reported if it leaves at most this part of the differing pixels, or this many pixels.
_MAX_REMAINING, _MAX_REMAINING_PIXELS = 0.03, 10
# Minimum ratio between the pixels that two causes leave, if only the better one is reported; and
# between what a mistake of a pair takes away and what the pair leaves.
_MIN_RATIO = 5
# Number of pixels at which mistakes are compared with each other.
_GROUPING_PIXELS = 2400
# Pixels of the first round, and causes after it.  Each further round has four times the pixels, and
# a quarter of the causes, but not fewer than the last number.
_FIRST_PIXELS, _MAX_CAUSES, _MIN_CAUSES = 240, 256, 16
# A cause that is not the best may leave this many pixels of a round more by chance.  A search ends
# if the best leaves more than this part of the differing pixels.
_CHANCE, _MAX_WORST = 4, 0.75
# Maximum numbers of pixels, and of pixels times surfaces, at which many causes are rendered: a
# larger picture is represented by a random subset.  A picture that was compressed is rendered in
# full, with fewer causes.
MAX_PIXELS, _MAX_INTERSECTIONS = 131_072, 2_000_000
# Number of intersections in one batch of pixels: their arrays take about a megabyte each.
_INTERSECTIONS_PER_BATCH = 100_000
# In scenes of more surfaces, mistakes of a single surface are not tried in pairs.
_MAX_PAIRED_SURFACES = 40
# Compression changes levels: differences of more levels count as this many.
_MAX_LEVELS = 32

Cause: TypeAlias = tuple[str, ...]


def difference(a: Array, b: Array) -> Array:
    """Return, for each pixel, the largest difference between two pictures' channels, in levels.

    Parameters
    ----------
    a, b : (..., 3, n) arrays of equal type
        Codes of n pixels.

    Returns
    -------
    (..., n) array
    """
    return (np.maximum(a, b) - np.minimum(a, b)).max(axis=-2)


class Finding(NamedTuple):
    """The result of a search for the mistakes in a hand-in.

    A cause is a tuple of keywords of mistakes that are made together, such as
    ("mirrored", "gamma-none").

    Attributes
    ----------
    causes : tuple of tuples of str
        The causes with which the scene renders as the hand-in.  If there are several, their
        pictures of this scene are nearly the same.  Empty if there is no such cause.
    remaining_count : int
        Number of pixels in which the hand-in differs from the picture with the first cause, or, if
        there is none, with the hint.
    hint : tuple of str
        If `causes` is empty, the cause with the most similar picture.  Empty if it explains less
        than half of the differing pixels.
    """

    causes: tuple[Cause, ...]
    remaining_count: int
    hint: Cause = ()


def choose_stratified(stratum: Array, max_count: int) -> Array:
    """Choose items at random, about equally many from each stratum.

    Parameters
    ----------
    stratum : (n,) int array
        The stratum to which each item belongs.
    max_count : int
        Maximum number of items that are chosen.

    Returns
    -------
    index : (k,) int array
        Indices of the chosen items; k is the smaller of n and `max_count`.  The first indices of
        the result are what a call with a smaller `max_count` returns.
    """
    order = np.random.default_rng(1).permutation(len(stratum))
    order = order[np.argsort(stratum[order], kind="stable")]
    _, start, count = np.unique(stratum[order], return_index=True, return_counts=True)
    place_in_stratum = np.arange(len(order)) - np.repeat(start, count)
    return order[np.argsort(place_in_stratum, kind="stable")[:max_count]]


class KnownPictures:
    """The pictures of one scene at one size: the right one, and those with known mistakes.

    Pictures are defined by formulas (functions for values such as the radiance); a mistake replaces
    several formulas.  A cause is a tuple of keywords of mistakes that are made together.

    Parameters
    ----------
    scene : Scene or (h, w, 3) uint8 array
        The scene at this size; or, without a scene, the codes of a right picture.
    right_codes : (3, n) uint8 array
        The right picture's codes.
    surface : (n,) int array
        Index of the surface that each pixel shows; -1 for the background.
    width : int
        Width of the picture in pixels.
    shared_formulas : dict of str to callable
        Formulas, by name, that all pictures have in place of the usual ones.

    Attributes
    ----------
    pixel_count, surface_count : int
        Numbers of pixels of the picture, and of surfaces of the scene.
    text : dict of str to str
        The sentence of each mistake of the table, by its keyword.
    table : dict of str to dict
        The formulas of each mistake that can be rendered, by its keyword.
    kinds : list of str
        The keywords of the table, without those in `mistakes.VARIANTS`.
    sample : (m,) int array
        Indices of pixels in a random order, of which already the first ones show all surfaces, lit
        and in shadow.
    """

    def __init__(
        self, scene: Scene | Codes, right_codes: Array, surface: Array, width: int,
        shared_formulas: Formulas,
    ) -> None:  # fmt: skip
        self.right_codes, self.surface, self.width = right_codes, surface, width
        self.shared_formulas = shared_formulas
        self.pixel_count, self._blank = right_codes.shape[1], np.zeros_like(right_codes)
        size = {"width": width, "height": self.pixel_count // width}
        self._inputs = scene_values(scene) | size
        known_scene = scene if isinstance(scene, Scene) else Scene(**size)
        self.surface_count = len(known_scene.surfaces)
        table = mistakes.list_mistakes(known_scene)
        self.text = {kind: mistake.text for kind, mistake in table.items()}
        one_pixel = self.formula_cache(np.array([0]), self._blank)
        self.table = {kind: mistake.formulas for kind, mistake in table.items()
                      if (joined := join_formulas([shared_formulas, mistake.formulas])) is not None
                      and one_pixel.is_computable(joined)}  # fmt: skip
        self.kinds = [kind for kind in self.table if kind not in mistakes.VARIANTS]
        self._one_object_kinds = {k for k, mistake in table.items() if mistake.concerns_one_object}
        subset = choose_stratified(surface, max(MAX_PIXELS // 32, _MAX_CAUSES))
        stratum = surface[subset]
        if isinstance(scene, Scene) and scene.lights:
            for is_lit in self.compute("lit", subset)[:4]:
                stratum = 2 * stratum + is_lit
        self.sample = subset[choose_stratified(stratum, len(subset))]

    def formulas_of(self, cause: Cause) -> Formulas | None:
        """Return the formulas that the mistakes of a cause replace.

        Parameters
        ----------
        cause : tuple of str
            Keywords of mistakes that are made together; without any, those of the right picture.

        Returns
        -------
        dict of str to callable, or None
            The formulas by name, with those that all pictures share; None if two mistakes replace
            the same formula, and so exclude each other.
        """
        return join_formulas([self.shared_formulas, *(self.table[kind] for kind in cause)])

    def fitted_names(self, kind: str) -> Set[str]:
        """Return the names of the fitted numbers that the formulas of a mistake use.

        A fitted number, such as "fitted_gamma", is estimated from the hand-in.

        Parameters
        ----------
        kind : str
            Keyword of the mistake.
        """
        formulas = self.table[kind].values()
        used = {name for formula in formulas for name in parameter_names(formula)}
        return used & (mistakes.FITTED - {"brightest"})

    def formula_cache(
        self, pixels: Array, handin: Array, fitted_pixels: FormulaCache | None = None
    ) -> FormulaCache:
        """Return a cache that computes the values of formulas at some pixels.

        Parameters
        ----------
        pixels : (k,) int array
            Indices of the pixels.
        handin : (3, n) uint8 array
            Codes of the complete picture that was handed in.
        fitted_pixels : FormulaCache, optional
            The pixels from which fitted numbers are estimated; by default, `pixels`.
        """
        inputs = {"i": pixels % self.width, "j": pixels // self.width, "handin": handin[:, pixels]}
        return FormulaCache(self._inputs | inputs, fitted_pixels)

    def pixel_batches(self, pixels: Array) -> Iterator[Array]:
        """Divide an array of pixel indices into batches whose rendering takes little memory."""
        batch_size = max(500, _INTERSECTIONS_PER_BATCH // max(1, self.surface_count))
        return (pixels[k : k + batch_size] for k in range(0, len(pixels), batch_size))

    def compute(self, name: str, pixels: Array) -> Array:
        """Compute a formula of the right picture at some pixels.

        Parameters
        ----------
        name : str
            Name of the formula, such as "lit".
        pixels : (k,) int array
            Indices of the pixels.

        Returns
        -------
        (..., k) array
        """
        values = [self.formula_cache(batch, self._blank).get(name, self.shared_formulas)
                  for batch in self.pixel_batches(pixels)]  # fmt: skip
        return np.concatenate(values, axis=-1)

    def fitting_cache(self, handin: Array) -> FormulaCache:
        """Return the formulas at those pixels from which fitted numbers are estimated.

        These pixels are a sample of the picture, and its brightest pixel.

        Parameters
        ----------
        handin : (3, n) uint8 array
            Codes of the picture that was handed in.
        """
        brightest = self.right_codes.astype(np.int16).sum(axis=0).argmax()
        pixels = np.append(next(self.pixel_batches(self.sample)), brightest)
        return self.formula_cache(pixels, handin)

    def render(
        self, causes: Sequence[Cause], pixels: Array, handin: Array,
        fitted_pixels: FormulaCache | None,
    ) -> Array:  # fmt: skip
        """Render some pixels with each of several causes.

        Parameters
        ----------
        causes : sequence of tuples of str
            Keywords of mistakes that are made together.
        pixels : (k,) int array
            Indices of the pixels.
        handin : (3, n) uint8 array
            Codes of the complete picture that was handed in.
        fitted_pixels : FormulaCache or None
            The result of `fitting_cache` for the hand-in; None if no cause has fitted numbers.

        Returns
        -------
        codes : (causes, 3, k) uint8 array
        """
        codes = np.empty((len(causes), 3, len(pixels)), dtype=np.uint8)
        start = 0
        for batch in self.pixel_batches(pixels):
            cache = self.formula_cache(batch, handin, fitted_pixels)
            end = start + len(batch)
            for cause_codes, cause in zip(codes, causes, strict=True):
                cause_codes[:, start:end] = cache.codes(self.formulas_of(cause) or {})
            start = end
        return codes

    @cached_property
    def groups(self) -> dict[Cause, list[Cause]]:
        """Mistakes that change the picture, grouped by the picture that they give.

        Each mistake is also rendered in those variants of a right tracer with which it gives
        another picture.  A cause is then the keyword of the mistake and that of the variant.
        Mistakes that show only together with others have a group of their own.  Mistakes with
        fitted numbers are skipped, as are, in a scene of many surfaces, those of one object.

        The dict has the first cause of each group as key, and all causes of the group as value.
        """
        variants = ((), *((kind,) for kind in mistakes.VARIANTS if kind in self.table))
        has_many_surfaces = self.surface_count > _MAX_PAIRED_SURFACES
        skipped = self._one_object_kinds if has_many_surfaces else set[str]()
        causes = [(kind, *variant) for kind in self.kinds for variant in variants
                  if kind not in skipped and not self.fitted_names(kind)]  # fmt: skip
        causes = [cause for cause in causes if self.formulas_of(cause) is not None]
        pixels = next(self.pixel_batches(self.sample[:_GROUPING_PIXELS]))
        codes = dict(zip(causes, self.render(causes, pixels, self._blank, None), strict=True))
        groups: dict[bytes, list[Cause]] = {}
        for cause in sorted(causes, key=len):
            group = groups.setdefault(codes[cause].tobytes(), [])
            if cause[:1] not in group:
                group.append(cause)
        groups.pop(self.right_codes[:, pixels].tobytes(), None)
        # Some mistakes show only where another mistake brings about radiance beyond 1.
        hidden: list[Cause] = [(kind,) for kind in mistakes.OVEREXPOSED if kind in self.table]
        return {cause: [cause] for cause in hidden} | {group[0]: group for group in groups.values()}

    @cached_property
    def singles(self) -> list[Cause]:
        """All causes that consist of a single mistake, some with a variant of a right tracer."""
        members = (cause for group in self.groups.values() for cause in group)
        return [*((kind,) for kind in self.kinds), *(c for c in members if len(c) > 1)]

    @cached_property
    def rendered_pairs(self) -> tuple[list[tuple[Cause, Cause]], Array, Array]:
        """All pairs of mistakes that change the picture, rendered at a few pixels.

        Item 0 is a list of the pairs; each consists of two causes (tuples of keywords).  Item 1
        contains the codes (pairs, 3, k) of each pair at k pixels.  Item 2 contains the indices (k,)
        of these pixels.
        """
        share = min(1.0, _MAX_PAIRED_SURFACES / max(1, self.surface_count))
        pixels = self.sample[: max(40, int(share * _FIRST_PIXELS))]
        cache = self.formula_cache(pixels, self._blank)
        # Several samples per pixel would take too long, and rounding is determined in the end.
        slow = {kind for kind in self.table if "samples" in self.table[kind]}
        candidates = [cause for cause in self.groups
                      if slow.isdisjoint(cause) and cause[0] not in mistakes.ROUNDINGS]  # fmt: skip
        pairs, codes = list[tuple[Cause, Cause]](), list[Array]()
        for k, first in enumerate(candidates):
            others = [other for other in candidates[k + 1 :] if self.join_causes(first, other)]
            other_formulas = [self.formulas_of(other) or {} for other in others]
            codes += cache.codes_of_pairs(self.formulas_of(first) or {}, other_formulas)
            pairs += [(first, other) for other in others]
        return pairs, np.array(codes).reshape(len(pairs), 3, len(pixels)), pixels

    def join_causes(self, first: Cause, second: Cause) -> Cause | None:
        """Join two causes (tuples of keywords of mistakes) to one.

        Returns
        -------
        tuple of str, or None
            The keywords of both; at the end, that of the variant of a right tracer, if one cause
            has it.  None if the mistakes exclude each other, or if both causes have a variant.
        """
        variants = [kind for kind in mistakes.VARIANTS if kind in (*first, *second)]
        kinds = [kind for kind in (*first, *second) if kind not in mistakes.VARIANTS]
        cause = (*kinds, *variants)
        return cause if len(variants) < 2 and self.formulas_of(cause) is not None else None


class Search:
    """The search for the causes of one hand-in.

    A cause is a tuple of keywords of mistakes that are made together.  It *leaves* those pixels in
    which the hand-in differs from the picture that is rendered with the cause.

    Parameters
    ----------
    handin : (3, n) uint8 array
        Codes of the picture that was handed in.
    known : KnownPictures
        The pictures of the scene at the size of the hand-in.
    lossy_levels : int
        Levels by which the file format of the hand-in, or of the right picture, changes codes.
    save : callable, optional
        Converts codes (3, n) to those that this file format would contain.

    Attributes
    ----------
    tolerance : int
        Differences of at most this many levels are ignored.
    is_wrong : (n,) bool array
        Which pixels differ from the right picture by more than the tolerance.
    wrong_count, clearly_wrong_count : int
        Number of these pixels, and of pixels that differ by more than one level.
    fitted_pixels : FormulaCache
        The pixels from which fitted numbers, such as a gamma, are estimated.
    """

    def __init__(
        self, handin: Array, known: KnownPictures, lossy_levels: int = 0,
        save: Callable[[Array], Array] | None = None,
    ) -> None:  # fmt: skip
        self.handin, self.known, self.lossy_levels = handin, known, lossy_levels
        self._save = save or (lambda codes: codes)
        levels = difference(self._save(known.right_codes), handin)
        self.clearly_wrong_count = int((levels > 1).sum())
        # If at most two pixels differ by more than rounding, single levels count as wrong.
        self.tolerance = lossy_levels or int(self.clearly_wrong_count > 2)
        self.is_wrong = levels > self.tolerance
        self.wrong_count = int(self.is_wrong.sum())
        color_counts = np.unique(handin.astype(np.int32).T @ (65536, 256, 1), return_counts=True)[1]
        foreground_count = known.pixel_count - int(color_counts.max())
        max_share = int(_MAX_REMAINING * min(self.wrong_count, foreground_count))
        self._max_remaining = max(_MAX_REMAINING_PIXELS, max_share)
        order = np.random.default_rng(1).permutation(known.pixel_count)
        self._wrong_and_right = order[self.is_wrong[order]], order[~self.is_wrong[order]]
        size = min(MAX_PIXELS, _MAX_INTERSECTIONS // max(1, known.surface_count))
        self._final_pixels, self._final_weights = self._choose_pixels(size)
        if lossy_levels or known.pixel_count <= size:
            every_pixel = np.arange(known.pixel_count)
            self._final_pixels, self._final_weights = every_pixel, np.ones(known.pixel_count)
        self._remaining, self._inexact = dict[Cause, int](), dict[Cause, int]()
        self.fitted_pixels = known.fitting_cache(handin)

    def _choose_pixels(self, count: int) -> tuple[Array, Array]:
        """Choose pixels, half of which differ from the right picture.

        If there are too few pixels of one kind, more of the other are chosen.

        Parameters
        ----------
        count : int
            Number of pixels to choose; a smaller picture gives fewer.

        Returns
        -------
        pixels : (k,) int array
            Indices of the chosen pixels.
        weights : (k,) float array
            The number of pixels of the picture that each chosen one represents.
        """
        wrong, right = self._wrong_and_right
        chosen_wrong = wrong[: max(count // 2, count - len(right))]
        chosen_right = right[: count - len(chosen_wrong)]
        chosen = chosen_wrong, chosen_right
        weights = [len(every) / max(1, len(part))
                   for every, part in zip(self._wrong_and_right, chosen, strict=True)]  # fmt: skip
        return np.concatenate(chosen), np.repeat(weights, (len(chosen_wrong), len(chosen_right)))

    def _final_differences(self, causes: Sequence[Cause]) -> Array:
        """Compare the hand-in with its causes at the pixels of the final round.

        Parameters
        ----------
        causes : sequence of tuples of str
            The causes with which the pixels are rendered.

        Returns
        -------
        levels : (causes, k) array
            For each cause and pixel, the largest difference between the channels, in levels.
        """
        pixels = self._final_pixels
        rendered = self.known.render(causes, pixels, self.handin, self.fitted_pixels)
        return np.array([difference(self._save(codes), self.handin[:, pixels])
                         for codes in rendered]).reshape(len(causes), len(pixels))  # fmt: skip

    def _count_remaining(self, cause: Cause) -> int:
        """Return the number of pixels that a cause leaves wrong.

        In a large picture, the number is an estimate from a subset of the pixels.  The result is
        cached.
        """
        if cause not in self._remaining:
            is_left = self._final_differences([cause])[0] > self.tolerance
            self._remaining[cause] = round(is_left @ self._final_weights)
        return self._remaining[cause]

    def _count_remaining_everywhere(self, cause: Cause) -> int:
        """Count the pixels of the complete picture that a cause does not explain."""
        every_pixel = np.arange(self.known.pixel_count)
        if len(self._final_pixels) == len(every_pixel):
            return self._count_remaining(cause)
        codes = self.known.render([cause], every_pixel, self.handin, self.fitted_pixels)[0]
        return int((difference(codes, self.handin) > self.tolerance).sum())

    def _select_best(self, causes: list[Cause]) -> list[Cause]:
        """Select the causes that leave the fewest pixels wrong, by successive halving.

        Successive halving compares all causes at few pixels, then the best of them at more pixels,
        and so on.

        Returns
        -------
        list of tuples of str
            At most `_MIN_CAUSES` causes, the best first.  Empty if all are bad.
        """
        pixel_count, max_causes, min_causes = _FIRST_PIXELS, _MAX_CAUSES, _MIN_CAUSES
        if self.lossy_levels:
            min_causes = max(1, min(min_causes, min_causes * MAX_PIXELS // self.known.pixel_count))
        while len(causes) > min_causes and pixel_count < len(self._final_pixels):
            causes = self._run_round(causes, pixel_count, max(min_causes, max_causes))
            pixel_count, max_causes = 4 * pixel_count, max_causes // 4
        return sorted(self._with_rounding(causes[:_MIN_CAUSES]), key=self._count_remaining)

    def _run_round(self, causes: list[Cause], pixel_count: int, max_causes: int) -> list[Cause]:
        """Select the causes that leave the fewest of some pixels wrong: a round of `_select_best`.

        After lossy compression, nearly all levels are wrong, so the causes with the smallest sum of
        differences are selected.

        Parameters
        ----------
        causes : list of tuples of str
            The causes to compare.
        pixel_count : int
            Number of pixels at which the causes are rendered.
        max_causes : int
            Maximum number of causes to select.

        Returns
        -------
        list of tuples of str
            The selected causes, the best first.  Empty if all leave more than `_MAX_WORST` of the
            pixels that differ from the right picture.
        """
        pixels, weights = self._choose_pixels(pixel_count)
        codes = self.known.render(causes, pixels, self.handin, self.fitted_pixels)
        levels = difference(codes, self.handin[:, pixels])
        if self.lossy_levels:
            order = np.argsort(np.minimum(levels, _MAX_LEVELS) @ weights, kind="stable")
            return [causes[k] for k in order[:max_causes]]
        is_left = levels > self.tolerance
        if is_left[:, self.is_wrong[pixels]].mean(axis=1).min() > _MAX_WORST:
            return []
        remaining = is_left @ weights
        limit = 1.5 * remaining.min() + _CHANCE * weights.max()
        order = np.argsort(remaining, kind="stable")[:max_causes]
        return [causes[k] for k in order if remaining[k] <= limit]

    def find(self) -> Finding:
        """Search for the causes with which the scene renders as the hand-in.

        Single mistakes are tried first, and pairs only if no single mistake explains the hand-in
        almost exactly.  If no cause explains it, the nearest one is returned as a hint.
        """
        singles = self._select_best(self.known.singles)
        group = self._select_reportable(singles)
        if not group or self._count_remaining(group[0]) > _MAX_REMAINING_PIXELS:
            pairs = self._best_pairs()
            better = self._select_reportable([c for c in pairs if self._needs_each_mistake(c)])
            if better and (
                not group
                or _MIN_RATIO * self._count_remaining(better[0]) <= self._count_remaining(group[0])
            ):
                group = better
            elif not group:
                return self._find_hint(singles, pairs)
        remaining_count = self._count_remaining_everywhere(group[0])
        if remaining_count > self._max_remaining:  # the estimate from a subset was smaller
            return self._find_hint(group[:1], [])
        return Finding(tuple(dict.fromkeys(map(_without_variants, group))), remaining_count)

    def _find_hint(self, singles: list[Cause], pairs: list[Cause]) -> Finding:
        """Return a finding without causes, whose hint is the cause that explains most pixels.

        Parameters
        ----------
        singles, pairs : list of tuples of str
            Single mistakes, and pairs of mistakes, each with the best first.  The best pair is
            preferred only if it leaves less than half the pixels of the best single mistake.

        Returns
        -------
        Finding
            Without a hint if the best cause explains less than half of the wrong pixels.
        """
        if not (best := singles[:1] + pairs[:1]):
            return Finding((), self.wrong_count)
        remaining = [self._count_remaining(cause) for cause in best]
        hint = best[-1] if 2 * remaining[-1] < remaining[0] else best[0]
        if 2 * (unexplained := self._count_remaining_everywhere(hint)) > self.wrong_count:
            return Finding((), self.wrong_count)
        return Finding((), unexplained, _without_variants(hint))

    def _best_pairs(self) -> list[Cause]:
        """Return the pairs of mistakes that leave the fewest pixels wrong, the best first.

        If several mistakes have the same picture, only the first of them is tried in pairs.  The
        others are tried in its place if a pair with it is among the best.
        """
        known = self.known
        pairs, codes, pixels = known.rendered_pairs
        is_left = difference(codes, self.handin[:, pixels]) > self.tolerance
        order = np.argsort(is_left.sum(axis=1), kind="stable")[:_MAX_CAUSES]
        mistakes_of = {cause: pairs[k] for k in order if (cause := known.join_causes(*pairs[k]))}
        background = mistakes.BACKGROUND
        if self.handin[:, known.surface < 0].any():
            mistakes_of |= {cause: (background, other) for other in known.groups
                            if (cause := known.join_causes(background, other))}  # fmt: skip
        best = self._select_best([*mistakes_of])
        groups = {background: [background]} | known.groups
        roundings = [(), *((kind,) for kind in mistakes.ROUNDINGS)]
        close = [c for c in mistakes_of if any((*c, *rounding) in best for rounding in roundings)]
        members = {joined: None for cause in close
                   for first in groups[mistakes_of[cause][0]]
                   for second in groups[mistakes_of[cause][1]]
                   if (joined := known.join_causes(first, second))}  # fmt: skip
        return self._select_best([*members]) if len(members) > len(close) else best

    def _needs_each_mistake(self, cause: Cause) -> bool:
        """Test whether each mistake of a pair explains far more pixels than the pair leaves.

        If the pair has a mistake of the camera, its picture must also show at least three surfaces,
        or all that the right picture shows: a picture that shows less may agree by chance.

        Parameters
        ----------
        cause : tuple of str
            Keywords of the mistakes; a variant of a right tracer or a rounding may follow them.
        """
        known, additions = self.known, (*mistakes.VARIANTS, *mistakes.ROUNDINGS)
        kinds = [kind for kind in cause if kind not in additions]
        suffix = [kind for kind in cause if kind in additions]
        remaining = self._count_remaining(cause)
        for others in combinations(kinds, len(kinds) - 1):
            explained = self._count_remaining((*others, *suffix)) - remaining
            if explained < max(_MIN_RATIO * remaining, 1):
                return False
        has_camera_mistake = any(mistakes.CAMERA & known.table[kind].keys() for kind in kinds)
        if not has_camera_mistake or not known.surface_count:
            return True
        pixels = next(known.pixel_batches(known.sample))
        cache, formulas = known.formula_cache(pixels, self.handin), known.formulas_of(cause) or {}
        is_hit, surface = (cache.get(name, formulas) for name in ("hit", "surface"))
        right_surfaces = np.unique(known.surface[pixels])
        return len(np.unique(surface[is_hit])) >= min(3, int((right_surfaces >= 0).sum()))

    def _select_reportable(self, causes: list[Cause]) -> list[Cause]:
        """Select the causes that may be reported.

        A reportable cause explains almost all wrong pixels, nearly as many as the best cause does,
        and nearly as many of them exactly.  A cause with fitted numbers, such as a gamma, is
        reported only if there is no other.

        Parameters
        ----------
        causes : list of tuples of str
            Results of `_select_best`.

        Returns
        -------
        list of tuples of str
            The selected causes, in the order of the table of mistakes.
        """
        remaining = {cause: self._count_remaining(cause) for cause in causes}
        limit = min(self._max_remaining, self.wrong_count - 1)
        causes = [cause for cause in causes if remaining[cause] <= limit]
        if not causes:
            return []
        min_remaining = min(remaining[cause] for cause in causes)
        causes = [c for c in causes if remaining[c] < _MIN_RATIO * max(1, min_remaining)]
        min_inexact = min(self._inexact[cause] for cause in causes)
        max_inexact = _MIN_RATIO * max(min_inexact, _MAX_REMAINING_PIXELS)
        causes = [c for c in causes if self._inexact[c] <= max_inexact]
        causes = [c for c in causes if not any(map(self.known.fitted_names, c))] or causes
        place = {kind: k for k, kind in enumerate(self.known.table)}
        return sorted(causes, key=lambda cause: [place[kind] for kind in cause])

    def _with_rounding(self, causes: list[Cause]) -> list[Cause]:
        """Add a mistake of rounding to those causes whose picture it makes far more exact.

        The causes, and each of them with each mistake of rounding, are rendered at the pixels of
        the final round.  This sets the numbers of pixels that they leave, in `_remaining` and
        `_inexact`; the latter also counts pixels that are one level off.

        Parameters
        ----------
        causes : list of tuples of str
            Keywords of mistakes that are made together.

        Returns
        -------
        list of tuples of str
            Each cause, unchanged or with one more keyword.
        """
        may_round = self.tolerance and not self.lossy_levels
        kinds = [kind for kind in mistakes.ROUNDINGS if may_round and kind in self.known.table]
        variants = {cause: [(*cause, kind) for kind in kinds
                            if self.known.formulas_of((*cause, kind)) is not None]
                    for cause in causes}  # fmt: skip
        every = [*dict.fromkeys(v for cause in causes for v in (cause, *variants[cause]))]
        for cause, levels in zip(every, self._final_differences(every), strict=True):
            self._remaining[cause] = round((levels > self.tolerance) @ self._final_weights)
            self._inexact[cause] = round((levels > self.lossy_levels) @ self._final_weights)
        chosen = []
        for cause in causes:
            rounded = min([cause, *variants[cause]], key=self._inexact.__getitem__)
            limit = _MIN_RATIO * max(self._inexact[rounded], _MAX_REMAINING_PIXELS)
            chosen.append(rounded if limit < self._inexact[cause] else cause)
        return chosen


def _without_variants(cause: Cause) -> Cause:
    """Remove, from the keywords of a cause, variants of a right tracer, which are no mistakes."""
    return tuple(kind for kind in cause if kind not in mistakes.VARIANTS)
