"""Turn scene files into Mitsuba 3 scenes, and hold the two renderers against each other.

python -m converters.to_mitsuba SCENE.xml ...            writes NAME.mitsuba.xml, stock plugins
python -m converters.to_mitsuba --exact SCENE.xml ...    the same by this project's plugins
python -m converters.to_mitsuba --render SCENE.xml ...   writes NAME.mitsuba.png and .exr
python -m converters.to_mitsuba --check SCENE.xml ...    compares, and writes NAME.check.png

There are two flavours. The default uses stock plugins only and opens in the plain mitsuba
command; its lights fall off and its highlights are alike, not the same. The exact flavour
(--exact, and always what --render and --check use) names four small plugins of this project
and loads with mitsuba.load_file after "import converters.plugins".

Converting needs no Mitsuba. --render and --check need it ("pip install .[reference]").
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from converters.flavours import exact, stock
from tracer.image import write_png
from tracer.reader import SceneFileError, load_scene

__all__ = ["main"]

_Work = Callable[[Path, Path, argparse.Namespace], bool]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 0, or 1 where a scene failed or a tolerance is broken."""
    parser = _parser()
    options = parser.parse_args(arguments)
    output: Path | None = options.output
    to_folder = output is not None and (len(options.scenes) > 1 or output.is_dir())
    if to_folder and output is not None and not output.is_dir():
        parser.error(f"--output {output} must be a folder that exists, for several scenes")
    if options.samples is not None and options.samples < 1:
        parser.error("--samples must be at least 1")
    work, suffix = _work(options)
    done = []
    for scene in options.scenes:
        beside = scene.with_name(f"{scene.stem}{suffix}")
        target = beside if output is None else output / beside.name if to_folder else output
        done.append(_guarded(work, scene, target, options))
    return 0 if all(done) else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m converters.to_mitsuba",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scenes", nargs="+", type=Path, metavar="SCENE.xml")
    parser.add_argument(
        "-o", "--output", type=Path, help="a file for one scene, a folder for several"
    )
    parser.add_argument(
        "--exact", action="store_true", help="name this project's plugins: the same picture"
    )
    parser.add_argument("--samples", type=int, metavar="N", help="samples a pixel")
    parser.add_argument(
        "--variant", help="Mitsuba's variant (default: the fastest that works on this machine)"
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--render", action="store_true", help="render with Mitsuba, exact flavour")
    what.add_argument(
        "--check", action="store_true", help="compare the tracer with Mitsuba, exact flavour"
    )
    return parser


def _work(options: argparse.Namespace) -> tuple[_Work, str]:
    if options.render:
        return _render, ".mitsuba.png"
    if options.check:
        return _check, ".check.png"
    return _convert, ".mitsuba.xml"


def _guarded(work: _Work, scene: Path, target: Path, options: argparse.Namespace) -> bool:
    """Do one scene; what goes wrong with it is one line a fault, and spares the others."""
    try:
        return work(scene, target, options)
    except SceneFileError as error:
        print(error, file=sys.stderr)
    except OSError as error:
        print(f"{target}: cannot be written: {error.strerror or error}", file=sys.stderr)
    except ImportError as error:
        print(f"{scene}: {error}", file=sys.stderr)
    return False


def _convert(path: Path, target: Path, options: argparse.Namespace) -> bool:
    flavour = exact if options.exact else stock
    scene = load_scene(path)
    text = flavour(scene) if options.samples is None else flavour(scene, options.samples)
    # Beside the target first: a failure leaves an earlier file as it was.
    beside = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(target)
    finally:
        beside.unlink(missing_ok=True)
    print(f"{target}: {'exact' if options.exact else 'stock'} flavour")
    return True


def _render(path: Path, target: Path, options: argparse.Namespace) -> bool:
    from converters.check import render_mitsuba, write_exr
    from converters.variant import use

    scene = load_scene(path)
    choice = use(options.variant)
    image = render_mitsuba(scene, options.samples or 1, choice.variant)
    write_png(target, image)
    write_exr(target.with_suffix(".exr"), image)
    print(f"{target} and .exr: {scene.width} x {scene.height}, {choice.variant} ({choice.reason})")
    return True


def _check(path: Path, target: Path, options: argparse.Namespace) -> bool:
    from converters.check import check
    from reference.compare import write_comparison

    result = check(path, options.variant)
    write_comparison(
        target, result.tracer, result.mitsuba, labels=("tracer", f"Mitsuba {result.variant}")
    )
    print(result.report())
    print(f"  {target}")
    return not result.faults


if __name__ == "__main__":
    sys.exit(main())
