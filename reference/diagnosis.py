"""Name the kinds of difference between two pictures, in words: geometry first, shading next.

Geometry: B is turned over, moved or stretched until A is like it, whatever curve maps the levels of
one to the other's, so that a wrong gamma hides nothing.  Levels: a curve that explains nearly all
of them is named.  What is still unexplained is told by where it lies, which sign it has, and how it
ends.  Two faults are told one after the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import permutations, product
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage, optimize
from skimage.registration import phase_cross_correlation

__all__ = ["GAMMA", "Diagnosis", "diagnose", "linear"]

Codes: TypeAlias = NDArray[np.uint8]
Floats: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]
T = TypeVar("T")

GAMMA = 2.2

# Larger pictures are judged by every second, third ... row and column; some questions need fewer.
_PIXELS, _FEWER = 60_000, 12_000
# Neighbours further apart than this, in codes, have an edge between them.
_EDGE = 8
# What holds for this part of the differing pixels counts as true of all.
_NEARLY_ALL = 0.9
# A lossy format changes levels by up to so many, but for a few per cent of them.
_LOSSY = 6
# A difference ends sharply if, where it ends, it is larger than this part of its maximum.
_SHARP = 0.22
# Longer side of the pictures in which a zoom is looked for, and made precise.
_SMALL, _FINE = 64, 256


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
    if not difference.any():
        return Diagnosis("identical", "The pictures are identical.")
    if difference.max() == 1:
        return _rounding(a, b)
    for name, image, other in (("A", a, "B"), ("B", b, "A")):
        if image.max() < noise:
            return Diagnosis("black", f"{name} is black, and {other} is not.")
        if np.ptp(image, axis=(0, 1)).max() < noise:
            return Diagnosis("flat", f"{name} has one colour everywhere.")
    if (np.abs(255 - b.astype(np.int16) - a) <= noise).mean() > 0.98:
        return Diagnosis("inverted", "A is the negative of B.")
    count = int(np.count_nonzero((difference > noise).any(axis=2)))
    if not count:
        return Diagnosis("noise", f"No level is off by more than {noise}: noise of the format.")
    if lossy:
        a, b = (_halved(image) for image in (a, b))
    found: list[Diagnosis] = []

    def keep(result: tuple[T, Diagnosis | None]) -> T:
        if result[1] is not None:
            found.append(result[1])
        return result[0]

    a = keep(_background(a, b, noise))
    a = keep(_turned(a, b))
    a = keep(_reordered(a, b))
    pair = keep(_moved(a, b, noise))
    pair = keep(_encoded(pair))
    left = pair.misfit(_SAME, _SAME)
    # At edges the amount of a shift is never quite known.
    if left.sum() > ((0.03 if found else 0) + (0.03 if lossy else 0)) * pair.shown.sum() or (
        not found and not lossy
    ):
        keep((pair, _shading(pair, left, count)))
    if not found:
        text = f"{_differ(count)}, as the format of one of the pictures may make them."
        return Diagnosis("noise", text)
    return Diagnosis(" + ".join(f.kind for f in found), " ".join(f.text for f in found))


def _halved(image: Codes) -> Codes:
    """A picture of half the size, without most of what compression does to it."""
    height, width = (size - size % 2 for size in image.shape[:2])
    quarters = image[:height, :width].reshape(height // 2, 2, width // 2, 2, 3)
    return np.asarray(np.round(quarters.mean(axis=(1, 3))), dtype=np.uint8)


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
    if count < 0.01 * lit:
        return Diagnosis(
            "rounding", f"{_differ(count)} by one level: rounding, nothing to worry about."
        )
    if (a <= b).all():
        text = "One level of rounding: A is cut off where it should be rounded."
    elif (a >= b).all():
        text = "One level of rounding, only upwards: A's factor is more than 255, or B is cut off."
    else:
        text = "One level of rounding, up and down: the factor is not 255."
    return Diagnosis("cut off", text)


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
        dark = np.maximum(self.a, self.high).max(axis=2) <= self.noise
        shown: Bools = self.known & ~dark
        return shown

    def curve(self) -> Floats:
        """Level of A (256,) for each of B: the median where B has no edge."""
        sure = self.known & ((self.high - self.low).max(axis=2) <= _EDGE)
        levels = 256 * ((self.low[sure].astype(np.intp) + self.high[sure]) // 2) + self.a[sure]
        counts = np.bincount(levels.ravel(), minlength=65536).reshape(256, 256).cumsum(axis=1)
        if not levels.size:
            return _SAME
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
        curves = self.curve(), _SAME
        left = min(int(self.misfit(curve, curve).sum()) for curve in curves)
        return left / max(1, int(self.shown.sum())) if self.known.any() else 1.0


_SAME = np.arange(256.0)


class _Motion(NamedTuple):
    """B as A shows it: (x, y), from the centre, is B's matrix (x, y) - shift, within `slack`."""

    kind: str
    text: str
    matrix: Floats
    shift: Floats
    slack: float

    def back(self) -> _Motion:
        inverse = np.linalg.inv(self.matrix).astype(np.float64)
        return self._replace(matrix=inverse, shift=-self.shift)

    def pair(self, a: Codes, b: Codes, noise: int) -> _Pair:
        height, width = a.shape[:2]
        step, middle = _step(a), np.array([width - 1, height - 1]) / 2
        x = np.arange(0, width, step) - middle[0]
        y = np.arange(0, height, step)[:, None] - middle[1]
        places = [
            np.round(m[0] * x + m[1] * y - shift + half, 6)
            for m, shift, half in zip(self.matrix, self.shift, middle, strict=True)
        ]
        ends = [(np.floor(p - self.slack), np.ceil(p + self.slack)) for p in places]
        columns, rows = ([end.astype(np.intp) for end in both] for both in ends)
        if not self.slack and all((low == high).all() for low, high in ends):
            columns, rows = columns[:1], rows[:1]
        there, known = [], np.ones((), dtype=np.bool_)
        for column, row in product(columns, rows):
            known = known & (column >= 0) & (column < width) & (row >= 0) & (row < height)
            there.append(b[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)])
        low, high = np.minimum.reduce(there), np.maximum.reduce(there)
        return _Pair(a[::step, ::step], low, high, known, noise)


def _step(image: Codes, most: int = _PIXELS) -> int:
    """Every so many rows and columns of a picture are about so many pixels, at most."""
    return max(1, math.ceil(math.sqrt(image.shape[0] * image.shape[1] / most)))


def _background(a: Codes, b: Codes, noise: int) -> tuple[Codes, Diagnosis | None]:
    """A with a black background."""
    step = _step(b)
    black = b.max(axis=2) <= noise
    behind = a[::step, ::step][black[::step, ::step]].astype(np.intp) @ [65536, 256, 1]
    if not behind.size:
        return a, None
    common = int(np.bincount(np.unique(behind, return_inverse=True)[1].ravel()).argmax())
    colour = np.array([(np.unique(behind)[common] >> k) & 255 for k in (16, 8, 0)])
    empty = (np.abs(a.astype(np.int16) - colour) <= noise).all(axis=2)
    if colour.max() <= 2 * noise or min(empty[black].mean(), black[empty].mean()) < 0.8:
        return a, None
    text = f"A's background is not black: it has the levels {', '.join(map(str, colour))}."
    return np.where(empty[:, :, None], np.uint8(0), a), Diagnosis("background", text)


_ORDERS = list(permutations(range(3)))


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


_TURNS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "mirrored": ("A is mirrored: left and right are swapped.", lambda a: a[:, ::-1]),
    "flipped": ("A is upside down: row 0 should be the top.", lambda a: a[::-1]),
    "turned": ("A is turned by 180 degrees.", lambda a: a[::-1, ::-1]),
    "transposed": ("A is transposed: x and y are swapped.", lambda a: a.swapaxes(0, 1)),
}


def _turned(a: Codes, b: Codes) -> tuple[Codes, Diagnosis | None]:
    """A as it would be if it were not turned over."""
    step = _step(b)
    edges, right = _edges(a[::step, ::step]), _edges(b[::step, ::step])
    levels, lines = _unlike(a, b).min(), max(_shared(edges, right))
    found: list[tuple[float, Codes, Diagnosis]] = []
    for kind, (text, turn) in _TURNS.items():
        if (image := turn(a)).shape == b.shape:
            unlike = _unlike(image, b).min()
            by_edges = unlike < levels and lines < 0.9 and max(_shared(turn(edges), right)) > 0.95
            if unlike < min(0.15, 0.4 * levels) or by_edges:
                found.append((unlike, image, Diagnosis(kind, text)))
    return min(found, key=lambda one: one[0])[1:] if found else (a, None)


def _reordered(a: Codes, b: Codes) -> tuple[Codes, Diagnosis | None]:
    """A with its channels in B's order."""
    unlike = _unlike(a, b)
    best = int(unlike.argmin())
    if not unlike[best] < min(0.15, 0.5 * unlike[0] - 1e-3):
        return a, None
    order = list(_ORDERS[best])
    names = ", ".join(("red", "green", "blue")[order.index(channel)] for channel in range(3))
    text = f"A's channels are in another order: {names}."
    return a[:, :, order], Diagnosis("channels", text)


_STILL = _Motion("", "", np.eye(2), np.zeros(2), 0)


def _moved(a: Codes, b: Codes, noise: int) -> tuple[_Pair, Diagnosis | None]:
    """Both at the same places: B shifted, stretched or turned as A is."""
    still = _STILL.pair(a, b, noise)
    before = still.unexplained()
    if before > 0.002:
        for motions in (_slid, _far):
            for motion in motions(a, b, still):
                moved, opposite = (m.pair(a, b, noise) for m in (motion, motion.back()))
                after = moved.unexplained()
                # The leeway that a motion brings would explain something the other way as well.
                if after < min(0.3 * before, 0.5 * opposite.unexplained()):
                    return moved, Diagnosis(motion.kind, motion.text)
    return still, None


def _slid(a: Codes, b: Codes, still: _Pair) -> Iterator[_Motion]:
    """A shift by half pixels, or a stretch by one, estimated from gradients.

    Along each axis the shift is modelled as c + s x, x from -1/2 at one border to 1/2 at the
    other: least squares of A - B = -(c + s x) dI/dx (B. Lucas and T. Kanade, An iterative image
    registration technique, IJCAI 1981).
    """
    height, width = b.shape[:2]
    if min(height, width) < 4:
        return
    step, curve = _step(b, 4 * _PIXELS), still.curve()

    def at(down: int, right: int) -> tuple[Floats, Floats]:
        place = slice(1 + down, height - 1 + down, step), slice(1 + right, width - 1 + right, step)
        return a[place].astype(np.float64), curve[b[place]]

    (here, there), right, left, lower, upper = at(0, 0), at(0, 1), at(0, -1), at(1, 0), at(-1, 0)
    across, down = ((sum(p) - sum(q)) / 4 for p, q in ((right, left), (lower, upper)))
    x = ((np.arange(1, width - 1, step) + 0.5) / width - 0.5)[:, None]
    y = ((np.arange(1, height - 1, step) + 0.5) / height - 0.5)[:, None, None]
    columns = [across, across * x, down, down * y]
    matrix = np.array([[float((p * q).sum()) for q in columns] for p in columns])
    target = np.array([float((p * (there - here)).sum()) for p in columns])
    fit = np.linalg.lstsq(matrix, target, rcond=1e-6)[0]
    shift, stretch = np.round(2 * fit[::2]) / 2, np.round(fit[1::2])
    if shift.any() and np.abs(shift).max() <= 2:
        half = ": samples belong at the pixels' centres" if (shift % 1).any() else ""
        text = f"A is shifted by {_way(*shift.tolist())}{half}."
        yield _Motion("shifted", text, np.eye(2), shift, 0)
    elif np.abs(stretch).max() == 1 and not shift.any():
        word = "smaller" if stretch.sum() < 0 else "larger"
        text = (
            f"A is a pixel {word} than it should be, about its centre: pixel centres lie at"
            " (column + 1/2) / width, not at column / (width - 1)."
        )
        matrix = np.diag(1 - stretch / (width, height))
        yield _Motion("stretched", text, matrix, np.zeros(2), 0)


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
    small, fine = (
        [ndimage.gaussian_filter(_thumbnail(image, size), 1) for image in (a, b)]
        for size in (_SMALL, _FINE)
    )
    if min(image.std() for image in (*small, *fine)) < 1:
        return
    scale = max(1, max(a.shape) / _FINE)

    def zoom(across: float, down: float) -> _Motion:
        text = "A shows everything {} as large as B, about its centre: check the window's size and"
        text = f"{text.format(_times(across))} distance."
        if abs(across / down - 1) > 0.02:
            sides = [("width", "viewWidth", across), ("height", "viewHeight", down)]
            sides = [side for side in sides if abs(side[2] - 1) > 0.01]
            to = " and ".join(f"{_times(by)} B's {name}" for name, _, by in sides)
            check = " and ".join(name for _, name, _ in sides)
            text = f"A is stretched about its centre, to {to}: check {check}."
        return _Motion("zoomed", text, np.diag([1 / across, 1 / down]), np.zeros(2), 0.5)

    def roll(angle: float) -> _Motion:
        c, s = np.cos(angle), np.sin(angle)
        way = "clockwise" if angle < 0 else "anticlockwise"
        text = f"A is turned by {abs(np.degrees(angle)):.0f} degrees {way}: check viewUp."
        return _Motion("rolled", text, np.array([[c, -s], [s, c]]), np.zeros(2), 0.5)

    def move(right: float, down: float) -> _Motion:
        shift = np.round(np.array([right, down]) * scale)
        text = f"A is shifted by {_way(*shift.tolist())}: check viewDir." if shift.any() else ""
        return _Motion("shifted", text, np.eye(2), shift, 1)

    def likeness(motion: _Motion, images: list[Floats], scale: float = 1) -> float:
        matrix, middle = motion.matrix[::-1, ::-1], (np.array(images[1].shape) - 1) / 2
        offset = middle - matrix @ middle - motion.shift[::-1] / scale
        moved = ndimage.affine_transform(images[1], matrix, offset, order=1, cval=np.nan)
        return _correlation(images[0], moved)

    turns = np.linspace(-np.pi, np.pi, 60, endpoint=False)
    shift = phase_cross_correlation(*fine, normalization=None, upsample_factor=10)[0][::-1]
    angle = max(turns, key=lambda angle: likeness(roll(angle), small))
    starts: tuple[tuple[Callable[..., _Motion], list[float]], ...] = (
        (zoom, list(_best_zoom(*small))),
        (roll, [angle]),
    )
    motions = [move(*shift)]
    for kind, start in starts:
        found = optimize.minimize(
            lambda by, kind=kind: -likeness(kind(*by), fine), start, method="Nelder-Mead",
            options={"maxfev": 60, "xatol": 1e-4},
        )  # fmt: skip
        motions.append(kind(*found.x))
    best = max(motions, key=lambda motion: likeness(motion, fine, scale))
    if best.shift.any() or 0.01 < np.abs(best.matrix - np.eye(2)).max() < 20:
        yield best


def _times(factor: float) -> str:
    return f"{factor:.2f} times"


def _thumbnail(image: Codes, size: int) -> Floats:
    """A picture's grey levels, as large as `size` at most."""
    grey = Image.fromarray(np.ascontiguousarray(image)).convert("L")
    grey.thumbnail((size, size), Image.Resampling.BOX)
    return np.asarray(grey, dtype=np.float64)


def _correlation(a: Floats, b: Floats) -> float:
    """How alike two pictures are, where the second is known; -1 if that is next to nowhere."""
    known = ~np.isnan(b)
    x, y = a[known], b[known]
    if x.size < 0.02 * a.size or min(x.std(), y.std()) < 1:
        return -1.0
    x, y = x - x.mean(), y - y.mean()
    # Not x @ y: threads of BLAS take longer to wake than this takes.
    return float((x * y).sum() / np.sqrt((x * x).sum() * (y * y).sum()))


def _best_zoom(a: Floats, b: Floats) -> tuple[float, float]:
    """Factors across and down that make B most like A."""
    factors = np.exp(np.linspace(-2, 2, 33))
    sides = []
    for size in a.shape:
        middle = (size - 1) / 2
        at = np.round(middle + (np.arange(size) - middle) / factors[:, None]).astype(np.intp)
        inside = [(p >= 0) & (p < size) for p in at]
        sides.append([(np.flatnonzero(k), p[k]) for p, k in zip(at, inside, strict=True)])
    best = (1.0, 1.0, -1.0)
    for (rows, from_rows), down in zip(sides[0], factors, strict=True):
        strip, b_strip = a[rows], b[from_rows]
        for (columns, from_columns), across in zip(sides[1], factors, strict=True):
            alike = _correlation(strip[:, columns], b_strip[:, from_columns])
            if alike > best[2] and rows.size * columns.size > 0.02 * a.size:
                best = (float(across), float(down), alike)
    return best[:2]


def _encoded(pair: _Pair) -> tuple[_Pair, Diagnosis | None]:
    """The same, B's levels mapped as A's are."""
    shown = max(1, int(pair.shown.sum()))
    before = int(pair.misfit(_SAME, _SAME).sum()) / shown
    tried = [(int(pair.misfit(t.low, t.high).sum()) / shown, t) for t in _tones(pair)]
    named = [one for one in tried if one[1].kind != "curve"]
    left, tone = min(named, key=lambda one: one[0])
    if left > 0.03:
        left, tone = min(tried, key=lambda one: one[0])
    # A curve without a parameter may leave half to other faults.
    if not (
        left <= min(0.03, 0.3 * before) < before - (0.05 if pair.noise > 1 else 0)
        or (tone.fixed and left < 0.5 < 0.8 < before)
    ):
        return pair, None
    ends = tone.low[pair.low], tone.high[pair.high]
    low, high = (f(*ends).astype(np.uint8) for f in (np.minimum, np.maximum))
    mapped = _Pair(pair.a, low, high, pair.known, pair.noise)
    return mapped, Diagnosis(tone.kind, tone.text)


class _Tone(NamedTuple):
    """A curve of levels: for each of B (256,) the least and the largest level of A."""

    kind: str
    text: str
    low: Floats
    high: Floats
    fixed: bool = True


def _tones(pair: _Pair) -> Iterator[_Tone]:
    # B's light is known to within the half level by which it was rounded, unless it is clipped.
    lights = [(np.maximum(_SAME - 0.5, 0) / 255) ** GAMMA, ((_SAME + 0.5) / 255) ** GAMMA]
    lights[1][255] = np.inf

    def tone(kind: str, text: str, curve: Callable[[Floats], Floats], fixed: bool = True) -> _Tone:
        low, high = (np.round(255 * np.clip(curve(light), 0, 1)) for light in lights)
        return _Tone(kind, text, low, high, fixed)

    yield tone("gamma", "A lacks gamma: its levels are linear in light.", lambda x: x)
    text = "A has gamma twice: the power 1 / 2.2 is to be taken once."
    yield tone("gamma", text, lambda x: x ** (1 / GAMMA**2))
    text = "A has gamma the wrong way round: the power 2.2 in place of 1 / 2.2."
    yield tone("gamma", text, lambda x: x**GAMMA)
    yield tone("gamma", "A is encoded with the sRGB curve in place of gamma 2.2.", _srgb)
    text = "A differs only where B is 255: light beyond 1 is to be clipped, not to wrap round."
    full = np.where(_SAME == 255, 0, _SAME)
    yield _Tone("unclipped", text, full, _SAME)
    a, b = pair.a, pair.low
    sure = pair.known[:, :, None] & (pair.high - b <= pair.noise)
    sure = sure & (b > 20) & (b < 240) & (a > 8) & (a < 248)
    if sure.sum() > 50:
        x, y = linear(a[sure]), linear(b[sure])
        by = float(np.median(x / y))
        text = f"A is {'brighter' if by > 1 else 'darker'} by a factor of {by:.3g} in linear light."
        yield tone("brightness", text, lambda light: (by * light) ** (1 / GAMMA), False)
        power = float(np.median(np.log(x) / np.log(y))) / GAMMA
        text = f"A is encoded with a gamma of about {1 / power:.2f} in place of 2.2."
        yield tone("gamma", text, lambda light: light**power, False)
        curve = pair.curve()
    if sure.sum() > 50 and np.ptp(curve) > 32 and _palette(b[sure.any(axis=2)]) > 16:
        sample = ", ".join(f"{k} to {curve[k]:.0f}" for k in (64, 128, 192))
        text = f"A's levels are those of B through another curve, which takes {sample}."
        yield _Tone("curve", text, curve, curve, False)


def _srgb(light: Floats) -> Floats:
    """IEC 61966-2-1."""
    root: Floats = 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, 12.92 * light, root)


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
    a, low, high, noise = pair.a, pair.low, pair.high, pair.noise
    if not wrong.any():
        return Diagnosis("few", f"{_differ(count)}: too few to tell why.")
    b = np.asarray((low.astype(np.int16) + high) // 2, dtype=np.uint8)
    shown, part = pair.shown, float(wrong.sum() / pair.shown.sum())
    change = (a.astype(np.int16) - np.clip(a, low, high))[wrong]
    brighter, darker = (
        bool((sign * change >= -2 * noise).all(axis=1).mean() > _NEARLY_ALL) for sign in (1, -1)
    )
    edges = _edges(a), _edges(b)
    kept, shared = _shared(*edges)
    peak, right_peak = a.max(axis=2), b.max(axis=2)
    black, full = (float(found[wrong].mean()) for found in (peak <= noise, peak == 255))
    colours, right_colours = (_palette(image[shown]) for image in (a, b))
    # How A's light differs from B's: by which factors, how much more where B is bright, in hue.
    least, most, rise, tint = 0.0, np.inf, 0.0, 0.0
    middle = wrong & (right_peak > 20) & (right_peak < 250) & (peak < 250) & (peak > 4)
    if middle.sum() > 20:
        mine, right = linear(a[middle]), linear(b[middle])
        light, right_light = mine.sum(axis=1), right.sum(axis=1)
        least, most = np.percentile(light / right_light, [5, 95])
        ends = np.percentile(right_light, [25, 75])
        places = right_light <= ends[0], right_light >= ends[1]
        dim, bright = (float(np.median((light - right_light)[place])) for place in places)
        rise = bright / dim if dim else 0.0
        tint = float(
            np.abs(mine / light[:, None] - right / right_light[:, None]).max(axis=1).mean()
        )
    clean = noise == 1
    sharp = _sharpness(a, b, wrong) > (_SHARP if clean else 0.12)
    fades, all_over = (brighter or darker) and not sharp, part > _NEARLY_ALL
    specks = 1 - ndimage.binary_opening(wrong, np.ones((3, 3))).sum() / wrong.sum()
    unlit = brighter and high[wrong].max(axis=1).max() <= noise
    at_edges = (edges[0] & edges[1])[wrong].mean() > 0.95
    share = f"in {part:.1%} of what is shown"
    word = "brighter" if brighter else "darker" if darker else "brighter or darker"
    of_levels = np.percentile(np.abs(change).max(axis=1), 95)
    rules = (
        (at_edges and (count < 0.001 * wrong.size or not (brighter or darker)), "edges",
         "Only edges differ: A's samples lie elsewhere in the pixel, or are several a pixel."),
        (count < 0.001 * wrong.size, "few", f"{_differ(count)}: too few to tell why."),
        (all_over and right_colours > 8 and np.isin(a[shown], (0, 255)).all(), "whole numbers",
         "A's levels are 0 and 255 alone: light is made a whole number before it is encoded."),
        (all_over and darker and black > 0.7 and kept > 0.5, "normals",
         f"A is black in {black:.0%} of what B shows: n.l is negative, as of normals inwards."),
        (part > 0.8 and colours == 1 < right_colours, "unshaded",
         "A shows silhouettes in one colour: nothing is shaded."),
        (part > 0.8 and colours <= 16 and 4 * colours < right_colours and full < 0.8
         and a.max() > 64, "unshaded",
         f"A has no more than {colours} colours: objects are drawn, but not shaded."),
        (max(kept, shared) < (0.8 if clean else 0.6), "geometry",
         f"The geometry differs: of B's edges, A has {shared:.0%}.  Check the camera first."),
        (brighter and part > 0.5 and full > 0.8, "overexposed",
         f"A is overexposed {share}: a vector in the shading is not of length 1."),
        (brighter and all_over and tint > 0.025, "colours",
         "Everything is brighter, and of another hue: diffuseColor is not used as it should be."),
        (brighter and all_over and 0.5 < rise < 2 and least < 1.25, "ambient",
         "A is brighter by the same light everywhere: an ambient term too many."),
        (darker and all_over and 0.5 < rise < 2 and most > 0.8, "ambient",
         "A is darker by the same light everywhere: it lacks an ambient term."),
        (darker and all_over and most < 0.3, "falls off", "Everything is darker, by factors from"
         f" {least:.2g} to {most:.2g}: light is not to fall off with distance."),
        (all_over and (brighter or darker), "uneven",
         f"Everything is {word}, by factors from {least:.2g} to {most:.2g} in linear light."),
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
        (brighter and fades and rise > 2.2, "highlights",
         f"Highlights are stronger or larger in A, {share}."),
        (darker and fades and rise > 2.2, "missing highlight",
         f"Highlights are missing, or weaker, in A, {share}."),
        (clean and (unlit or (fades and rise < 1)), "facing",
         f"A is {word} {share}, where surfaces turn away from a light: n.l below 0 is 0."),
        (sharp and not (brighter or darker) and tint > 0.2, "nearest",
         f"Another surface is seen {share}: the nearest hit is the one to show."),
        (True, "other", f"The geometry agrees, the shading differs: A is {word} {share}, mostly"
         f" in the {_place(wrong)}, by up to {of_levels:.0f} levels."),
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
