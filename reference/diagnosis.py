"""Which kind of difference lies between two pictures, in words.

Each kind that can be predicted from the right picture is a hypothesis: for
every pixel and channel an interval of 8-bit codes in which the other picture's
would lie.  The hypothesis that leaves the fewest pixels unexplained is the
diagnosis, if it leaves few enough.  All other kinds are told apart by where the
difference lies, which sign it has, and whether it ends sharply or fades.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import permutations
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tracer.arrays import Bools, Floats

__all__ = ["GAMMA", "Diagnosis", "diagnose", "linear"]

Codes: TypeAlias = NDArray[np.int16]

GAMMA = 2.2

# A hypothesis may leave this part of the differing pixels unexplained.
_EXACT, _SUBPIXEL = 0.02, 0.1
# Levels up to this far apart, in codes, count as equal.
_NOISE = 2
# Neighbours further apart than this, in codes, have an edge between them.
_EDGE = 8
# What holds for this part of the differing pixels counts as true of all.
_NEARLY_ALL = 0.95
# Of so small a part of the picture no kind is told.
_FEW = 0.001
# A difference ends sharply if, where it ends, it is larger than this part of its maximum.
_SHARP = 0.22
# The outline is another if more than this part of the differing pixels is black in one picture.
_OUTLINE = 0.05


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The kind of a difference.

    Attributes
    ----------
    kind : str
        A keyword, such as ``"gamma"``.
    text : str
        A sentence about A, taking B as the right one.
    """

    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class _Hypothesis:
    """What A would be like: codes between `low` and `high`, (h, w, 3)."""

    kind: str
    text: str
    low: NDArray[np.floating]
    high: NDArray[np.floating]


def linear(codes: NDArray[np.generic]) -> Floats:
    """Linear light of 8-bit codes: the inverse of the format's gamma of 2.2."""
    light: Floats = (np.asarray(codes, dtype=np.float64) / 255) ** GAMMA
    return light


def diagnose(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> Diagnosis:
    """Tell which kind of difference lies between A and the right picture, B.

    Parameters
    ----------
    a, b : (h, w, 3) uint8
        Their sizes may differ.
    """
    if a.shape != b.shape:
        return _sizes(a.shape, b.shape)
    x, y = a.astype(np.int16), b.astype(np.int16)
    difference = np.abs(x - y)
    if not difference.any():
        return Diagnosis("identical", "The pictures are identical.")
    if difference.max() == 1:
        return _rounding(x, y)
    if not a.any():
        return Diagnosis("black", "A is black.")
    if not b.any():
        return Diagnosis("black", "B is black, and A is not.")
    if not np.ptp(x, axis=(0, 1)).any():
        return Diagnosis("flat", "A has one colour everywhere.")
    differing = int(np.count_nonzero((difference > 1).any(axis=2)))
    best = min(_exact(x, y), key=lambda guess: _unexplained(x, guess))
    if _unexplained(x, best) <= _EXACT * differing:
        return Diagnosis(best.kind, best.text)
    moved = _moved(x, y)
    if moved is not None and _unexplained(x, moved) <= _SUBPIXEL * differing:
        return Diagnosis(moved.kind, moved.text)
    return _regional(x, y)


def _sizes(a: tuple[int, ...], b: tuple[int, ...]) -> Diagnosis:
    text = f"Different sizes: A has {a[1]}x{a[0]} pixels, B {b[1]}x{b[0]}"
    if a[:2] == b[1::-1]:
        text += "; width and height are swapped"
    elif a[0] * b[1] == a[1] * b[0]:
        text += f"; of the same shape, A {a[0] / b[0]:.3g} times as large"
    return Diagnosis("size", text + ".")


def _rounding(a: Codes, b: Codes) -> Diagnosis:
    """At most one level apart."""
    changed = (a != b).any(axis=2)
    count, lit = int(np.count_nonzero(changed)), int(np.count_nonzero(b.any(axis=2)))
    if count < 0.01 * lit:
        text = f"{_differ(count)} by one level: rounding, nothing to worry about."
        return Diagnosis("rounding", text)
    if (a <= b).all():
        return Diagnosis(
            "cut off", "One level of rounding: A is cut off where it should be rounded."
        )
    if (a >= b).all():
        return Diagnosis(
            "cut off",
            "One level of rounding, only upwards: B is cut off, or A is rounded up, or A's factor"
            " is more than 255.",
        )
    return Diagnosis(
        "rounding", "One level of rounding, up and down: 255 is not the factor, or noise was added."
    )


def _differ(count: int) -> str:
    return "One pixel differs" if count == 1 else f"{count} pixels differ"


def _unexplained(a: Codes, guess: _Hypothesis) -> int:
    outside = (a < guess.low) | (a > guess.high)
    return int(np.count_nonzero(outside.any(axis=2)))


def _exact(a: Codes, b: Codes) -> Iterator[_Hypothesis]:
    """Hypotheses that move whole pixels, or map levels to other levels."""
    for kind, text, image in (
        ("mirrored", "A is mirrored: left and right are swapped.", b[:, ::-1]),
        ("flipped", "A is upside down: row 0 should be the top.", b[::-1]),
        ("turned", "A is turned by 180 degrees.", b[::-1, ::-1]),
        ("inverted", "A is the negative of B.", 255 - b),
    ):
        yield _Hypothesis(kind, text, image - 1.0, image + 1.0)
    if b.shape[0] == b.shape[1]:
        text = "A is transposed: its rows are B's columns, as where x and y are swapped."
        image = b.transpose(1, 0, 2)
        yield _Hypothesis("transposed", text, image - 1.0, image + 1.0)
    for order in list(permutations(range(3)))[1:]:  # the first is the right one
        names = ", ".join(("red", "green", "blue")[channel] for channel in order)
        text = f"A's channels are in another order: {names}."
        yield _Hypothesis("channels", text, b[:, :, order] - 1.0, b[:, :, order] + 1.0)
    steps, (height, width) = (-2, -1, 0, 1, 2), b.shape[:2]
    for right in steps:
        for down in steps:
            # What comes in from beyond the border may be anything.
            known = 2 * abs(right) < width and 2 * abs(down) < height
            if known and (right or down):
                text = f"A is shifted by {_way(right, down)}."
                yield _Hypothesis("shifted", text, *_around(b, [(right, down)]))
    yield from _tones(a, b)
    if not np.ptp(a, axis=2).any():
        text = "A is grey, as where one channel stands for all; B has colours."
        low, high = b.min(axis=2, keepdims=True), b.max(axis=2, keepdims=True)
        yield _Hypothesis("grey", text, low - 1.0, high + 1.0)
    full = b == 255
    text = "A differs only where B is 255: light beyond 1 is to be clipped, not to wrap round."
    yield _Hypothesis("unclipped", text, np.where(full, 0, b - 1.0), np.where(full, 255, b + 1.0))


def _tones(a: Codes, b: Codes) -> Iterator[_Hypothesis]:
    """Hypotheses that map levels to other levels."""
    # B's light is known to within the half level by which it was rounded, unless it is clipped.
    low = linear(np.maximum(b - 0.5, 0))
    high = np.where(b < 255, linear(b + 0.5), np.inf)

    def tone(kind: str, text: str, curve: Callable[[Floats], Floats]) -> _Hypothesis:
        levels = [np.round(255 * np.clip(curve(light), 0, 1)) for light in (low, high)]
        return _Hypothesis(kind, text, levels[0] - 1, levels[1] + 1)

    yield tone("gamma", "A lacks gamma: its levels are linear in light.", lambda light: light)
    yield tone("gamma", "A is encoded with the sRGB curve in place of gamma 2.2.", _srgb)
    middle = (b > 20) & (b < 240) & (a > 8) & (a < 248)
    if not middle.any():
        return
    factor = float(np.median(linear(a[middle]) / linear(b[middle])))
    word = "brighter" if factor > 1 else "darker"
    text = f"A is {word} by a factor of {factor:.3g} in linear light."
    # What is displayed is the light to the power of 1 / 2.2.
    yield tone("brightness", text, lambda light: (factor * light) ** (1 / GAMMA))
    power = float(np.median(np.log(a[middle] / 255) / np.log(linear(b[middle]))))
    text = f"A is encoded with a gamma of about {1 / power:.2f} in place of 2.2."
    yield tone("gamma", text, lambda light: light**power)


def _srgb(light: Floats) -> Floats:
    """IEC 61966-2-1."""
    root: Floats = 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, 12.92 * light, root)


def _around(b: Codes, moves: list[tuple[int, int]]) -> tuple[Floats, Floats]:
    """Range of the codes at several whole-pixel shifts of B; unknown beyond its border."""
    height, width = b.shape[:2]
    low, high = np.full(b.shape, np.inf), np.full(b.shape, -np.inf)
    inside = np.ones((height, width), dtype=np.bool_)
    for right, down in moves:
        rows, columns = np.arange(height) - down, np.arange(width) - right
        inside &= ((rows >= 0) & (rows < height))[:, None] & (columns >= 0) & (columns < width)
        image = b[np.clip(rows, 0, height - 1)][:, np.clip(columns, 0, width - 1)]
        low, high = np.minimum(low, image), np.maximum(high, image)
    low[~inside], high[~inside] = -np.inf, np.inf
    return low - 1, high + 1


def _way(right: float, down: float) -> str:
    """A shift in words: "half a pixel to the right and a whole one down"."""
    names = {0.5: "half a pixel", 1: "one pixel", 1.5: "one and a half pixels", 2: "two pixels"}
    parts = [
        f"{names[abs(size)]} {ways[size < 0]}"
        for size, ways in ((right, ("to the right", "to the left")), (down, ("down", "up")))
        if size
    ]
    return " and ".join(parts)


def _moved(a: Codes, b: Codes) -> _Hypothesis | None:
    """A shift by half pixels, or a stretch by one, estimated from gradients.

    Along each axis the shift is modelled as c + s x, x from -1/2 at one border
    to 1/2 at the other: least squares of A - B = -(c + s x) dI/dx (B. Lucas and
    T. Kanade, An iterative image registration technique, IJCAI 1981).
    """
    height, width = b.shape[:2]
    if min(height, width) < 4:
        return None
    mean = (a + b) / 2.0
    change = (a - b).astype(np.float64)[1:-1, 1:-1]
    across = (mean[1:-1, 2:] - mean[1:-1, :-2]) / 2
    down = (mean[2:, 1:-1] - mean[:-2, 1:-1]) / 2
    x = ((np.arange(1, width - 1) + 0.5) / width - 0.5)[:, None]
    y = ((np.arange(1, height - 1) + 0.5) / height - 0.5)[:, None, None]
    columns = [across, across * x, down, down * y]
    matrix = np.array([[float(np.sum(p * q)) for q in columns] for p in columns])
    target = np.array([-float(np.sum(p * change)) for p in columns])
    fit = np.linalg.lstsq(matrix, target, rcond=1e-6)[0]
    shift_x, stretch_x, shift_y, stretch_y = (np.round(2 * fit) / 2).tolist()
    if max(abs(shift_x), abs(shift_y)) > 1.5:
        return None
    if not shift_x and not shift_y and max(abs(stretch_x), abs(stretch_y)) >= 1:
        word = "smaller" if stretch_x + stretch_y < 0 else "larger"
        return _Hypothesis(
            "stretched",
            f"A is a pixel {word} than it should be, about its centre: pixel centres lie at"
            " (column + 1/2) / width, not at column / (width - 1).",
            *_stretched(b, stretch_x, stretch_y),
        )
    if not shift_x and not shift_y:
        return None
    moves = [(i, j) for i in _between(shift_x) for j in _between(shift_y)]
    text = f"A is shifted by {_way(shift_x, shift_y)}"
    if 0.5 in (abs(shift_x), abs(shift_y)):
        text += ": samples belong at the pixels' centres"
    return _Hypothesis("shifted", text + ".", *_around(b, moves))


def _stretched(b: Codes, stretch_x: float, stretch_y: float) -> tuple[Floats, Floats]:
    """Range of the codes if B's left half moves to one side and its right half to the other."""
    low, high = np.empty(b.shape), np.empty(b.shape)
    rows, columns = (np.array_split(np.arange(size), 2) for size in b.shape[:2])
    for down, part in zip((-stretch_y, stretch_y), rows, strict=True):
        for right, half in zip((-stretch_x, stretch_x), columns, strict=True):
            moves = [(i, j) for i in {0, int(np.sign(right))} for j in {0, int(np.sign(down))}]
            place = np.ix_(part, half)
            low[place], high[place] = (bound[place] for bound in _around(b, moves))
    return low, high


def _between(shift: float) -> set[int]:
    """The whole shifts on both sides of one by half pixels."""
    return {int(np.floor(shift)), int(np.ceil(shift))}


def _regional(a: Codes, b: Codes) -> Diagnosis:
    """Diagnosis by where the difference lies, its sign, and how it ends."""
    change = a - b
    differs: Bools = np.abs(change).max(axis=2) > _NOISE
    if not differs.any():
        return Diagnosis("rounding", "Two levels at most: rounding, or noise.")
    empty: Bools = b.max(axis=2) == 0
    count, share = int(np.count_nonzero(differs)), float(differs.mean())
    behind = differs & empty
    if np.count_nonzero(behind) > max(0.9 * count, 0.5 * np.count_nonzero(empty)) and (
        np.ptp(a[behind], axis=0).max() <= _NOISE
    ):
        return Diagnosis("background", "A's background is not black.")
    # In every channel: of another colour, one may be brighter and another darker.
    brighter = bool((change[differs] >= -_NOISE).all(axis=1).mean() > _NEARLY_ALL)
    darker = bool((change[differs] <= _NOISE).all(axis=1).mean() > _NEARLY_ALL)
    few = share < _FEW
    at_edges = (_edges(a) & _edges(b))[differs].mean() > _NEARLY_ALL
    if at_edges and (few or not (brighter or darker)):
        return Diagnosis(
            "edges",
            "Only edges differ: A or B is anti-aliased, samples lie elsewhere in the pixel, or"
            " shadows are moved, by an offset or by a light that is elsewhere.",
        )
    if few:
        return Diagnosis("few", f"{_differ(count)}: too few to tell why.")
    same_outline = np.mean(a.any(axis=2) == b.any(axis=2)) > 0.99
    # An ambient term lights what is black as well.
    if (same_outline or brighter or darker) and differs[~empty].mean() > 0.97:
        if brighter:
            return Diagnosis(
                "brightness",
                "A is brighter everywhere, not by one factor: an ambient term, or other lights.",
            )
        return Diagnosis(
            "brightness",
            "Everything is lit otherwise, not by one factor: lights that fall off with distance,"
            " an ambient term that A lacks, or other colours.",
        )
    if brighter or darker:
        return _one_sided(a, b, differs, brighter=brighter)
    return Diagnosis(
        "other",
        f"{share:.1%} of the pixels differ by more than {_NOISE} levels, in none of the ways"
        " known here: look at the geometry, the camera and the shaders.",
    )


def _one_sided(a: Codes, b: Codes, differs: Bools, *, brighter: bool) -> Diagnosis:
    """Diagnosis of a part of A that is brighter than in B, or darker, by how it ends."""
    word, lights = ("larger", "has a light too many") if brighter else ("smaller", "lacks a light")
    of_size = f"are {word} in A: look at radii, the eye and the window"
    outline = (a.any(axis=2) != b.any(axis=2))[differs].mean() > _OUTLINE
    size = np.abs(linear(a) - linear(b)).mean(axis=2)
    if _sharpness(a, b, differs, size) > _SHARP:
        if brighter:
            kind = "missing shadows"
            text = (
                f"Shadows are missing in A ({differs.mean():.1%} of its pixels), or it has a light"
                " or an object too many, or much wider highlights."
            )
        else:
            kind = "extra shadows"
            text = (
                "A has shadows that B has not, as where surfaces shadow themselves, or it lacks a"
                " light, an object or a part of its highlights."
            )
        # A single light's shadows are as black as what is behind all objects.
        return Diagnosis(kind, f"{text} Or objects {of_size}." if outline else text)
    if outline:
        return Diagnosis("outline", f"Objects {of_size}; or it {lights}.")
    if brighter:
        return Diagnosis("highlights", f"Highlights are stronger or larger in A, or it {lights}.")
    return Diagnosis(
        "missing highlight", f"Highlights are missing, or weaker, in A, or it {lights}."
    )


def _edges(image: Codes) -> Bools:
    """Pixels (h, w) with an edge between them and one of their eight neighbours."""
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(0, 1))
    edges: Bools = (np.ptp(windows, axis=(3, 4)) > _EDGE).any(axis=2)
    return edges


def _sharpness(a: Codes, b: Codes, differs: Bools, size: Floats) -> float:
    """How large the difference is where it ends, relative to what it is at most.

    Ends at a silhouette, where both pictures have an edge, do not count.
    """
    inner = []
    for axis in (0, 1):
        step = [np.abs(np.diff(image, axis=axis)).max(axis=2) <= _EDGE for image in (a, b)]
        ends = np.diff(differs, axis=axis) & (step[0] | step[1])
        pairs = np.lib.stride_tricks.sliding_window_view(size, 2, axis=axis)
        inner.append(pairs.max(axis=2)[ends])
    values = np.concatenate(inner)
    if not values.size:
        return 1.0
    return float(np.median(values) / np.percentile(size[differs], 90))
