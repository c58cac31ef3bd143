"""Bring pictures to the same places: B turned over, moved or stretched until it is as A shows it.

A curve of levels that explains the rest is allowed for, so that a wrong gamma hides nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import permutations, product
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage, optimize
from skimage.registration import phase_cross_correlation

__all__ = [
    "EDGE",
    "SAME",
    "Bools",
    "Codes",
    "Diagnosis",
    "Floats",
    "Pair",
    "aligned",
    "edges_of",
    "shared_edges",
]

Codes: TypeAlias = NDArray[np.uint8]
Floats: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]

# Larger pictures are judged by every second, third ... row and column; some questions need fewer.
_PIXELS, _FEWER = 60_000, 12_000
# Neighbours further apart than this, in codes, have an edge between them.
EDGE = 8
# Longer side of the pictures in which a motion is looked for, and made precise.
_SMALL, _FINE = 64, 256
SAME = np.arange(256.0)


class Diagnosis(NamedTuple):
    """The kind of a difference: a keyword, such as ``"gamma"``, and a sentence on A, B being right.

    Of several faults, keywords are joined by `` + ``, and sentences follow one another.
    """

    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class Pair:
    """A and B at some places, B moved to where A shows it.

    Attributes
    ----------
    a : (h, w, 3) uint8
    low, high : (h, w, 3) uint8
        B's levels lie between these: a shift by half a pixel, say, leaves them undecided.
    known : (h, w) bool
        Whether B shows what is there.
    noise : int
        Levels this far apart count as equal.
    """

    a: Codes
    low: Codes
    high: Codes
    known: Bools
    noise: int

    @property
    def shown(self) -> Bools:
        """Places (h, w) where something is seen, in A or in B."""
        shown: Bools = self.known & (np.maximum(self.a, self.high).max(axis=2) > self.noise)
        return shown

    def curve(self) -> Floats:
        """Level of A (256,) for each of B: the median where B has no edge."""
        sure = self.known & ((self.high - self.low).max(axis=2) <= EDGE)
        if not sure.any():
            return SAME
        levels = 256 * ((self.low[sure].astype(np.intp) + self.high[sure]) // 2) + self.a[sure]
        counts = np.bincount(levels.ravel(), minlength=65536).reshape(256, 256).cumsum(axis=1)
        there = np.flatnonzero(counts[:, -1])
        median = (2 * counts[there] < counts[there, -1:]).sum(axis=1)
        return np.asarray(np.interp(SAME, there, median))

    def misfit(self, low: Floats, high: Floats) -> Bools:
        """Places (h, w) where A is not what B's levels are mapped to, from `low` to `high`."""
        ends = low[self.low], high[self.high]
        least, most = np.minimum(*ends) - self.noise, np.maximum(*ends) + self.noise
        wrong: Bools = ((self.a < least) | (self.a > most)).any(axis=2) & self.shown
        if self.noise > 1:  # what a format does to levels is worst along edges
            wrong = ndimage.binary_opening(wrong, np.ones((3, 3)))
        return wrong

    def unexplained(self) -> float:
        """Part of what is shown that no curve explains, or that a curve of no effect does not."""
        left = min(int(self.misfit(curve, curve).sum()) for curve in (self.curve(), SAME))
        return left / max(1, int(self.shown.sum())) if self.known.any() else 1.0


class _Motion(NamedTuple):
    """B as A shows it: (x, y), from the centre, is B's matrix (x, y) - shift, within `slack`."""

    kind: str
    text: str
    matrix: Floats
    shift: Floats
    slack: float = 0

    def back(self) -> _Motion:
        inverse = np.asarray(np.linalg.inv(self.matrix), dtype=np.float64)
        return self._replace(matrix=inverse, shift=-self.shift)

    def pair(self, a: Codes, b: Codes, noise: int) -> Pair:
        height, width = a.shape[:2]
        step, middle = _step(a), np.array([width - 1, height - 1]) / 2
        x = np.arange(0, width, step) - middle[0]
        y = np.arange(0, height, step)[:, None] - middle[1]
        there, known, ends = [], np.ones((), dtype=np.bool_), []
        for m, shift, half in zip(self.matrix, self.shift, middle, strict=True):
            at = np.round(m[0] * x + m[1] * y - shift + half, 6)
            low, high = np.floor(at - self.slack), np.ceil(at + self.slack)
            known = known & (low >= 0) & (high <= 2 * half)
            both = (low,) if np.array_equal(low, high) else (low, high)
            ends.append([np.clip(end, 0, 2 * half).astype(np.intp) for end in both])
        there = [b[row, column] for column, row in product(*ends)]
        return Pair(
            a[::step, ::step], np.minimum.reduce(there), np.maximum.reduce(there), known, noise
        )


def _step(image: Codes, most: int = _PIXELS) -> int:
    """Every so many rows and columns of a picture are about so many pixels, at most."""
    return max(1, math.ceil(math.sqrt(image.shape[0] * image.shape[1] / most)))


def _background(a: Codes, b: Codes, noise: int) -> tuple[Codes, list[Diagnosis]]:
    """A with a black background."""
    black = b.max(axis=2) <= noise
    if not black.any():
        return a, []
    behind, count = np.unique(a[black][:: _step(b) ** 2], axis=0, return_counts=True)
    colour = behind[count.argmax()].astype(np.int16)
    empty = (np.abs(a - colour) <= noise).all(axis=2)
    if colour.max() <= 2 * noise or min(empty[black].mean(), black[empty].mean()) < 0.8:
        return a, []
    text = f"A's background is not black: it has the levels {', '.join(map(str, colour))}."
    return np.where(empty[:, :, None], np.uint8(0), a), [Diagnosis("background", text)]


_ORDERS = np.array(list(permutations(range(3))))
_TURNS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "mirrored": ("A is mirrored: left and right are swapped.", lambda a: a[:, ::-1]),
    "flipped": ("A is upside down: row 0 should be the top.", lambda a: a[::-1]),
    "turned": ("A is turned by 180 degrees.", lambda a: a[::-1, ::-1]),
    "transposed": ("A is transposed: x and y are swapped.", lambda a: a.swapaxes(0, 1)),
}


def _unlike(a: Codes, b: Codes) -> Floats:
    """How little B's levels tell of A's, for each order of A's channels: 1 - r^2."""
    step = _step(b, _FEWER)
    x, y = (image[::step, ::step].reshape(-1, 3).astype(np.float64) for image in (a, b))
    shown = (x + y).any(axis=1)
    x, y = (levels[shown] - levels[shown].mean() for levels in (x, y))
    cross = np.einsum("ni,nj->ij", x, y)[_ORDERS, range(3)].sum(axis=1)
    return 1 - cross * np.abs(cross) / max(1, (x * x).sum() * (y * y).sum())


def _rearranged(a: Codes, b: Codes) -> tuple[Codes, list[Diagnosis]]:
    """A as it would be if it were not turned over, with its channels in B's order."""
    found, unlike, step = [], _unlike(a, b), _step(b)
    turns = [(turn(a), kind, text) for kind, (text, turn) in _TURNS.items()]
    fitting = [turn for turn in turns if turn[0].shape == b.shape]
    turned, kind, text = min(fitting, key=lambda turn: _unlike(turn[0], b).min())
    edges = shared_edges(*(edges_of(image[::step, ::step]) for image in (turned, b)))
    limit = (0.75 if max(edges) > 0.95 else 0.4) * unlike.min() - 1e-3
    if (other := _unlike(turned, b)).min() < limit:
        a, unlike, found = turned, other, [Diagnosis(kind, text)]
    best = int(unlike.argmin())
    if unlike[best] < 0.5 * unlike[0] - 1e-3:
        order = _ORDERS[best].tolist()
        names = ", ".join(("red", "green", "blue")[order.index(channel)] for channel in range(3))
        found.append(Diagnosis("channels", f"A's channels are in another order: {names}."))
        a = a[:, :, order]
    return a, found


def _moved(a: Codes, b: Codes, noise: int) -> tuple[Pair, list[Diagnosis]]:
    """Both at the same places: B shifted, stretched or turned as A is."""
    still = _Motion("", "", np.eye(2), np.zeros(2)).pair(a, b, noise)
    before = still.unexplained()
    for search in (_slid, _far) if before > 0.002 else ():
        if motion := search(a, b, still):
            moved, opposite = (m.pair(a, b, noise) for m in (motion, motion.back()))
            # The leeway that a motion brings would explain something the other way as well.
            if moved.unexplained() < min(0.3 * before, 0.5 * opposite.unexplained()):
                return moved, [Diagnosis(motion.kind, motion.text)]
    return still, []


def _slid(a: Codes, b: Codes, still: Pair) -> _Motion | None:
    """A shift by half pixels, or a stretch by one, estimated from gradients.

    Along each axis the shift is modelled as c + s x, x from -1/2 at one border to 1/2 at the
    other: least squares of A - B = -(c + s x) dI/dx (B. Lucas and T. Kanade, An iterative image
    registration technique, IJCAI 1981).
    """
    height, width = b.shape[:2]
    if min(height, width) < 4:
        return None
    step, there = _step(b), still.curve().astype(np.float32)[b].mean(axis=2)
    down, across = (gradient[::step, ::step] for gradient in np.gradient(there))
    x, y = np.linspace(-0.5, 0.5, width)[::step], np.linspace(-0.5, 0.5, height)[::step, None]
    columns = np.stack([across, across * x, down, down * y])
    matrix = np.einsum("ihw,jhw->ij", columns, columns)
    target = np.einsum("ihw,hw->i", columns, there[::step, ::step] - a[::step, ::step].mean(axis=2))
    fit = np.linalg.lstsq(matrix, target, rcond=1e-6)[0]
    shift, stretch = np.round(2 * fit[::2]) / 2, np.round(fit[1::2])
    if shift.any() and np.abs(shift).max() <= 2:
        half = ": samples belong at the pixels' centres" if (shift % 1).any() else ""
        text = f"A is shifted by {_way(*shift.tolist())}{half}."
        return _Motion("shifted", text, np.eye(2), shift)
    if np.abs(stretch).max() == 1 and not shift.any():
        word = "smaller" if stretch.sum() < 0 else "larger"
        text = (
            f"A is a pixel {word} than it should be, about its centre: pixel centres lie at"
            " (column + 1/2) / width, not at column / (width - 1)."
        )
        return _Motion("stretched", text, np.diag(1 - stretch / (width, height)), np.zeros(2))
    return None


def _way(right: float, down: float) -> str:
    """A shift in words: "half a pixel to the right and 2 pixels down"."""
    names = {0.5: "half a pixel", 1: "one pixel", 1.5: "one and a half pixels"}
    parts = [
        f"{names.get(abs(size), f'{abs(size):.0f} pixels')} {ways[size < 0]}"
        for size, ways in ((right, ("to the right", "to the left")), (down, ("down", "up")))
        if size
    ]
    return " and ".join(parts)


def _far(a: Codes, b: Codes, still: Pair) -> _Motion | None:
    """A zoom or stretch about the centre, a turn about it, or a shift by many pixels.

    What makes B most like A in small pictures is made precise in larger ones.
    """
    silhouettes = [image.max(axis=2) > still.noise for image in (still.a, still.low)]
    agree = (silhouettes[0] == silhouettes[1]).mean() > 0.995
    if agree and max(shared_edges(edges_of(still.a), edges_of(still.low))) > 0.85:
        return None
    small, fine = ([_grey(image, size) for image in (a, b)] for size in (_SMALL, _FINE))

    def cost(kind: Callable[..., _Motion], by: Iterable[float], images: list[Floats]) -> float:
        """How little A is like B moved: minus their correlation."""
        motion, size = kind(*by), np.array(images[1].shape)
        matrix, middle = motion.matrix[::-1, ::-1], (size - 1) / 2
        shift = motion.shift[::-1] * size.max() / max(a.shape)
        moved = ndimage.affine_transform(
            images[1], matrix, middle - matrix @ middle - shift, order=1, cval=np.nan
        )
        return -_correlation(images[0], moved)

    shift = phase_cross_correlation(*fine, normalization=None, upsample_factor=10)[0][::-1]
    tried = [(_shift, tuple(shift * max(a.shape) / max(fine[0].shape)))]
    tried += [(_zoom, powers) for powers in product(np.arange(-2, 2.1, 0.25), repeat=2)]
    tried += [(_roll, (angle,)) for angle in np.arange(-3.1, 3.1, 0.1)]
    kind, start = min(tried, key=lambda one: cost(*one, small))
    if cost(kind, start, small) > -0.7:
        return None
    found = optimize.fmin(
        lambda by: cost(kind, by, fine),
        start,
        xtol=1e-4,
        maxfun=60,
        disp=False,
        initial_simplex=start + 0.1 * np.eye(len(start) + 1, len(start)),
    )
    best = kind(*found)
    return best if best.shift.any() or np.abs(best.matrix - np.eye(2)).max() > 0.01 else None


def _shift(*by: float) -> _Motion:
    right, down = map(round, by)
    text = f"A is shifted by {_way(right, down)}: check viewDir."
    return _Motion("shifted", text, np.eye(2), np.array(by), 1)


def _zoom(*powers: float) -> _Motion:
    """Larger across and down by powers of e."""
    across, down = np.exp(powers)
    text = f"A shows everything {across:.2f} times as large as B, about its centre: check the"
    text += " window's size and distance."
    if abs(across / down - 1) > 0.02:
        sides = [("width", "viewWidth", across), ("height", "viewHeight", down)]
        sides = [side for side in sides if abs(side[2] - 1) > 0.01]
        to = " and ".join(f"{by:.2f} times B's {name}" for name, _, by in sides)
        check = " and ".join(name for _, name, _ in sides)
        text = f"A is stretched about its centre, to {to}: check {check}."
    return _Motion("zoomed", text, np.diag([1 / across, 1 / down]), np.zeros(2), 0.5)


def _roll(angle: float) -> _Motion:
    c, s = np.cos(angle), np.sin(angle)
    way = "clockwise" if angle < 0 else "anticlockwise"
    text = f"A is turned by {abs(np.degrees(angle)):.0f} degrees {way}: check viewUp."
    return _Motion("rolled", text, np.array([[c, -s], [s, c]]), np.zeros(2), 0.5)


def _grey(image: Codes, size: int) -> Floats:
    """A picture's grey levels, blurred, as large as `size` at most."""
    grey = Image.fromarray(np.ascontiguousarray(image)).convert("L")
    grey.thumbnail((size, size), Image.Resampling.BOX)
    return np.asarray(ndimage.gaussian_filter(np.asarray(grey, dtype=np.float64), 1))


def _correlation(a: Floats, b: Floats) -> float:
    """How alike two pictures are, where the second is known; -1 if that is next to nowhere."""
    known = ~np.isnan(b)
    x, y = a[known], b[known]
    if x.size < 0.02 * a.size or min(x.std(), y.std()) < 1:
        return -1.0
    x, y = x - x.mean(), y - y.mean()
    # Not x @ y: threads of BLAS take longer to wake than this takes.
    return float((x * y).sum() / np.sqrt((x * x).sum() * (y * y).sum()))


def edges_of(image: Codes) -> Bools:
    """Pixels (h, w) with an edge between them and one of their eight neighbours."""
    steps = ndimage.morphological_gradient(image, (3, 3, 1))
    return np.asarray((steps > EDGE).any(axis=2))


def shared_edges(a: Bools, b: Bools) -> tuple[float, float]:
    """Part of A's edges that B has, and of B's that A has, within a pixel."""
    wide = [ndimage.binary_dilation(edges, np.ones((3, 3))) for edges in (a, b)]
    first, second = (a & wide[1]).sum() / max(1, a.sum()), (b & wide[0]).sum() / max(1, b.sum())
    return float(first), float(second)


def aligned(a: Codes, b: Codes, noise: int) -> tuple[Pair, list[Diagnosis]]:
    """A and B at the same places, and what kept them apart."""
    a, background = _background(a, b, noise)
    a, turned = _rearranged(a, b)
    pair, moved = _moved(a, b, noise)
    return pair, [*background, *turned, *moved]
