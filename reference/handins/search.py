"""Find the mistakes that draw a hand-in: single ones first, then all pairs.

A mistake is named only if the hand-in *is* the picture drawn with it; what draws the same picture
is named along with it.  Where all pixels are computed by themselves, few of them rule out most.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from reference.handins import mistakes
from reference.handins.drawing import PER_PIXEL, Drawing, given, join
from reference.handins.formulas import Array, Formulas, parameters
from reference.pictures import Codes
from tracer import Scene

# A picture drawn may differ in so many pixels: of all, of those in which the right one differs, and
# of those in which the hand-in does not have its commonest colour.
_OF_ALL, _OF_WRONG, _OF_SHOWN = 0.005, 0.2, 0.05
# What is named differs in so many times fewer pixels than what is not.
_APART = 5
# If a single mistake leaves more pixels wrong, pairs are tried.
_ENOUGH = 10
# So many pixels of a sample count as chance.
_ODD = 3
# Pixels of a scene on which single mistakes and pairs are drawn for all hand-ins; how many pairs
# are drawn on as many pixels of the hand-in, on more of them, and whole.
_SINGLES, _PAIRS = 2400, 240
_SOME, _FEW, _FINAL = 400, 60, 16
# Of more surfaces, single ones are left out of pairs; of more lights, none is missed at pixels.
_MANY_SURFACES, _MANY_LIGHTS = 40, 4
# Rounding decides so many pixels at most, each within so many pixels from its centre, or where
# shadow rays start so far above or below a surface, in parts of its distance from the origin.
_TIES, _HAIR, _LIFTS = 0.001, 0.05, (-1e-3, 0, 1e-3)
# Dots: neighbours differ so often, as a part of how often they would by chance.
_DOTS = 0.3
# Levels: where a format changes them, those further apart count as these.
_FAR = 32
# Numbers that are kept of some pixels, if every value had one for each surface; bytes of whole
# pictures that are kept for other hand-ins.
_VALUES, _KEPT = 60_000_000, 100_000_000

Cause: TypeAlias = tuple[str, ...]


def difference(a: Array, b: Array) -> Array:
    """The largest of three channels' differences (..., n) between codes (..., 3, n)."""
    return (np.maximum(a, b) - np.minimum(a, b)).max(axis=-2)


class Finding(NamedTuple):
    """Sets of mistakes, each of which draws the hand-in; none if nothing does.

    `left` pixels differ from the picture drawn.
    """

    causes: tuple[Cause, ...]
    left: int


class Sample(NamedTuple):
    """Some pixels of a picture, and how many each stands for."""

    pixels: Array
    weights: Array

    @classmethod
    def of(cls, strata: Array, size: int) -> Sample:
        """Choose as many pixels from each stratum (n,), in a fixed random order."""
        order = np.random.default_rng(1).permutation(len(strata))
        order = order[np.argsort(strata[order], kind="stable")]
        _, first, count = np.unique(strata[order], return_index=True, return_counts=True)
        rank = np.arange(len(order)) - np.repeat(first, count)
        chosen = np.argsort(rank, kind="stable")[:size]
        taken = np.bincount(np.repeat(np.arange(len(first)), count)[chosen], minlength=len(first))
        weights = np.repeat(count / np.maximum(taken, 1), count)[chosen]
        return cls(order[chosen], weights)


class Drawings:
    """A scene, or a right picture alone, drawn with mistakes; all have the formulas of `base`.

    `columns` are the picture's, which are the scene's unless it is turned.  What does not depend on
    a hand-in is drawn once for all of them.
    """

    def __init__(
        self, scene: Scene | Codes, height: int, width: int, columns: int, base: Formulas
    ) -> None:
        self.given = given(scene) | {"width": width, "height": height}
        self.base, self.columns, self.number = base, columns, height * width
        self.blank = np.zeros((3, self.number), dtype=np.uint8)
        known = scene if isinstance(scene, Scene) else Scene(width=width, height=height)
        self.surfaces = len(known.surfaces)
        mistake = mistakes.mistakes_of(known)
        self.text = {kind: one.text for kind, one in mistake.items()}
        # With a picture alone, few mistakes can be drawn.
        pixel = self.drawing(np.array([0]), self.blank)
        self.table = {kind: one.formulas for kind, one in mistake.items()
                      if (both := join([base, one.formulas])) and pixel.able(both)}  # fmt: skip
        # Of many surfaces, each is drawn where a hand-in calls for it.
        self.alone = {kind: one.surface for kind, one in mistake.items()
                      if one.surface is not None and self.surfaces > _MANY_SURFACES}  # fmt: skip
        self._whole: dict[Cause, Array] = {}
        self.right = self.whole([()], self.blank)[()]
        seen = self.values(("surface", "hit", "lit", "image"), [base], self.blank)[0]
        self.surface = np.where(seen["hit"], seen.get("surface", 0), -1)
        self.lit = seen.get("lit", np.zeros((0, self.number), dtype=np.bool_))
        self.brightest = seen["image"].argmax(axis=1)
        strata = self.surface
        for lit in self.lit[:_MANY_LIGHTS]:
            strata = 2 * strata + lit
        self.samples = [Sample.of(strata, size) for size in (_PAIRS, _SINGLES)]

    def changes(self, cause: Cause) -> Formulas | None:
        """The formulas of a set of mistakes; None if they exclude each other."""
        return join([self.base, *(self.table[kind] for kind in cause)])

    def fitted(self, cause: Cause) -> bool:
        """Whether the picture depends on the hand-in."""
        return any("handin" in parameters(f) for kind in cause for f in self.table[kind].values())

    def drawing(self, pixels: Array, handin: Array, capacity: int = 0) -> Drawing:
        """Some pixels, to be drawn; so many values are kept, or as many as memory bears."""
        capacity = capacity or _VALUES // (len(pixels) * (1 + self.surfaces))
        places = {"i": pixels % self.columns, "j": pixels // self.columns}
        return Drawing(self.given | places | {"handin": handin[:, pixels]}, capacity)

    def parts(self, handin: Array) -> Iterator[Drawing]:
        """All pixels in parts that fit into a processor's cache."""
        step = max(2000, 400_000 // max(1, self.surfaces))
        for start in range(0, self.number, step):
            yield self.drawing(np.arange(start, min(start + step, self.number)), handin, 100)

    @cached_property
    def parts_of_scene(self) -> list[Drawing]:
        """The same, to be used again, for what does not depend on a hand-in."""
        return [*self.parts(self.blank)]

    def values(self, names: Sequence[str], changes: Sequence[Formulas], handin: Array) -> list[Any]:
        """Formulas' values for all pixels, in terms of a scene or of a right picture."""
        again = 0 < self.surfaces <= _MANY_SURFACES  # others would take too much memory
        parts = self.parts_of_scene if again else self.parts(handin)
        found: list[list[Any]] = [[] for _ in changes]
        for part in parts:
            for each, changed in zip(found, changes, strict=True):
                each.append(part.pixels(changed, names))
        return [{name: np.concatenate([values[name] for values in each], axis=-1)
                 for name in each[0]} for each in found]  # fmt: skip

    def whole(self, causes: Iterable[Cause], handin: Array) -> dict[Cause, Array]:
        """Whole pictures (3, n)."""
        causes = list(causes)
        found = {c: self._whole[c] for c in causes if c in self._whole}
        todo = {c: changes for c in causes if c not in found and (changes := self.changes(c))
                is not None}  # fmt: skip
        pixels = self.values(PER_PIXEL, [*todo.values()], handin) if todo else []
        for (c, changes), values in zip(todo.items(), pixels, strict=True):
            found[c] = Drawing({"handin": handin} | values).get("codes", changes)
            if not self.fitted(c):
                self._whole[c] = found[c]
        while len(self._whole) * 3 * self.number > _KEPT:
            del self._whole[next(iter(self._whole))]
        return found

    def codes(self, causes: Iterable[Cause], sample: Sample, handin: Array) -> dict[Cause, Array]:
        """Draw some pixels, and the brightest for what depends on these."""
        drawing = self.drawing(np.append(sample.pixels, self.brightest), handin)
        found = {c: drawing.codes(self.changes(c) or {}) for c in causes}
        return {c: codes[:, : len(sample.pixels)] for c, codes in found.items()}

    @cached_property
    def singles(self) -> dict[Cause, Array]:
        """The scene's sample drawn with each mistake; shadow rays spare the surface or not."""
        kinds = [kind for kind in self.table if kind not in self.alone and not self.fitted((kind,))]
        ways = ((kind, *own) for kind in kinds for own in ((), (mistakes.OWN_SURFACE,)))
        possible = [c for c in ways if c[-1] in self.table and self.changes(c) is not None]
        drawn = self.codes(possible, self.samples[1], self.blank)
        return {c: drawn[c] for c in sorted(drawn, key=len)}

    @cached_property
    def alike(self) -> dict[Cause, list[Cause]]:
        """Of mistakes that show, the first of all that draw the same, and these."""
        found: dict[bytes, list[Cause]] = {}
        for cause, codes in self.singles.items():
            found.setdefault(codes.tobytes(), []).append(cause)
        found.pop(self.right[:, self.samples[1].pixels].tobytes(), None)
        # With another mistake, some show that do not show alone.
        hidden: dict[Cause, list[Cause]] = {
            (kind,): [(kind,)] for kind in mistakes.OVEREXPOSED if kind in self.table
        }
        return hidden | {causes[0]: causes for causes in found.values()}

    @cached_property
    def pairs(self) -> tuple[dict[Cause, tuple[Cause, Cause]], Array]:
        """All pairs of mistakes that show, and these drawn on a sample: (pairs, 3, n)."""
        sample = self.samples[0]
        drawing = self.drawing(np.append(sample.pixels, self.brightest), self.blank)
        heads = [c for c in self.alike if "samples" not in self.table[c[0]]]  # takes too long
        found: dict[Cause, tuple[Cause, Cause]] = {}
        drawn: list[Array] = []
        for k, a in enumerate(heads):
            new = {c: (a, b) for b in heads[k + 1 :] if (c := self.joined(a, b)) and c not in found}
            others = [self.changes(b) or {} for _, b in new.values()]
            drawn += drawing.pairs(self.changes(a) or {}, others)
            found |= new
        return found, np.array(drawn)[..., : len(sample.pixels)]

    def joined(self, a: Cause, b: Cause) -> Cause | None:
        """Both causes; None if they exclude each other."""
        kinds = tuple(kind for kind in (*a, *b) if kind != mistakes.OWN_SURFACE)
        cause = (*kinds, mistakes.OWN_SURFACE) if mistakes.OWN_SURFACE in (*a, *b) else kinds
        return None if self.changes(cause) is None else cause


class Search:
    """A hand-in's pixels (3, n), and what draws them.

    Its format, or that of the right picture, changes levels by `lossy`; `saved` does so to others.
    """

    def __init__(
        self,
        handin: Array,
        drawings: Drawings,
        lossy: int = 0,
        saved: Callable[[Array], Array] | None = None,
    ) -> None:
        self.handin, self.drawings, self.number = handin, drawings, drawings.number
        self.lossy, self.saved = lossy, saved or (lambda codes: codes)
        right = self.saved(drawings.right)
        self.near = lossy or 1
        if (difference(right, handin) > 1).sum() <= 2:  # rounding, if anything
            self.near = 0
        self.wrong = difference(right, handin) > self.near
        colours = handin.T.astype(np.int32) @ (65536, 256, 1)
        commonest = np.unique(colours, return_counts=True)[1].max()
        self.most = min(_OF_ALL * self.number, _OF_WRONG * self.wrong.sum(),
                        _OF_SHOWN * (self.number - int(commonest)))  # fmt: skip
        # Half of them wrong.
        self.samples = [Sample.of(self.wrong, size) for size in (_PAIRS, _SINGLES // 2)]

    def left(self, cause: Cause, tolerance: int) -> int:
        """Count the pixels that a cause leaves wrong."""
        drawn = self.saved(self.drawings.whole([cause], self.handin)[cause])
        return int((difference(drawn, self.handin) > tolerance).sum())

    def find(self) -> Finding:
        """Say what draws the hand-in, if anything does."""
        left, group = self.single()
        if not group or left > _ENOUGH:
            fewer, two = self.double()
            if two and (not group or _APART * fewer <= left):
                left, group = fewer, two
        if group:
            group = self.rounded(group)
        causes = dict.fromkeys(tuple(k for k in c if k != mistakes.OWN_SURFACE) for c in group)
        return Finding(tuple(causes), left)

    def single(self) -> tuple[int, list[Cause]]:
        """Draw each mistake alone."""
        d = self.drawings
        good = self.good([*d.singles], [*d.singles.values()], d.samples[1], _SOME)
        kinds = [kind for kind in d.table if d.fitted((kind,))] + self.of_suspects()
        return self.best(self.sifted([*good, *((kind,) for kind in kinds)], 1))

    def of_suspects(self) -> list[str]:
        """Mistakes of one surface of many: most of what is wrong is on it, or in its shadow."""
        d = self.drawings
        if not d.alone:
            return []
        sample = self.samples[0].pixels[self.wrong[self.samples[0].pixels]]
        on = d.surface[sample] == np.arange(d.surfaces)[:, None]
        blocked = d.drawing(sample, self.handin).get("blocking", d.base).any(axis=0)
        touched = (on | blocked).mean(axis=1) > 1 - _OF_WRONG
        return [kind for kind, surface in d.alone.items() if touched[surface]]

    def double(self) -> tuple[int, list[Cause]]:
        """Of mistakes that show, one for all that draw the same, all pairs."""
        pairs, drawn = self.drawings.pairs
        parts = dict(pairs)
        good = self.good([*parts], drawn, self.drawings.samples[0], _SOME)
        background = mistakes.BACKGROUND
        alike = {background: [background]} | self.drawings.alike
        join = self.drawings.joined
        if self.handin[:, self.drawings.surface < 0].any():
            shown = {both: (background, a) for a in alike if (both := join(background, a))}
            parts |= shown
            good += self.sifted([*shown], 0)
        least, group = self.best(self.sifted(self.sifted(good, 0), 1))
        all_of_them = {c: None for both in group for a in alike[parts[both][0]]
                for b in alike[parts[both][1]] if (c := join(a, b))}  # fmt: skip
        wide = [*all_of_them][: 4 * _FINAL]
        return self.best(wide) if len(wide) > len(group) else (least, group)

    def good(
        self, causes: list[Cause], drawn: Array | list[Array], sample: Sample, count: int
    ) -> list[Cause]:
        """Those that leave fewest pixels wrong in a sample."""
        if not causes:
            return []
        off = difference(np.asarray(drawn), self.handin[:, sample.pixels])
        if self.lossy:  # what a format does to a few pixels depends on others around them
            left, limit = np.minimum(off, _FAR) @ sample.weights, np.inf
        else:
            left = (off > self.near) @ sample.weights
            few = _ODD * sample.weights.max()
            limit = min(self.most, _APART * left.min()) + few
        order = np.argsort(left, kind="stable")
        return [causes[k] for k in order[left[order] <= limit][:count]]

    def sifted(self, causes: list[Cause], size: int) -> list[Cause]:
        """The best in a sample of the hand-in, half of it wrong."""
        count = (_FEW, _FINAL)[size]
        if len(causes) <= count // 8:
            return causes
        drawn = self.drawings.codes(causes, self.samples[size], self.handin)
        return self.good(causes, [*drawn.values()], self.samples[size], count)

    def best(self, causes: list[Cause]) -> tuple[int, list[Cause]]:
        """Draw them whole: how many pixels the best leaves wrong, and all that leave as few."""
        drawn = self.drawings.whole(causes, self.handin)
        right = self.drawings.right
        left = {c: self.left(c, self.near) for c in causes if (drawn[c] != right).any()}
        least = min(left.values(), default=self.number)
        if least > self.most:
            return least, []
        group = [c for c in left if left[c] < _APART * max(1, least)]
        # Of those, the ones that have the very levels, and no number from the hand-in.
        levels = {c: self.left(c, self.lossy) for c in group}
        exact = max(_APART * min(levels.values()), _OF_ALL * self.number)
        group = [c for c in group if levels[c] <= exact]
        group = [c for c in group if not self.drawings.fitted(c)] or group
        place = {name: k for k, name in enumerate(self.drawings.table)}
        return least, sorted(group, key=lambda c: [place[kind] for kind in c])

    def rounded(self, group: list[Cause]) -> list[Cause]:
        """The same with another way to round, if that gives the very levels."""
        before = self.left(group[0], 0)
        if self.near == 1 and before > _OF_ALL * self.number:
            for kind in mistakes.ROUNDINGS:
                cause = (*group[0], kind)
                if self.drawings.changes(cause) and _APART * self.left(cause, 0) <= before:
                    return [(*c, kind) for c in group]
        return group

    def near_ties(self) -> bool:
        """Whether few pixels are wrong, and each is drawn so a hair beside its centre."""
        pixels = np.flatnonzero(difference(self.drawings.right, self.handin) > 1)
        if len(pixels) > _TIES * self.number:
            return False
        drawing, base = self.drawings.drawing(pixels, self.handin), self.drawings.base
        hairs = [
            mistakes.offset(0.5 + x, 0.5 + y) for x, y in product((-_HAIR, 0, _HAIR), repeat=2)
        ]
        lifts = [mistakes.read(f"shadow_p = p + {by} * sqrt(dot(p, p)) * n") for by in _LIFTS]
        drawn = np.array([drawing.codes(base | a | b) for a in hairs for b in lifts]).astype(int)
        here = self.handin[:, pixels]
        return bool(((here >= drawn.min(axis=0) - 1) & (here <= drawn.max(axis=0) + 1)).all())

    @cached_property
    def lights(self) -> tuple[Array, Array, Array]:
        """Which lights (lights, n) the hand-in lacks, which it has too much; whether that is known.

        These are the fewest changes that give its levels.
        """
        d, lit = self.drawings, self.drawings.lit
        found, fewest = lit.copy(), np.full(self.number, np.inf)
        if len(lit) <= _MANY_LIGHTS:
            choices = [*product((False, True), repeat=len(lit))]
            some = [
                mistakes.read(f"lit = array({[*c]})[:, None] & (distance > 0)") for c in choices
            ]
            drawn = d.values(["codes"], [d.base | chosen for chosen in some], self.handin)
            for lights, one in zip(np.array(choices), drawn, strict=True):
                number = (lit != lights[:, None]).sum(axis=0)
                better = (difference(one["codes"], self.handin) <= 1) & (number < fewest)
                fewest[better] = number[better]
                found[:, better] = lights[:, None]
        return lit & ~found, found & ~lit, np.isfinite(fewest)

    def speckled(self) -> bool:
        """Whether surfaces shadow themselves, in dots that depend on rounding.

        Light is lost alone, and so that neighbours differ nearly as often as by chance.
        """
        lost, too_much, known = self.lights
        if (too_much.any(axis=0) | ~known).sum() > self.most or not lost.any():
            return False
        shape = len(lost), -1, self.drawings.columns
        lost, lit = lost.reshape(shape), self.drawings.lit.reshape(shape)
        share, differ, expected = lost.sum() / lit.sum(), 0, 0.0
        for axis in (1, 2):
            both = lit & np.roll(lit, 1, axis)
            differ += int((both & (lost != np.roll(lost, 1, axis))).sum())
            expected += 2 * share * (1 - share) * both.sum()
        return bool(lost.any(axis=0).mean() > _OF_ALL and differ > _DOTS * expected)
