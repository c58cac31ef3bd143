"""Render a scene with simulated mistakes, at few or all pixels.

A picture is defined by formulas (functions for values such as the radiance), and a mistake by the
formulas that it replaces (see `mistakes.md`).  A *cause* is a tuple of keywords of mistakes that
are made together.  It may end with the keyword of a *variant*: another correct way to write a
tracer, which changes how some mistakes look.

`MistakeRenderer` evaluates formulas at any pixels.  At a small sample of pixels, it also finds out
which causes are worth trying in a scene.  Causes that change nothing are left out, and causes that
give the same picture form a group, of which only the first is paired with those of other groups.

Pixels are numbered row by row.  Pictures are arrays of 8-bit codes with one column per pixel.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import chain, combinations
from typing import Annotated as Shaped
from typing import NamedTuple, TypeAlias

import numpy as np

from reference.handins.drawing import FormulaCache, join_formulas, make_formula_inputs
from reference.handins.formula_functions import Array
from reference.handins.formulas import Formulas, collect_parameters
from reference.handins.mistakes import ALWAYS_PAIRED, ROUNDINGS, VARIANTS, Mistake, list_mistakes
from reference.handins.sampling import Ints32, choose_from_strata
from reference.pictures import Codes
from tracer import Scene

# Number of pixels at which the pictures with different mistakes are compared with each other.
_GROUPING_PIXELS = 2400

# Number of pixels at which all pairs of mistakes are rendered.
_FIRST_PIXELS = 240

# Minimum of this number, which is smaller in scenes with many surfaces.
_MIN_FIRST_PIXELS = 40

# In scenes with more surfaces, mistakes that concern a single surface are not tried in pairs.
_MAX_PAIRED_SURFACES = 40

# Maximum number of pixels at which many causes are rendered.  A random subset represents a larger
# picture.
MAX_PIXELS = 131_072

# Maximum number of pixels, times the number of surfaces, at which many causes are rendered.
MAX_INTERSECTIONS = 2_000_000

# The sample that represents a picture has a pixel for this many of the intersections that
# `MAX_INTERSECTIONS` permits.
_INTERSECTIONS_PER_SAMPLE = 20

# Minimum number of pixels in the sample, if the picture has so many.
_MIN_SAMPLE_SIZE = 500

# The sample is chosen from a subset of at most this share of `MAX_PIXELS`.
_SAMPLE_SHARE = 1 / 32

# The sample represents light and shadow of at most this many lights.
_MAX_SAMPLED_LIGHTS = 4

# Number of intersections in one batch of pixels.  Their arrays stay in the CPU cache.
_INTERSECTIONS_PER_BATCH = 25_000

# Minimum number of pixels in a batch.  With fewer, the calls take longer than the arithmetic.
_MIN_BATCH_SIZE = 100

Cause: TypeAlias = tuple[str, ...]


class RenderedPairs(NamedTuple):
    """The pairs of mistakes to try, rendered at the same pixels."""

    # Maps each pair, which is a cause of two mistakes, to the two causes that it joins.
    causes_by_pair: dict[Cause, tuple[Cause, Cause]]
    codes: Shaped[Codes, "pairs 3 n"]
    pixel_index: Shaped[Ints32, "n"]


class MistakeRenderer:
    """Renders one scene, at one size, with simulated mistakes.

    Parameters
    ----------
    source
        The scene at this size; or, if there is no scene, the reference picture.
    reference_codes
        The codes of the reference picture.
    surface_index
        The surface that each pixel shows; -1 for the background.
    width
        The width of the picture in pixels.
    base_formulas
        Formulas, by name, that replace the usual ones in all pictures.
    """

    reference_codes: Shaped[Codes, "3 n"]
    surface_index: Shaped[Array, "n"]
    width: int
    pixel_count: int
    surface_count: int
    # The mistakes that can be rendered, by keyword, in the order of the table of mistakes.
    mistakes: dict[str, Mistake]
    # Number of pixels at which all causes are rendered; smaller in scenes with many surfaces.
    first_round_size: int

    def __init__(
        self,
        source: Scene | Shaped[Codes, "h w 3"],
        reference_codes: Shaped[Codes, "3 n"],
        surface_index: Shaped[Array, "n"],
        width: int,
        base_formulas: Formulas,
    ) -> None:
        self.reference_codes = reference_codes
        self.surface_index = surface_index
        self.width = width
        self.base_formulas = base_formulas
        self.pixel_count = reference_codes.shape[1]
        self._blank_codes = np.broadcast_to(np.uint8(0), reference_codes.shape)
        height = self.pixel_count // width
        self._inputs = make_formula_inputs(source) | {"width": width, "height": height}
        self._has_scene = isinstance(source, Scene)
        scene = source if isinstance(source, Scene) else Scene(width=width, height=height)
        self.surface_count = len(scene.surfaces)
        pixel_share = min(1.0, _MAX_PAIRED_SURFACES / max(1, self.surface_count))
        self.first_round_size = max(_MIN_FIRST_PIXELS, int(pixel_share * _FIRST_PIXELS))
        self.mistakes = self._select_possible_mistakes(list_mistakes(scene))

    def _select_possible_mistakes(self, candidates: dict[str, Mistake]) -> dict[str, Mistake]:
        """Select the mistakes, by keyword, that can be rendered from the source.

        A mistake cannot be rendered if it replaces a formula of `base_formulas`.
        """
        first_pixel = self.make_cache(np.array([0]), self._blank_codes)
        possible_mistakes = {}
        for keyword, mistake in candidates.items():
            formulas = join_formulas([self.base_formulas, mistake.formulas])
            if formulas and first_pixel.can_compute_codes(formulas):
                possible_mistakes[keyword] = mistake
        return possible_mistakes

    @cached_property
    def sample_index(self) -> Shaped[Ints32, "m"]:
        """Pixels in random order.  The first of them show all surfaces, lit and in shadow."""
        subset_index = choose_from_strata(self.surface_index, int(_SAMPLE_SHARE * MAX_PIXELS))
        strata = self.surface_index[subset_index]
        if self._has_scene:
            is_lit = self.evaluate([self.base_formulas], subset_index, name="lit")[0]
            for is_lit_by_light in is_lit[:_MAX_SAMPLED_LIGHTS]:
                strata = 2 * strata + is_lit_by_light
        intersections = _INTERSECTIONS_PER_SAMPLE * max(1, self.surface_count)
        sample_size = max(_MIN_SAMPLE_SIZE, MAX_INTERSECTIONS // intersections)
        return subset_index[choose_from_strata(strata, sample_size)]

    @cached_property
    def variants(self) -> list[str]:
        """The variants that give the right picture of this scene."""
        return [keyword for keyword in VARIANTS if self._is_right((keyword,))]

    def _is_right(self, cause: Cause) -> bool:
        """Test whether a cause can be rendered, and gives the right picture."""
        if not self.mistakes.keys() >= {*cause}:
            return False
        pixel_index = self.sample_index[:_GROUPING_PIXELS]
        codes = self.evaluate([self.get_formulas(cause)], pixel_index)[0]
        return bool((codes == self.reference_codes[:, pixel_index]).all())

    def get_formulas(self, cause: Cause) -> Formulas:
        """Collect the formulas that simulate a cause.

        The result is empty if its mistakes exclude each other (see `join_formulas`).
        """
        return join_formulas([self.base_formulas, *(self.mistakes[key].formulas for key in cause)])

    def needs_fitting(self, keyword: str) -> bool:
        """Test whether a mistake has a number estimated from the submission, as `fitted_gamma`."""
        names = collect_parameters(self.mistakes[keyword].formulas)
        return any(name.startswith("fitted_") for name in names)

    def make_cache(
        self,
        pixel_index: Shaped[Array, "k"],
        submitted_codes: Shaped[Codes, "3 n"],
        fitting_cache: FormulaCache | None = None,
    ) -> FormulaCache:
        """Create a cache of the values of formulas at the given pixels.

        Some formulas of mistakes have a number that is estimated from the submitted picture, such
        as `fitted_gamma`.  It is estimated at the pixels of `fitting_cache`, or at those of the new
        cache if that is None.
        """
        row, column = np.divmod(pixel_index, self.width)
        pixel_inputs = {"i": column, "j": row, "submitted_codes": submitted_codes[:, pixel_index]}
        return FormulaCache(self._inputs | pixel_inputs, fitting_cache)

    def split_pixels(self, pixel_index: Shaped[Array, "k"]) -> Iterator[Shaped[Array, "batch"]]:
        """Yield the pixels in batches that take little memory to render."""
        size = max(_MIN_BATCH_SIZE, _INTERSECTIONS_PER_BATCH // max(1, self.surface_count))
        return (pixel_index[start : start + size] for start in range(0, len(pixel_index), size))

    def evaluate(
        self,
        formula_maps: Sequence[Formulas],
        pixel_index: Shaped[Array, "k"],
        submitted_codes: Shaped[Codes, "3 n"] | None = None,
        fitting_cache: FormulaCache | None = None,
        name: str = "codes",
    ) -> Shaped[Array, "pictures ... k"]:
        """Evaluate a formula at some pixels of several pictures, which contain different mistakes.

        Parameters
        ----------
        formula_maps
            For each picture, the formulas, by name, that replace those of the reference picture.
        submitted_codes
            The submitted picture; by default, black.
        fitting_cache
            As in `make_cache`.  By default, numbers are estimated separately in each batch.
        """
        submitted_codes = self._blank_codes if submitted_codes is None else submitted_codes
        caches = (
            self.make_cache(batch, submitted_codes, fitting_cache)
            for batch in self.split_pixels(pixel_index)
        )
        values = [
            [cache.get_value(name, formulas) for formulas in formula_maps] for cache in caches
        ]
        return np.concatenate(values, axis=-1)

    def evaluate_everywhere(self, name: str) -> Shaped[Array, "... n"]:
        """Evaluate a formula of the reference picture at all pixels."""
        every_pixel = np.arange(self.pixel_count)
        values: Array = self.evaluate([self.base_formulas], every_pixel, name=name)[0]
        return values

    @cached_property
    def cause_groups(self) -> dict[Cause, list[Cause]]:
        """Causes of one mistake, in groups that give the same picture at the sampled pixels.

        The key of a group is its first cause, which has no variant if possible.  Three kinds of
        mistakes are in no group: those that change nothing, those with estimated numbers and, if
        the scene has many surfaces, those that concern a single surface or light.  The mistakes of
        `ALWAYS_PAIRED` have groups of their own.
        """
        has_many_surfaces = self.surface_count > _MAX_PAIRED_SURFACES
        keywords = [
            keyword
            for keyword, mistake in self.mistakes.items()
            if keyword not in VARIANTS
            and not self.needs_fitting(keyword)
            and not (has_many_surfaces and mistake.concerns_one_object)
        ]
        causes = [
            *((keyword,) for keyword in keywords),
            *chain(*(self.add_variants((keyword,)) for keyword in keywords)),
        ]
        pixel_index = self.sample_index[:_GROUPING_PIXELS]
        pictures = self.evaluate([self.get_formulas(cause) for cause in causes], pixel_index)
        # The keys are pictures, except those of mistakes that are always paired.
        groups: dict[bytes, list[Cause]] = {
            keyword.encode(): [(keyword,)] for keyword in ALWAYS_PAIRED if keyword in self.mistakes
        }
        for cause, picture in zip(causes, pictures, strict=True):
            group = groups.setdefault(picture.tobytes(), [])
            if cause[:1] not in group:
                group.append(cause)
        groups.pop(self.reference_codes[:, pixel_index].tobytes(), None)
        return {group[0]: group for group in groups.values()}

    @cached_property
    def single_causes(self) -> list[Cause]:
        """All causes of one mistake, some with a variant."""
        singles: list[Cause] = [(key,) for key in self.mistakes if key not in VARIANTS]
        return singles + [cause for cause in chain(*self.cause_groups.values()) if cause[1:]]

    @cached_property
    def rendered_pairs(self) -> RenderedPairs:
        """The pairs of causes from two groups, rendered at the first pixels of the sample.

        Pairs that exclude each other are left out.  So are antialiasing and rounding.
        """
        pixel_index = self.sample_index[: self.first_round_size]
        # Several samples per pixel would take too long, and `search` adds rounding at the end.
        skipped_keys = {key for key in self.mistakes if "samples" in self.mistakes[key].formulas}
        skipped_keys |= {*ROUNDINGS}
        causes = [cause for cause in self.cause_groups if skipped_keys.isdisjoint(cause)]
        causes_by_pair = {
            pair: (cause_a, cause_b)
            for cause_a, cause_b in combinations(causes, 2)
            if (pair := self.join_causes(cause_a, cause_b))
        }
        formula_maps = [self.get_formulas(pair) for pair in causes_by_pair]
        no_codes = np.zeros((0, 3, len(pixel_index)), dtype=np.uint8)
        codes = self.evaluate(formula_maps, pixel_index) if causes_by_pair else no_codes
        return RenderedPairs(causes_by_pair=causes_by_pair, codes=codes, pixel_index=pixel_index)

    @cached_property
    def _place_by_keyword(self) -> dict[str, int]:
        """Maps the keyword of each mistake to its place in the table, where variants come last."""
        return {keyword: place for place, keyword in enumerate(self.mistakes)}

    def join_causes(self, cause_a: Cause, cause_b: Cause) -> Cause:
        """Join two causes into one, whose keywords are in the order of the table of mistakes.

        The result is empty if the mistakes exclude each other, or if both causes contain a variant.
        """
        cause = tuple(sorted((*cause_a, *cause_b), key=self._place_by_keyword.__getitem__))
        variant_count = len(cause) - len(remove_variants(cause))
        return cause if variant_count < 2 and self.get_formulas(cause) else ()

    def add_variants(self, cause: Cause) -> Iterator[Cause]:
        """Yield copies of a cause, each with one of `variants`, unless they exclude each other."""
        joined_causes = (self.join_causes(cause, (variant,)) for variant in self.variants)
        return filter(None, joined_causes)


def remove_variants(cause: Iterable[str]) -> Cause:
    """Remove the keywords of variants from a cause."""
    return tuple(keyword for keyword in cause if keyword not in VARIANTS)
