"""Hold the tracer's pictures against Mitsuba's, pixel by pixel, in linear light.

With this project's plugins (the exact flavour) all light is compared; with Mitsuba's own alone
diffuse light, so that no plugin has a say in what is seen, and by which light.
``python -m reference.check`` prints how similar the pictures of the stock flavours are.

Both sample the pixels' centres.  Mitsuba's float32 may fall on the other side of an edge that runs
through one: pixels that change by more than `EDGE_CHANGE` when the tracer's sample moves by
`EDGE_SHIFT` pixels are masked if they differ.  Every other pixel has to agree, or exact arithmetic
says which of the two errs.  Limits are in units of the brightest pixel where that is more than 1.
"""

from __future__ import annotations

from tracer.command.process import run

if __name__ == "__main__":
    run(__spec__.name)

import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from converters.camera import Floats
from converters.flavours import exact, gain, squared, stock
from converters.rendering import Rendering, load, render_mitsuba
from converters.variant import LLVM, use
from reference import plain
from reference.command import need_scenes, own_scenes, parser
from reference.figures import Figures, figures
from reference.regenerate import load_small
from tracer import Lambertian, Scene, Surfaces, load_scene, render
from tracer.messages import printable

__all__ = [
    "CheckResult",
    "check",
    "check_diffuse",
    "check_scene",
    "compare",
    "edge_mask",
    "faults",
    "main",
    "resemblance",
]

EDGE_SHIFT = 0.003  # how far a sample moves, in pixels and both ways, to see if an edge is near
EDGE_CHANGE = 1e-2  # what change of linear radiance makes an edge
MAX_MASKED = 0.015  # largest share of a picture that may be masked
MIN_SSIM = 0.999  # least SSIM of the two pictures, masked pixels included
MAX_DIFFERENCE = 1e-4  # largest difference in linear radiance outside the mask
MAX_MEDIAN = 1e-6  # largest median of these differences

# Exact arithmetic is slow: of more pixels that differ some are traced, evenly chosen.
_MOST_ASKED = 500

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """The result of a comparison of two linear pictures, (h, w, 3) float64.

    `reference` is Mitsuba's, but the tracer's where exact arithmetic says that Mitsuba errs.
    `mask` (h, w) marks edge pixels that differ, which do not count.  The figures are of `tracer`
    against `reference`, outside the mask, in units of the brightest pixel where that is more than
    1; the SSIM is of the whole picture.  Times are warm where that makes a difference.
    """

    name: str
    tracer: Floats
    mitsuba: Floats
    reference: Floats
    mask: Mask
    figures: Figures
    variant: str
    tracer_seconds: float
    mitsuba_seconds: float
    differing: int = 0
    """Pixels that differ outside the mask, of which `asked` were traced exactly."""
    asked: int = 0
    agreed: int = 0
    """Pixels among these on which the tracer is right."""
    judged: bool = True
    """Whether the pictures are to be the same, and not only similar."""

    @property
    def remark(self) -> str:
        """What the oracle says of pixels that differ; empty if none does."""
        if not self.asked:
            return ""
        pixels = f"{self.differing} pixel{'s' * (self.differing != 1)}"
        if self.agreed == self.asked:
            return f"Mitsuba errs on {pixels}, says exact arithmetic (asked about {self.asked})"
        asked = f"exact arithmetic, asked about {self.asked} of the {pixels} that differ"
        return f"{asked}, agrees with the tracer on {self.agreed}"

    @property
    def faults(self) -> tuple[str, ...]:
        """What is out of tolerance; nothing if the pictures agree."""
        return faults(self.figures, self.mask) if self.judged else ()

    def report(self) -> str:
        """The result in a few lines of text."""
        f = self.figures
        same = "agrees" + " with exact arithmetic" * (self.differing > 0)
        verdict = "DIFFERS" if self.faults else same if self.judged else "is similar"
        lines = [
            f"{self.name}: {verdict}",
            f"  SSIM {f.ssim:.6f}; linear difference: max {f.max:.1e}, 99.9% {f.p999:.1e},"
            f" RMSE {f.rmse:.1e}, pixels over 1e-3: {f.over}",
            f"  edge pixels that differ, masked: {f.masked} ({self.mask.mean():.3%})",
            f"  Mitsuba ({self.variant}) {self.mitsuba_seconds:.3f} s,"
            f" tracer {self.tracer_seconds:.3f} s",
        ]
        if self.remark:
            lines.append(f"  {self.remark}")
        return "\n".join([*lines, *(f"  out of tolerance: {fault}" for fault in self.faults)])


def faults(measured: Figures, mask: Mask) -> tuple[str, ...]:
    """Which figures of a comparison are out of tolerance, in words."""
    ssim, most, median, share = measured.ssim, measured.max, measured.median, float(mask.mean())
    limits = {
        f"SSIM {ssim:.5f} is below {MIN_SSIM}": ssim < MIN_SSIM,
        f"largest difference {most:.1e} exceeds {MAX_DIFFERENCE:.0e}": most > MAX_DIFFERENCE,
        f"median difference {median:.1e} exceeds {MAX_MEDIAN:.0e}": median > MAX_MEDIAN,
        f"{share:.2%} of the pixels are masked, more than {MAX_MASKED:.1%}": share > MAX_MASKED,
    }
    return tuple(fault for fault, broken in limits.items() if broken)


def edge_mask(scene: Scene, image: Floats) -> Mask:
    """Pixels (h, w) near an edge: they change when the sample of the tracer's `image` moves."""
    mask, change = np.zeros(image.shape[:2], dtype=np.bool_), EDGE_CHANGE * _unit(image)
    for dx, dy in product((-EDGE_SHIFT, EDGE_SHIFT), repeat=2):
        mask |= np.abs(render(scene, offset=(dx, dy)) - image).max(axis=2) > change
    return mask


def _unit(image: Floats) -> float:
    """What limits are multiples of: 1, or the radiance of a brighter picture's brightest pixel."""
    return max(1.0, float(image.max(initial=0)))


def check(path: Path, variant: str | None = None, flavour: str = "exact") -> CheckResult:
    """Render a scene file with the tracer and with Mitsuba, and compare.

    The exact flavour judges all light, "stock" diffuse light, by stock parts alone; "stock-lights"
    does not judge.  Raises what `load_scene` and `converters.variant.use` do.
    """
    scene, name = load_scene(path), printable(path.stem)
    ways = {"exact": check_scene, "stock": check_diffuse, "stock-lights": resemblance}
    return ways[flavour](scene, name, variant)


def check_scene(scene: Scene, name: str, variant: str | None = None) -> CheckResult:
    """Compare all light, by this project's plugins."""
    rendered = load(exact(scene), variant=variant)
    if use(variant).variant == LLVM:
        rendered()  # compiles the kernel
    return compare(scene, name, rendered())


def check_diffuse(scene: Scene, name: str, variant: str | None = None) -> CheckResult:
    """Compare diffuse light, by Mitsuba's own parts alone, in square pixels.

    Each light is rendered by itself, for Mitsuba would pick one of them at random, and its fall-off
    undone by the distance of the points that Mitsuba sees.
    """
    surfaces = (replace(s, shader=Lambertian(diffuse=s.shader.diffuse)) for s in scene.surfaces)
    matte = replace(squared(scene), surfaces=Surfaces.of(surfaces))
    image, start = np.zeros((matte.height, matte.width, 3)), perf_counter()
    for light in matte.lights:
        white = replace(light, intensity=(1.0, 1.0, 1.0))
        root = ET.fromstring(stock(replace(matte, lights=(white,)), 1))
        parts = {part.get("type"): part for part in root.iter("*")}
        root.remove(parts["direct"])
        aov = ET.SubElement(root, "integrator", type="aov")
        ET.SubElement(aov, "string", name="aovs", value="p:position")
        aov.append(parts["direct"])
        parts["multijitter"].set("type", "stratified")
        ET.SubElement(parts["multijitter"], "boolean", name="jitter", value="false")
        seen = load(ET.tostring(root, encoding="unicode"), variant=variant)().image
        place, strength = parts["point"].findall("*")
        away = seen[..., -3:] - [float(place.get(axis, "")) for axis in "xyz"]
        unit = float(strength.get("value", "").split()[0]) / (np.pi * gain(matte.surfaces))
        falloff = (away * away).sum(axis=2, keepdims=True) / unit
        image += seen[..., :3] * falloff * light.intensity
    rendering = Rendering(image, use(variant).variant, perf_counter() - start)
    return compare(matte, f"{name}, diffuse light by stock plugins", rendering)


def resemblance(
    scene: Scene, name: str, variant: str | None = None, flavour: str = "stock-lights"
) -> CheckResult:
    """Compare the smooth picture with that of a stock flavour, in square pixels, and judge not."""
    start = perf_counter()
    image = render_mitsuba(scene, variant=variant, flavour=flavour)
    rendering = Rendering(image, use(variant).variant, perf_counter() - start)
    return compare(squared(scene), f"{name}, {flavour} flavour", rendering, judged=False)


def compare(scene: Scene, name: str, rendering: Rendering, *, judged: bool = True) -> CheckResult:
    """Hold the tracer's picture of a scene against one that Mitsuba has made.

    Raises ValueError if a radiance of Mitsuba's is not finite, or every pixel is masked.
    """
    if not np.isfinite(rendering.image).all():
        raise ValueError(
            "Mitsuba's radiance is not finite; keep the colours and lights of the scene closer to 1"
        )
    samples = 1 if judged else 16
    render(scene, samples=samples)  # so that the next, which is timed, is warm
    start = perf_counter()
    image = render(scene, samples=samples)
    seconds = perf_counter() - start
    reference, unit = rendering.image.copy(), _unit(image) if judged else 1.0
    differs = (np.abs(image - reference).max(axis=2) > MAX_DIFFERENCE * unit) & judged
    mask = differs & edge_mask(scene, image) if differs.any() else differs
    differs &= ~mask
    pixels = np.argwhere(differs)
    asked = pixels[:: 1 + len(pixels) // _MOST_ASKED]
    row, column = asked.T
    exactly = plain.trace(scene, column + 0.5, row + 0.5, arithmetic="decimal").radiance
    agrees = np.abs(image[row, column] - exactly).max(axis=1) <= MAX_DIFFERENCE * unit
    if agrees.all():
        reference[differs] = image[differs]
    return CheckResult(
        name=name,
        tracer=image,
        mitsuba=rendering.image,
        reference=reference,
        mask=mask,
        figures=figures(image / unit, reference / unit, mask),
        variant=rendering.variant,
        differing=len(pixels),
        asked=len(asked),
        agreed=int(agrees.sum()),
        tracer_seconds=seconds,
        mitsuba_seconds=rendering.seconds,
        judged=judged,
    )


def main() -> None:
    """Print a table of how similar the stock flavours are, in Markdown."""
    used = parser("reference.check", __doc__)
    used.parse_args()
    need_scenes(used)
    print("| scene | stock | stock-lights |\n|---|---|---|")
    for path in own_scenes():
        scene = load_small(path)
        found = (resemblance(scene, "", None, name) for name in ("stock", "stock-lights"))
        print(f"| {path.stem} |", " | ".join(f"{f.figures.ssim:.3f}" for f in found), "|")
