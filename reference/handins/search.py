"""Find the mistakes with which a scene renders as a hand-in: first single ones, then all pairs.

The problem is that there are tens of thousands of pairs, and that a picture of each would take
hours.  Almost all pairs are refuted by a few pixels, so the search is successive halving (Jamieson
and Talwalkar 2016): all candidates are rendered at few pixels, the best of them at more pixels,
and only the last few in full.  A *cause* is a tuple of mistakes that are made together.

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
    """Return the maximum over the channels of the difference (..., n) of codes (..., 3, n)."""
    return (np.maximum(a, b) - np.minimum(a, b)).max(axis=-2)


class Finding(NamedTuple):
    """The result of a search.

    Attributes
    ----------
    causes : tuple of causes
        Those with which the scene renders as the hand-in; empty if there are none.  If there are
        several, this scene cannot tell them apart.
    remaining : int
        Number of pixels in which the hand-in differs from the picture with the first cause, or
        with the hint.
    hint : cause
        If no cause is known, the nearest one; empty if it explains less than half of the pixels.
    """

    causes: tuple[Cause, ...]
    remaining: int
    hint: Cause = ()


def stratified(strata: Array, size: int) -> Array:
    """Choose at most `size` indices of an array (n,) of strata, about equally many per stratum.

    The first indices of a larger choice are a smaller choice.
    """
    order = np.random.default_rng(1).permutation(len(strata))
    order = order[np.argsort(strata[order], kind="stable")]
    _, start, count = np.unique(strata[order], return_index=True, return_counts=True)
    rank = np.arange(len(order)) - np.repeat(start, count)
    return order[np.argsort(rank, kind="stable")[:size]]


class KnownPictures:
    """The pictures of one scene at one size: the right one, and those with mistakes.

    Parameters
    ----------
    scene : Scene or (h, w, 3) uint8 array
        The scene at this size, or a right picture alone.
    right : (3, n) uint8 array
        The right picture's codes.
    surface : (n,) int array
        The index of the surface that each pixel shows, or -1.
    columns : int
        Width of the picture in pixels.
    base : dict
        Formulas that all pictures share.
    """

    def __init__(
        self, scene: Scene | Codes, right: Array, surface: Array, columns: int, base: Formulas
    ) -> None:
        self.right, self.surface, self.columns, self.base = right, surface, columns, base
        self.count, self._blank = right.shape[1], np.zeros_like(right)
        size = {"width": columns, "height": self.count // columns}
        self._given = scene_values(scene) | size
        known = scene if isinstance(scene, Scene) else Scene(**size)
        self.surface_count = len(known.surfaces)
        table = mistakes.list_mistakes(known)
        self.text = {kind: mistake.text for kind, mistake in table.items()}
        one_pixel = self.formulas(np.array([0]), self._blank)
        self.table = {kind: mistake.formulas for kind, mistake in table.items()
                      if (both := join_formulas([base, mistake.formulas])) is not None
                      and one_pixel.is_computable(both)}  # fmt: skip
        self.kinds = [kind for kind in self.table if kind not in mistakes.VARIANTS]
        self.numbered = {kind for kind, mistake in table.items() if mistake.concerns_one_object}
        # The scene's pixels, mixed so that the first ones have all surfaces and shadows.
        subset = stratified(surface, max(MAX_PIXELS // 32, _MAX_CAUSES))
        strata = surface[subset]
        if isinstance(scene, Scene) and scene.lights:
            for lit in self.in_batches("lit", subset)[:4]:
                strata = 2 * strata + lit
        self.sample = subset[stratified(strata, len(subset))]

    def changes(self, cause: Cause) -> Formulas | None:
        """Return the formulas of a cause; None if its mistakes exclude each other."""
        return join_formulas([self.base, *(self.table[kind] for kind in cause)])

    def fitted_names(self, kind: str) -> Set[str]:
        """Return the formulas that a mistake uses, and that are computed from the hand-in."""
        used = {name for f in self.table[kind].values() for name in parameter_names(f)}
        return used & (mistakes.FITTED - {"brightest"})

    def formulas(
        self, pixels: Array, handin: Array, fit: FormulaCache | None = None
    ) -> FormulaCache:
        """Return the formulas for pixels (k,), given as indices; `handin` (3, n) is complete."""
        places = {"i": pixels % self.columns, "j": pixels // self.columns}
        return FormulaCache(self._given | places | {"handin": handin[:, pixels]}, fit)

    def batches(self, pixels: Array) -> Iterator[Array]:
        """Divide pixels (k,) into batches that take little memory."""
        step = max(500, _INTERSECTIONS_PER_BATCH // max(1, self.surface_count))
        return (pixels[start : start + step] for start in range(0, len(pixels), step))

    def in_batches(self, name: str, pixels: Array, changes: Formulas | None = None) -> Array:
        """Compute a formula for pixels (k,), by default that of the right picture."""
        values = [self.formulas(batch, self._blank).get(name, changes or self.base)
                  for batch in self.batches(pixels)]  # fmt: skip
        return np.concatenate(values, axis=-1)

    def fitted_formulas(self, handin: Array) -> FormulaCache:
        """Return the formulas for the pixels that decide on numbers fitted to a hand-in."""
        brightest = self.right.astype(np.int16).sum(axis=0).argmax()
        return self.formulas(np.append(next(self.batches(self.sample)), brightest), handin)

    def render(
        self, causes: Sequence[Cause], pixels: Array, handin: Array, fit: FormulaCache | None
    ) -> Array:
        """Render pixels (k,) with each cause: (causes, 3, k) codes.

        `fit` is the result of `fitted_formulas` for the hand-in (3, n).
        """
        codes = np.empty((len(causes), 3, len(pixels)), dtype=np.uint8)
        start = 0
        for batch in self.batches(pixels):
            formulas = self.formulas(batch, handin, fit)
            for one, cause in zip(codes, causes, strict=True):
                one[:, start : start + len(batch)] = formulas.codes(self.changes(cause) or {})
            start += len(batch)
        return codes

    @cached_property
    def alike(self) -> dict[Cause, list[Cause]]:
        """Mistakes that show, grouped by their pictures: the first of each group, and all of it.

        A mistake is also rendered in the variants of the right tracer, where these differ.
        """
        variants = ((), *((kind,) for kind in mistakes.VARIANTS if kind in self.table))
        skipped = self.numbered if self.surface_count > _MAX_PAIRED_SURFACES else set[str]()
        causes = [(kind, *variant) for kind in self.kinds for variant in variants
                  if kind not in skipped and not self.fitted_names(kind)]  # fmt: skip
        causes = [cause for cause in causes if self.changes(cause) is not None]
        pixels = next(self.batches(self.sample[:_GROUPING_PIXELS]))
        codes = dict(zip(causes, self.render(causes, pixels, self._blank, None), strict=True))
        groups: dict[bytes, list[Cause]] = {}
        for cause in sorted(causes, key=len):
            group = groups.setdefault(codes[cause].tobytes(), [])
            if cause[:1] not in group:
                group.append(cause)
        groups.pop(self.right[:, pixels].tobytes(), None)
        # Some mistakes show only where another mistake brings about light beyond 1.
        hidden: list[Cause] = [(kind,) for kind in mistakes.OVEREXPOSED if kind in self.table]
        return {c: [c] for c in hidden} | {group[0]: group for group in groups.values()}

    @cached_property
    def singles(self) -> list[Cause]:
        """All single mistakes."""
        members = (cause for group in self.alike.values() for cause in group)
        return [*((kind,) for kind in self.kinds), *(c for c in members if len(c) > 1)]

    @cached_property
    def pairs(self) -> tuple[list[tuple[Cause, Cause]], Array, Array]:
        """All pairs of mistakes that show: the pairs, and their codes (pairs, 3, k) at k pixels.

        Item 2 contains the indices (k,) of these pixels.
        """
        share = min(1.0, _MAX_PAIRED_SURFACES / max(1, self.surface_count))
        pixels = self.sample[: max(40, int(share * _FIRST_PIXELS))]
        formulas = self.formulas(pixels, self._blank)
        # Several samples per pixel would take too long, and rounding is determined in the end.
        slow = {kind for kind in self.table if "samples" in self.table[kind]}
        heads = [c for c in self.alike if slow.isdisjoint(c) and c[0] not in mistakes.ROUNDINGS]
        pairs, codes = list[tuple[Cause, Cause]](), list[Array]()
        for k, a in enumerate(heads):
            others = [b for b in heads[k + 1 :] if self.joined(a, b)]
            changes = [self.changes(b) or {} for b in others]
            codes += formulas.codes_of_pairs(self.changes(a) or {}, changes)
            pairs += [(a, b) for b in others]
        return pairs, np.array(codes).reshape(len(pairs), 3, len(pixels)), pixels

    def joined(self, a: Cause, b: Cause) -> Cause | None:
        """Return the cause of both; None if they exclude each other, or assume other variants."""
        variants = [kind for kind in mistakes.VARIANTS if kind in (*a, *b)]
        kinds = [kind for kind in (*a, *b) if kind not in mistakes.VARIANTS]
        cause = (*kinds, *variants)
        return cause if len(variants) < 2 and self.changes(cause) is not None else None


class Search:
    """The search for the causes of one hand-in.

    Parameters
    ----------
    handin : (3, n) uint8 array
    known : KnownPictures
    lossy : int
        Levels by which the file format of the hand-in, or of the right picture, changes codes.
    saved : callable, optional
        Changes codes (3, n) as that file format does.
    """

    def __init__(
        self, handin: Array, known: KnownPictures, lossy: int = 0,
        saved: Callable[[Array], Array] | None = None,
    ) -> None:  # fmt: skip
        self.handin, self.known, self.lossy = handin, known, lossy
        self.saved = saved or (lambda codes: codes)
        off = difference(self.saved(known.right), handin)
        # If at most two pixels differ by more than rounding, single levels count as wrong.
        self.tolerance = lossy or int((off > 1).sum() > 2)
        self.is_wrong, self.beyond = off > self.tolerance, int((off > 1).sum())
        self.wrong = int(self.is_wrong.sum())
        commonest = np.unique(handin.astype(np.int32).T @ (65536, 256, 1), return_counts=True)[1]
        shown = known.count - int(commonest.max())
        self.max_remaining = max(
            _MAX_REMAINING_PIXELS, int(_MAX_REMAINING * min(self.wrong, shown))
        )
        mixed = np.random.default_rng(1).permutation(known.count)
        self._halves = [mixed[self.is_wrong[mixed]], mixed[~self.is_wrong[mixed]]]
        size = min(MAX_PIXELS, _MAX_INTERSECTIONS // max(1, known.surface_count))
        self._last, self._weights = self._pixels(size)
        if lossy or known.count <= size:
            self._last, self._weights = np.arange(known.count), np.ones(known.count)
        self._remaining, self._inexact = dict[Cause, int](), dict[Cause, int]()
        self.fit = known.fitted_formulas(handin)

    def _pixels(self, size: int) -> tuple[Array, Array]:
        """Choose pixels, half of them wrong.

        Returns
        -------
        pixels : (k,) int array
            Indices.
        weights : (k,) float array
            The number of pixels of the picture that each one represents.
        """
        a, b = self._halves
        first = a[: max(size // 2, size - len(b))]
        second = b[: size - len(first)]
        weights = [len(half) / max(1, len(chosen)) for half, chosen in ((a, first), (b, second))]
        return np.append(first, second), np.repeat(weights, (len(first), len(second)))

    def off(self, causes: Sequence[Cause]) -> Array:
        """Return the differences (causes, k), in levels, at the k pixels of the last round."""
        rendered = self.known.render(causes, self._last, self.handin, self.fit)
        return np.array([difference(self.saved(codes), self.handin[:, self._last])
                         for codes in rendered]).reshape(len(causes), len(self._last))  # fmt: skip

    def remaining(self, cause: Cause) -> int:
        """Return the number of pixels that a cause leaves wrong; from a subset, an estimate."""
        if cause not in self._remaining:
            self._remaining[cause] = round((self.off([cause])[0] > self.tolerance) @ self._weights)
        return self._remaining[cause]

    def remaining_everywhere(self, cause: Cause) -> int:
        """Count the pixels of the complete picture that a cause leaves wrong."""
        if len(self._last) == self.known.count:
            return self.remaining(cause)
        count = 0
        for batch in self.known.batches(np.arange(self.known.count)):
            codes = self.known.render([cause], batch, self.handin, self.fit)[0]
            count += int((difference(codes, self.handin[:, batch]) > self.tolerance).sum())
        return count

    def halve(self, causes: list[Cause]) -> list[Cause]:
        """Return the best causes, the best first, by successive halving; none if all are bad."""
        size, count, least = _FIRST_PIXELS, _MAX_CAUSES, _MIN_CAUSES
        if self.lossy:
            least = max(1, min(least, least * MAX_PIXELS // self.known.count))
        while len(causes) > least and size < len(self._last):
            causes = self._round(causes, size, max(least, count))
            size, count = 4 * size, count // 4
        return sorted(self._rounded(causes[:_MIN_CAUSES]), key=self.remaining)

    def _round(self, causes: list[Cause], size: int, count: int) -> list[Cause]:
        """Return the best causes, at most `count`, by `size` pixels.

        Causes that leave the fewest pixels wrong are the best.  If all leave nearly all of the
        differing pixels wrong, none is returned.  Compression changes a pixel by its neighbours,
        so there the levels are added up.
        """
        pixels, weights = self._pixels(size)
        off = difference(self.known.render(causes, pixels, self.handin, self.fit),
                         self.handin[:, pixels])  # fmt: skip
        if self.lossy:
            order = np.argsort(np.minimum(off, _MAX_LEVELS) @ weights, kind="stable")
            return [causes[k] for k in order[:count]]
        off = off > self.tolerance
        if off[:, self.is_wrong[pixels]].mean(axis=1).min() > _MAX_WORST:
            return []
        error = off @ weights
        worst = 1.5 * error.min() + _CHANCE * weights.max()
        order = np.argsort(error, kind="stable")[:count]
        return [causes[k] for k in order if error[k] <= worst]

    def find(self) -> Finding:
        """Return the causes that render the hand-in, or else the nearest one."""
        singles = self.halve(self.known.singles)
        group = self._reported(singles)
        if not group or self.remaining(group[0]) > _MAX_REMAINING_PIXELS:
            pairs = self._pairs()
            better = self._reported([c for c in pairs if self.is_needed(c)])
            if better and (
                not group or _MIN_RATIO * self.remaining(better[0]) <= self.remaining(group[0])
            ):
                group = better
            elif not group:
                return self._nearest(singles, pairs)
        remaining = self.remaining_everywhere(group[0])
        if remaining > self.max_remaining:  # the subset gave fewer
            return self._nearest(group[:1], [])
        causes = dict.fromkeys(tuple(k for k in c if k not in mistakes.VARIANTS) for c in group)
        return Finding(tuple(causes), remaining)

    def _nearest(self, singles: list[Cause], pairs: list[Cause]) -> Finding:
        """Return the cause that explains most pixels as a hint; a pair only if it is far better."""
        if not (best := singles[:1] + pairs[:1]):
            return Finding((), self.wrong)
        hint = best[-1] if 2 * self.remaining(best[-1]) < self.remaining(best[0]) else best[0]
        if 2 * (unexplained := self.remaining_everywhere(hint)) > self.wrong:
            return Finding((), self.wrong)
        return Finding(
            (), unexplained, tuple(kind for kind in hint if kind not in mistakes.VARIANTS)
        )

    def _pairs(self) -> list[Cause]:
        """Return the best pairs of mistakes."""
        known = self.known
        pairs, codes, pixels = known.pairs
        off = difference(codes, self.handin[:, pixels]) > self.tolerance
        order = np.argsort(off.sum(axis=1), kind="stable")[:_MAX_CAUSES]
        parts = {c: pairs[k] for k in order if (c := known.joined(*pairs[k]))}
        background = mistakes.BACKGROUND
        if self.handin[:, known.surface < 0].any():
            parts |= {c: (background, a) for a in known.alike if (c := known.joined(background, a))}
        best = self.halve([*parts])
        alike = {background: [background]} | known.alike
        close = [c for c in parts if c in best or any((*c, k) in best for k in mistakes.ROUNDINGS)]
        members = {c: None for both in close for a in alike[parts[both][0]]
                   for b in alike[parts[both][1]] if (c := known.joined(a, b))}  # fmt: skip
        return self.halve([*members]) if len(members) > len(close) else best

    def is_needed(self, cause: Cause) -> bool:
        """Return whether each mistake of a pair takes away far more than the pair leaves.

        Mistakes of the camera by which fewer surfaces are seen than in the right picture count as
        needed only if three are seen: with fewer, the picture shows too little.
        """
        kept = (*mistakes.VARIANTS, *mistakes.ROUNDINGS)
        remaining, suffix = self.remaining(cause), [kind for kind in cause if kind in kept]
        kinds = [kind for kind in cause if kind not in kept]
        for others in combinations(kinds, len(kinds) - 1):
            if self.remaining((*others, *suffix)) - remaining < max(_MIN_RATIO * remaining, 1):
                return False
        camera = any(mistakes.CAMERA & self.known.table[kind].keys() for kind in kinds)
        if not camera or not self.known.surface_count:
            return True
        sample = next(self.known.batches(self.known.sample))
        formulas, changes = self.known.formulas(sample, self.handin), self.known.changes(cause)
        hit, surface = (formulas.get(name, changes or {}) for name in ("hit", "surface"))
        right = np.unique(self.known.surface[sample])
        return len(np.unique(surface[hit])) >= min(3, int((right >= 0).sum()))

    def _reported(self, causes: list[Cause]) -> list[Cause]:
        """Select the causes that may be reported, from the best ones, in the table's order."""
        causes = [c for c in causes if self.remaining(c) <= self.max_remaining and self.shows(c)]
        if not causes:
            return []
        least = min(map(self.remaining, causes))
        causes = [c for c in causes if self.remaining(c) < _MIN_RATIO * max(1, least)]
        exact = _MIN_RATIO * max(min(map(self._inexact.__getitem__, causes)), _MAX_REMAINING_PIXELS)
        causes = [c for c in causes if self._inexact[c] <= exact]
        causes = [c for c in causes if not any(map(self.known.fitted_names, c))] or causes
        place = {kind: k for k, kind in enumerate(self.known.table)}
        return sorted(causes, key=lambda c: [place[kind] for kind in c])

    def shows(self, cause: Cause) -> bool:
        """Return whether a cause takes away any of the differing pixels."""
        return self.remaining(cause) < self.wrong

    def _rounded(self, causes: list[Cause]) -> list[Cause]:
        """Render causes for the last time, and add the rounding to those that it makes exact."""
        kinds = [k for k in mistakes.ROUNDINGS if k in self.known.table and not self.lossy]
        variants = {c: [(*c, k) for k in kinds if self.tolerance and self.known.changes((*c, k))
                        is not None] for c in causes}  # fmt: skip
        every = [*dict.fromkeys(v for c in causes for v in (c, *variants[c]))]
        for cause, off in zip(every, self.off(every), strict=True):
            self._remaining[cause] = round((off > self.tolerance) @ self._weights)
            self._inexact[cause] = round((off > self.lossy) @ self._weights)
        rounded = [min([c, *variants[c]], key=self._inexact.__getitem__) for c in causes]
        limit = {r: _MIN_RATIO * max(self._inexact[r], _MAX_REMAINING_PIXELS) for r in rounded}
        return [r if limit[r] < self._inexact[c] else c
                for c, r in zip(causes, rounded, strict=True)]  # fmt: skip
