"""Measure how much two pictures differ in linear light, and draw the difference."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from skimage.metrics import structural_similarity

from tracer import to_codes
from tracer.files import atomic_file

Bools: TypeAlias = NDArray[np.bool_]
Floats: TypeAlias = NDArray[np.float64]

GAMMA = 2.2
"""Exponent of the encoding of 8-bit pictures, as the scene format has it."""

# Side of the window of SSIM in pixels (Z. Wang et al., Image quality assessment, IEEE TIP 13(4),
# 2004).
SSIM_WINDOW = 7
# Pixels that differ by more than this, in linear light, are counted.
_COUNTED_DIFFERENCE = 1e-3
# Percentile of the pixels' differences that is reported, and that the amplified difference shows.
_PERCENTILE = 99.9
# Pictures are enlarged, pixel by pixel, to panels at least this wide or high; lengths in pixels.
_MIN_PANEL, _MARGIN, _LABEL_HEIGHT, _FONT_SIZE = 300, 8, 24, 14
_PAPER_COLOR, _INK_COLOR = (250, 250, 250), (30, 30, 30)
# Colours that colour-blind readers can tell apart (M. Okabe and K. Ito, Color Universal Design,
# 2008).
_BRIGHTER_COLOR, _DARKER_COLOR = (1.0, 0.62, 0.0), (0.34, 0.71, 0.91)


def linear(codes: NDArray[np.generic]) -> Floats:
    """Decode 8-bit codes (any shape) to linear light, by the inverse of the format's gamma."""
    light: Floats = (np.arange(256) / 255) ** GAMMA
    return np.asarray(light[codes])


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """How much two pictures differ, in linear light.

    The difference of a pixel is that of its worst channel.

    Attributes
    ----------
    ssim : float
        Structural similarity of the pictures as displayed, masked pixels included.
    max, p999, median : float
        Maximum, 99.9th percentile and median of the pixels' differences.
    rmse : float
        Root mean square difference of pixels and channels.
    over : int
        Number of pixels whose difference is more than 1e-3.
    """

    ssim: float
    max: float
    p999: float
    rmse: float
    median: float
    over: int

    def __str__(self) -> str:
        return (
            f"SSIM {self.ssim:.6f}; linear difference: max {self.max:.1e}, 99.9% {self.p999:.1e},"
            f" median {self.median:.1e}, RMSE {self.rmse:.1e}, pixels over 1e-3: {self.over}"
        )


def figures(a: Floats, b: Floats, mask: Bools | None = None) -> Figures:
    """Measure how much two pictures differ.

    Parameters
    ----------
    a, b : (height, width, 3) float arrays
        Linear radiance.
    mask : (height, width) bool array, optional
        Pixels to exclude, except from SSIM.

    Raises
    ------
    ValueError
        If the shapes differ, a value is not finite, or every pixel is masked.
    """
    if a.shape != b.shape:
        raise ValueError(f"the pictures' shapes differ: {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("a picture contains values that are not finite")
    kept = np.ones(a.shape[:2], dtype=np.bool_) if mask is None else ~mask
    if not kept.any():
        raise ValueError("every pixel is masked")
    padding = [(0, max(SSIM_WINDOW - size, 0)) for size in a.shape[:2]] + [(0, 0)]
    shown = [np.pad(np.float32(x.clip(0, 1)) ** (1 / GAMMA), padding, mode="edge") for x in (a, b)]
    ssim = structural_similarity(*shown, win_size=SSIM_WINDOW, channel_axis=2, data_range=1.0)
    difference = np.abs(a - b)[kept]
    pixels = difference.max(axis=1)
    return Figures(
        ssim=float(ssim),
        max=float(pixels.max()),
        p999=float(np.percentile(pixels, _PERCENTILE)),
        rmse=float(np.sqrt(np.mean(difference**2))),
        median=float(np.median(pixels)),
        over=int(np.count_nonzero(pixels > _COUNTED_DIFFERENCE)),
    )


def write_comparison(path: str | Path, a: Floats, b: Floats, labels: tuple[str, str]) -> None:
    """Write a PNG file with two pictures and their amplified difference, side by side.

    Parameters
    ----------
    path : str or Path
        The file to write.
    a, b : (height, width, 3) float arrays
        Linear radiance of the left and the middle picture.
    labels : (str, str)
        Titles of these pictures; what does not fit is cut off.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    difference, gain = amplified(a, b)
    titles = (*labels, f"difference, {gain:,.10g} times" if gain else "no difference")
    legends = ("", "", "orange: the left is brighter, blue: it is darker" if gain else "")
    height, width = a.shape[:2]
    zoom = -(-_MIN_PANEL // max(width, height))
    panel_width = max(zoom * width, _MIN_PANEL)  # wide enough for a title
    panel_height = zoom * height + 2 * _LABEL_HEIGHT
    size = 3 * panel_width + 4 * _MARGIN, panel_height + 2 * _MARGIN
    sheet, font = Image.new("RGB", size, _PAPER_COLOR), ImageFont.load_default(size=_FONT_SIZE)
    pictures = (to_codes(a), to_codes(b), np.round(255 * difference).astype(np.uint8))
    for k, (codes, title, legend) in enumerate(zip(pictures, titles, legends, strict=True)):
        panel = Image.new("RGB", (panel_width, panel_height), _PAPER_COLOR)
        draw = ImageDraw.Draw(panel)
        draw.text((0, 0), title, fill=_INK_COLOR, font=font)
        draw.text((0, panel_height - _LABEL_HEIGHT + 4), legend, fill=_INK_COLOR, font=font)
        enlarged = codes.repeat(zoom, axis=0).repeat(zoom, axis=1)
        panel.paste(Image.fromarray(enlarged), (0, _LABEL_HEIGHT))
        sheet.paste(panel, (_MARGIN + k * (panel_width + _MARGIN), _MARGIN))
    with atomic_file(path, b"\x89PNG\r\n\x1a\n") as file:
        sheet.save(file, format="PNG")


def amplified(a: Floats, b: Floats) -> tuple[Floats, float]:
    """Make a picture of the difference of two pictures, amplified so that it is visible.

    Parameters
    ----------
    a, b : (height, width, 3) float arrays
        Linear radiance.

    Returns
    -------
    picture : (height, width, 3) float array
        Colours from 0 to 1: orange where `a` is brighter, blue where it is darker.  Their
        brightness is the amplified difference of the channel that differs most.
    gain : float
        Factor by which the difference is amplified: 1, 2 or 5 times a power of ten, so that 99.9 %
        of the pixels' differences fit.  0 if there is no difference.
    """
    difference = a - b
    channel = np.abs(difference).argmax(axis=2)[:, :, None]
    signed = np.take_along_axis(difference, channel, axis=2)
    size = np.abs(signed)
    largest = float(np.percentile(size, _PERCENTILE)) or float(size.max())
    if largest == 0:
        return np.zeros(a.shape), 0.0
    power = 10.0 ** np.floor(np.log10(1 / largest))
    gain = max(k * power for k in (1, 2, 5) if k * power * largest <= 1)
    brighter, darker = np.clip(gain * signed, 0, 1), np.clip(-gain * signed, 0, 1)
    return brighter * _BRIGHTER_COLOR + darker * _DARKER_COLOR, gain
