"""Hold the tracer's picture of a scene against Mitsuba's, pixel by pixel, in linear light.

Both sample the centres of the pixels.  Mitsuba computes in float32, so where an edge runs through
a pixel's centre the two may fall on different sides of it: pixels whose value changes by more
than `EDGE_CHANGE` when the tracer's sample moves by `EDGE_SHIFT` pixels are masked, and counted, if
they differ.  Every other pixel has to agree.  Limits are of linear radiance, in units of the
brightest pixel's where that is more than 1.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from converters.flavours import exact, normalisation
from converters.rendering import Rendering, load
from converters.variant import LLVM
from converters.visible import bounds
from reference.compare import Figures, figures
from reference.oracle import Oracle
from tracer import render
from tracer.arrays import Bools, Floats
from tracer.commands import printable
from tracer.scene.model import Scene
from tracer.scene.reader import load_scene

__all__ = [
    "EDGE_CHANGE",
    "EDGE_SHIFT",
    "MAX_DIFFERENCE",
    "MAX_MASKED",
    "MAX_MEDIAN",
    "MIN_SSIM",
    "CheckResult",
    "check",
    "check_scene",
    "compare",
    "doubts",
    "edge_mask",
    "faults",
]

EDGE_SHIFT = 0.003
"""How far a sample moves, in pixels and both ways, to see whether an edge is near."""
EDGE_CHANGE = 1e-2
"""What change of linear radiance makes an edge."""
MAX_MASKED = 0.015
"""Largest share of a picture that may be masked."""
MIN_SSIM = 0.999
"""Least SSIM of the two pictures, masked pixels included."""
MAX_DIFFERENCE = 1e-4
"""Largest difference in linear radiance outside the mask."""
MAX_MEDIAN = 1e-6
"""Largest median of these differences."""

# Largest coordinate, with what is seen scaled to 10 units, at which float32 is accurate enough.
_LARGEST = 1e4

# The oracle, being slow, judges at most this many pixels.  If more differ, or if nothing is known
# to be hard for Mitsuba, that stays the judge, and the oracle is asked about some of them.
_MOST_JUDGED, _MOST_ASKED = 20_000, 200


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """The result of a comparison.

    Attributes
    ----------
    name : str
    tracer, mitsuba : (h, w, 3) float64
        The two pictures, linear.
    reference : (h, w, 3) float64
        What the tracer is held against: Mitsuba's picture, but for the
        pixels that the oracle has judged.
    mask : (h, w) bool
        Edge pixels that differ, which do not count.
    figures : Figures
        Of `tracer` against `reference`, outside the mask, in units of the
        brightest pixel where that is more than 1; the SSIM is of the whole
        picture.
    variant : str
        Mitsuba's.
    reasons : tuple of str
        What the scene has that is hard for Mitsuba; empty if no pixel differs.
    differing : int
        How many pixels differ from Mitsuba's, masked ones included if there are reasons.
    judged : int
        How many of these are held against the oracle in place of Mitsuba.
    asked, agreed : int
        Where Mitsuba stays the judge: about how many the oracle was asked, and
        on how many it agrees with the tracer.
    tracer_seconds, mitsuba_seconds : float
        Rendering times, warm where that makes a difference.
    """

    name: str
    tracer: Floats
    mitsuba: Floats
    reference: Floats
    mask: Bools
    figures: Figures
    variant: str
    reasons: tuple[str, ...]
    judged: int
    tracer_seconds: float
    mitsuba_seconds: float
    differing: int = 0
    asked: int = 0
    agreed: int = 0

    @property
    def remark(self) -> str:
        """What the oracle says of pixels that differ; empty if it was not asked."""
        hard = ", ".join(self.reasons)
        if self.judged:
            pixels = f"{self.judged} pixel{'s' * (self.judged != 1)}"
            return f"Mitsuba errs on {pixels} ({hard}): there the oracle is the judge"
        if not self.asked:
            return ""
        return (
            f"the oracle, asked about {self.asked} of the {self.differing} pixels that differ,"
            f" agrees with the tracer on {self.agreed}"
            + (f"; hard for Mitsuba are {hard}" if hard else "")
        )

    @property
    def faults(self) -> tuple[str, ...]:
        """What is out of tolerance; nothing if the pictures agree."""
        return faults(self.figures, self.mask)

    def report(self) -> str:
        """The result in a few lines of text."""
        f = self.figures
        verdict = "DIFFERS" if self.faults else "agrees"
        if self.faults and self.asked and self.agreed == self.asked:
            verdict += ", where Mitsuba errs"
        lines = [
            f"{self.name}: {verdict}",
            f"  SSIM {f.ssim:.6f}; linear difference: max {f.max:.1e}, 99.9% {f.p999:.1e},"
            f" RMSE {f.rmse:.1e}, pixels over 1e-3: {f.over}",
            f"  differing edge pixels, masked: {f.masked} ({self.mask.mean():.3%}); they change by"
            f" more than {EDGE_CHANGE:g} when the sample moves by {EDGE_SHIFT:g} pixels",
            f"  Mitsuba ({self.variant}) {self.mitsuba_seconds:.3f} s,"
            f" tracer {self.tracer_seconds:.3f} s",
        ]
        if self.remark:
            lines.append(f"  {self.remark}")
        return "\n".join([*lines, *(f"  out of tolerance: {fault}" for fault in self.faults)])


def faults(measured: Figures, mask: Bools) -> tuple[str, ...]:
    """Which figures of a comparison are out of tolerance, in words."""
    share = float(mask.mean())
    limits = (
        (measured.ssim >= MIN_SSIM, f"SSIM {measured.ssim:.5f} is below {MIN_SSIM}"),
        (
            measured.max <= MAX_DIFFERENCE,
            f"largest difference {measured.max:.1e} exceeds {MAX_DIFFERENCE:.0e}",
        ),
        (
            measured.median <= MAX_MEDIAN,
            f"median difference {measured.median:.1e} exceeds {MAX_MEDIAN:.0e}",
        ),
        (share <= MAX_MASKED, f"{share:.2%} of the pixels are masked, more than {MAX_MASKED:.1%}"),
    )
    return tuple(fault for within, fault in limits if not within)


def edge_mask(scene: Scene, image: Floats) -> Bools:
    """Pixels (h, w) near an edge: moving the sample a little changes them.

    Parameters
    ----------
    scene : Scene
    image : (h, w, 3) float64
        The tracer's picture of it.
    """
    mask, change = np.zeros(image.shape[:2], dtype=np.bool_), EDGE_CHANGE * _unit(image)
    for dx, dy in product((-EDGE_SHIFT, EDGE_SHIFT), repeat=2):
        mask |= np.abs(render(scene, offset=(dx, dy)) - image).max(axis=2) > change
    return mask


def _unit(image: Floats) -> float:
    """What limits are multiples of: 1, or the radiance of a brighter picture's brightest pixel."""
    return max(1.0, float(image.max(initial=0)))


def doubts(scene: Scene) -> tuple[str, ...]:
    """Why Mitsuba's picture of a scene is not to be trusted everywhere; empty if it is."""
    surfaces = scene.surfaces
    low, high = surfaces.min_pt, surfaces.max_pt
    found = []
    if (low == high).any():
        found.append("zero-thickness boxes")
    balls = np.column_stack([surfaces.center, surfaces.radius])
    if len(np.unique(balls, axis=0)) < len(balls):
        found.append("coincident spheres")
    if any(_shared_faces(low, high, axis) for axis in range(3)):
        found.append("coincident faces of boxes")
    if np.abs(normalisation(scene)(bounds(surfaces))).max() > _LARGEST:
        found.append("surfaces a thousand times larger than what is seen")
    return tuple(found)


def _shared_faces(low: Floats, high: Floats, axis: int) -> bool:
    """Whether two boxes have overlapping faces in one plane across an axis."""
    boxes = np.tile(np.arange(len(low)), 2)
    plane = np.concatenate([low[:, axis], high[:, axis]])
    others = [k for k in range(3) if k != axis]
    order = np.argsort(plane, kind="stable")
    ends = np.flatnonzero(np.diff(plane[order])) + 1
    for group in np.split(boxes[order], ends):
        corner, opposite = low[group][:, others], high[group][:, others]
        for i in range(1, len(group)):
            overlap = (corner[:i] < opposite[i]) & (corner[i] < opposite[:i])
            if (overlap.all(axis=1) & (group[:i] != group[i])).any():
                return True
    return False


def check(path: str | os.PathLike[str], variant: str | None = None) -> CheckResult:
    """Render a scene file with the tracer and with Mitsuba, and compare.

    Raises
    ------
    SceneFileError
        If the file is not a faultless scene.
    ImportError
        If the given variant does not work here.
    """
    return check_scene(load_scene(path), printable(Path(path).stem), variant)


def check_scene(scene: Scene, name: str, variant: str | None = None) -> CheckResult:
    """Render a scene with the tracer and with Mitsuba, and compare."""
    rendered = load(exact(scene), variant)
    rendering = rendered()
    if rendering.variant == LLVM:
        # The first time compiles the kernel.
        rendering = rendered()
    return compare(scene, name, rendering)


def compare(scene: Scene, name: str, rendering: Rendering) -> CheckResult:
    """Hold the tracer's picture of a scene against one that Mitsuba has made.

    Raises
    ------
    ValueError
        If a radiance of Mitsuba's is not finite, or every pixel is masked.
    """
    if not np.isfinite(rendering.image).all():
        raise ValueError(
            "Mitsuba's radiance is not finite; keep the colours and lights of the scene closer to 1"
        )
    render(scene)  # so that the next, which is timed, is warm
    start = perf_counter()
    image = render(scene)
    seconds = perf_counter() - start
    reference, unit = rendering.image.copy(), _unit(image)
    differs = np.abs(image - reference).max(axis=2) > MAX_DIFFERENCE * unit
    mask = differs & edge_mask(scene, image) if differs.any() else differs
    reasons = doubts(scene) if differs.any() else ()
    if not reasons:
        differs = differs & ~mask
    differing = np.argwhere(differs)
    trusted = not reasons or len(differing) > _MOST_JUDGED
    pixels = differing[:: 1 + len(differing) // _MOST_ASKED] if trusted else differing
    truth, (row, column) = _asked(scene, pixels), pixels.T
    agrees = np.abs(image[row, column] - truth).max(axis=1) <= MAX_DIFFERENCE * unit
    if not trusted:
        reference[row, column] = truth
    return CheckResult(
        name=name,
        tracer=image,
        mitsuba=rendering.image,
        reference=reference,
        mask=mask,
        figures=figures(image / unit, reference / unit, mask),
        variant=rendering.variant,
        reasons=reasons,
        differing=len(differing),
        judged=0 if trusted else len(pixels),
        asked=len(pixels) if trusted else 0,
        agreed=int(agrees.sum()) if trusted else 0,
        tracer_seconds=seconds,
        mitsuba_seconds=rendering.seconds,
    )


def _asked(scene: Scene, pixels: NDArray[np.intp]) -> Floats:
    """Radiance (n, 3) of pixels (n, 2), rows and columns, by the oracle."""
    oracle = Oracle(scene)
    found = [oracle.judge(column + 0.5, row + 0.5).radiance for row, column in pixels.tolist()]
    return np.array(found).reshape(-1, 3)
