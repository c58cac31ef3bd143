"""Which Mitsuba variant this machine can run: LLVM where it works, else scalar.

The ``llvm_ad_rgb`` variant needs a shared libLLVM.  Without one Mitsuba says so, but with some
versions of LLVM (15 and 16, for instance) the first kernel aborts the whole process.  So a child
process tries a small kernel first, once for each process that asks.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import cache
from typing import NamedTuple

try:
    import mitsuba as mi
except NameError as error:  # so drjit ends where a library of the system is missing
    raise ImportError(str(error.__context__ or error)) from error

__all__ = ["LLVM", "SCALAR", "Choice", "choose", "ensure", "mi", "use"]

LLVM = "llvm_ad_rgb"
SCALAR = "scalar_rgb"

# With the two operations at which unusable versions are known to fail: a maximum, and a ray query.
_KERNEL = f"""
import drjit as dr
import mitsuba as mi
mi.set_variant({LLVM!r})
scene = mi.load_dict({{"type": "scene", "shape": {{"type": "sphere"}}}})
x = dr.maximum(dr.linspace(mi.Float, -.5, .5, 64), 0)
hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(x, 0, 3), mi.Vector3f(0, 0, -1)))
assert abs(dr.mean(hit.t)[0] - 2) < .1
"""


class Choice(NamedTuple):
    """A variant, and why it was chosen."""

    variant: str
    reason: str


def choose(kernel: str = _KERNEL, timeout: float = 60) -> Choice:
    """Choose the fastest variant that works here: LLVM if a child runs `kernel` within seconds."""
    # No home: kernels cached there by a good libLLVM would hide that this one is bad.
    try:
        child = subprocess.run(
            [sys.executable, "-c", kernel],
            env=os.environ | {"HOME": os.devnull},
            capture_output=True,
            text=True,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired:
        return Choice(SCALAR, "the libLLVM found here hangs")
    if child.returncode == 0:
        return Choice(LLVM, "libLLVM works")
    if child.returncode < 0:
        name = signal.Signals(-child.returncode).name
        return Choice(SCALAR, f"the libLLVM found here kills the process with {name}")
    said = child.stderr.strip().splitlines() or ["it said nothing"]
    return Choice(SCALAR, f"no usable libLLVM: {said[-1].strip()}")


_chosen = cache(choose)


def use(variant: str | None = None) -> Choice:
    """Make a variant Mitsuba's current one; ImportError for a given one that does not work here."""
    choice = _chosen()
    if variant is not None and variant != choice.variant:
        able = [name for name in mi.variants() if name.endswith("_rgb")]
        if variant not in able:
            raise ImportError(
                f"{variant or repr(variant)} is not an RGB variant; choose one of {', '.join(able)}"
            )
        if variant == LLVM:
            raise ImportError(f"{LLVM} does not work here: {choice.reason}")
        choice = Choice(variant, "asked for")
    mi.set_variant(choice.variant)
    return choice


def ensure() -> None:
    """Make the fastest variant that works Mitsuba's current one, unless there is one already."""
    if mi.variant() is None:
        use()
