"""Compare two pictures: figures, a three-part picture, and the kind of difference.

``python -m reference.compare A.png B.png`` compares A with B, the right one.
"""

from __future__ import annotations

import argparse
import re
import stat
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from skimage.metrics import structural_similarity

from reference.command import run, spare_inputs
from reference.diagnosis import GAMMA, diagnose, linear
from tracer.arrays import Bools, Floats
from tracer.commands import atomic_file, file_name, is_folder, print_line, printable
from tracer.picture.png import PNG, to_codes

__all__ = ["Figures", "figures", "main", "write_comparison"]

# SSIM's window (Z. Wang et al., Image quality assessment, IEEE TIP 13(4), 2004).
_WINDOW = 7
# Pixels further apart than this, in linear light, are counted.
_OVER = 1e-3
# Smaller panels are enlarged, pixel by pixel.
_PANEL = 300
# Formats whose bits a channel are known before they are decoded.
_FORMATS = ("BMP", "GIF", "JPEG", "PNG", "PPM", "TGA", "TIFF", "WEBP")
_MARGIN, _LABEL = 8, 24
_PAPER, _INK = (250, 250, 250), (30, 30, 30)
# Colours that stay apart for colour-blind eyes (M. Okabe and K. Ito, 2008).
_BRIGHTER, _DARKER = (1.0, 0.62, 0.0), (0.34, 0.71, 0.91)


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """How far apart two pictures are.

    Attributes
    ----------
    ssim : float
        Mean structural similarity of the displayed pictures, masked pixels included.
    max, p999, median : float
        Largest, 99.9th percentile and median of the pixels' differences in
        linear light, each pixel's the largest of its channels'.
    rmse : float
        Root mean square of the linear difference over pixels and channels.
    over : int
        Pixels that differ by more than 1e-3.
    masked : int
        Pixels left out of everything but `ssim`.
    """

    ssim: float
    max: float
    p999: float
    rmse: float
    median: float
    over: int
    masked: int

    def __str__(self) -> str:
        text = (
            f"SSIM {self.ssim:.6f}   max {self.max:.2e}   p99.9 {self.p999:.2e}"
            f"   RMSE {self.rmse:.2e}   median {self.median:.2e}   over 1e-3: {self.over}"
        )
        return text + (f"   masked: {self.masked}" if self.masked else "")


def figures(a: Floats, b: Floats, mask: Bools | None = None) -> Figures:
    """Measure how far apart two pictures are.

    Parameters
    ----------
    a, b : (h, w, 3) float
        Linear radiance.
    mask : (h, w) bool, optional
        Pixels to leave out.

    Raises
    ------
    ValueError
        If the shapes differ, a value is not finite, or every pixel is masked.
    """
    if a.shape != b.shape:
        raise ValueError(f"the pictures' shapes differ: {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("a picture holds values that are not finite")
    kept = np.ones(a.shape[:2], dtype=np.bool_) if mask is None else ~mask
    if not kept.any():
        raise ValueError("every pixel is masked")
    rows, columns = (max(_WINDOW - size, 0) for size in a.shape[:2])
    missing = (0, rows), (0, columns), (0, 0)
    # What a screen is given, in 0 ... 1.
    shown = [np.pad(np.clip(image, 0, 1) ** (1 / GAMMA), missing, mode="edge") for image in (a, b)]
    ssim = structural_similarity(*shown, win_size=_WINDOW, channel_axis=2, data_range=1.0)
    difference = np.abs(a - b)[kept]
    pixels = difference.max(axis=1)
    return Figures(
        ssim=float(ssim),
        max=float(pixels.max()),
        p999=float(np.percentile(pixels, 99.9)),
        rmse=float(np.sqrt(np.mean(difference**2))),
        median=float(np.median(pixels)),
        over=int(np.count_nonzero(pixels > _OVER)),
        masked=int(kept.size - pixels.size),
    )


def write_comparison(path: str | Path, a: Floats, b: Floats, labels: tuple[str, str]) -> None:
    """Write a PNG of three parts: A, B and the difference, amplified.

    Parameters
    ----------
    path : str or Path
    a, b : (h, w, 3) float
        Linear radiance.
    labels : (str, str)
        What A and B are.

    Raises
    ------
    ValueError
        If the shapes differ.
    OSError
        If the file cannot be written.
    """
    if a.shape != b.shape:
        raise ValueError(f"the pictures' shapes differ: {a.shape} and {b.shape}")
    shown, gain = amplified(a, b)
    titles = (*labels, f"difference, {gain:,.10g} times" if gain else "no difference")
    height, width = a.shape[:2]
    zoom = -(-_PANEL // max(width, height))
    panel_width, panel_height = width * zoom, height * zoom
    column = max(panel_width, _PANEL)  # wide enough for a label
    sheet = Image.new(
        "RGB", (3 * column + 4 * _MARGIN, panel_height + 2 * _MARGIN + 2 * _LABEL), _PAPER
    )
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=14)

    def write(x: int, y: int, text: str) -> None:
        """Write as much of a text as fits into a column."""
        shown = text
        while draw.textlength(shown, font) > column:
            shown = shown.removesuffix("...")[:-1] + "..."
        draw.text((x, y), shown, fill=_INK, font=font)

    panels = (to_codes(a), to_codes(b), np.round(255 * shown).astype(np.uint8))
    for k, (codes, title) in enumerate(zip(panels, titles, strict=True)):
        left = _MARGIN + k * (column + _MARGIN)
        panel = Image.fromarray(np.ascontiguousarray(codes)).resize(
            (panel_width, panel_height), Image.Resampling.NEAREST
        )
        sheet.paste(panel, (left, _MARGIN + _LABEL))
        write(left, _MARGIN, title)
    if gain:
        legend = "orange: the left is brighter, blue: it is darker"
        write(left, _MARGIN + _LABEL + panel_height + 4, legend)
    with atomic_file(path, PNG) as file:
        sheet.save(file, format="PNG")


def amplified(a: Floats, b: Floats) -> tuple[Floats, float]:
    """The difference as a picture, and by how much it is amplified.

    Returns
    -------
    image : (h, w, 3)
        In 0 ... 1: orange where A is brighter, blue where it is darker.
    gain : float
        1, 2 or 5 times a power of ten, such that all but a thousandth of the
        pixels' differences fit; 0 if there is none.
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


def read_picture(path: str | Path) -> NDArray[np.uint8]:
    """Read a picture of 8 bits a channel as codes (h, w, 3).

    What is transparent in it is black, as where a scene has nothing.

    Raises
    ------
    OSError, SyntaxError, ValueError
        If it cannot be read, or has more than 8 bits a channel.
    """
    if not stat.S_ISREG(Path(path).stat().st_mode):  # a pipe or a device may block
        raise ValueError("not a regular file")
    try:
        opened = Image.open(path, formats=_FORMATS)
    except Image.DecompressionBombError as error:
        raise ValueError(str(error)) from error
    with opened as image:
        if image.mode not in ("1", "L", "LA", "P", "PA", "RGB", "RGBA"):
            raise ValueError(f"has pixels of mode {image.mode}; 8-bit RGB is needed")
        if any(_deep(codec, coding) for codec, _, _, coding in image.tile):
            raise ValueError("has more than 8 bits a channel; 8-bit RGB is needed")
        rgba = image.convert("RGBA")
    black = Image.new("RGBA", rgba.size, (0, 0, 0, 255))
    return np.asarray(Image.alpha_composite(black, rgba).convert("RGB"))


def _note(name: str, path: Path) -> str:
    """What a file's format may have done to the levels of its picture; empty if nothing."""
    with Image.open(path, formats=_FORMATS) as image:
        if image.format in ("JPEG", "WEBP"):
            return f"{name} is a {image.format}, which may change levels: save it as PNG."
        if image.mode in ("P", "PA"):
            return f"{name} has a palette, of 256 colours at most: save it as RGB."
        if image.convert("RGBA").getchannel("A").getextrema() != (255, 255):
            return f"{name} is transparent in places, which counts as black: save it as RGB."
        return ""


def _deep(codec: str, coding: Any) -> bool:
    """Whether Pillow would drop the low bits of a picture, told by how it would decode it."""
    if codec.startswith("ppm"):
        _, largest = coding
        return bool(largest > 255)
    # The raw mode, alone or first of several: 16 bits a channel in whichever byte order.
    return re.search(r";16[BLN]", str(coding)) is not None


def tolerance(text: str) -> float:
    """The type of a tolerance; argparse names it so where the text is no number."""
    value = float(text)
    if not value >= 0:
        raise argparse.ArgumentTypeError(f"must be 0 or more, is {text}")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m reference.compare",
        description="Compare picture A with B, the right one: figures in linear light, the kind"
        " of difference, and a picture of A, B and the difference.",
        epilog="Exit status: 0 within the tolerances, 1 beyond them, 2 wrong usage or a picture"
        " that cannot be read.  Without a tolerance, any difference exits with 1.",
    )
    parser.add_argument("a", metavar="A.png", type=Path, help="the picture in question")
    parser.add_argument("b", metavar="B.png", type=Path, help="the right one")
    parser.add_argument("--ssim", type=tolerance, metavar="S", help="least SSIM that is tolerated")
    parser.add_argument(
        "--max", type=tolerance, metavar="M", help="largest linear difference that is tolerated"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=file_name,
        metavar="PATH",
        help="the comparison, or a folder for it that is there (A.compare.png)",
    )
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = _parser()
    options = parser.parse_args(arguments)
    output = options.a.parent / f"{options.a.stem}.compare.png"
    if options.output is not None:
        output = Path(options.output, output.name if is_folder(options.output) else "")
    spare_inputs(parser, output, (options.a, options.b))
    try:
        return _compare(options, output)
    except MemoryError:
        print_line(
            sys.stderr, printable(f"{options.a}: not enough memory to compare it; compare a part")
        )
        return 2


def _compare(options: argparse.Namespace, output: Path) -> int:
    codes = []
    for path in (options.a, options.b):
        try:
            codes.append(read_picture(path))
        except (OSError, SyntaxError, ValueError) as error:  # the second is Pillow's, of a PNG
            reason = getattr(error, "strerror", None) or error
            print_line(sys.stderr, printable(f"{path}: cannot be read: {reason}"))
            return 2
    diagnosis = diagnose(*codes)
    if codes[0].shape != codes[1].shape:
        print_line(sys.stdout, diagnosis.text)
        return 1
    a, b = (linear(picture) for picture in codes)
    result = figures(a, b)
    try:
        write_comparison(output, a, b, (printable(options.a.name), printable(options.b.name)))
    except OSError as error:
        print_line(sys.stderr, printable(f"{output}: cannot be written: {error.strerror or error}"))
        return 2
    named_files = (("A", options.a), ("B", options.b)) if diagnosis.kind != "identical" else ()
    notes = [note for name, path in named_files if (note := _note(name, path))]
    if not notes or diagnosis.kind != "other":  # or else the format may be to blame, not the scene
        notes.append(diagnosis.text)
    for line in (str(result), *notes, printable(str(output))):
        print_line(sys.stdout, line)
    if options.ssim is None and options.max is None:
        return int(diagnosis.kind != "identical")
    within = (options.ssim is None or result.ssim >= options.ssim) and (
        options.max is None or result.max <= options.max
    )
    return int(not within)


if __name__ == "__main__":
    run(main)
