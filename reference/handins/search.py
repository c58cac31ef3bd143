"""Find the mistakes that turn a scene into a submitted picture: first single ones, then all pairs.

A *submitted picture* is one that a student handed in, the *reference picture* is what it should be,
and a *cause* is a tuple of keywords of mistakes that are made together.

The problem is that there are tens of thousands of pairs of mistakes, and that rendering a picture
with each pair would take hours.  A few pixels refute almost all pairs, so the search is successive
halving (Jamieson and Talwalkar 2016): it tries all causes at a few pixels, the best of them at more
pixels, and only the last few in full.

A cause is reported only if the scene, rendered with it, gives the submitted picture.  Exceptions
are allowed in 3 % of the pixels that differ from the reference picture.  If no cause is reported,
the one that comes closest to explaining the picture is returned as a hint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from itertools import chain, combinations, product
from typing import NamedTuple, TypeAlias

import numpy as np

from reference.handins import mistakes
from reference.handins.drawing import FormulaCache, join_formulas, make_formula_inputs
from reference.handins.formulas import Array, Formulas, collect_parameters
from reference.pictures import JPEG_BLOCK, Codes, compare_levels, to_columns, to_picture
from tracer import Scene

# A cause is reported if it leaves at most this share of the wrong pixels unexplained, or at most
# this number of pixels.
_MAX_UNEXPLAINED_SHARE, _MAX_UNEXPLAINED = 0.03, 10
# One cause is far better than another if the other leaves this many times as many pixels
# unexplained, or inexact.
_LARGE_RATIO = 5
# Number of pixels at which the pictures with different mistakes are compared with each other.
_GROUPING_PIXELS = 2400
# Maximum number of pixels in the first round, and of causes after it.  Each further round
# has four times the pixels and a quarter of the causes, but no fewer than the last number.
_FIRST_PIXELS, _MAX_CAUSE_COUNT, _FINAL_CAUSE_COUNT = 240, 256, 16
# By chance, the right cause may leave this many more pixels of a round unexplained than the best.
# The search ends if the best cause leaves more than this share of the wrong pixels unexplained.
_CHANCE_MARGIN, _HOPELESS_SHARE = 4, 0.75
# Maximum number of pixels, and of pixels times surfaces, at which many causes are rendered.  A
# random subset represents a larger picture.
MAX_PIXELS, _MAX_INTERSECTIONS = 131_072, 2_000_000
# Maximum number of items from which items are chosen; a random subset represents more.
_MAX_CANDIDATES = 1_000_000
# Number of intersections in one batch of pixels: their arrays stay in the CPU cache.
_INTERSECTIONS_PER_BATCH = 25_000
# In scenes with more surfaces, mistakes that concern a single surface are not tried in pairs.
_MAX_PAIRED_SURFACES = 40
# After lossy compression, differences of more levels count as this many.
_MAX_DIFFERENCE = 32
# The picture of a pair with a camera mistake must show at least this many surfaces, if the scene
# has them.
_MIN_SHOWN_SURFACES = 3

Cause: TypeAlias = tuple[str, ...]


class Finding(NamedTuple):
    """The result of searching for the mistakes in a submitted picture.

    A cause is a tuple of keywords of mistakes that are made together, such as
    ("mirrored", "gamma-none").

    Attributes
    ----------
    causes : tuple of tuples of str
        The causes that explain the submitted picture.  If there are several, they give nearly the
        same picture of this scene.  Empty if no cause explains it.
    unexplained_count : int
        Number of pixels that the first cause, or otherwise the hint, leaves unexplained.  Without a
        hint, the number of wrong pixels.
    hint : tuple of str
        If `causes` is empty, the cause that comes closest to explaining the picture.  Empty if even
        this cause leaves more than half of the wrong pixels unexplained.
    """

    causes: tuple[Cause, ...]
    unexplained_count: int
    hint: Cause = ()


def choose_from_strata(strata: Array, max_count: int) -> Array:
    """Choose items at random, about the same number from each stratum.

    Parameters
    ----------
    strata : (n,) int array
        The stratum of each of the n items.
    max_count : int
        Maximum number of items to choose, at most `_MAX_CANDIDATES`.

    Returns
    -------
    item_index : (k,) int array
        Indices of the chosen items; k is the smaller of n and `max_count`.
    """
    candidate_index = shuffle_range(len(strata))[:_MAX_CANDIDATES]
    order = np.argsort(strata[candidate_index], kind="stable")
    counts = np.unique(strata[candidate_index], return_counts=True)[1]
    # The first candidate of each stratum has place 0, the second has place 1, and so on.
    place_in_stratum = np.arange(len(order)) - np.repeat(counts.cumsum() - counts, counts)
    return candidate_index[order[np.argsort(place_in_stratum, kind="stable")[:max_count]]]


def shuffle_range(count: int) -> Array:
    """Return the integers from 0 to `count` - 1 in random order, which is always the same."""
    # Arrays of int64 would take too much memory.
    return np.random.default_rng(1).permutation(np.arange(count, dtype=np.int32))


class MistakeRenderer:
    """Renders one scene, at one size, with simulated mistakes.

    A picture is defined by formulas (functions for values such as the radiance), and a mistake by
    the formulas that it replaces.

    Parameters
    ----------
    source : Scene or (h, w, 3) uint8 array
        The scene at this size; or, if there is no scene, the codes of the reference picture.
    reference_codes : (3, n) uint8 array
        8-bit codes of the n pixels of the reference picture.
    surface_index : (n,) int array
        Index of the surface that each pixel shows; -1 for the background.
    width : int
        Width of the picture in pixels.
    base_formulas : dict of str to callable
        Formulas, by name, that replace the usual ones in all pictures.

    Attributes
    ----------
    pixel_count, surface_count : int
        Number of pixels in the picture, and of surfaces in the scene.
    mistakes : dict of str to Mistake
        The mistakes that can be rendered, by keyword, in the order of the table of mistakes.
    sample_index : (m,) int array
        Pixel indices in random order.  The first of them show all surfaces, lit and in shadow.
    first_round_size : int
        Number of pixels at which all causes are rendered; smaller in scenes with many surfaces.
    """

    def __init__(
        self, source: Scene | Codes, reference_codes: Array, surface_index: Array, width: int,
        base_formulas: Formulas,
    ) -> None:  # fmt: skip
        self.reference_codes, self.surface_index = reference_codes, surface_index
        self.width, self.base_formulas = width, base_formulas
        self.pixel_count = reference_codes.shape[1]
        self._blank_codes = np.broadcast_to(np.uint8(0), reference_codes.shape)
        size = {"width": width, "height": self.pixel_count // width}
        self._inputs = make_formula_inputs(source) | size
        scene = source if isinstance(source, Scene) else Scene(**size)
        self.surface_count = len(scene.surfaces)
        pixel_share = min(1.0, _MAX_PAIRED_SURFACES / max(1, self.surface_count))
        self.first_round_size = max(40, int(pixel_share * _FIRST_PIXELS))
        self.mistakes = mistakes.list_mistakes(scene)
        first_pixel = self.make_cache(np.array([0]), self._blank_codes)
        self.mistakes = {
            keyword: mistake for keyword, mistake in self.mistakes.items()
            if (changes := self.get_formulas((keyword,))) and first_pixel.can_compute_codes(changes)
        }  # fmt: skip
        subset_index = choose_from_strata(surface_index, MAX_PIXELS // 32)
        strata = surface_index[subset_index]
        if isinstance(source, Scene):
            for is_lit in self.evaluate([base_formulas], subset_index, name="lit")[0][:4]:
                strata = 2 * strata + is_lit
        sample_size = max(500, _MAX_INTERSECTIONS // max(20, 20 * self.surface_count))
        self.sample_index = subset_index[choose_from_strata(strata, sample_size)]

    def get_formulas(self, cause: Cause) -> Formulas:
        """Collect the formulas that simulate the given mistakes.

        Parameters
        ----------
        cause : tuple of str
            Keywords of mistakes that are made together.

        Returns
        -------
        dict of str to callable
            The formulas, by name, that replace those of the reference picture.  Empty if two
            mistakes replace the same formula, and so exclude each other.
        """
        return join_formulas([self.base_formulas, *(self.mistakes[key].formulas for key in cause)])

    def needs_fitting(self, keyword: str) -> bool:
        """Test whether a mistake depends on a number estimated from the submitted picture.

        For example, the formula `fitted_gamma` estimates a wrong gamma.

        Parameters
        ----------
        keyword : str
            Keyword of the mistake, such as "gamma".
        """
        names = collect_parameters(self.mistakes[keyword].formulas)
        return any(name.startswith("fitted_") for name in names)

    def make_cache(
        self, pixel_index: Array, submitted_codes: Array, fitting_cache: FormulaCache | None = None
    ) -> FormulaCache:
        """Create a cache that evaluates formulas, such as the radiance, at the given pixels.

        Parameters
        ----------
        pixel_index : (k,) int array
            Indices of the pixels.
        submitted_codes : (3, n) uint8 array
            8-bit codes of all n pixels of the submitted picture.
        fitting_cache : FormulaCache, optional
            The cache whose pixels are used to fit parameters such as gamma.  By default,
            the pixels of the new cache are used.
        """
        row, column = np.divmod(pixel_index, self.width)
        pixel_inputs = {"i": column, "j": row, "submitted_codes": submitted_codes[:, pixel_index]}
        return FormulaCache(self._inputs | pixel_inputs, fitting_cache)

    def split_pixels(self, pixel_index: Array) -> Iterator[Array]:
        """Divide an array of pixel indices into batches that take little memory to render."""
        size = max(100, _INTERSECTIONS_PER_BATCH // max(1, self.surface_count))
        return (pixel_index[start : start + size] for start in range(0, len(pixel_index), size))

    def evaluate(
        self, formula_maps: Sequence[Formulas], pixel_index: Array,
        submitted_codes: Array | None = None, fitting_cache: FormulaCache | None = None,
        name: str = "codes",
    ) -> Array:  # fmt: skip
        """Evaluate a formula at some pixels of several pictures, which contain different mistakes.

        Parameters
        ----------
        formula_maps : sequence of dict of str to callable
            For each picture, the formulas, by name, that replace those of the reference picture.
        pixel_index : (k,) int array
            Indices of the pixels.
        submitted_codes : (3, n) uint8 array, optional
            8-bit codes of all n pixels of the submitted picture; by default, black.
        fitting_cache : FormulaCache, optional
            The cache whose pixels are used to fit parameters such as gamma.  By default, the
            parameters are fitted separately for each batch of pixels.
        name : str
            Name of the formula to evaluate; by default, the 8-bit codes.

        Returns
        -------
        values : (pictures, ..., k) array
            The values of the formula; for the codes, (pictures, 3, k).
        """
        submitted_codes = self._blank_codes if submitted_codes is None else submitted_codes
        caches = (self.make_cache(batch, submitted_codes, fitting_cache)
                  for batch in self.split_pixels(pixel_index))  # fmt: skip
        values = [[cache.get_value(name, formulas) for formulas in formula_maps]
                  for cache in caches]  # fmt: skip
        return np.concatenate(values, axis=-1)

    @cached_property
    def cause_groups(self) -> dict[Cause, list[Cause]]:
        """Causes grouped by the picture that they give; the key of a group is its first cause.

        A cause is one mistake, alone or with a variant.  A variant is another correct way to write
        a tracer; it changes how some mistakes look.

        Mistakes that depend on numbers estimated from a submitted picture are omitted.  So are
        mistakes that concern a single surface or light, if the scene has many surfaces.
        """
        variants = ((), *((keyword,) for keyword in mistakes.VARIANTS if keyword in self.mistakes))
        has_many_surfaces = self.surface_count > _MAX_PAIRED_SURFACES
        causes = [
            cause for keyword, mistake in self.mistakes.items() for variant in variants
            if keyword not in mistakes.VARIANTS and not self.needs_fitting(keyword)
            and not (has_many_surfaces and mistake.concerns_one_object)
            and self.get_formulas(cause := (keyword, *variant))
        ]  # fmt: skip
        causes.sort(key=len)  # so that a group begins with a cause without a variant, if possible
        pixel_index = self.sample_index[:_GROUPING_PIXELS]
        pictures = self.evaluate([self.get_formulas(cause) for cause in causes], pixel_index)
        # Keep these mistakes: they may show only with another one that raises the radiance above 1.
        groups: dict[bytes, list[Cause]] = {
            keyword.encode(): [(keyword,)]
            for keyword in mistakes.OVEREXPOSURE_ONLY if keyword in self.mistakes
        }  # fmt: skip
        for cause, picture in zip(causes, pictures, strict=True):
            group = groups.setdefault(picture.tobytes(), [])
            if cause[:1] not in group:
                group.append(cause)
        groups.pop(self.reference_codes[:, pixel_index].tobytes(), None)
        return {group[0]: group for group in groups.values()}

    @cached_property
    def single_causes(self) -> list[Cause]:
        """All causes of one mistake, some with a variant: another correct way to write a tracer."""
        singles: list[Cause] = [(key,) for key in self.mistakes if key not in mistakes.VARIANTS]
        return singles + [cause for cause in chain(*self.cause_groups.values()) if cause[1:]]

    @cached_property
    def rendered_pairs(self) -> tuple[dict[Cause, tuple[Cause, Cause]], Array, Array]:
        """The pairs of mistakes to try, rendered at k pixels.

        Item 0 maps each pair, which is a cause of two mistakes, to the two causes that it joins.
        Item 1 contains the rendered 8-bit codes (pairs, 3, k), and item 2 the pixel indices (k,).
        """
        pixel_index = self.sample_index[: self.first_round_size]
        # Several samples per pixel would take too long, and rounding is determined at the end.
        skipped_keys = {key for key in self.mistakes if "samples" in self.mistakes[key].formulas}
        skipped_keys |= {*mistakes.ROUNDINGS}
        causes = [cause for cause in self.cause_groups if skipped_keys.isdisjoint(cause)]
        pairs = {pair: (cause_a, cause_b) for cause_a, cause_b in combinations(causes, 2)
                 if (pair := self.join_causes(cause_a, cause_b))}  # fmt: skip
        formula_maps = [self.get_formulas(pair) for pair in pairs]
        no_codes = np.zeros((0, 3, len(pixel_index)), dtype=np.uint8)
        return pairs, self.evaluate(formula_maps, pixel_index) if pairs else no_codes, pixel_index

    def join_causes(self, cause_a: Cause, cause_b: Cause) -> Cause:
        """Join two causes into one.

        Parameters
        ----------
        cause_a, cause_b : tuple of str
            Keywords of mistakes that are made together, perhaps followed by the keyword of a
            variant (another correct way to write a tracer).

        Returns
        -------
        tuple of str
            The keywords of both causes, with the variant last.  Empty if the mistakes exclude each
            other, or if both causes contain a variant.
        """
        variants = [keyword for keyword in (*cause_a, *cause_b) if keyword in mistakes.VARIANTS]
        cause = (*remove_variants((*cause_a, *cause_b)), *variants)
        return cause if len(variants) < 2 and self.get_formulas(cause) else ()


class Submission:
    """A picture that a student submitted, and the search for its mistakes.

    A *cause* is a tuple of keywords of mistakes that are made together.  A *wrong* pixel differs
    from the reference picture.  A cause leaves a pixel *unexplained* if the submitted picture
    differs there from the picture that is rendered with the cause.

    Parameters
    ----------
    codes : (3, n) uint8 array
        8-bit codes of the n pixels of the submitted picture.
    renderer : MistakeRenderer
        Renders the scene with mistakes, at the size of the submitted picture.
    format_noise : int
        Number of levels by which the file format of the submitted picture, or of the reference
        picture, may have changed codes.
    reencode : callable, optional
        Takes the codes (h, w, 3) of a picture, and returns them as this file format alters them.

    Attributes
    ----------
    tolerance : int
        Differences of at most this many levels are ignored.
    is_wrong : (n,) bool array
        True for pixels that differ from the reference picture by more than the tolerance.
    wrong_count, clearly_wrong_count : int
        Number of wrong pixels, and of pixels that differ by more than one level.
    fitting_cache : FormulaCache
        The cache whose pixels are used to fit parameters such as gamma: a sample of the
        picture, and the brightest pixel.
    """

    def __init__(
        self, codes: Array, renderer: MistakeRenderer, format_noise: int = 0,
        reencode: Callable[[Codes], Codes] | None = None,
    ) -> None:  # fmt: skip
        self.codes, self.renderer, self.format_noise = codes, renderer, format_noise
        self._reencode, reference_codes = reencode, renderer.reference_codes
        differences = compare_levels(self._apply_losses(reference_codes, renderer.width), codes)
        self.clearly_wrong_count = int((differences > 1).sum())
        # If at most two pixels differ by more than one level, differences of one level count, too.
        self.tolerance = format_noise or int(self.clearly_wrong_count > 2)
        self.is_wrong = differences > self.tolerance
        self.wrong_count, pixel_count = int(self.is_wrong.sum()), renderer.pixel_count
        order = shuffle_range(pixel_count)
        red, green, blue = codes[:, order[:MAX_PIXELS]].astype(np.uint32)
        counts = np.unique(red << 16 | green << 8 | blue, return_counts=True)[1]
        foreground_count = pixel_count * (1 - counts.max() / len(red))
        max_unexplained = int(_MAX_UNEXPLAINED_SHARE * min(self.wrong_count, foreground_count))
        self._max_unexplained = max(_MAX_UNEXPLAINED, max_unexplained)
        is_wrong = self.is_wrong[order]
        # Indices of wrong pixels, then of right ones, both in random order.
        self._shuffled_pixels = [order[mask][:MAX_PIXELS].copy() for mask in (is_wrong, ~is_wrong)]
        max_count = min(MAX_PIXELS, _MAX_INTERSECTIONS // max(1, renderer.surface_count))
        final = self._choose_blocks(max_count) if reencode else (*self._choose_pixels(max_count), 0)
        self._final_pixels, self._final_weights, self._final_width = final
        # For each measured cause, the numbers of unexplained and of inexact pixels.
        self._counts_by_cause = dict[Cause, list[int]]()
        fitting_pixels = np.append(renderer.sample_index, reference_codes.sum(0, np.int16).argmax())
        self.fitting_cache = renderer.make_cache(fitting_pixels, codes)

    def _choose_pixels(self, count: int) -> tuple[Array, Array]:
        """Choose random pixels: half of them wrong, half of them right, if there are enough.

        Wrong pixels differ from the reference picture.

        Parameters
        ----------
        count : int
            Number of pixels to choose; in a smaller picture, all pixels are chosen.

        Returns
        -------
        pixel_index : (k,) int array
            Indices of the chosen pixels, sorted.
        weights : (k,) float array
            Number of pixels of the picture that each chosen pixel represents.
        """
        wrong_pixels, right_pixels = self._shuffled_pixels
        chosen_wrong_pixels = wrong_pixels[: max(count // 2, count - len(right_pixels))]
        chosen_right_pixels = right_pixels[: count - len(chosen_wrong_pixels)]
        pixel_index = np.sort(np.concatenate([chosen_wrong_pixels, chosen_right_pixels]))
        wrong_weight = self.wrong_count / max(1, len(chosen_wrong_pixels))
        right_weight = (len(self.is_wrong) - self.wrong_count) / max(1, len(chosen_right_pixels))
        return pixel_index, np.where(self.is_wrong[pixel_index], wrong_weight, right_weight)

    def _choose_blocks(self, count: int) -> tuple[Array, Array, int]:
        """Choose random blocks of a JPEG picture: half of them with wrong pixels, half without.

        The chosen blocks form a mosaic, one below the other.  JPEG compresses blocks separately, so
        compression alters them as it does in the whole picture, except at their edges.

        Parameters
        ----------
        count : int
            Number of pixels to choose; raised to `MAX_PIXELS` / 8 if it is less.  If the picture
            has no more pixels, or is narrower or lower than a block, all pixels are chosen.

        Returns
        -------
        pixel_index : (k,) int array
            Indices of the pixels of the chosen blocks, in the order of the mosaic.
        weights : (k,) float array
            Number of pixels of the whole picture that each chosen pixel represents; 0 at the edges
            of blocks.
        width : int
            Width of a block; or of the whole picture, if all pixels are chosen.
        """
        pixel_count, width, side = self.renderer.pixel_count, self.renderer.width, JPEG_BLOCK
        every_pixel, count = np.arange(pixel_count, dtype=np.int32), max(count, MAX_PIXELS // 8)
        if pixel_count <= count or min(width, pixel_count // width) < side:
            return every_pixel, np.ones(pixel_count), width
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
        return blocks[block_index].ravel(), weights.ravel(), side

    def _apply_losses(self, codes: Codes, width: int) -> Codes:
        """Alter the codes of a picture as the file format of the submitted picture would.

        Parameters
        ----------
        codes : (3, n) uint8 array
            8-bit codes of the n pixels of the picture.
        width : int
            Width of the picture in pixels.

        Returns
        -------
        (3, n) uint8 array
            The altered codes; unchanged if the submission has no `reencode` function.
        """
        return to_columns(self._reencode(to_picture(codes, width))) if self._reencode else codes

    def _compare_levels(self, causes: Sequence[Cause], pixel_index: Array, width: int = 0) -> Array:
        """Render a picture with each cause, and compare it with the submitted picture.

        Parameters
        ----------
        causes : sequence of tuples of str
            At least one cause: the keywords of mistakes that are made together.
        pixel_index : (k,) int array
            Indices of the pixels to compare.
        width : int
            If given, the pixels form a picture of this width, and the rendered codes are altered
            by the file format of the submitted picture.  By default, they are not altered.

        Returns
        -------
        differences : (causes, k) array
            For each cause and pixel, the difference in levels, in the channel that differs most.
        """
        formula_maps = [self.renderer.get_formulas(cause) for cause in causes]
        pictures = self.renderer.evaluate(formula_maps, pixel_index, self.codes, self.fitting_cache)
        if width and self._reencode:
            pictures = np.array([self._apply_losses(codes, width) for codes in pictures])
        return compare_levels(pictures, self.codes[:, pixel_index])

    def _cache_counts(self, causes: Sequence[Cause]) -> None:
        """Compute the results of `_count_unexplained` and `_count_inexact`, and cache them.

        Parameters
        ----------
        causes : sequence of tuples of str
            For each cause, the keywords of mistakes that are made together.
        """
        cached_counts, limits = self._counts_by_cause, (self.tolerance, self.format_noise)
        if new_causes := [cause for cause in dict.fromkeys(causes) if cause not in cached_counts]:
            differences = self._compare_levels(new_causes, self._final_pixels, self._final_width)
            for cause, difference in zip(new_causes, differences, strict=True):
                counts = ((difference > limit) @ self._final_weights for limit in limits)
                cached_counts[cause] = [*map(round, counts)]

    def _count_unexplained(self, cause: Cause) -> int:
        """Count the pixels that a cause leaves unexplained.

        In these pixels, the submitted picture differs from the picture rendered with the cause by
        more than the tolerance.

        Parameters
        ----------
        cause : tuple of str
            Keywords of mistakes that are made together.

        Returns
        -------
        int
            Number of pixels; an estimate if the picture is large.
        """
        self._cache_counts([cause])
        return self._counts_by_cause[cause][0]

    def _count_inexact(self, cause: Cause) -> int:
        """Count the pixels of the submitted picture that a cause does not reproduce exactly.

        If its format is lossy, differences of at most `format_noise` levels are ignored.

        Parameters
        ----------
        cause : tuple of str
            Keywords of mistakes that are made together.

        Returns
        -------
        int
            Number of pixels; an estimate if the picture is large.
        """
        self._cache_counts([cause])
        return self._counts_by_cause[cause][1]

    def _rank_causes(self, causes: list[Cause]) -> list[Cause]:
        """Select the causes that leave the fewest pixels unexplained, and rank them.

        Successive halving compares all causes at a few pixels, then the best of them at more
        pixels, and so on.

        Parameters
        ----------
        causes : list of tuples of str
            For each cause, the keywords of mistakes that are made together.

        Returns
        -------
        list of tuples of str
            At most `_FINAL_CAUSE_COUNT` causes, the best first.  Empty if no cause explains a
            quarter of the wrong pixels.
        """
        pixel_count, max_causes = self.renderer.first_round_size, _MAX_CAUSE_COUNT
        while len(causes) > _FINAL_CAUSE_COUNT and pixel_count < len(self._final_pixels):
            causes = self._run_round(causes, pixel_count, max(_FINAL_CAUSE_COUNT, max_causes))
            pixel_count, max_causes = 4 * pixel_count, max_causes // 4
        self._cache_counts(causes[:_FINAL_CAUSE_COUNT])
        return sorted(causes[:_FINAL_CAUSE_COUNT], key=self._count_unexplained)

    def _run_round(self, causes: list[Cause], pixel_count: int, max_causes: int) -> list[Cause]:
        """Run one round of successive halving: compare causes at some pixels, and keep the best.

        Parameters
        ----------
        causes : list of tuples of str
            The causes to compare.
        pixel_count : int
            Number of pixels at which to compare the causes.
        max_causes : int
            Maximum number of causes to keep.

        Returns
        -------
        list of tuples of str
            The best causes, the best first.  Empty if every cause leaves more than
            `_HOPELESS_SHARE` of the wrong pixels unexplained.
        """
        pixel_index, weights = self._choose_pixels(pixel_count)
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

    def find_mistakes(self) -> Finding:
        """Search for the mistakes that explain the submitted picture.

        Pairs of mistakes are tried only if no single mistake explains the picture almost exactly.

        Returns
        -------
        Finding
            The causes that explain the picture.  If there are none, perhaps a hint: the cause that
            comes closest to explaining it.
        """
        single_causes = self._add_rounding(self._rank_causes(self.renderer.single_causes))
        pairs, causes = list[Cause](), self._select_good_causes(single_causes)
        single_count: float = self._count_unexplained(causes[0]) if causes else np.inf
        if single_count > _MAX_UNEXPLAINED:
            pairs = self._add_rounding(self._select_best_pairs())
            good_pairs = self._select_good_causes(list(filter(self._needs_both_mistakes, pairs)))
            if good_pairs and _LARGE_RATIO * self._count_unexplained(good_pairs[0]) <= single_count:
                causes = good_pairs
        # A pair is preferred only if it leaves less than half as many pixels unexplained.
        best_cause = min(causes[:1] or single_causes + pairs, default=(), key=lambda cause: (
            (1 + (cause in pairs)) * self._count_unexplained(cause)))  # fmt: skip
        if 2 * self._count_unexplained(best_cause) > self.wrong_count:
            return Finding((), self.wrong_count)
        unexplained_count = self._count_unexplained_in_full(best_cause)
        if causes and unexplained_count <= self._max_unexplained:
            return Finding(tuple(dict.fromkeys(map(remove_variants, causes))), unexplained_count)
        return Finding((), unexplained_count, remove_variants(best_cause))

    def _count_unexplained_in_full(self, cause: Cause) -> int:
        """Count the pixels of the complete picture that a cause leaves unexplained."""
        every_pixel = np.arange(self.renderer.pixel_count, dtype=np.int32)
        differences = self._compare_levels([cause], every_pixel, self.renderer.width)
        return int((differences > self.tolerance).sum())

    def _select_best_pairs(self) -> list[Cause]:
        """Select the pairs of mistakes that come closest to explaining the submitted picture.

        If several mistakes give the same picture, only one of them is tried in all pairs.  The best
        pairs are then tried again with each of the others in its place.

        Returns
        -------
        list of tuples of str
            At most `_FINAL_CAUSE_COUNT` causes, the best first.  Each contains the keywords of two
            mistakes.
        """
        renderer, background = self.renderer, mistakes.BACKGROUND
        groups = {background: [background]} | renderer.cause_groups
        all_pairs, codes, pixel_index = renderer.rendered_pairs
        is_unexplained = compare_levels(codes, self.codes[:, pixel_index]) > self.tolerance
        order, items = np.argsort(is_unexplained.sum(axis=1), kind="stable"), [*all_pairs.items()]
        causes_by_pair = dict(items[index] for index in order[:_MAX_CAUSE_COUNT])
        if self.codes[:, renderer.surface_index < 0].any():
            causes_by_pair |= {pair: (background, other) for other in groups
                              if (pair := renderer.join_causes(background, other))}  # fmt: skip
        best_pairs = self._rank_causes([*causes_by_pair])
        # The best pairs, and all pairs that give the same pictures; a dictionary has no duplicates.
        pairs = {pair: None for best_pair in best_pairs
                 for causes in product(*(groups[cause] for cause in causes_by_pair[best_pair]))
                 if (pair := renderer.join_causes(*causes))}  # fmt: skip
        return self._rank_causes([*pairs]) if len(pairs) > len(best_pairs) else best_pairs

    def _needs_both_mistakes(self, cause: Cause) -> bool:
        """Test whether two mistakes explain the submitted picture together, but neither does alone.

        Parameters
        ----------
        cause : tuple of str
            Keywords of two mistakes, perhaps followed by those of a rounding mistake and of a
            variant (another correct way to write a tracer).

        Returns
        -------
        bool
            True if each mistake alone leaves far more pixels unexplained than both together.
            False if a camera mistake leaves few surfaces in the picture, which may match by chance.
        """
        pair_unexplained = self._count_unexplained(cause)
        if pair_unexplained > self._max_unexplained:
            return False  # the pair will not be reported
        min_unexplained = pair_unexplained + max(_LARGE_RATIO * pair_unexplained, 1)
        for keyword in set(remove_variants(cause)).difference(mistakes.ROUNDINGS):
            remaining_cause = tuple(other for other in cause if other != keyword)
            if self._count_unexplained(remaining_cause) < min_unexplained:
                return False
        renderer, formulas = self.renderer, self.renderer.get_formulas(cause)
        if not renderer.surface_count or mistakes.CAMERA_FORMULAS.isdisjoint(formulas):
            return True
        shown_index = renderer.evaluate([formulas], renderer.sample_index, name="shown_surface")[0]
        shown_count, reference_count = (len(np.unique(index[index >= 0])) for index in (
            shown_index, renderer.surface_index[renderer.sample_index]))  # fmt: skip
        return shown_count >= min(_MIN_SHOWN_SURFACES, reference_count)

    def _select_good_causes(self, causes: list[Cause]) -> list[Cause]:
        """Select the causes that are good enough to report.

        A cause is good enough if it leaves few pixels unexplained and no other cause is far better.
        Causes that depend on a number estimated from the submitted picture, such as a gamma, are
        selected only if no other causes are good enough.

        Parameters
        ----------
        causes : list of tuples of str
            For each cause, the keywords of mistakes that are made together.

        Returns
        -------
        list of tuples of str
            The selected causes, in the order of the table of mistakes.
        """
        max_unexplained = min(self._max_unexplained, self.wrong_count - 1)
        causes = [cause for cause in causes if self._count_unexplained(cause) <= max_unexplained]
        if not causes:
            return []
        unexplained_limit = _LARGE_RATIO * max(1, min(map(self._count_unexplained, causes)))
        causes = [cause for cause in causes if self._count_unexplained(cause) < unexplained_limit]
        max_inexact = _LARGE_RATIO * max(min(map(self._count_inexact, causes)), _MAX_UNEXPLAINED)
        causes = [cause for cause in causes if self._count_inexact(cause) <= max_inexact]
        keywords, needs_fitting = [*self.renderer.mistakes], self.renderer.needs_fitting
        causes = [cause for cause in causes if not any(map(needs_fitting, cause))] or causes
        return sorted(causes, key=lambda cause: [keywords.index(keyword) for keyword in cause])

    def _add_rounding(self, causes: list[Cause]) -> list[Cause]:
        """Add a rounding mistake to each cause that then reproduces far more pixels exactly.

        A rounding mistake, such as truncation, changes 8-bit codes by at most 1.

        Parameters
        ----------
        causes : list of tuples of str
            For each cause, the keywords of mistakes that are made together.

        Returns
        -------
        list of tuples of str
            The causes in the same order, each unchanged or with the keyword of a rounding mistake.
        """
        # Without a tolerance, rounding is found like other mistakes; lossy compression hides it.
        if not self.tolerance or self.format_noise:
            return causes
        join, roundings = self.renderer.join_causes, mistakes.ROUNDINGS
        candidates = [[cause, *filter(None, (join(cause, (rounding,)) for rounding in roundings))]
                      for cause in causes]  # fmt: skip
        self._cache_counts([*chain(*candidates)])
        chosen_causes = list[Cause]()
        for cause, cause_candidates in zip(causes, candidates, strict=True):
            best_cause = min(cause_candidates, key=self._count_inexact)
            max_inexact = _LARGE_RATIO * max(self._count_inexact(best_cause), _MAX_UNEXPLAINED)
            chosen_causes.append(best_cause if max_inexact < self._count_inexact(cause) else cause)
        return chosen_causes


def remove_variants(cause: Cause) -> Cause:
    """Remove the keywords of variants from a cause.

    Parameters
    ----------
    cause : tuple of str
        Keywords of mistakes that are made together, and of variants.  A variant is another correct
        way to write a tracer; it changes how some mistakes look.

    Returns
    -------
    tuple of str
        The keywords of the mistakes.
    """
    return tuple(keyword for keyword in cause if keyword not in mistakes.VARIANTS)
