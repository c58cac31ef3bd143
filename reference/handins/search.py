"""Find the mistakes that draw a hand-in: single ones first, then all pairs.

A mistake is named only if the hand-in *is* the picture drawn with it; what draws the same picture
is named along with it.  Where all pixels are computed by themselves, few of them rule out most.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from reference.handins import mistakes
from reference.handins.drawing import PER_PIXEL, Drawing, given, join
from reference.handins.formulas import Array, Formulas, formula, parameters
from tracer import Scene

# A picture drawn may differ in so many pixels: of all, of those in which the right one differs, and
# of those in which the hand-in does not have its commonest colour.
_OF_ALL, _OF_WRONG, _OF_SHOWN = 0.005, 0.2, 0.05
# What is named differs in so many times fewer pixels than what is not.
_APART = 5
# If a single mistake leaves more pixels wrong, pairs are tried.
_ENOUGH = 10
# Pixels of a scene on which single mistakes and pairs are drawn for all hand-ins; how many pairs
# are drawn on as many pixels of the hand-in, on more of them, and whole.
_SINGLES, _PAIRS = 2400, 240
_SOME, _FEW, _FINAL = 400, 60, 16
# Of more surfaces, no single one is left out; of more lights, speckles are not looked for.
_MANY_SURFACES, _MANY_LIGHTS = 40, 4
# Rounding decides so many pixels at most, each within so many pixels from its centre.
_TIES, _HAIR = 0.001, 0.05
# Levels: where a format changes them, those further apart count as these.
_FAR = 32
# Bytes of whole pictures that are kept for other hand-ins.
_KEPT = 100_000_000

Cause: TypeAlias = tuple[str, ...]


def difference(a: Array, b: Array) -> Array:
    """The largest of three channels' differences (..., n) between codes (..., 3, n)."""
    return (np.maximum(a, b) - np.minimum(a, b)).max(axis=-2)


def differing(a: Array, b: Array, tolerance: int) -> Array:
    """Pixels (..., n) in which codes (..., 3, n) differ by more."""
    return difference(a, b) > tolerance


class Finding(NamedTuple):
    """Sets of mistakes, each of which draws the hand-in; none if nothing does.

    `wrong` pixels differ from the right picture, `left` ones from the picture drawn.
    """

    causes: tuple[Cause, ...]
    wrong: int
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


class SceneDrawings:
    """A scene drawn with mistakes, and with all of them some formulas `base`, so many columns wide.

    What does not depend on a hand-in is drawn once for all of them.
    """

    def __init__(self, scene: Scene, base: Formulas, columns: int = 0) -> None:
        self.scene, self.base, self.columns = scene, base, columns or scene.width
        self.number, few = scene.width * scene.height, len(scene.surfaces) <= _MANY_SURFACES
        table = mistakes.mistakes_of(scene, each_surface=few)
        self.table = {
            k: m.formulas for k, m in table.items() if not m.formulas.keys() & base.keys()
        }
        self.text = {kind: one.text for kind, one in table.items()} | {
            mistakes.SPECKLED: mistakes.SPECKLED_TEXT
        }
        self._whole: dict[Cause, Array] = {}
        self.blank = np.zeros((3, self.number), dtype=np.uint8)
        self.right = self.whole([()], self.blank)[()]
        names = ("surface", "hit", "lit", "image")
        self.surface, hit, self.lit, image = self.values(names, [self.base], self.blank)[0].values()
        self.surface = np.where(hit, self.surface, -1)
        self.brightest = image.argmax(axis=1)
        self.strata = self.surface
        for lit in self.lit[:_MANY_LIGHTS]:
            self.strata = 2 * self.strata + lit
        self.sample = Sample.of(self.strata, _SINGLES)

    def changes(self, cause: Cause) -> Formulas | None:
        """The formulas of a set of mistakes; None if they exclude each other."""
        return join([self.base, *(self.table[kind] for kind in cause)])

    def fitted(self, cause: Cause) -> bool:
        """Whether the picture depends on the hand-in."""
        return any("handin" in parameters(f) for kind in cause for f in self.table[kind].values())

    def drawing(self, pixels: Array, handin: Array, capacity: int = 3000) -> Drawing:
        rows, columns = np.divmod(pixels, self.columns)
        return Drawing(given(self.scene, columns, rows, handin[:, pixels]), capacity)

    def values(self, names: Sequence[str], changes: Sequence[Formulas], handin: Array) -> list[Any]:
        """Formulas' values for all pixels, computed in parts that fit into a processor's cache."""
        parts: list[list[Any]] = [[] for _ in changes]
        step = max(2000, 400_000 // max(1, len(self.scene.surfaces)))
        for start in range(0, self.number, step):
            drawing = self.drawing(np.arange(start, min(start + step, self.number)), handin, 100)
            for found, changed in zip(parts, changes, strict=True):
                found.append(drawing.pixels(changed, names))
        return [{name: np.concatenate([part[name] for part in found], axis=-1) for name in names}
                for found in parts]  # fmt: skip

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
        """The scene's sample drawn with each mistake alone."""
        kinds = [kind for kind in self.table if kind != mistakes.OWN_SURFACE]
        causes = [*((kind,) for kind in kinds), *((kind, mistakes.OWN_SURFACE) for kind in kinds)]
        fixed = [c for c in causes if not self.fitted(c)]
        return self.codes(fixed, self.sample, self.blank)

    @cached_property
    def alike(self) -> dict[Cause, list[Cause]]:
        """Of mistakes that show, the first of all that draw the same, and these."""
        found: dict[bytes, list[Cause]] = {}
        for cause, codes in self.singles.items():
            found.setdefault(codes.tobytes(), []).append(cause)
        found.pop(self.right[:, self.sample.pixels].tobytes(), None)
        # With another mistake, some show that do not show alone.
        hidden: dict[Cause, list[Cause]] = {(kind,): [(kind,)] for kind in mistakes.OVEREXPOSED}
        return hidden | {causes[0]: causes for causes in found.values()}

    @cached_property
    def pairs(self) -> tuple[dict[Cause, tuple[Cause, Cause]], Array, Sample]:
        """All pairs of mistakes that show, and these drawn on a sample: (pairs, 3, n)."""
        sample = Sample.of(self.strata, _PAIRS)
        drawing = self.drawing(np.append(sample.pixels, self.brightest), self.blank)
        heads = [c for c in self.alike if "samples" not in self.table[c[0]]]  # takes too long
        found: dict[Cause, tuple[Cause, Cause]] = {}
        drawn: list[Array] = []
        for k, a in enumerate(heads):
            new = {c: (a, b) for b in heads[k + 1 :] if (c := self.joined(a, b)) and c not in found}
            others = [self.changes(b) or {} for _, b in new.values()]
            drawn += drawing.pairs(self.changes(a) or {}, others)
            found |= new
        return found, np.array(drawn)[..., : len(sample.pixels)], sample

    def joined(self, a: Cause, b: Cause) -> Cause | None:
        """Both causes; None if they exclude each other."""
        kinds = tuple(kind for kind in (*a, *b) if kind != mistakes.OWN_SURFACE)
        cause = (*kinds, mistakes.OWN_SURFACE) if mistakes.OWN_SURFACE in (*a, *b) else kinds
        return None if self.changes(cause) is None else cause


class Search:
    """A hand-in's pixels (3, n), and what draws them."""

    def __init__(
        self,
        handin: Array,
        drawings: SceneDrawings,
        lossy: int = 0,
        saved: Callable[[Array], Array] | None = None,
    ) -> None:
        self.handin, self.drawings, self.number = handin, drawings, drawings.number
        self.lossy, self.saved = lossy, saved or (lambda codes: codes)
        right = self.saved(drawings.right)
        self.near = lossy or 1
        if differing(right, handin, 1).sum() <= 2:  # rounding, if anything
            self.near = 0
        self.wrong = differing(right, handin, self.near)
        colours = handin.T.astype(np.int32) @ (65536, 256, 1)
        commonest = np.unique(colours, return_counts=True)[1].max()
        self.most = min(_OF_ALL * self.number, _OF_WRONG * self.wrong.sum(),
                        _OF_SHOWN * (self.number - int(commonest)))  # fmt: skip
        # Half of them wrong.
        self.samples = [Sample.of(self.wrong, size) for size in (_PAIRS, _SINGLES // 2)]

    def left(self, cause: Cause, tolerance: int) -> int:
        """Count the pixels that a cause leaves wrong."""
        drawn = self.saved(self.drawings.whole([cause], self.handin)[cause])
        return int(differing(drawn, self.handin, tolerance).sum())

    def find(self) -> Finding:
        """Say what draws the hand-in, if anything does."""
        wrong = int(self.wrong.sum())
        if not np.ptp(self.handin, axis=1).any():
            return Finding((), wrong, wrong)
        left, group = self.single()
        if not group or left > _ENOUGH:
            fewer, two = self.double()
            if two and (not group or _APART * fewer <= left):
                left, group = fewer, two
        if group:
            group = self.rounded(group)
        else:
            left, group = (0, []) if self.lossy else self.speckled()
        causes = dict.fromkeys(tuple(k for k in c if k != mistakes.OWN_SURFACE) for c in group)
        return Finding(tuple(causes), wrong, left if causes else wrong)

    def near_ties(self) -> bool:
        """Whether few pixels are wrong, and each is drawn so a hair beside its centre."""
        pixels = np.flatnonzero(difference(self.drawings.right, self.handin) > 1)
        if len(pixels) > _TIES * self.number:
            return False
        drawing, base = self.drawings.drawing(pixels, self.handin), self.drawings.base
        hairs = [
            mistakes.offset(0.5 + x, 0.5 + y)
            for x in (-_HAIR, 0, _HAIR)
            for y in (-_HAIR, 0, _HAIR)
        ]
        lifts = [
            mistakes.read(f"shadow_p = p + {sign * 1e-3} * sqrt(dot(p, p)) * n")
            for sign in (-1, 0, 1)
        ]
        drawn = np.array([drawing.codes(base | a | b) for a in hairs for b in lifts]).astype(int)
        here = self.handin[:, pixels]
        return bool(((here >= drawn.min(axis=0) - 1) & (here <= drawn.max(axis=0) + 1)).all())

    def single(self) -> tuple[int, list[Cause]]:
        drawings, fixed = self.drawings, self.drawings.singles
        kinds = [kind for kind in drawings.table if drawings.fitted((kind,))]
        causes = [*((kind,) for kind in kinds), *((kind, mistakes.OWN_SURFACE) for kind in kinds)]
        drawn = fixed | drawings.codes(causes, drawings.sample, self.handin)
        good = self.good([*drawn], np.array([*drawn.values()]), drawings.sample, 4 * _OF_ALL, _FEW)
        return self.best(self.sifted(good, 1, _FINAL))

    def double(self) -> tuple[int, list[Cause]]:
        """Of mistakes that show, one for all that draw the same, all pairs."""
        pairs, drawn, sample = self.drawings.pairs
        parts = dict(pairs)
        good = self.good([*parts], drawn, sample, 6 * _OF_ALL, _SOME)
        alike = {mistakes.BACKGROUND: [mistakes.BACKGROUND]} | self.drawings.alike
        join = self.drawings.joined
        if self.handin[:, self.drawings.surface < 0].any():
            shown = {
                both: (mistakes.BACKGROUND, a)
                for a in alike
                if (both := join(mistakes.BACKGROUND, a))
            }
            parts |= shown
            good += self.sifted([*shown], 0, _FEW)
        least, group = self.best(self.sifted(self.sifted(good, 0, _FEW), 1, _FINAL))
        all_of_them = {c: None for both in group for a in alike[parts[both][0]]
                for b in alike[parts[both][1]] if (c := join(a, b))}  # fmt: skip
        wide = [*all_of_them][: 4 * _FINAL]
        return self.best(wide) if len(wide) > len(group) else (least, group)

    def good(
        self, causes: list[Cause], drawn: Array, sample: Sample, most: float, count: int
    ) -> list[Cause]:
        """Those that leave fewest pixels wrong in a sample."""
        if not causes:
            return []
        off = difference(drawn, self.handin[:, sample.pixels])
        if self.lossy:  # what a format does to a few pixels depends on others around them
            left, limit = np.minimum(off, _FAR) @ sample.weights, np.inf
        else:
            left = (off > self.near) @ sample.weights
            limit = max(min(most * self.number, 2 * _OF_WRONG * self.wrong.sum()), 4)
        order = np.argsort(left, kind="stable")
        return [causes[k] for k in order[left[order] <= limit][:count]]

    def sifted(self, causes: list[Cause], size: int, count: int) -> list[Cause]:
        """The best in a sample of the hand-in, half of it wrong."""
        if len(causes) <= count // 2:
            return causes
        drawn = self.drawings.codes(causes, self.samples[size], self.handin)
        most = (3 if size == 0 else 2) * _OF_ALL
        return self.good(causes, np.array([*drawn.values()]), self.samples[size], most, count)

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
        group = [c for c in group if not {*c} & {*mistakes.FITTED}] or group
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

    def lights(self, pixels: Array, cause: Cause = ()) -> tuple[Array, Array, Array]:
        """Which lights the hand-in has at some pixels, which it should have; where that is known.

        These are the fewest changes that give its levels.
        """
        d = self.drawings
        changes, flat, drawing = d.changes(cause) or {}, self.handin[:, pixels], d.drawing(
            pixels, self.handin)  # fmt: skip
        lit, count = drawing.get("lit", changes), len(d.scene.lights)
        everywhere = changes | {"lit": formula("distance > 0")}
        per_light = drawing.get("per_light", everywhere)
        rest = {name: drawing.get(name, changes) for name in PER_PIXEL} | {"handin": flat}
        fewest, found = np.full(len(pixels), count + 1), lit.copy()
        for code in range(2**count):
            some = np.array([code >> k & 1 for k in range(count)], dtype=bool)
            sum_of_some = (per_light * some[:, None, None]).sum(axis=0)
            codes = Drawing(rest | {"radiance": sum_of_some}).get("codes", changes)
            number = (lit != some[:, None]).sum(axis=0)
            better = ~differing(codes, flat, 1) & (number < fewest)
            fewest[better] = number[better]
            found[:, better] = some[:, None]
        return found, lit, fewest <= count

    def misplaced_lights(self) -> list[tuple[int, int]]:
        """For each light, at how many wrong pixels it is missing, and at how many too much."""
        if len(self.drawings.scene.lights) > _MANY_LIGHTS:
            return []
        found, lit, known = self.lights(np.flatnonzero(self.wrong))
        pairs = zip(found & known, lit & known, strict=True)
        return [(int((should & ~has).sum()), int((has & ~should).sum())) for has, should in pairs]

    def speckled(self) -> tuple[int, list[Cause]]:
        """Surfaces that shadow themselves, in dots that depend on rounding: lights are lost."""
        d = self.drawings
        light = self.handin.max(axis=0).reshape(-1, d.columns).astype(np.int16)
        dots = light[:, 1:-1] < np.minimum(light[:, :-2], light[:, 2:]) - 1
        if len(d.scene.lights) > _MANY_LIGHTS or dots.sum() < _OF_ALL * self.number / 2:
            return 0, []
        names = list(mistakes.RIGHT)
        free = {*names[: names.index("centers")], *names[names.index("image") :]}
        for cause in [(), *d.alike]:
            # With mistakes of the camera and of colours.
            if any(not d.table[kind].keys() <= free for kind in cause):
                continue
            found, lit, known = self.lights(self.samples[0].pixels, cause)
            if (~known | (found & ~lit).any(axis=0)).mean() > 2 * _OF_ALL:
                continue
            found, lit, known = self.lights(np.arange(self.number), cause)
            left = int((~known | (found & ~lit).any(axis=0)).sum())
            if left <= self.most and self.scattered(cause, lit & ~found, lit):
                return left, [(*cause, mistakes.SPECKLED)]
        return 0, []

    def scattered(self, cause: Cause, lost: Array, lit: Array) -> bool:
        """Whether light is lost in dots: neighbours on a surface differ nearly as if by chance."""
        d = self.drawings
        surface = d.values(["surface"], [d.changes(cause) or {}], self.handin)[0]["surface"]
        differ = expected = 0.0
        for k in range(len(lit)):
            dots = lost[k].reshape(-1, d.columns)
            for index in np.unique(surface[lost[k]]):
                on = ((surface == index) & lit[k]).reshape(dots.shape)
                share = dots[on].mean()
                for axis in (0, 1):
                    inner = on & np.roll(on, 1, axis)
                    differ += (inner & (dots != np.roll(dots, 1, axis))).sum()
                    expected += 2 * share * (1 - share) * inner.sum()
        return bool(lost.any(axis=0).mean() > _OF_ALL and differ > 0.3 * expected > 0)
