"""Bring pictures to the same places: B turned over, moved or stretched until it is as A shows it.

A curve of levels that explains the rest is allowed for, so that a wrong gamma hides nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import permutations, product
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage, optimize
from skimage.registration import phase_cross_correlation

Codes: TypeAlias = NDArray[np.uint8]
Floats: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]

# Larger pictures are judged by every second, third ... row and column; some questions need fewer.
_PIXELS, _FEWER = 60_000, 12_000
# Longer side of the pictures in which a motion is looked for, and made precise.
_SMALL, _FINE = 64, 256
# Neighbours further apart than this, in codes, have an edge between them.
EDGE = 8
_SAME = np.arange(256.0)


class Diagnosis(NamedTuple):
    """A keyword, such as ``"gamma"``, and a sentence on A, B being right.

    Of several faults, keywords are joined by `` + ``, and sentences follow one another.
    """

    kind: str
    text: str


class Pair(NamedTuple):
    """A (h, w, 3), and B moved to where A shows it: its levels lie between `low` and `high`.

    A shift by half a pixel, say, leaves them undecided.  `shown` (h, w): where something is seen,
    in A or in B, and B shows what is there.  Levels count as equal up to `noise`.
    """

    a: Codes
    low: Codes
    high: Codes
    shown: Bools
    noise: int

    def curve(self) -> Floats:
        """Level of A (256,) for each of B: the median where B has no edge."""
        sure = self.shown & ((self.high - self.low).max(axis=2) <= EDGE)
        if not sure.any():
            return _SAME
        levels = 256 * ((self.low[sure].astype(np.intp) + self.high[sure]) // 2) + self.a[sure]
        counts = np.bincount(levels.ravel(), minlength=65536).reshape(256, 256).cumsum(axis=1)
        there = np.flatnonzero(counts[:, -1])
        median = (2 * counts[there] < counts[there, -1:]).sum(axis=1)
        return np.asarray(np.interp(_SAME, there, median))

    def misfit(self, low: Floats = _SAME, high: Floats = _SAME) -> Bools:
        """Places (h, w) where A is not what B's levels are mapped to, from `low` to `high`."""
        ends = low[self.low], high[self.high]
        least, most = np.minimum(*ends) - self.noise, np.maximum(*ends) + self.noise
        wrong: Bools = ((self.a < least) | (self.a > most)).any(axis=2) & self.shown
        if self.noise > 1:  # what a format does to levels is worst along edges
            wrong = ndimage.binary_opening(wrong, np.ones((3, 3)))
        return wrong

    def unexplained(self) -> float:
        """Part of what is shown that neither a curve nor none explains."""
        left = min(int(self.misfit(curve, curve).sum()) for curve in (self.curve(), _SAME))
        return left / self.shown.sum() if self.shown.any() else 1.0


class _Motion(NamedTuple):
    """B as A shows it: (x, y), from the centre, is B's matrix (x, y) - shift, within `slack`."""

    kind: str
    text: str
    matrix: Floats = np.eye(2)
    shift: Floats = np.zeros(2)
    slack: float = 0

    def pair(self, a: Codes, b: Codes, noise: int) -> Pair:
        step, middle = _step(a), np.array([a.shape[1] - 1, a.shape[0] - 1]) / 2
        y, x = np.ogrid[: a.shape[0] : step, : a.shape[1] : step]
        known, ends = np.ones((), dtype=np.bool_), []
        for m, shift, half in zip(self.matrix, self.shift, middle, strict=True):
            at = np.round(m[0] * (x - middle[0]) + m[1] * (y - middle[1]) - shift + half, 6)
            low, high = np.floor(at - self.slack), np.ceil(at + self.slack)
            known = known & (low >= 0) & (high <= 2 * half)
            both = (low,) if np.array_equal(low, high) else (low, high)
            ends.append([np.clip(end, 0, 2 * half).astype(np.intp) for end in both])
        near = [b[row, column] for column, row in product(*ends)]
        low, high = np.minimum.reduce(near), np.maximum.reduce(near)
        some = a[::step, ::step]
        return Pair(some, low, high, known & (np.maximum(some, high).max(axis=2) > noise), noise)


def _step(image: Codes, most: int = _PIXELS) -> int:
    """Every so many rows and columns of a picture are about so many pixels, at most."""
    return max(1, math.ceil(math.sqrt(image.shape[0] * image.shape[1] / most)))


def _background(a: Codes, b: Codes, noise: int) -> tuple[Codes, list[Diagnosis]]:
    """A with a black background, if it has another where B is black."""
    black = b.max(axis=2) <= noise
    if black.any():
        colour = np.median(a[black][:: _step(b) ** 2], axis=0).astype(np.int16)
        empty = (np.abs(a - colour) <= noise).all(axis=2)
        if colour.max() > 2 * noise and empty[black].mean() > 0.8 and black[empty].mean() > 0.8:
            levels = ", ".join(map(str, colour))
            text = f"A's background is not black: it has the levels {levels}."
            return np.where(empty[:, :, None], np.uint8(0), a), [Diagnosis("background", text)]
    return a, []


_ORDERS = np.array(list(permutations(range(3))))
_TURNS: tuple[tuple[str, str, Callable[[Codes], Codes]], ...] = (
    ("mirrored", "A is mirrored: left and right are swapped.", lambda a: a[:, ::-1]),
    ("flipped", "A is upside down: row 0 should be the top.", lambda a: a[::-1]),
    ("turned-180", "A is turned by 180 degrees.", lambda a: a[::-1, ::-1]),
    ("transposed", "A is transposed: x and y are swapped.", lambda a: a.swapaxes(0, 1)),
)


def _unlike(a: Codes, b: Codes) -> Floats:
    """How little B's levels tell of A's, for each order of A's channels: 1 - r^2."""
    step = _step(b, _FEWER)
    x, y = (image[::step, ::step].reshape(-1, 3).astype(np.float64) for image in (a, b))
    shown = (x + y).any(axis=1)
    x, y = (levels[shown] - levels[shown].mean() for levels in (x, y))
    cross = np.einsum("ni,nj->ij", x, y)[_ORDERS, range(3)].sum(axis=1)
    return np.asarray(1 - cross * np.abs(cross) / max(1, (x * x).sum() * (y * y).sum()))


def _rearranged(a: Codes, b: Codes) -> tuple[Codes, list[Diagnosis]]:
    """A as it would be if it were not turned over, with its channels in B's order."""
    found, unlike, step = [], _unlike(a, b), _step(b)
    turns = [(turn(a), kind, text) for kind, text, turn in _TURNS]
    fitting = [turn for turn in turns if turn[0].shape == b.shape]
    turned, *fault = min(fitting, key=lambda turn: _unlike(turn[0], b).min())
    edges = shared(turned[::step, ::step], b[::step, ::step])
    limit = (0.75 if max(edges) > 0.95 else 0.4) * unlike.min() - 1e-3
    if (other := _unlike(turned, b)).min() < limit:
        a, unlike, found = turned, other, [Diagnosis(*fault)]
    best = int(unlike.argmin())
    if unlike[best] < 0.5 * unlike[0] - 1e-3:
        order = _ORDERS[best].tolist()
        names = [("red", "green", "blue")[order.index(channel)] for channel in range(3)]
        kind = "channels-" + "".join(name[0] for name in names).upper()
        found.append(Diagnosis(kind, f"A's channels are in another order: {', '.join(names)}."))
        a = a[:, :, order]
    return a, found


def align(a: Codes, b: Codes, noise: int) -> tuple[Pair, list[Diagnosis]]:
    """A and B at the same places, and what kept them apart."""
    a, background = _background(a, b, noise)
    a, found = _rearranged(a, b)
    found = background + found
    still = _Motion("", "").pair(a, b, noise)
    before = still.unexplained()
    for search, left in ((_near, 0.1), (_far, 0.3)) if before > 0.002 else ():
        if motion := search(a, b, still):
            inverse = np.linalg.inv(motion.matrix).astype(np.float64)
            back = motion._replace(matrix=inverse, shift=-motion.shift)
            moved, opposite = (m.pair(a, b, noise) for m in (motion, back))
            # The leeway that a motion brings would explain something the other way as well.
            if moved.unexplained() < min(left * before, 0.5 * opposite.unexplained()):
                return moved, [*found, Diagnosis(motion.kind, motion.text)]
    return still, found


def _near(a: Codes, b: Codes, still: Pair) -> _Motion:
    """The best shift by up to two pixels, or a stretch by one."""
    height, width = b.shape[:2]
    text = "A is a pixel smaller than it should be, about its centre: pixel centres lie at"
    text += " (column + 1/2) / width, not at column / (width - 1)."
    tried = [_Motion("size-minus-1", text, np.diag([1 + 1 / width, 1 + 1 / height]))]
    for steps in ((-2, -1, 0, 1, 2), (-0.5, 0, 0.5)):
        tried += [_shift(x, y, slack=0) for x in steps for y in steps if x or y]
    return min(tried, key=lambda motion: motion.pair(a, b, still.noise).unexplained())


def _far(a: Codes, b: Codes, still: Pair) -> _Motion | None:
    """A zoom or stretch about the centre, a turn about it, or a shift by many pixels.

    What makes B most like A in small pictures is made precise in larger ones.
    """
    seen = [image.max(axis=2) > still.noise for image in (still.a, still.low)]
    if (seen[0] == seen[1]).mean() > 0.995 and max(shared(still.a, still.low)) > 0.85:
        return None
    small, fine = ([_grey(image, size) for image in (a, b)] for size in (_SMALL, _FINE))

    def cost(kind: Callable[..., _Motion], images: list[Floats], by: Sequence[float]) -> float:
        """How little A is like B moved: minus their correlation where B is known."""
        motion, size = kind(*by), np.array(images[1].shape)
        matrix, middle = motion.matrix[::-1, ::-1], (size - 1) / 2
        start = middle - matrix @ middle - motion.shift[::-1] * size.max() / max(a.shape)
        moved = ndimage.affine_transform(images[1], matrix, start, order=1, cval=np.nan)
        known = ~np.isnan(moved)
        x, y = images[0][known], moved[known]
        if known.mean() < 0.02 or min(x.std(), y.std()) < 1:
            return 1.0
        return -float(np.corrcoef(x, y)[0, 1])

    shift = phase_cross_correlation(*fine, normalization=None, upsample_factor=10)[0][::-1]
    tried: list[tuple[Callable[..., _Motion], Iterable[Sequence[float]]]] = [
        (_zoom, product(np.arange(-2, 2.1, 0.25), repeat=2)),
        (_roll, np.arange(-3, 3.1, 0.1)[:, None]),
        (_shift, [shift * max(a.shape) / max(fine[0].shape)]),
    ]
    found = []
    for kind, grid in tried:
        start = min(grid, key=partial(cost, kind, small))
        if cost(kind, small, start) < -0.7:
            near = start + 0.1 * np.eye(len(start) + 1, len(start))
            options = {"initial_simplex": near, "xatol": 1e-4, "maxfev": 60}
            exact = partial(cost, kind, fine)
            best = optimize.minimize(exact, start, method="Nelder-Mead", options=options)
            found.append((best.fun, kind(*best.x)))
    return min(found, key=lambda one: one[0])[1] if found else None


# Shifts (right, down) that the table of mistakes has as well.
_SHIFTS = {
    (0.5, 0): "pixel-left", (0, 0.5): "pixel-upper", (-0.5, 0): "pixel-right",
    (0, -0.5): "pixel-lower", (0.5, 0.5): "pixel-upper-left", (0.5, -0.5): "pixel-lower-left",
    (-0.5, 0.5): "pixel-upper-right", (-0.5, -0.5): "pixel-lower-right", (1, 0): "shift-right",
    (-1, 0): "shift-left", (0, -1): "shift-up", (0, 1): "shift-down", (-1, -1): "shift-left-up",
    (-1, 1): "shift-left-down", (1, -1): "shift-right-up", (1, 1): "shift-right-down",
}  # fmt: skip


def _shift(*by: float, slack: float = 1) -> _Motion:
    shift = np.round(by) if slack else np.array(by)
    why = "samples belong at the pixels' centres" if (shift % 1).any() else "check viewDir"
    ways = zip(shift, (("to the right", "to the left"), ("down", "up")), strict=True)
    names = {0.5: "half a pixel", 1: "one pixel"}
    parts = [f"{names.get(abs(s), f'{abs(s):g} pixels')} {way[int(s < 0)]}" for s, way in ways if s]
    text = f"A is shifted by {' and '.join(parts)}: {why}."
    return _Motion(_SHIFTS.get(tuple(shift.tolist()), "shift"), text, shift=shift, slack=slack)


def _zoom(*powers: float) -> _Motion:
    """Larger across and down by powers of e."""
    across, down = np.exp(powers)
    sides = (across, "wide", "viewWidth"), (down, "high", "viewHeight")
    changed = [side for side in sides if abs(side[0] - 1) > 0.004] or sides
    size = " and ".join(f"{by:.3g} times as {word}" for by, word, _ in changed)
    check = changed[0][2] if len(changed) == 1 else "the window's size and distance"
    text = f"A shows everything {size} as B, about its centre: check {check}."
    return _Motion("zoom", text, np.diag([1 / across, 1 / down]), slack=0.5)


def _roll(angle: float) -> _Motion:
    c, s = np.cos(angle), np.sin(angle)
    way = "clockwise" if angle < 0 else "anticlockwise"
    text = f"A is turned by {abs(np.degrees(angle)):.0f} degrees {way}: check viewUp."
    return _Motion("roll", text, np.array([[c, -s], [s, c]]), slack=0.5)


def _grey(image: Codes, size: int) -> Floats:
    """A picture's grey levels, blurred, as large as `size` at most."""
    grey = Image.fromarray(np.ascontiguousarray(image)).convert("L")
    grey.thumbnail((size, size), Image.Resampling.BOX)
    return np.asarray(ndimage.gaussian_filter(np.asarray(grey, dtype=np.float64), 1))


def edges_of(image: Codes) -> Bools:
    """Pixels (h, w) with an edge between them and one of their eight neighbours."""
    steps = ndimage.morphological_gradient(image, (3, 3, 1))
    return np.asarray((steps > EDGE).any(axis=2))


def shared(a: Codes, b: Codes) -> tuple[float, float]:
    """Part of A's edges that B has, and of B's that A has, within a pixel."""
    mine, right = edges_of(a), edges_of(b)
    wide = [ndimage.binary_dilation(edges, np.ones((3, 3))) for edges in (mine, right)]
    first, second = mine[wide[1]].sum() / max(1, mine.sum()), right[wide[0]].sum()
    return float(first), float(second / max(1, right.sum()))
