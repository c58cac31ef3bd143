"""Measure how much two pictures differ in linear light, and draw the difference.

A picture file stores an 8-bit code for each channel of a pixel.  *Linear light* is the number from
0 to 1 for which the code stands: (code / 255)^2.2.  SSIM is the structural similarity of two
pictures, which is 1 if they are equal.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated as Shaped
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from skimage.metrics import structural_similarity

from reference.judges.arrays import Bools, Floats
from reference.pictures import Codes
from tracer.files import open_atomically

Differences: TypeAlias = NDArray[np.float32]

GAMMA = 2.2
"""Exponent of the gamma encoding of 8-bit pictures in the scene format."""
LARGE_DIFFERENCE_TEXT = "1e-3"
"""`LARGE_DIFFERENCE` as reports print it."""
LARGE_DIFFERENCE = float(LARGE_DIFFERENCE_TEXT)
"""Pixels that differ by more than this in linear light are counted."""
PERCENTILE = 99.9
"""Percentile of the pixels' differences that is reported.  It also limits their amplification."""

# Side of the window of SSIM in pixels (Z. Wang et al., Image quality assessment, IEEE TIP 13(4),
# 2004).
_SSIM_SIDE = 7
# Maximum number of pixels, approximately, in a band of rows that is compared or drawn at once.
# Comparing takes about 100 bytes of memory per pixel.
_PIXELS_PER_BAND = 500_000
# Pictures are enlarged, pixel by pixel, to panels at least this many pixels wide or high.
_MIN_PANEL_SIDE = 300
# Lengths in pixels on the sheet that shows two pictures and their difference.
_MARGIN = 8  # around each panel
_LABEL_HEIGHT = 24  # of a line of text
_LEGEND_GAP = 4  # between a picture and the line below it
_FONT_SIZE = 14
# 8-bit colours of the background and the text.
_PAPER_COLOR = (250, 250, 250)
_INK_COLOR = (30, 30, 30)
# Colours, from 0 to 1, where the first picture is brighter and where it is darker.  Colour-blind
# readers can tell them apart (M. Okabe and K. Ito, Color Universal Design, 2008).
_BRIGHTER_COLOR = (1.0, 0.62, 0.0)
_DARKER_COLOR = (0.34, 0.71, 0.91)


def decode_to_linear(codes: Shaped[NDArray[Any], "..."]) -> Shaped[Floats, "..."]:
    """Convert the 8-bit codes of a picture to linear light from 0 to 1."""
    light_by_code: Floats = (np.arange(256) / 255) ** GAMMA
    return np.asarray(light_by_code[codes])


@dataclass(frozen=True, slots=True, kw_only=True)
class Metrics:
    """Measures of the difference between two pictures, in linear light.

    The difference of a pixel is the largest absolute difference of its three channels.
    """

    ssim: float
    max: float
    percentile: float  # the `PERCENTILE`-th percentile of the pixels' differences
    rmse: float  # root mean square difference of all channels
    median: float
    differing_count: int  # number of pixels that differ by more than `LARGE_DIFFERENCE`

    def __str__(self) -> str:
        """Format all measures as one line of text."""
        return (
            f"SSIM {self.ssim:.6f}; linear difference: max {self.max:.1e},"
            f" {PERCENTILE}% {self.percentile:.1e}, median {self.median:.1e}, RMSE {self.rmse:.1e},"
            f" pixels over {LARGE_DIFFERENCE_TEXT}: {self.differing_count}"
        )


def measure_differences(
    first_image: Shaped[Floats, "height width 3"],
    second_image: Shaped[Floats, "..."],
    is_excluded: Shaped[Bools, "height width"] | None = None,
) -> Metrics:
    """Measure how much two pictures in linear light differ.

    Pixels that are marked in `is_excluded` are left out of all measures except the SSIM.  By
    default, no pixel is excluded.  Raise ValueError if the shapes of the pictures differ, if a
    value is not finite, or if every pixel is excluded.
    """
    shape = first_image.shape
    if shape != second_image.shape:
        raise ValueError(f"the pictures' shapes differ: {shape} and {second_image.shape}")
    if not (np.isfinite(first_image).all() and np.isfinite(second_image).all()):
        raise ValueError("a picture contains values that are not finite")
    is_compared = np.ones(shape[:2], dtype=np.bool_) if is_excluded is None else ~is_excluded
    if not is_compared.any():
        raise ValueError("every pixel is excluded")
    channel_difference = np.abs(first_image - second_image)[is_compared]
    pixel_difference = channel_difference.max(axis=1)
    return Metrics(
        ssim=_compute_ssim(first_image, second_image),
        max=float(pixel_difference.max()),
        percentile=float(np.percentile(pixel_difference, PERCENTILE)),
        rmse=float(np.sqrt(np.mean(channel_difference**2))),
        median=float(np.median(pixel_difference)),
        differing_count=int(np.count_nonzero(pixel_difference > LARGE_DIFFERENCE)),
    )


def _compute_ssim(
    first_image: Shaped[Floats, "height width 3"], second_image: Shaped[Floats, "height width 3"]
) -> float:
    """Compute the SSIM of two pictures in linear light, after encoding them with gamma.

    A picture that is smaller than a window of SSIM is extended: its last row and its last column
    are repeated.
    """
    height, width, _ = first_image.shape
    padding = (0, max(_SSIM_SIDE - height, 0)), (0, max(_SSIM_SIDE - width, 0)), (0, 0)
    padded_pair = []
    for image in (first_image, second_image):
        encoded_image = image.clip(0, 1).astype(np.float32) ** (1 / GAMMA)
        padded_pair.append(np.pad(encoded_image, padding, mode="edge"))
    ssim = structural_similarity(*padded_pair, win_size=_SSIM_SIDE, channel_axis=2, data_range=1.0)
    return float(ssim)


class Comparison(NamedTuple):
    """How much two gamma-encoded pictures, A and B, differ in linear light."""

    ssim: float
    rmse: float  # root mean square difference of all channels
    max: float  # largest absolute difference of all channels
    # Difference of each pixel in the channel that differs most; positive where A is brighter.
    difference: Shaped[Differences, "height width"]


def compare_codes(
    codes_a: Shaped[Codes, "height width 3"], codes_b: Shaped[Codes, "height width 3"]
) -> Comparison:
    """Measure how much two gamma-encoded pictures of equal size differ in linear light.

    Large pictures are compared in bands of rows, to save memory.  The result is the same.
    """
    height, width, _ = codes_a.shape
    band_height = max(1, _PIXELS_PER_BAND // width)
    window_margin = _SSIM_SIDE - 1
    # Number of rows in which a window of SSIM may begin.
    start_row_count = max(1, height - window_margin)
    ssim = sum_of_squares = max_difference = 0.0
    difference_bands = []
    for band_start in range(0, height, band_height):
        # Windows that begin in the band may extend below it.
        rows = slice(band_start, band_start + band_height + window_margin)
        light_a = decode_to_linear(codes_a[rows])
        light_b = decode_to_linear(codes_b[rows])
        # The SSIM of a picture is the mean over its windows.  So the SSIM of a band is weighted by
        # the share of the windows that begin in it.
        band_start_row_count = max(0, min(band_height, start_row_count - band_start))
        ssim += band_start_row_count / start_row_count * _compute_ssim(light_a, light_b)
        channel_difference = (light_a - light_b)[:band_height]
        max_difference = max(max_difference, float(np.abs(channel_difference).max()))
        sum_of_squares += float((channel_difference**2).sum())
        difference_bands.append(get_largest_difference(channel_difference))
    return Comparison(
        ssim=ssim,
        rmse=float(np.sqrt(sum_of_squares / codes_a.size)),
        max=max_difference,
        difference=np.concatenate(difference_bands),
    )


def write_comparison(
    path: str | Path,
    images: tuple[Shaped[Codes, "height width 3"], Shaped[Codes, "height width 3"]],
    difference: Shaped[Differences, "height width"],
    titles: tuple[str, str],
) -> None:
    """Write a PNG file that shows two pictures and their amplified difference side by side.

    An existing file is replaced only if it is a PNG file.  Raise OSError if the file cannot be
    written.

    Parameters
    ----------
    images
        The left and the right picture.  Small pictures are enlarged: each pixel becomes a square.
    difference
        The left picture minus the right one, in linear light (see `get_largest_difference`).
    titles
        Texts above the left and the right picture.  What does not fit is cut off.
    """
    difference_codes, gain = amplify_difference(difference)
    difference_title = f"difference, {gain:,.10g} times" if gain else "no difference"
    legend = "orange: the left is brighter, blue: it is darker" if gain else ""
    panels = [
        _Panel(codes=images[0], title=titles[0], legend=""),
        _Panel(codes=images[1], title=titles[1], legend=""),
        _Panel(codes=difference_codes, title=difference_title, legend=legend),
    ]
    height, width = difference.shape
    zoom = -(-_MIN_PANEL_SIDE // max(width, height))
    panel_width = max(zoom * width, _MIN_PANEL_SIDE)  # wide enough for a title
    panel_height = _LABEL_HEIGHT + zoom * height + _LABEL_HEIGHT
    sheet_size = 3 * panel_width + 4 * _MARGIN, panel_height + 2 * _MARGIN
    sheet = Image.new("RGB", sheet_size, _PAPER_COLOR)
    for panel_index, panel in enumerate(panels):
        left = _MARGIN + panel_index * (panel_width + _MARGIN)
        _paste_panel(sheet, panel, left, panel_width, zoom)
    with open_atomically(path, b"\x89PNG\r\n\x1a\n") as file:
        sheet.save(file, format="PNG")


class _Panel(NamedTuple):
    """A picture with texts above and below it."""

    codes: Shaped[Codes, "height width 3"]
    title: str
    legend: str


def _paste_panel(sheet: Image.Image, panel: _Panel, left: int, width: int, zoom: int) -> None:
    """Draw a panel on a sheet: its title, its picture enlarged `zoom` times, and its legend."""
    picture_height, picture_width, _ = panel.codes.shape
    picture_top = _MARGIN + _LABEL_HEIGHT
    legend_top = picture_top + zoom * picture_height + _LEGEND_GAP
    font = ImageFont.load_default(size=_FONT_SIZE)
    for text, top in ((panel.title, _MARGIN), (panel.legend, legend_top)):
        label = Image.new("RGB", (width, _LABEL_HEIGHT), _PAPER_COLOR)
        ImageDraw.Draw(label).text((0, 0), text, fill=_INK_COLOR, font=font)
        sheet.paste(label, (left, top))
    band_height = max(1, _PIXELS_PER_BAND // picture_width)
    for start in range(0, picture_height, band_height):
        band = panel.codes[start : start + band_height]
        enlarged = band.repeat(zoom, axis=0).repeat(zoom, axis=1)
        sheet.paste(Image.fromarray(enlarged), (left, picture_top + zoom * start))


def get_largest_difference(
    channel_difference: Shaped[Floats, "height width 3"],
) -> Shaped[Differences, "height width"]:
    """Return each pixel's signed difference in the channel that differs most.

    If two channels of opposite sign differ most, the positive difference is returned.
    """
    minimum = channel_difference.min(axis=2)
    maximum = channel_difference.max(axis=2)
    difference: Differences = np.where(maximum >= -minimum, maximum, minimum).astype(np.float32)
    return difference


def amplify_difference(
    difference: Shaped[Differences, "height width"],
) -> tuple[Shaped[Codes, "height width 3"], float]:
    """Draw a difference between two pictures, multiplied by a gain; return the codes and the gain.

    Pixels are orange where the difference is positive, blue where it is negative, and black where
    it is 0.  The gain is 0 if all differences are 0.
    """
    gain = _choose_gain(difference)
    codes = np.zeros((*difference.shape, 3), dtype=np.uint8)
    colors = 255 * np.array([_BRIGHTER_COLOR, _DARKER_COLOR])
    brighter_color, darker_color = colors.astype(np.float32)
    for row_codes, row in zip(codes, difference, strict=True):  # row by row, to save memory
        intensity = np.clip(gain * row, -1, 1)[:, None]
        row_codes[:] = np.round(np.maximum(intensity * brighter_color, -intensity * darker_color))
    return codes, gain


def _choose_gain(difference: Shaped[Differences, "height width"]) -> float:
    """Choose the number by which differences of pixels are multiplied to become visible.

    It is the largest of 1, 2 and 5 times a power of ten with which the `PERCENTILE`-th percentile
    of the absolute differences becomes at most 1.  If that percentile is 0, because fewer pixels
    differ, the largest difference takes its place.  The gain is 0 if that is 0, too.
    """
    abs_difference = np.abs(difference)
    max_shown_difference = float(np.percentile(abs_difference, PERCENTILE))
    max_shown_difference = max_shown_difference or float(abs_difference.max())
    if max_shown_difference == 0:
        return 0.0
    power_of_ten = float(10.0 ** np.floor(np.log10(1 / max_shown_difference)))
    gains = [factor * power_of_ten for factor in (1, 2, 5)]
    return max(gain for gain in gains if gain * max_shown_difference <= 1)
