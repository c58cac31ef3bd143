"""How far apart two pictures are in linear light, in figures and as a picture."""

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
# SSIM's window (Z. Wang et al., Image quality assessment, IEEE TIP 13(4), 2004).
_WINDOW = 7
# Smaller panels are enlarged, pixel by pixel.
_PANEL, _MARGIN, _LABEL = 300, 8, 24
_PAPER, _INK = (250, 250, 250), (30, 30, 30)
# Colours that stay apart for colour-blind eyes (M. Okabe and K. Ito, 2008).
_BRIGHTER, _DARKER = (1.0, 0.62, 0.0), (0.34, 0.71, 0.91)


def linear(codes: NDArray[np.generic]) -> Floats:
    """Linear light of 8-bit codes: the inverse of the format's gamma of 2.2."""
    light: Floats = (np.arange(256) / 255) ** GAMMA
    return np.asarray(light[codes])


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """How far apart two pictures are, in linear light; each pixel counts by its worst channel.

    `ssim` is of the pictures as displayed, masked pixels included; `rmse` is over pixels and
    channels; `over` counts the pixels that differ by more than 1e-3.
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
    """Measure how far apart two pictures (h, w, 3) of linear radiance are, less a mask (h, w).

    Raises ValueError if the shapes differ, a value is not finite, or every pixel is masked.
    """
    if a.shape != b.shape:
        raise ValueError(f"the pictures' shapes differ: {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("a picture holds values that are not finite")
    kept = np.ones(a.shape[:2], dtype=np.bool_) if mask is None else ~mask
    if not kept.any():
        raise ValueError("every pixel is masked")
    missing = [(0, max(_WINDOW - size, 0)) for size in a.shape[:2]] + [(0, 0)]
    shown = [np.pad(np.float32(x.clip(0, 1)) ** (1 / GAMMA), missing, mode="edge") for x in (a, b)]
    ssim = structural_similarity(*shown, win_size=_WINDOW, channel_axis=2, data_range=1.0)
    difference = np.abs(a - b)[kept]
    pixels = difference.max(axis=1)
    return Figures(
        ssim=float(ssim),
        max=float(pixels.max()),
        p999=float(np.percentile(pixels, 99.9)),
        rmse=float(np.sqrt(np.mean(difference**2))),
        median=float(np.median(pixels)),
        over=int(np.count_nonzero(pixels > 1e-3)),
    )


def write_comparison(path: str | Path, a: Floats, b: Floats, labels: tuple[str, str]) -> None:
    """Write a PNG of A, B and the difference, amplified, under labels.

    A and B are linear radiance (h, w, 3).  Raises OSError if the file cannot be written.
    """
    shown, gain = amplified(a, b)
    titles = (*labels, f"difference, {gain:,.10g} times" if gain else "no difference")
    legend = "orange: the left is brighter, blue: it is darker" if gain else ""
    height, width = a.shape[:2]
    zoom = -(-_PANEL // max(width, height))
    column = max(zoom * width, _PANEL)  # wide enough for a label
    tall = zoom * height + 2 * _LABEL
    sheet = Image.new("RGB", (3 * column + 4 * _MARGIN, tall + 2 * _MARGIN), _PAPER)
    panels = (to_codes(a), to_codes(b), np.round(255 * shown).astype(np.uint8))
    for k, (codes, title) in enumerate(zip(panels, titles, strict=True)):
        part = Image.new("RGB", (column, tall), _PAPER)  # cuts off what is too long for it
        draw, font = ImageDraw.Draw(part), ImageFont.load_default(size=14)
        draw.text((0, 0), title, fill=_INK, font=font)
        draw.text((0, tall - _LABEL + 4), legend if k == 2 else "", fill=_INK, font=font)
        part.paste(Image.fromarray(codes.repeat(zoom, axis=0).repeat(zoom, axis=1)), (0, _LABEL))
        sheet.paste(part, (_MARGIN + k * (column + _MARGIN), _MARGIN))
    with atomic_file(path, b"\x89PNG\r\n\x1a\n") as file:
        sheet.save(file, format="PNG")


def amplified(a: Floats, b: Floats) -> tuple[Floats, float]:
    """The difference in 0 ... 1, orange where A is brighter and blue where darker, and its gain.

    The gain is 1, 2 or 5 times a power of ten, such that all but a thousandth of the pixels'
    differences fit; 0 if there is none.
    """
    difference = a - b
    strongest = np.abs(difference).argmax(axis=2)[:, :, None]
    signed = np.take_along_axis(difference, strongest, axis=2)
    size = np.abs(signed)
    full = float(np.percentile(size, 99.9)) or float(size.max())
    if full == 0:
        return np.zeros(a.shape), 0.0
    power = 10.0 ** np.floor(np.log10(1 / full))
    gain = max(k * power for k in (1, 2, 5) if k * power * full <= 1)
    bright, dark = np.clip(gain * signed, 0, 1), np.clip(-gain * signed, 0, 1)
    return bright * _BRIGHTER + dark * _DARKER, gain
