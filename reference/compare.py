"""Compare pictures with the right ones, in linear light, and tell the kind of difference.

    python -m reference.compare A.png B.png
    python -m reference.compare HAND-INS/ RIGHT/

B is the right picture, or a scene, which is rendered.  All pictures in a folder A, and in its
folders, are compared with B, or with those of the same names in a folder B.  Beside each picture
that differs goes one of A, B and the difference.  Exit status: 0 if all are within the tolerances,
1 if some are not, 2 for wrong usage, 3 if some cannot be read.  Without a tolerance, no difference
is tolerated.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import argparse
import csv
import io
import json
import os
import re
import stat
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from skimage.metrics import structural_similarity

from reference.alignment import Bools, Floats
from reference.command import parser, spare_inputs
from reference.diagnosis import GAMMA, diagnose, linear
from tracer import SceneFileError, load_scene, render, to_codes
from tracer.command.arguments import file_name, is_folder
from tracer.command.process import print_line
from tracer.files import atomic_file
from tracer.messages import printable

__all__ = ["Figures", "figures", "main", "write_comparison"]

# SSIM's window (Z. Wang et al., Image quality assessment, IEEE TIP 13(4), 2004).
_WINDOW = 7
# Smaller panels are enlarged, pixel by pixel.
_PANEL, _MARGIN, _LABEL = 300, 8, 24
_PAPER, _INK = (250, 250, 250), (30, 30, 30)
# So many pictures take longer than to start further processes.
_MANY = 8
# Formats whose bits a channel are known before they are decoded.
_FORMATS = ("BMP", "GIF", "JPEG", "PNG", "PPM", "TGA", "TIFF", "WEBP")
_LOSSY = ("JPEG", "WEBP")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".ppm", ".tga", ".tif", ".tiff", ".webp")
# Colours that stay apart for colour-blind eyes (M. Okabe and K. Ito, 2008).
_BRIGHTER, _DARKER = (1.0, 0.62, 0.0), (0.34, 0.71, 0.91)


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
    masked: int

    def __str__(self) -> str:
        text = (
            f"SSIM {self.ssim:.6f}   max {self.max:.2e}   p99.9 {self.p999:.2e}"
            f"   RMSE {self.rmse:.2e}   median {self.median:.2e}   over 1e-3: {self.over}"
        )
        return text + (f"   masked: {self.masked}" if self.masked else "")


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
        masked=int(kept.size - pixels.size),
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


class Picture(NamedTuple):
    """A picture's codes (h, w, 3), a note on what its format did to them, and whether it did."""

    codes: NDArray[np.uint8]
    note: str = ""
    lossy: bool = False


def read_picture(path: Path) -> Picture:
    """Read a picture, or render a scene file; what is transparent is black.

    Raises OSError, SyntaxError, ValueError, or Pillow's own, if it cannot be read, is no scene, or
    has colours of more than 8 bits a channel.
    """
    if not stat.S_ISREG(path.stat().st_mode):  # a pipe or a device may block
        raise ValueError("not a regular file")
    if path.suffix.lower() == ".xml":
        return Picture(to_codes(render(load_scene(path))))
    with Image.open(path, formats=_FORMATS) as image:
        if image.mode.startswith("I"):  # grey of 16 bits
            grey = np.round(np.clip(np.asarray(image), 0, 65535) / 257).astype(np.uint8)
            return Picture(np.repeat(grey[:, :, None], 3, axis=2))
        if image.mode not in ("1", "L", "LA", "P", "PA", "RGB", "RGBA"):
            raise ValueError(f"has pixels of mode {image.mode}; 8-bit RGB is needed")
        # Pillow would drop low bits without a word: how it decodes is what tells.
        for codec, _, _, coding in image.tile:
            largest = coding[1] if codec.startswith("ppm") and isinstance(coding, tuple) else 0
            if largest > 255 or re.search(r";16[BLN]", str(coding)):
                raise ValueError("has more than 8 bits a channel; 8-bit RGB is needed")
        rgba = image.convert("RGBA")
        note, lossy = "", image.format in _LOSSY or image.mode in ("P", "PA")
        if image.format in _LOSSY:
            note = f"is a {image.format}, which changes levels: save it as PNG."
        elif lossy:
            note = "has a palette, of 256 colours at most: save it as RGB."
        elif rgba.getchannel("A").getextrema() != (255, 255):
            note = "is transparent in places, which counts as black: save it as RGB."
    black = Image.new("RGBA", rgba.size, (0, 0, 0, 255))
    return Picture(np.asarray(Image.alpha_composite(black, rgba).convert("RGB")), note, lossy)


class _Result(NamedTuple):
    """What `--json` and `--csv` tell of a picture."""

    picture: str
    right: str | None
    agrees: bool = False
    ssim: float | None = None
    max: float | None = None
    diagnosis: str | None = None
    error: str | None = None

    def line(self) -> str:
        """A line for a list of many."""
        if self.error:
            return f"unread   {printable(self.picture)}: {self.error}"
        found = "" if self.ssim is None else f"SSIM {self.ssim:.4f}  max {self.max:.2e}  "
        word = "agrees " if self.agrees else "differs"
        return f"{word}  {found}{printable(self.picture)}: {self.diagnosis}"


def tolerance(text: str) -> float:
    """The type of a tolerance; argparse names it so where the text is no number."""
    if not (value := float(text)) >= 0:
        raise argparse.ArgumentTypeError(f"must be 0 or more, is {text}")
    return value


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    used = parser("reference.compare", __doc__)
    add = used.add_argument
    add("a", metavar="A", type=Path, help="the picture in question, or a folder")
    add("b", metavar="B", type=Path, help="the right picture, a scene file, or a folder of these")
    add("--ssim", type=tolerance, metavar="S", help="least SSIM that is tolerated")
    add("--max", type=tolerance, metavar="M", help="largest linear difference that is tolerated")
    where = "the comparison (A.compare.png), or a folder, for which PATH may end in /"
    add("-o", "--output", type=file_name, metavar="PATH", help=where)
    form = used.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print a list with an object a picture")
    form.add_argument("--csv", action="store_true", help="print the same as a table")
    options = used.parse_args(arguments)
    many = options.a.is_dir()
    pictures = sorted(filter(_is_hand_in, options.a.rglob("*"))) if many else [options.a]
    if not pictures:
        used.error(printable(f"{options.a}: holds no pictures"))
    if many and options.output is not None and not is_folder(options.output):
        wrong = f"-o {options.output}: several pictures need a folder; end it in {os.sep}"
        used.error(printable(wrong))
    rights: list[Path | None] = [options.b] * len(pictures)
    if options.b.is_dir():
        # A picture comes before a scene of the same name.
        known = sorted(options.b.glob("*.xml")) + sorted(filter(_is_hand_in, options.b.iterdir()))
        by_name = {_key(path): path for path in known}
        rights = [by_name.get(_key(picture)) for picture in pictures]
    outputs = _outputs(options, pictures, many)
    spare_inputs(used, outputs, (*pictures, *filter(None, rights)))
    results: list[_Result] = []
    with ProcessPoolExecutor(2) if len(pictures) >= _MANY else nullcontext() as pool:
        mapped = pool.map if pool else map
        for result, lines in mapped(partial(_judge, options, many), pictures, rights, outputs):
            results.append(result)
            if not (options.json or options.csv):
                for line in (result.line(),) if many else lines:
                    print_line(sys.stdout, line)
    agree, unread = sum(r.agrees for r in results), sum(r.error is not None for r in results)
    if options.json:
        print_line(sys.stdout, json.dumps([r._asdict() for r in results], indent=1))
    elif options.csv:
        table = io.StringIO()
        csv.writer(table, lineterminator="\n").writerows([_Result._fields, *results])
        print_line(sys.stdout, table.getvalue().removesuffix("\n"))
    elif many:
        differ = len(results) - agree - unread
        summary = f"{len(results)} pictures: {agree} agree, {differ} differ"
        print_line(sys.stdout, summary + (f", {unread} cannot be compared" if unread else ""))
    elif unread:
        print_line(sys.stderr, str(results[0].error))
    return 3 if unread else int(agree < len(results))


def _key(path: Path) -> str:
    """What a picture and the right one have in common: the name, without `.png` and `.xml`."""
    return path.name.removesuffix(path.suffix).removesuffix(".xml").lower()


def _is_hand_in(path: Path) -> bool:
    name = path.name.lower()
    return name.endswith(_SUFFIXES) and not name.endswith(".compare.png") and path.is_file()


def _outputs(options: argparse.Namespace, pictures: list[Path], many: bool) -> list[Path]:
    """Where the comparison of each picture goes; none to another's place."""
    if options.output is not None and not many and not is_folder(options.output):
        return [Path(options.output)]
    above, outputs = options.a if many else options.a.parent, []
    taken = Counter(picture.with_suffix("") for picture in pictures)  # a.png and a.jpg
    for picture in pictures:
        name = picture.stem if taken[picture.with_suffix("")] == 1 else picture.name
        folder = picture.parent
        if options.output is not None:
            folder = Path(options.output, folder.relative_to(above))
        outputs.append(folder / f"{name}.compare.png")
    return outputs


_read_right = lru_cache(maxsize=8)(read_picture)


def _judge(
    options: argparse.Namespace, many: bool, picture: Path, right: Path | None, output: Path
) -> tuple[_Result, list[str]]:
    """Compare a picture; and the lines that a pair alone is told in.

    Of many, a comparison is written only of those that differ.
    """
    result = _Result(str(picture), None if right is None else str(right))
    if right is None:
        wrong = f"{picture}: {options.b} has no picture of this name"
        return result._replace(error=printable(wrong)), []
    where, what = picture, "read"
    try:
        pictures = [read_picture(picture)]
        where = right
        pictures.append(_read_right(right))
        where, what = picture, "compared"
        lossy = any(picture.lossy for picture in pictures)
        diagnosis = diagnose(pictures[0].codes, pictures[1].codes, lossy=lossy)
        same = diagnosis.kind == "identical"
        notes = [f"{n} {p.note}" for n, p in zip("AB", pictures, strict=True) if p.note]
        words = [*(() if same else notes), diagnosis.text]
        told = result._replace(diagnosis=" ".join(words))
        if diagnosis.kind == "size":
            return told, words
        a, b = (linear(picture.codes) for picture in pictures)
        found = figures(a, b)
        if options.ssim is not None or options.max is not None:
            near = options.max is None or found.max <= options.max
            same = near and (options.ssim is None or found.ssim >= options.ssim)
        where, what = output, "written"
        if not (many and same):
            output.parent.mkdir(parents=True, exist_ok=True)
            write_comparison(output, a, b, (printable(picture.name), printable(right.name)))
    except SceneFileError as error:
        return result._replace(error=str(error)), []
    except (MemoryError, OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        # Pillow's of a PNG is a SyntaxError.
        memory = "not enough memory; compare a part" if isinstance(error, MemoryError) else error
        reason = getattr(error, "strerror", None) or memory
        return result._replace(error=printable(f"{where}: cannot be {what}: {reason}")), []
    told = told._replace(agrees=same, ssim=found.ssim, max=found.max)
    return told, [str(found), *words, printable(str(output))]
