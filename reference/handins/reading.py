"""Read pictures of any format, find hand-ins in folders, and the right picture for each."""

from __future__ import annotations

import difflib
import io
import re
import stat
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image, JpegImagePlugin, UnidentifiedImageError

Codes: TypeAlias = NDArray[np.uint8]

# Formats whose bits a channel are known before they are decoded.
_FORMATS = ("BMP", "GIF", "JPEG", "PNG", "PPM", "TGA", "TIFF", "WEBP")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".ppm", ".tga", ".tif", ".tiff", ".webp")
UNREADABLE = (MemoryError, OSError, SyntaxError, ValueError, Image.DecompressionBombError)
"""What reading may raise; Pillow's errors in a PNG are SyntaxErrors."""


def reason(fault: BaseException, remedy: str) -> str:
    """Why something is unreadable; `remedy` is what to do where memory is short."""
    if isinstance(fault, MemoryError):
        return f"not enough memory; {remedy}"
    if isinstance(fault, UnidentifiedImageError):
        return "not a picture in a format that is known"
    return getattr(fault, "strerror", None) or str(fault)


class Picture(NamedTuple):
    """A picture's codes (h, w, 3), a note on what its format did to them, and what it does.

    `lossy`: codes that are saved in this format differ from themselves by so many levels, or, where
    `saved` does to others what it did to these, from those.
    """

    codes: Codes
    note: str = ""
    lossy: int = 0
    saved: Callable[[Codes], Codes] | None = None


class HandIn(NamedTuple):
    """A picture that was handed in, the right one or a scene file, or what is wrong.

    `output` is where a picture of both is written.
    """

    picture: Path
    right: Path | None
    error: str | None = None
    output: Path | None = None


def read_picture(path: Path) -> Picture:
    """Read a picture; what is transparent is black.

    Raises one of `UNREADABLE` if it cannot be read, or has more than 8 bits a channel.
    """
    if not stat.S_ISREG(path.stat().st_mode):  # a pipe or a device may block
        raise ValueError("not a regular file")
    with Image.open(path, formats=_FORMATS) as image:
        if image.mode.startswith("I"):  # grey of 16 bits
            grey = np.round(np.clip(np.asarray(image), 0, 65535) / 257).astype(np.uint8)
            return Picture(np.repeat(grey[:, :, None], 3, axis=2))
        if image.mode not in ("1", "L", "LA", "P", "PA", "RGB", "RGBA"):
            raise ValueError(f"has pixels of mode {image.mode}; 8-bit RGB is needed")
        # Pillow would drop low bits without a word: how it decodes shows it.
        for codec, _, _, coding in image.tile:
            largest = coding[1] if codec.startswith("ppm") and isinstance(coding, tuple) else 0
            if largest > 255 or re.search(r";16[BLN]", str(coding)):
                raise ValueError("has more than 8 bits a channel; 8-bit RGB is needed")
        rgba = image.convert("RGBA")
        note, lossy, saved = "", 0, None
        # A WEBP holds a chunk VP8L if it is lossless.
        if image.format == "WEBP" and b"VP8L" not in path.read_bytes()[:64]:
            note, lossy = "is a WEBP, which changes levels: save it as PNG.", 12
        elif image.format == "JPEG":
            note, lossy, saved = "is a JPEG, which changes levels: save it as PNG.", 3, _jpeg(image)
        elif image.mode in ("P", "PA"):
            note, lossy = "has a palette, of 256 colours at most: save it as RGB.", 12
        elif rgba.getchannel("A").getextrema() != (255, 255):
            note = "is transparent in places, which counts as black: save it as RGB."
    black = Image.new("RGBA", rgba.size, (0, 0, 0, 255))
    return Picture(
        np.asarray(Image.alpha_composite(black, rgba).convert("RGB")), note, lossy, saved
    )


def _jpeg(image: Image.Image) -> Callable[[Codes], Codes]:
    """Return what saves codes with the same tables as a JPEG, and reads them."""
    options = {
        "qtables": image.quantization,  # type: ignore[attr-defined]
        "subsampling": JpegImagePlugin.get_sampling(image),
    }

    def saved(codes: Codes) -> Codes:
        data = io.BytesIO()
        Image.fromarray(codes).save(data, "JPEG", **options)
        return np.asarray(Image.open(data))

    return saved


def hand_ins(folder: Path) -> list[Path]:
    """All pictures in a folder and its folders, but comparisons and what a system leaves there."""
    return sorted(path for path in _visible(folder) if _is_picture(path))


def empty_folders(folder: Path) -> list[Path]:
    """Folders in it without any picture, in them or in their folders; the outermost of these."""
    full = {above for picture in hand_ins(folder) for above in picture.parents}
    empty = (path for path in _visible(folder) if path.is_dir() and path not in full)
    return sorted(path for path in empty if path.parent in full or path.parent == folder)


def _visible(folder: Path) -> Iterator[Path]:
    for path in folder.rglob("*"):
        parts = path.relative_to(folder).parts
        if not any(part.startswith(".") or part == "__MACOSX" for part in parts):
            yield path


def _is_picture(path: Path) -> bool:
    name = path.name.lower()
    return name.endswith(_SUFFIXES) and not name.endswith(".compare.png") and path.is_file()


def match(pictures: Iterable[Path], rights: Path) -> tuple[list[HandIn], list[Path]]:
    """Find the right picture or scene of each; and those that nobody has handed in.

    In a folder `rights`, `NAME.png`, `NAME.check.png` and the like were made of the scene
    `NAME.xml`, and are passed over.  `NAME.png`, `NAME.xml.png` and `ID_NAME.png` are hand-ins of
    NAME, in upper or lower case.
    """
    if not rights.is_dir():
        return [HandIn(picture, rights) for picture in pictures], []
    scenes = sorted(rights.glob("*.xml"))
    found = sorted(filter(_is_picture, rights.iterdir())) + scenes
    known = {_name(path): path for path in found if not any(_made_of(path, one) for one in scenes)}
    used, matched = set[str](), []
    for picture in pictures:
        name, error = _name(picture), None
        fitting = [one for one in known if name == one or name.endswith(f"_{one}")]
        right = known[max(fitting, key=len)] if fitting else None
        if right is None:
            error = f"no scene or picture in {rights} has this name"
            near = difflib.get_close_matches(name, known, 1) or difflib.get_close_matches(
                name.rpartition("_")[2], known, 1
            )
            error += f"; did you mean {known[near[0]].name}?" if near else ""
        else:
            used.add(_name(right))
        matched.append(HandIn(picture, right, error))
    return matched, [path for name, path in known.items() if name not in used]


def _made_of(path: Path, scene: Path) -> bool:
    return path.name.startswith(f"{scene.stem}.") and path != scene


def _name(path: Path) -> str:
    """What a picture and the right one have in common: the name, without `.png` and `.xml`."""
    return path.stem.lower().removesuffix(".xml")
