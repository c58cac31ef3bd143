"""Name the kinds of difference between two pictures, in words: geometry first, shading next.

Geometry: B is turned over, moved or stretched until A is like it, whatever curve maps the levels of
one to the other's, so that a wrong gamma hides nothing.  Levels: a curve that explains nearly all
of them is named.  What is still unexplained is told by where it lies, which sign it has, and how it
ends.  Two faults are told one after the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage, optimize
from skimage.registration import phase_cross_correlation

__all__ = ["GAMMA", "Diagnosis", "diagnose", "linear"]

Codes: TypeAlias = NDArray[np.uint8]
Floats: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]

GAMMA = 2.2

# Larger pictures are judged by every second, third ... row and column; some questions need fewer.
_PIXELS, _FEWER = 60_000, 12_000
# Neighbours further apart than this, in codes, have an edge between them.
_EDGE = 8
# A lossy format changes levels by up to so many, but for a few per cent of them.
_LOSSY = 6
# Longer side of the pictures in which a motion is looked for, and made precise.
_SMALL, _FINE = 64, 256
_SAME = np.arange(256.0)


class Diagnosis(NamedTuple):
    """The kind of a difference: a keyword, such as ``"gamma"``, and a sentence on A, B being right.

    Of several faults, keywords are joined by `` + ``, and sentences follow one another.
    """

    kind: str
    text: str


def linear(codes: NDArray[np.generic]) -> Floats:
    """Linear light of 8-bit codes: the inverse of the format's gamma of 2.2."""
    light: Floats = (np.arange(256) / 255) ** GAMMA
    return np.asarray(light[codes])


def diagnose(a: Codes, b: Codes, *, lossy: bool = False) -> Diagnosis:
    """Tell which kinds of difference lie between A and the right picture, B.

    Parameters
    ----------
    a, b : (h, w, 3) uint8
        Their sizes may differ.
    lossy : bool
        Whether the format of a picture changes levels, as JPEG does.
    """
    if a.shape != b.shape:
        return _sizes(a.shape, b.shape)
    noise = _LOSSY if lossy else 1
    difference = np.maximum(a, b) - np.minimum(a, b)
    count = int(np.count_nonzero((difference > noise).any(axis=2)))
    if difference.max() <= 1:
        return _rounding(a, b)
    for name, image, other in (("A", a, "B"), ("B", b, "A")):
        if image.max() < noise:
            return Diagnosis("black", f"{name} is black, and {other} is not.")
        if np.ptp(image, axis=(0, 1)).max() < noise:
            return Diagnosis("flat", f"{name} has one colour everywhere.")
    if (np.abs(255 - b.astype(np.int16) - a) <= noise).mean() > 0.98:
        return Diagnosis("inverted", "A is the negative of B.")
    if not count:
        return Diagnosis("noise", f"No level is off by more than {noise}: noise of the format.")
    if lossy:
        # Half the size keeps little of what compression does.
        a, b = (np.asarray(Image.fromarray(np.ascontiguousarray(x)).reduce(2)) for x in (a, b))
    a, background = _background(a, b, noise)
    a, turned = _rearranged(a, b)
    pair, moved = _moved(a, b, noise)
    pair, encoded = _encoded(pair)
    found = [*background, *turned, *moved, *encoded]
    left = pair.misfit(_SAME, _SAME)
    # At edges the amount of a shift is never quite known, and a format changes most.
    spare = 0.03 * (bool(found) + lossy)
    if not spare or left.sum() > spare * pair.shown.sum():
        found.append(_shading(pair, left, count))
    if not found:
        text = f"{_differ(count)}, as the format of one of the pictures may make them."
        return Diagnosis("noise", text)
    return Diagnosis(" + ".join(f.kind for f in found), " ".join(f.text for f in found))


def _sizes(a: tuple[int, ...], b: tuple[int, ...]) -> Diagnosis:
    text = f"Different sizes: A has {a[1]}x{a[0]} pixels, B {b[1]}x{b[0]}"
    if a[:2] == b[1::-1]:
        text += "; width and height are swapped"
    elif a[0] * b[1] == a[1] * b[0]:
        text += f"; of the same shape, A {a[0] / b[0]:.3g} times as large"
    return Diagnosis("size", text + ".")


def _rounding(a: Codes, b: Codes) -> Diagnosis:
    """At most one level apart."""
    count, lit = (int(np.count_nonzero(x.any(axis=2))) for x in (a != b, b))
    if not count:
        return Diagnosis("identical", "The pictures are identical.")
    if count < 0.01 * lit:
        few = f"{_differ(count)} by one level: rounding, nothing to worry about."
        return Diagnosis("rounding", few)
    how = "up and down: the factor is not 255"
    if (a <= b).all():
        how = "downwards: A is cut off where it should be rounded"
    elif (a >= b).all():
        how = "only upwards: A's factor is more than 255, or B is cut off"
    return Diagnosis("cut off", f"One level of rounding, {how}.")


def _differ(count: int) -> str:
    return "One pixel differs" if count == 1 else f"{count} pixels differ"


@dataclass(frozen=True, slots=True)
class _Pair:
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
        sure = self.known & ((self.high - self.low).max(axis=2) <= _EDGE)
        if not sure.any():
            return _SAME
        levels = 256 * ((self.low[sure].astype(np.intp) + self.high[sure]) // 2) + self.a[sure]
        counts = np.bincount(levels.ravel(), minlength=65536).reshape(256, 256).cumsum(axis=1)
        there = np.flatnonzero(counts[:, -1])
        median = (2 * counts[there] < counts[there, -1:]).sum(axis=1)
        return np.asarray(np.interp(_SAME, there, median))

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
        left = min(int(self.misfit(curve, curve).sum()) for curve in (self.curve(), _SAME))
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

    def pair(self, a: Codes, b: Codes, noise: int) -> _Pair:
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
        return _Pair(
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


_ORDERS = list(permutations(range(3)))
_TURNS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "mirrored": ("A is mirrored: left and right are swapped.", lambda a: a[:, ::-1]),
    "flipped": ("A is upside down: row 0 should be the top.", lambda a: a[::-1]),
    "turned": ("A is turned by 180 degrees.", lambda a: a[::-1, ::-1]),
    "transposed": ("A is transposed: x and y are swapped.", lambda a: a.swapaxes(0, 1)),
}


def _unlike(a: Codes, b: Codes) -> Floats:
    """How badly B's levels tell A's, for each order of A's channels: 1 - correlation ratio."""
    step = _step(b, _FEWER)
    a, b = a[::step, ::step], b[::step, ::step]
    shown = a.any(axis=2) | b.any(axis=2)
    values, levels = a[shown].astype(np.float64), b[shown] >> 2
    count = np.maximum(np.bincount(levels.ravel(), minlength=64), 1)
    sums = [[np.bincount(y, x, 64) for x in values.T] for y in levels.T]
    whole = max(values.var() * values.size, 1e-6)
    mean = values.sum() ** 2 / max(1, values.size)
    between = [(sum(sums[k][order[k]] for k in range(3)) ** 2 / count).sum() for order in _ORDERS]
    return np.asarray(1 - (np.array(between) - mean) / whole)


def _rearranged(a: Codes, b: Codes) -> tuple[Codes, list[Diagnosis]]:
    """A as it would be if it were not turned over, with its channels in B's order."""
    image, unlike, found = a, _unlike(a, b), []
    limit, step = min(0.15, 0.4 * unlike.min()), _step(b)
    edges, right = _edges(a[::step, ::step]), _edges(b[::step, ::step])
    off = max(_shared(edges, right)) < 0.9
    for kind, (text, turn) in _TURNS.items():
        if (turned := turn(a)).shape == b.shape:
            other = _unlike(turned, b)
            by_edges = off and max(_shared(turn(edges), right)) > 0.95
            if other.min() < (unlike.min() if by_edges else min(limit, unlike.min())):
                image, unlike, found = turned, other, [Diagnosis(kind, text)]
    best = int(unlike.argmin())
    if unlike[best] < min(0.15, 0.5 * unlike[0] - 1e-3):
        order = list(_ORDERS[best])
        names = ", ".join(("red", "green", "blue")[order.index(channel)] for channel in range(3))
        text = f"A's channels are in another order: {names}."
        return image[:, :, order], [*found, Diagnosis("channels", text)]
    return image, found


def _moved(a: Codes, b: Codes, noise: int) -> tuple[_Pair, list[Diagnosis]]:
    """Both at the same places: B shifted, stretched or turned as A is."""
    still = _Motion("", "", np.eye(2), np.zeros(2)).pair(a, b, noise)
    before = still.unexplained()
    for motions in (_slid, _far) if before > 0.002 else ():
        for motion in motions(a, b, still):
            moved, opposite = (m.pair(a, b, noise) for m in (motion, motion.back()))
            # The leeway that a motion brings would explain something the other way as well.
            if moved.unexplained() < min(0.3 * before, 0.5 * opposite.unexplained()):
                return moved, [Diagnosis(motion.kind, motion.text)]
    return still, []


def _slid(a: Codes, b: Codes, still: _Pair) -> Iterator[_Motion]:
    """A shift by half pixels, or a stretch by one, estimated from gradients.

    Along each axis the shift is modelled as c + s x, x from -1/2 at one border to 1/2 at the
    other: least squares of A - B = -(c + s x) dI/dx (B. Lucas and T. Kanade, An iterative image
    registration technique, IJCAI 1981).
    """
    height, width = b.shape[:2]
    if min(height, width) < 4:
        return
    step, there = _step(b), still.curve()[b].mean(axis=2)
    down, across = (gradient[::step, ::step] for gradient in np.gradient(there))
    x, y = np.linspace(-0.5, 0.5, width)[::step], np.linspace(-0.5, 0.5, height)[::step, None]
    columns = np.stack([across, across * x, down, down * y])
    matrix = np.einsum("ihw,jhw->ij", columns, columns)
    target = np.einsum("ihw,hw->i", columns, (there - a.mean(axis=2))[::step, ::step])
    fit = np.linalg.lstsq(matrix, target, rcond=1e-6)[0]
    shift, stretch = np.round(2 * fit[::2]) / 2, np.round(fit[1::2])
    if shift.any() and np.abs(shift).max() <= 2:
        half = ": samples belong at the pixels' centres" if (shift % 1).any() else ""
        text = f"A is shifted by {_way(*shift.tolist())}{half}."
        yield _Motion("shifted", text, np.eye(2), shift)
    elif np.abs(stretch).max() == 1 and not shift.any():
        word = "smaller" if stretch.sum() < 0 else "larger"
        text = (
            f"A is a pixel {word} than it should be, about its centre: pixel centres lie at"
            " (column + 1/2) / width, not at column / (width - 1)."
        )
        yield _Motion("stretched", text, np.diag(1 - stretch / (width, height)), np.zeros(2))


def _way(right: float, down: float) -> str:
    """A shift in words: "half a pixel to the right and 2 pixels down"."""
    names = {0.5: "half a pixel", 1: "one pixel", 1.5: "one and a half pixels"}
    parts = [
        f"{names.get(abs(size), f'{abs(size):.0f} pixels')} {ways[size < 0]}"
        for size, ways in ((right, ("to the right", "to the left")), (down, ("down", "up")))
        if size
    ]
    return " and ".join(parts)


def _far(a: Codes, b: Codes, still: _Pair) -> Iterator[_Motion]:
    """A zoom or stretch about the centre, a turn about it, or a shift by many pixels.

    Each is searched for in small pictures, and the one that makes B most like A made precise.
    """
    silhouettes = [image.max(axis=2) > still.noise for image in (still.a, still.low)]
    agree = (silhouettes[0] == silhouettes[1]).mean() > 0.995
    if agree and max(_shared(_edges(still.a), _edges(still.low))) > 0.85:
        return
    small, fine = ([_grey(image, size) for image in (a, b)] for size in (_SMALL, _FINE))
    if min(image.std() for image in (*small, *fine)) < 1:
        return
    scale = max(1, max(a.shape) / _FINE)

    def likeness(motion: _Motion, images: list[Floats]) -> float:
        matrix, middle = motion.matrix[::-1, ::-1], (np.array(images[1].shape) - 1) / 2
        offset = middle - matrix @ middle - motion.shift[::-1] / scale
        moved = ndimage.affine_transform(images[1], matrix, offset, order=1, cval=np.nan)
        return _correlation(images[0], moved)

    motions = [_shift(scale * phase_cross_correlation(*fine, normalization=None)[0][::-1])]
    for kind, grid in (_zoom, (slice(-2, 2.1, 0.125),) * 2), (_roll, (slice(-3.1, 3.1, 0.1),)):

        def cost(by: Floats, images: list[Floats], kind: Any = kind) -> float:
            return -likeness(kind(*np.atleast_1d(by)), images)

        start = optimize.brute(cost, grid, (small,), finish=None)
        found = optimize.fmin(cost, start, (fine,), xtol=1e-4, maxfun=60, disp=False)
        motions.append(kind(*found))
    best = max(motions, key=lambda motion: likeness(motion, fine))
    if best.shift.any() or 0.01 < np.abs(best.matrix - np.eye(2)).max() < 20:
        yield best


def _shift(by: Floats) -> _Motion:
    shift = np.round(by)
    text = f"A is shifted by {_way(*shift.tolist())}: check viewDir."
    return _Motion("shifted", text, np.eye(2), shift, 1)


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


def _encoded(pair: _Pair) -> tuple[_Pair, list[Diagnosis]]:
    """The same, B's levels mapped as A's are."""
    shown = max(1, int(pair.shown.sum()))
    before = int(pair.misfit(_SAME, _SAME).sum()) / shown
    tried = [(int(pair.misfit(t.low, t.high).sum()) / shown, t) for t in _tones(pair)]
    left, tone = min((t for t in tried if t[1].kind != "curve"), key=lambda one: one[0])
    if left > 0.03:
        left, tone = min(tried, key=lambda one: one[0])
    # A curve without a parameter may leave half to other faults.
    if not (
        left <= min(0.03, 0.3 * before) < before - (0.05 if pair.noise > 1 else 0)
        or (tone.fixed and left < 0.5 < 0.8 < before)
    ):
        return pair, []
    ends = tone.low[pair.low], tone.high[pair.high]
    low, high = (f(*ends).astype(np.uint8) for f in (np.minimum, np.maximum))
    return replace(pair, low=low, high=high), [Diagnosis(tone.kind, tone.text)]


class _Tone(NamedTuple):
    """A curve of levels: for each of B (256,) the least and the largest level of A."""

    kind: str
    text: str
    low: Floats
    high: Floats
    fixed: bool


# Kind, sentence, and what light is encoded as; IEC 61966-2-1 is sRGB.
_CURVES: tuple[tuple[str, str, Callable[[Floats], Floats]], ...] = (
    ("gamma", "A lacks gamma: its levels are linear in light.", lambda x: x),
    ("gamma", "A has gamma twice: the power 1 / 2.2 is to be taken once.",
     lambda x: x ** GAMMA**-2),
    ("gamma", "A has gamma the wrong way round: the power 2.2 in place of 1 / 2.2.",
     lambda x: x**GAMMA),
    ("gamma", "A is encoded with the sRGB curve in place of gamma 2.2.",
     lambda x: np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)),
    ("unclipped", "A differs only where B is 255: light beyond 1 is to be clipped, not to wrap"
     " round.", lambda x: np.where(x > 1, 0, x ** (1 / GAMMA))),
)  # fmt: skip


def _tones(pair: _Pair) -> Iterator[_Tone]:
    # B's light is known to within the half level by which it was rounded, unless it is clipped.
    lights = [(np.maximum(_SAME - 0.5, 0) / 255) ** GAMMA, ((_SAME + 0.5) / 255) ** GAMMA]
    lights[1][255] = np.inf
    curves = [(*curve, True) for curve in _CURVES]
    a, b = pair.a, pair.low
    sure = pair.known[:, :, None] & (pair.high - b <= pair.noise)
    sure = sure & (b > 20) & (b < 240) & (a > 8) & (a < 248)
    if sure.sum() > 50:
        x, y = linear(a[sure]), linear(b[sure])
        by, power = float(np.median(x / y)), float(np.median(np.log(x) / np.log(y))) / GAMMA
        text = f"A is {'brighter' if by > 1 else 'darker'} by a factor of {by:.3g} in linear light."
        curves.append(("brightness", text, lambda x: (by * x) ** (1 / GAMMA), False))
        text = f"A is encoded with a gamma of about {1 / power:.2f} in place of 2.2."
        curves.append(("gamma", text, lambda x: x**power, False))
        curve = pair.curve()
        if np.ptp(curve) > 32 and _palette(b[sure.any(axis=2)]) > 16:
            sample = ", ".join(f"{k} to {curve[k]:.0f}" for k in (64, 128, 192))
            text = f"A's levels are those of B through another curve, which takes {sample}."
            yield _Tone("curve", text, curve, curve, False)
    for kind, text, encode, fixed in curves:
        low, high = (np.round(255 * np.clip(encode(light), 0, 1)) for light in lights)
        yield _Tone(kind, text, low, high, fixed)


def _edges(image: Codes) -> Bools:
    """Pixels (h, w) with an edge between them and one of their eight neighbours."""
    low, high = (f(image, (3, 3, 1)) for f in (ndimage.minimum_filter, ndimage.maximum_filter))
    edges: Bools = (high - low > _EDGE).any(axis=2)
    return edges


def _shared(a: Bools, b: Bools) -> tuple[float, float]:
    """Part of A's edges that B has, and of B's that A has, within a pixel."""
    wide = [ndimage.binary_dilation(edges, np.ones((3, 3))) for edges in (a, b)]
    first, second = (a & wide[1]).sum() / max(1, a.sum()), (b & wide[0]).sum() / max(1, b.sum())
    return float(first), float(second)


def _shading(pair: _Pair, wrong: Bools, count: int) -> Diagnosis:
    """Tell what is left by where it lies, its sign, and how it ends: the first rule that holds."""
    few = Diagnosis("few", f"{_differ(count)}: too few to tell why.")
    if not wrong.any():
        return few
    a, low, high, clean = pair.a, pair.low, pair.high, pair.noise == 1
    b = np.asarray((low.astype(np.int16) + high) // 2, dtype=np.uint8)
    shown, part = pair.shown, float(wrong.sum() / pair.shown.sum())
    change = (a.astype(np.int16) - np.clip(a, low, high))[wrong]
    brighter, darker = (
        bool((sign * change >= -2 * pair.noise).all(axis=1).mean() > 0.9) for sign in (1, -1)
    )
    word = "brighter" if brighter else "darker" if darker else "brighter or darker"
    one_way, all_over = brighter or darker, part > 0.9
    edges = _edges(a), _edges(b)
    kept, shared = _shared(*edges)
    peak, right_peak = a.max(axis=2), b.max(axis=2)
    black, full = (float(found[wrong].mean()) for found in (peak <= pair.noise, peak == 255))
    colours, right_colours = (_palette(image[shown]) for image in (a, b))
    # How A's light differs from B's: by which factors, how much more where B is bright, in hue.
    least, most, rise, tint = 0.0, np.inf, 0.0, 0.0
    middle = wrong & (right_peak > 20) & (right_peak < 250) & (peak < 250) & (peak > 4)
    if middle.sum() > 20:
        mine, right = linear(a[middle]), linear(b[middle])
        light, right_light = mine.sum(axis=1), right.sum(axis=1)
        least, most = np.percentile(light / right_light, [5, 95])
        ends, more = np.percentile(right_light, [25, 75]), light - right_light
        dim, bright = (
            np.median(more[right_light <= ends[0]]),
            np.median(more[right_light >= ends[1]]),
        )
        rise = bright / dim if dim else 0.0
        hues = mine / light[:, None] - right / right_light[:, None]
        tint = float(np.abs(hues).max(axis=1).mean())
    # A difference ends sharply if, where it ends, it is larger than this part of its maximum.
    sharp = _sharpness(a, b, wrong) > (0.22 if clean else 0.12)
    fades, even = one_way and not sharp, all_over and 0.5 < rise < 2
    specks = 1 - ndimage.binary_opening(wrong, np.ones((3, 3))).sum() / wrong.sum()
    unlit = brighter and high[wrong].max(axis=1).max() <= pair.noise
    at_edges = (edges[0] & edges[1])[wrong].mean() > 0.95
    flat = colours == 1 or (colours <= 16 and 4 * colours < right_colours and full < 0.8)
    share, factors = f"in {part:.1%} of what is shown", f"by factors from {least:.2g} to {most:.2g}"
    levels = np.percentile(np.abs(change).max(axis=1), 95)
    rules = (
        (at_edges and (count < 0.001 * wrong.size or not one_way), "edges",
         "Only edges differ: A's samples lie elsewhere in the pixel, or are several a pixel."),
        (count < 0.001 * wrong.size, *few),
        (all_over and right_colours > 8 and np.isin(a[shown], (0, 255)).all(), "whole numbers",
         "A's levels are 0 and 255 alone: light is made a whole number before it is encoded."),
        (all_over and darker and black > 0.7 and kept > 0.5, "normals",
         f"A is black in {black:.0%} of what B shows: n.l is negative, as of normals inwards."),
        (part > 0.8 and flat and colours < right_colours and a.max() > 64, "unshaded",
         f"A shows silhouettes in {'one colour' if colours == 1 else f'{colours} colours'}: nothing"
         " is shaded."),
        (max(kept, shared) < (0.8 if clean else 0.6), "geometry",
         f"The geometry differs: of B's edges, A has {shared:.0%}.  Check the camera first."),
        (brighter and part > 0.5 and full > 0.8, "overexposed",
         f"A is overexposed {share}: a vector in the shading is not of length 1."),
        (brighter and all_over and tint > 0.025, "colours",
         "Everything is brighter, and of another hue: diffuseColor is not used as it should be."),
        (even and ((brighter and least < 1.25) or (darker and most > 0.8)), "ambient",
         f"A is {word} by the same light everywhere: an ambient term too"
         f" {'many' if brighter else 'few'}."),
        (darker and all_over and most < 0.3, "falls off",
         f"Everything is darker, {factors}: light is not to fall off with distance."),
        (all_over and one_way, "uneven", f"Everything is {word}, {factors} in linear light."),
        (darker and specks > 0.4 and part > 0.02 and clean, "speckled",
         f"A is speckled with dark dots, {share}: surfaces shadow themselves."),
        (darker and part > 0.5, "missing light",
         f"A is darker {share}, and the same elsewhere: it lacks a light."),
        (darker and ((sharp and kept < 0.97) or black > 0.8), "extra shadows",
         f"A is darker {share}, within sharp borders: it has shadows that B has not."),
        (brighter and sharp and shared < 0.95 and part > 0.6, "extra light",
         f"A is brighter {share}, and the same elsewhere: it has a light too many."),
        (brighter and sharp and shared < 0.95, "missing shadows",
         f"Shadows are missing in A: it is brighter {share}, within sharp borders."),
        (fades and rise > 2.2, "highlights" if brighter else "missing highlight",
         f"Highlights are {'stronger or larger' if brighter else 'missing, or weaker,'} in A,"
         f" {share}."),
        (clean and (unlit or (fades and rise < 1)), "facing",
         f"A is {word} {share}, where surfaces turn away from a light: n.l below 0 is 0."),
        (sharp and not one_way and tint > 0.2, "nearest",
         f"Another surface is seen {share}: the nearest hit is the one to show."),
        (True, "other", f"The geometry agrees, the shading differs: A is {word} {share}, mostly"
         f" in the {_place(wrong)}, by up to {levels:.0f} levels."),
    )  # fmt: skip
    return next(Diagnosis(kind, text) for holds, kind, text in rules if holds)


def _place(wrong: Bools) -> str:
    """The ninth of the picture in which most of these pixels are, in words."""
    thirds = [np.array_split(part, 3, axis=1) for part in np.array_split(wrong, 3)]
    row, column = divmod(int(np.argmax([part.sum() for row in thirds for part in row])), 3)
    return f"{('upper', 'middle', 'lower')[row]} {('left', 'centre', 'right')[column]}"


def _palette(colours: Codes) -> int:
    """How many colours 95 % of these (n, 3) have, told apart by steps of 4 levels."""
    _, count = np.unique((colours >> 2).astype(np.intp) @ [65536, 256, 1], return_counts=True)
    return int(np.searchsorted(np.sort(count)[::-1].cumsum(), 0.95 * count.sum())) + 1


def _sharpness(a: Codes, b: Codes, differs: Bools) -> float:
    """How large the difference is where it ends, relative to what it is at most.

    Ends at a silhouette, where both pictures have an edge, do not count.
    """
    size, values = np.abs(linear(a) - linear(b)).mean(axis=2), []
    for axis in (0, 1) if min(differs.shape) > 1 else ():
        steps = [np.abs(np.diff(image.astype(np.int16), axis=axis)).max(axis=2) for image in (a, b)]
        ends = np.diff(differs, axis=axis) & (np.minimum(*steps) <= _EDGE)
        pairs = np.lib.stride_tricks.sliding_window_view(size, 2, axis=axis)
        values.append(pairs.max(axis=2)[ends])
    found = np.concatenate([*values, []])
    return float(np.median(found) / np.percentile(size[differs], 90)) if found.size else 1.0
