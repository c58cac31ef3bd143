"""Whether the tests notice mistakes: each mutation changes one place of tracer or converter.

    python tests/mutations.py [--slow] [--list] [NUMBER ...]

applies the mutations, or some of them, to copies of this checkout, one after the other, and runs
the tests on each until one fails: first those of its subject, then all others, and with `--slow`
the slow ones as well.  A mutation that no test notices has survived; the exit status is 1 if any
has.  `--list` only says whether each can be applied.  By hand: all take an hour.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

CHANGES = {
    # Camera: half a pixel, mirrored, upside down, projNormal ignored
    "tracer/view/camera.py": {
        "shift_u + (x - self.width / 2)": "shift_u + (x + 0.5 - self.width / 2)",
        "axes=np.array([u, -v, -w])": "axes=np.array([-u, -v, -w])",
        "shift_v=-float(center @ v)": "shift_v=float(center @ v)",
        "w = unit(camera.normal)": "w = unit(camera.view_dir)",
        "+ offset[1] * step_v": "- offset[1] * step_v",
        "camera.view_height / height": "camera.view_width / width",
    },
    # What is seen: ties, spans, hits, the eye inside; and what shades: sides, slabs, capsules
    "tracer/view/visibility.py": {
        "spread(index.take(g.owner)": "spread(-index.take(g.owner)",
    },
    "tracer/view/samples.py": {
        "_PAD = 0.5": "_PAD = -0.5",
    },
    "tracer/shapes/sphere.py": {
        "(radius - aside) * (radius + aside)": "radius * radius - aside",
        "np.where(power > 0, t, far)": "t",
        "np.where(inside, -1.0, 1.0)": "np.where(inside, 1.0, 1.0)",
        "return self.power <= 0": "return self.power < 0",
        "(b > 0) & (b < length2)": "(b > 0)",
        "b > 0),\n": "b < 0),\n",
        "(side == OUTSIDE) & (b < length2)": "(side == OUTSIDE)",
        "aside2 > outer) |": "aside2 > inner) |",
        "& (aside2 < inner)": "& (aside2 < outer)",
        "np.maximum(distance2, to_end2)": "np.minimum(distance2, to_end2)",
    },
    "tracer/shapes/box.py": {
        "d, closed=True": "d, closed=False",
        "np.where(enter <= leave, e": "np.where(enter < leave, e",
        "detail & 1, 1.0, -1.0": "detail & 1, -1.0, 1.0",
        "t = np.where(inside, leave, t)": "t = np.where(inside, enter, t)",
        "np.fmin(high, bound": "np.fmin(high, bound - 1e-3",
        "end - start, closed=False": "end - start, closed=True",
        "((leave > 0) & (leave < 1))": "(leave > 0)",
        "(enter > 0) & (leave < 1)\n": "(enter > 0)\n",
        "far += margin": "far -= margin",
    },
    "tracer/shapes/rounding.py": {
        "SURFACE_TOLERANCE = 64 * _EPSILON": "SURFACE_TOLERANCE = 0 * _EPSILON",
    },
    # Shadows: cells, packets, umbra
    "tracer/shadow/grid.py": {
        "right - left + 1, bottom": "np.maximum(right - left, 1), bottom",
        "shades[owner])": "~shades[owner])",
    },
    "tracer/shadow/packets.py": {
        "np.sqrt((half * half": "0.2 * np.sqrt((half * half",
        "np.sqrt((away * away": "0.2 * np.sqrt((away * away",
    },
    "tracer/shadow/occlusion.py": {
        "        blocked |= umbra\n": "",
    },
    # Light: behind the surface, not inside, intensity, shader, exponent, half vector
    "tracer/light/lighting.py": {
        "lit = incoming.n_dot_l > 0": "lit = incoming.n_dot_l > -np.inf",
        "(occluders.side[number] != INSIDE)": "(occluders.side[number] == INSIDE)",
        "channel += strength * weight": "channel += weight",
        "weights[1, at] = incoming": "weights[1, at] = 0.5 * incoming",
        "take(view.surfaces.shader_index": "take(view.surfaces.shader_index[::-1]",
    },
    "tracer/light/shading.py": {
        "np.exp(0.5 * exponent": "np.exp(exponent",
        "half2 = 1 + l_dot_v": "half2 = 1 - l_dot_v",
        "np.log1p(-0.5 * dot(e, e))": "np.log1p(-dot(e, e))",
    },
    # Antialiasing: lattice, regions, feet of margins, curvature, outlines
    "tracer/antialias/lattice.py": {
        "shift: Floats = (place - middle) / points": "shift: Floats = place / points",
    },
    "tracer/antialias/regions.py": {
        "t_y[region] * y": "t_x[region] * y",
        "|= (z > 0) << bit": "|= (z < 0) << bit",
    },
    "tracer/antialias/margins.py": {
        "step = -2 * middle": "step = 2 * middle",
    },
    "tracer/antialias/classify.py": {
        "[:, :-stride]) / 24": "[:, :-stride]) / 6",
        "radiance) / 3, 0)": "radiance) / 1, 0)",
    },
    "tracer/antialias/edges.py": {
        ", (row, owner, full_end, stop)": "",
    },
    # Codes, files, tiles
    "tracer/picture/png.py": {
        "x >= thresholds.take(code)": "x > thresholds.take(code)",
        "root**2 * root**0.2": "root**2 * root**0.4",
        "((0, 0), (1, 0))": "((0, 0), (0, 1))",
        "size * (a - 1)": "size * a",
    },
    "tracer/picture/bands.py": {
        "pickle.dump(made(number), memory)": "pickle.dump(made(number ^ 1), memory)",
        "divmod(number, len(self._columns))": "divmod(number, len(self._rows))",
    },
    # Reader and writer, explanations, warnings
    "tracer/scene/model.py": {
        "default=(0.0, 0.0, -1.0)": "default=(0.0, 0.0, 1.0)",
        '_ONE, metadata=of(schema.COLOR, "int': '_ZERO, metadata=of(schema.COLOR, "int',
    },
    "tracer/scene/schema.py": {
        "lambda x: x <= 0": "lambda x: x < 0",
        "wrong = min_pt > max_pt": "wrong = min_pt >= max_pt",
        "lambda x: x < 0,": "lambda x: x < -1,",
    },
    "tracer/scene/elements.py": {
        "element.line = parser.": "element.line = 1 + parser.",
    },
    "tracer/scene/reader.py": {
        "elif name in parts:": "elif child.tag in parts:",
    },
    "tracer/scene/writer.py": {
        "uses[place] > 1": "uses[place] > 2",
    },
    "tracer/explanation.py": {
        "float(hit.normal[0] @ towards)": "float(hit.normal[0] @ -towards)",
        "n_dot_l[number] / np.sqrt(": "n_dot_l[number] * np.sqrt(",
    },
    "tracer/suspicions.py": {
        "_LEAST_CODE = 10": "_LEAST_CODE = 1000",
        "if not seen.size": "if seen.size",
    },
    # Converter: window, handedness, field of view, lights, highlights, flavours
    "converters/camera.py": {
        "direction > 0 else -normal": "direction > 0 else normal",
        "np.asarray(x)[..., None] - 0.5": "np.asarray(x)[..., None] - 0.49",
        "np.cross(ahead, _unit(camera.view_up))": "np.cross(_unit(camera.view_up), ahead)",
    },
    "converters/flavours.py": {
        "atan(window.width": "atan(window.height",
        "float(below /": "float(-below /",
        "(np.pi * strength * distance2)": "(strength * distance2)",
        "* 8 / (shader.exponent + 2)": "* 4 / (shader.exponent + 2)",
    },
    "converters/plugins.py": {
        "0.5 * self.exponent": "1.0 * self.exponent",
        "(height <= self.tolerance)": "(height >= self.tolerance)",
    },
    "converters/to_mitsuba.py": {
        '_convert, "stock"': '_convert, "exact"',
    },
}
"""For each module texts that stand in it exactly once, and what takes their place."""

MUTATIONS = [(module, *both) for module, each in CHANGES.items() for both in each.items()]

FIRST = {
    "tracer/light": ["accuracy/test_closed_forms.py", "accuracy"],
    "tracer/antialias": ["accuracy/test_antialias.py", "accuracy"],
    "tracer/picture": ["command/test_png.py", "command"],
    "tracer/scene": ["format"],
    "tracer/explanation.py": ["command/test_explain.py"],
    "tracer/suspicions.py": ["command"],
    "converters": ["mitsuba"],
    "tracer": [
        *(f"accuracy/test_{m}.py" for m in ("camera_conventions", "closed_forms", "culling")),
        "accuracy",
    ],
}
"""Folders and files of tests that are run first, for what a module's path begins with."""


def copied(folder: Path) -> None:
    """Copy this checkout, as git knows it."""
    for name in subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True).splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)


def mutated(module: str, old: str, new: str) -> str:
    """The text of a module, with a mutation."""
    text = (ROOT / module).read_text(encoding="utf-8")
    if text.count(old) != 1:
        raise ValueError(f"{module}: {old!r} stands there {text.count(old)} times, not once")
    return text.replace(old, new)


def failing(folder: Path, *arguments: str) -> str | None:
    """The first test that fails in a copy of the checkout; None if none does."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode < 0:
        raise RuntimeError(f"pytest was ended by signal {-done.returncode}; run it again")
    lines = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    failed = lines[0].partition(" - ")[0] if lines else f"exit status {done.returncode}"
    return failed if done.returncode else None


def killed(module: str, text: str, slow: bool) -> str | None:
    """The test that notices a module's new text; None if none does."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        copied(folder)
        (folder / module).write_text(text, encoding="utf-8")
        first = next(tests for start, tests in FIRST.items() if module.startswith(start))
        runs = [[f"tests/{name}"] for name in first] + [["tests"]] + [["-m", "slow"]] * slow
        return next((test for run in runs if (test := failing(folder, *run))), None)


def main() -> int:
    """Run the tests on mutated copies; return 1 if any mutation survives, else 0."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("numbers", nargs="*", type=int, metavar="NUMBER")
    parser.add_argument("--slow", action="store_true", help="try the slow tests as well")
    parser.add_argument("--list", action="store_true", help="run no tests")
    arguments = parser.parse_args()
    survivors = 0
    for number in arguments.numbers or range(len(MUTATIONS)):
        module, old, new = MUTATIONS[number]
        text = mutated(module, old, new)
        test = "" if arguments.list else killed(module, text, arguments.slow)
        survivors += test is None
        told = "SURVIVED" if test is None else test
        print(f"{number} {module}: {new.strip()!r} {told}", flush=True)
    return int(survivors > 0)


if __name__ == "__main__":
    raise SystemExit(main())
