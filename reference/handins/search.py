"""Find the mistakes that turn a scene into a submitted picture: first single ones, then all pairs.

A *submitted picture* is one that a student handed in, the *reference picture* is what it should be,
and a *cause* is a tuple of keywords of mistakes that are made together.

The problem is that there are tens of thousands of pairs of mistakes, and that rendering a picture
with each pair would take hours.  A few pixels refute almost all pairs, so the search is successive
halving (Jamieson and Talwalkar 2016): it tries all causes at a few pixels, the best of them at more
pixels, and only the last few in full.

A cause is reported only if the scene, rendered with it, gives the submitted picture.  Exceptions
are allowed in 3 % of the pixels that differ from the reference picture, unless they fill a square.
Each mistake of a pair must meet this limit at the pixels that it adds to what the other explains.
If no cause is reported, the one that comes closest to explaining the picture is returned as a hint.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import chain, product
from typing import Annotated as Shaped
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.ndimage import binary_erosion

from reference.handins import mistakes
from reference.handins.drawing import FormulaCache
from reference.handins.formula_functions import Array
from reference.handins.renderer import (
    MAX_INTERSECTIONS,
    MAX_PIXELS,
    Cause,
    MistakeRenderer,
    remove_variants,
)
from reference.handins.sampling import choose_from_strata, shuffle_range
from reference.judges.arrays import Bools, Floats
from reference.pictures import JPEG_BLOCK, Codes, compare_levels, to_columns, to_rows

Reencode: TypeAlias = Callable[[Codes], Codes]

# A cause is reported if it leaves at most this share of the wrong pixels unexplained.
_MAX_UNEXPLAINED_SHARE = 0.03
# This many unexplained pixels are allowed in any case.
_MAX_UNEXPLAINED = 3
# Unexplained pixels that fill a square of this side show another mistake, however few they are.
_BLOCK_SIDE = 3
# A cause must reproduce all other pixels within one level, but nearly all of them exactly: it is
# reported if it leaves at most this share of those inexact that differ from the right picture.  In
# pictures of other tracers, true causes left up to .02, and false ones .4 and more.
_MAX_INEXACT_SHARE = 0.1
# A hint leaves at most this share of the wrong pixels unexplained: of hints that left more than
# 20 %, 13 of 75 were true.
_MAX_HINT_SHARE = 0.1
# One cause is far better than another if the other leaves this many times as many pixels
# unexplained, or inexact.
_LARGE_RATIO = 5
# Differences in this many pixels are never large.
_FEW_PIXELS = 10
# Maximum number of causes after the first round.  Each further round has four times the pixels and
# a quarter of the causes.
_MAX_CAUSE_COUNT = 256
# Maximum number of causes after the last round.
_FINAL_CAUSE_COUNT = 16
# By chance, the right cause may leave this many more pixels of a round unexplained than the best.
_CHANCE_MARGIN = 4
# The search ends if the best cause leaves more than this share of the wrong pixels unexplained.
_HOPELESS_SHARE = 0.75
# After lossy compression, differences of more levels count as this many.
_MAX_DIFFERENCE = 32
# The picture of a pair with a camera mistake must show at least this many surfaces, if the scene
# has them.
_MIN_SHOWN_SURFACES = 3


class Finding(NamedTuple):
    """The result of searching for the mistakes in a submitted picture."""

    # The causes that explain the submitted picture.  If there are several, they give nearly the
    # same picture of this scene.  Empty if no cause explains it.
    causes: tuple[Cause, ...]
    # Number of pixels that the first cause leaves unexplained; or the hint, if there are no causes.
    # Without either, it is the number of wrong pixels.
    unexplained_count: int
    # If there are no causes, the cause that comes closest to explaining the picture.  Empty if none
    # comes close enough.
    hint: Cause = ()


class _Selection(NamedTuple):
    """Pixels that represent a picture."""

    pixel_index: Shaped[Array, "k"]
    weights: Shaped[Floats, "k"]  # number of pixels of the picture that each represents
    width: int = 0  # of the picture that the pixels form; 0 if they form none


class Submission:
    """A picture that a student submitted, and the search for its mistakes.

    A *wrong* pixel differs from the reference picture by more than the tolerance.  A cause leaves a
    pixel *unexplained* if the submitted picture differs there by more than the tolerance from the
    picture that is rendered with the cause, and *inexact* if it differs at all.

    Parameters
    ----------
    renderer
        Renders the scene with mistakes, at the size of the submitted picture.
    format_noise
        Number of levels by which the file format of the submitted picture, or of the reference
        picture, may have changed codes.  Such differences count neither as wrong nor as inexact.
    reencode
        Returns the codes of a picture as the file format of the submitted picture alters them.
    """

    codes: Shaped[Codes, "3 n"]
    tolerance: int  # in levels
    is_wrong: Shaped[Bools, "n"]
    wrong_count: int
    clearly_wrong_count: int  # of pixels that differ by more than one level
    # Its pixels are used to estimate numbers such as gamma: a sample of the picture, and the
    # brightest pixel.
    fitting_cache: FormulaCache

    def __init__(
        self,
        codes: Shaped[Codes, "3 n"],
        renderer: MistakeRenderer,
        format_noise: int = 0,
        reencode: Reencode | None = None,
    ) -> None:
        self.codes = codes
        self.renderer = renderer
        self.format_noise = format_noise
        self._reencode = reencode
        reference_codes = renderer.reference_codes
        differences = compare_levels(
            _apply_losses(reencode, reference_codes, renderer.width), codes
        )
        self.clearly_wrong_count = int((differences > 1).sum())
        # If at most two pixels differ by more than one level, differences of one level count, too.
        self.tolerance = format_noise or int(self.clearly_wrong_count > 2)
        self.is_wrong = differences > self.tolerance
        self.wrong_count = int(self.is_wrong.sum())
        order = shuffle_range(renderer.pixel_count)
        self._max_unexplained = self._limit_unexplained(codes[:, order[:MAX_PIXELS]])
        is_wrong = self.is_wrong[order]
        # Indices of wrong pixels, then of right ones, both in random order.
        self._shuffled_pixels = [order[mask][:MAX_PIXELS].copy() for mask in (is_wrong, ~is_wrong)]
        max_count = min(MAX_PIXELS, MAX_INTERSECTIONS // max(1, renderer.surface_count))
        # The pixels at which the last causes are compared.
        choose = self._choose_blocks if reencode else self._choose_pixels
        self._final = choose(max_count)
        # For each measured cause, the numbers of unexplained and of inexact pixels.
        self._counts_by_cause = dict[Cause, list[int]]()
        fitting_pixels = np.append(renderer.sample_index, reference_codes.sum(0, np.int16).argmax())
        self.fitting_cache = renderer.make_cache(fitting_pixels, codes)

    def _limit_unexplained(self, random_codes: Shaped[Codes, "3 k"]) -> int:
        """Compute how many pixels a cause may leave unexplained, from random pixels' codes.

        Where most of a picture has one colour, the limit is a share of the other pixels.
        """
        red, green, blue = random_codes.astype(np.uint32)
        color_counts = np.unique(red << 16 | green << 8 | blue, return_counts=True)[1]
        foreground_share = 1 - color_counts.max() / len(red)
        considered_count = min(self.wrong_count, self.renderer.pixel_count * foreground_share)
        return max(_MAX_UNEXPLAINED, int(_MAX_UNEXPLAINED_SHARE * considered_count))

    def _choose_pixels(self, count: int) -> _Selection:
        """Choose random pixels: half of them wrong, half of them right, if there are enough.

        In a smaller picture, all pixels are chosen.
        """
        wrong_pixels, right_pixels = self._shuffled_pixels
        chosen_wrong_pixels = wrong_pixels[: max(count // 2, count - len(right_pixels))]
        chosen_right_pixels = right_pixels[: count - len(chosen_wrong_pixels)]
        pixel_index = np.sort(np.concatenate([chosen_wrong_pixels, chosen_right_pixels]))
        wrong_weight = self.wrong_count / max(1, len(chosen_wrong_pixels))
        right_weight = (len(self.is_wrong) - self.wrong_count) / max(1, len(chosen_right_pixels))
        weights = np.where(self.is_wrong[pixel_index], wrong_weight, right_weight)
        return _Selection(pixel_index=pixel_index, weights=weights)

    def _choose_blocks(self, count: int) -> _Selection:
        """Choose random blocks of a JPEG picture: half of them with wrong pixels, half without.

        The chosen blocks form a picture, one below the other.  JPEG compresses blocks separately,
        so it alters this picture as it does the whole one.  Only the edges of blocks differ; they
        get weight 0.  At least `MAX_PIXELS` / 8 pixels are chosen.  If the submitted picture has no
        more, or is narrower or shorter than a block, all its pixels are chosen, in their order.
        """
        pixel_count, width, side = self.renderer.pixel_count, self.renderer.width, JPEG_BLOCK
        every_pixel = np.arange(pixel_count, dtype=np.int32)
        count = max(count, MAX_PIXELS // 8)
        if pixel_count <= count or min(width, pixel_count // width) < side:
            weights = np.ones(pixel_count)
            return _Selection(pixel_index=every_pixel, weights=weights, width=width)
        pixel_grid = every_pixel.reshape(-1, width)
        rows, columns = (size // side * side for size in pixel_grid.shape)
        blocks: Array = pixel_grid[:rows, :columns].reshape(-1, side, columns // side, side)
        blocks = blocks.swapaxes(1, 2).reshape(-1, side, side)
        strata = self.is_wrong[blocks].any(axis=(1, 2)).astype(int)  # 1 if any pixel is wrong
        block_index = choose_from_strata(strata, count // side**2)
        block_weights = np.bincount(strata) / np.bincount(strata[block_index])
        weights = np.zeros((len(block_index), side, side))
        weights[:, 1:-1, 1:-1] = block_weights[strata[block_index], None, None]
        weights *= side**2 / (side - 2) ** 2
        pixel_index = blocks[block_index].ravel()
        return _Selection(pixel_index=pixel_index, weights=weights.ravel(), width=side)

    def _compare_levels(
        self, causes: Sequence[Cause], pixel_index: Shaped[Array, "k"], width: int = 0
    ) -> Shaped[Codes, "causes k"]:
        """Render a picture with each of at least one cause, and compare it with the submitted
        picture.

        If `width` is given, the pixels form a picture of this width, and the rendered codes are
        altered by the file format of the submitted picture.
        """
        formula_maps = [self.renderer.get_formulas(cause) for cause in causes]
        pictures = self.renderer.evaluate(formula_maps, pixel_index, self.codes, self.fitting_cache)
        if width and self._reencode:
            pictures = np.array([_apply_losses(self._reencode, codes, width) for codes in pictures])
        return compare_levels(pictures, self.codes[:, pixel_index])

    def _cache_counts(self, causes: Sequence[Cause]) -> None:
        """Compute the results of `_count_unexplained` and `_count_inexact`, and cache them.

        If a cause explains none but black pixels, and the picture has others, all wrong pixels
        count as unexplained, because black pixels cannot tell why they are black.
        """
        cached_counts, limits = self._counts_by_cause, (self.tolerance, self.format_noise)
        new_causes = [cause for cause in dict.fromkeys(causes) if cause not in cached_counts]
        if not new_causes:
            return
        pixel_index, weights = self._final.pixel_index, self._final.weights
        differences = self._compare_levels(new_causes, pixel_index, self._final.width)
        is_bright = self.codes[:, pixel_index].max(axis=0) > self.tolerance
        for cause, difference in zip(new_causes, differences, strict=True):
            counts = [round(float(weights[difference > limit].sum())) for limit in limits]
            if is_bright.any() and (difference[is_bright] > self.tolerance).all():
                counts[0] = self.wrong_count
            cached_counts[cause] = counts

    def _count_unexplained(self, cause: Cause) -> int:
        """Count the pixels that a cause leaves unexplained; an estimate if the picture is large."""
        self._cache_counts([cause])
        return self._counts_by_cause[cause][0]

    def _count_inexact(self, cause: Cause) -> int:
        """Count the pixels that a cause leaves inexact; an estimate if the picture is large."""
        self._cache_counts([cause])
        return self._counts_by_cause[cause][1]

    def _is_exact(self, cause: Cause) -> bool:
        """Test whether a cause reproduces nearly all pixels that it explains exactly."""
        inexact_count = self._count_inexact(cause) - self._count_unexplained(cause)
        return inexact_count <= max(_FEW_PIXELS, _MAX_INEXACT_SHARE * self._count_inexact(()))

    def _rank_causes(self, causes: list[Cause]) -> list[Cause]:
        """Select the causes that leave the fewest pixels unexplained, the best first.

        Successive halving compares all causes at a few pixels, then the best of them at more
        pixels, and so on.  The result has at most `_FINAL_CAUSE_COUNT` causes.  It is empty if no
        cause explains a quarter of the wrong pixels.
        """
        pixel_count, max_causes = self.renderer.first_round_size, _MAX_CAUSE_COUNT
        while len(causes) > _FINAL_CAUSE_COUNT and pixel_count < len(self._final.pixel_index):
            causes = self._run_round(causes, pixel_count, max(_FINAL_CAUSE_COUNT, max_causes))
            pixel_count, max_causes = 4 * pixel_count, max_causes // 4
        self._cache_counts(causes[:_FINAL_CAUSE_COUNT])
        return sorted(causes[:_FINAL_CAUSE_COUNT], key=self._count_unexplained)

    def _run_round(self, causes: list[Cause], pixel_count: int, max_causes: int) -> list[Cause]:
        """Run one round of successive halving: compare causes at some pixels, and keep the best.

        The result is empty if every cause leaves more than `_HOPELESS_SHARE` of the wrong pixels
        unexplained.
        """
        selection = self._choose_pixels(pixel_count)
        pixel_index, weights = selection.pixel_index, selection.weights
        differences = self._compare_levels(causes, pixel_index)
        if self.format_noise:  # nearly all pixels differ: select the smallest sums of differences
            order = np.argsort(np.minimum(differences, _MAX_DIFFERENCE) @ weights, kind="stable")
            return [causes[index] for index in order[:max_causes]]
        is_unexplained = differences > self.tolerance
        if is_unexplained[:, self.is_wrong[pixel_index]].mean(axis=1).min() > _HOPELESS_SHARE:
            return []
        unexplained_counts = is_unexplained @ weights
        max_unexplained = 1.5 * unexplained_counts.min() + _CHANCE_MARGIN * weights.max()
        order = np.argsort(unexplained_counts, kind="stable")[:max_causes]
        return [causes[index] for index in order if unexplained_counts[index] <= max_unexplained]

    @cached_property
    def _ranked_singles(self) -> list[Cause]:
        """The single mistakes that leave the fewest pixels unexplained, the best first."""
        return self._add_rounding(self._rank_causes(self.renderer.single_causes))

    @cached_property
    def good_singles(self) -> list[Cause]:
        """The single mistakes that are good enough to report, unless a pair is far better."""
        return self._select_good_causes(self._ranked_singles)

    def find_mistakes(self, *, may_be_pair: bool = True) -> Finding:
        """Search for the mistakes that explain the submitted picture, or come closest to it.

        Pairs of mistakes are tried only if no single mistake explains the picture almost exactly,
        and if `may_be_pair`.
        """
        singles, causes, pairs = self._ranked_singles, self.good_singles, list[Cause]()
        single_count: float = self._count_unexplained(causes[0]) if causes else np.inf
        if single_count > _MAX_UNEXPLAINED and may_be_pair:
            pairs = self._add_rounding(self._select_best_pairs())
            # A pair that is far worse than another is not reported in its place.
            good_pairs = [
                pair
                for pair in self._select_good_causes(pairs)
                if self._needs_both_mistakes(pair, _MAX_UNEXPLAINED_SHARE)
            ]
            if good_pairs and _LARGE_RATIO * self._count_unexplained(good_pairs[0]) <= single_count:
                causes = good_pairs
        if causes:
            is_unexplained = self._find_unexplained_pixels(causes[0])
            unexplained_count = int(is_unexplained.sum())
            if unexplained_count <= self._max_unexplained and not self._has_block(is_unexplained):
                distinct_causes = tuple(dict.fromkeys(map(remove_variants, causes)))
                return Finding(causes=distinct_causes, unexplained_count=unexplained_count)
            pairs = []
        return self._choose_hint(singles, pairs)

    def _choose_hint(self, singles: list[Cause], pairs: list[Cause]) -> Finding:
        """Choose the cause that leaves the fewest pixels unexplained, if it is good enough.

        A pair is preferred only if it leaves less than half as many pixels unexplained.
        """
        pairs = [pair for pair in pairs if self._needs_both_mistakes(pair, _MAX_HINT_SHARE)]
        hint = min(
            singles + pairs,
            default=(),
            key=lambda cause: (1 + (cause in pairs)) * self._count_unexplained(cause),
        )
        max_unexplained = _MAX_HINT_SHARE * self.wrong_count
        if self._count_unexplained(hint) > max_unexplained or not self._is_exact(hint):
            return Finding(causes=(), unexplained_count=self.wrong_count)
        unexplained_count = int(self._find_unexplained_pixels(hint).sum())
        return Finding(causes=(), unexplained_count=unexplained_count, hint=remove_variants(hint))

    def _find_unexplained_pixels(self, cause: Cause) -> Shaped[Bools, "n"]:
        """Find the pixels of the complete picture that a cause leaves unexplained."""
        every_pixel = np.arange(self.renderer.pixel_count, dtype=np.int32)
        differences = self._compare_levels([cause], every_pixel, self.renderer.width)
        is_unexplained: Bools = differences[0] > self.tolerance
        return is_unexplained

    def _has_block(self, is_unexplained: Shaped[Bools, "n"]) -> bool:
        """Test whether unexplained pixels fill a square, as a small highlight does.

        Where rounding decides, which is at edges, they form thin lines.  After lossy compression,
        the test is false, because it spreads errors over its blocks.
        """
        square = np.ones((_BLOCK_SIDE, _BLOCK_SIDE))
        rows = is_unexplained.reshape(-1, self.renderer.width)
        return not self.format_noise and bool(binary_erosion(rows, square).any())

    def _select_best_pairs(self) -> list[Cause]:
        """Select the pairs of mistakes that come closest to explaining the submitted picture.

        If several mistakes give the same picture, only one of them is tried in all pairs.  The best
        pairs are then tried again with each of the others in its place, and with variants.
        """
        renderer, background = self.renderer, mistakes.BACKGROUND
        groups = {background: [background]} | renderer.cause_groups
        rendered = renderer.rendered_pairs
        differences = compare_levels(rendered.codes, self.codes[:, rendered.pixel_index])
        is_unexplained = differences > self.tolerance
        order = np.argsort(is_unexplained.sum(axis=1), kind="stable")
        items = [*rendered.causes_by_pair.items()]
        causes_by_pair = dict(items[index] for index in order[:_MAX_CAUSE_COUNT])
        if self.codes[:, renderer.surface_index < 0].any():
            causes_by_pair |= {
                pair: (background, other)
                for other in groups
                if (pair := renderer.join_causes(background, other))
            }
        best_pairs = self._rank_causes([*causes_by_pair])
        # The best pairs, and all pairs that give the same pictures; a dictionary has no duplicates.
        pairs = {
            pair: None
            for best_pair in best_pairs
            for causes in product(*(groups[cause] for cause in causes_by_pair[best_pair]))
            if (pair := renderer.join_causes(*causes))
        }
        # A variant may show only in a pair.
        pairs |= {varied: None for pair in best_pairs for varied in renderer.add_variants(pair)}
        return self._rank_causes([*pairs]) if len(pairs) > len(best_pairs) else best_pairs

    def _needs_both_mistakes(self, pair: Cause, max_share: float) -> bool:
        """Test whether each mistake of a pair explains pixels that the other leaves unexplained.

        The pair must explain them as well as a single mistake would have to: it may leave at most
        `max_share` of their number unexplained.  False also if a camera mistake leaves few surfaces
        in the picture, which may match by chance.
        """
        pair_unexplained = self._count_unexplained(pair)
        for keyword in set(remove_variants(pair)).difference(mistakes.ROUNDINGS):
            remaining_cause = tuple(other for other in pair if other != keyword)
            explained_count = self._count_unexplained(remaining_cause) - pair_unexplained
            max_few = min(_MAX_UNEXPLAINED, explained_count / _LARGE_RATIO)
            if explained_count <= 0 or pair_unexplained > max(max_few, max_share * explained_count):
                return False
        renderer, formulas = self.renderer, self.renderer.get_formulas(pair)
        if not renderer.surface_count or mistakes.CAMERA_FORMULAS.isdisjoint(formulas):
            return True
        # The other mistake may remove surfaces.
        other_formulas = {k: formulas[k] for k in formulas if k not in mistakes.CAMERA_FORMULAS}
        formula_maps = formulas, other_formulas
        shown = renderer.evaluate(formula_maps, renderer.sample_index, name="shown_surface")
        shown_count, usual_count = (len(np.unique(index[index >= 0])) for index in shown)
        return shown_count >= min(_MIN_SHOWN_SURFACES, usual_count)

    def _select_good_causes(self, causes: list[Cause]) -> list[Cause]:
        """Select the causes that are good enough to report, in the order of the table of mistakes.

        They leave few pixels unexplained, reproduce most of the others exactly, and no other cause
        is far better.  Causes with an estimated number, such as a gamma, are selected only if there
        are no others.
        """
        max_unexplained = min(self._max_unexplained, self.wrong_count - 1)
        causes = [
            cause
            for cause in causes
            if self._count_unexplained(cause) <= max_unexplained and self._is_exact(cause)
        ]
        if not causes:
            return []
        min_unexplained = min(map(self._count_unexplained, causes))
        max_unexplained = max(_MAX_UNEXPLAINED, _LARGE_RATIO * min_unexplained)
        causes = [cause for cause in causes if self._count_unexplained(cause) <= max_unexplained]
        max_inexact = _LARGE_RATIO * max(min(map(self._count_inexact, causes)), _FEW_PIXELS)
        causes = [cause for cause in causes if self._count_inexact(cause) <= max_inexact]
        keywords, needs_fitting = [*self.renderer.mistakes], self.renderer.needs_fitting
        causes = [cause for cause in causes if not any(map(needs_fitting, cause))] or causes
        return sorted(causes, key=lambda cause: [keywords.index(keyword) for keyword in cause])

    def _add_rounding(self, causes: list[Cause]) -> list[Cause]:
        """Add a rounding mistake to each cause that then reproduces far more pixels exactly.

        A rounding mistake, such as truncation, changes codes by at most 1.
        """
        # Without a tolerance, rounding is found like other mistakes; lossy compression hides it.
        if not self.tolerance or self.format_noise:
            return causes
        join = self.renderer.join_causes
        candidates = [
            [cause, *filter(None, (join(cause, (rounding,)) for rounding in mistakes.ROUNDINGS))]
            for cause in causes
        ]
        self._cache_counts([*chain(*candidates)])
        chosen_causes = list[Cause]()
        for cause, cause_candidates in zip(causes, candidates, strict=True):
            best_cause = min(cause_candidates, key=self._count_inexact)
            max_inexact = _LARGE_RATIO * max(self._count_inexact(best_cause), _FEW_PIXELS)
            chosen_causes.append(best_cause if max_inexact < self._count_inexact(cause) else cause)
        return chosen_causes


def _apply_losses(
    reencode: Reencode | None, codes: Shaped[Codes, "3 k"], width: int
) -> Shaped[Codes, "3 k"]:
    """Alter the codes of a picture as a file format does, if it has a function for it."""
    return to_columns(reencode(to_rows(codes, width))) if reencode else codes
