"""Choose the Mitsuba variant that this machine can run: LLVM where it works, otherwise scalar.

The variant ``llvm_ad_rgb`` needs a shared libLLVM.  If there is none, Mitsuba reports it.  But with
some versions of LLVM (15 and 16, for example) the first kernel aborts the whole process.  A child
process therefore runs a small kernel first, once for each process that uses Mitsuba.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import cache
from typing import NamedTuple

try:
    import drjit as dr
    import mitsuba as mi
except NameError as error:  # raised by Dr.Jit if a library of the system is missing
    raise ImportError(str(error.__context__ or error)) from error

__all__ = ["LLVM", "SCALAR", "Choice", "ensure_variant", "fastest_variant", "mi", "use_variant"]

# On one processor, Mitsuba's reader and writer of EXR files would wait forever for a second thread.
if dr.thread_count() < 2:
    dr.set_thread_count(2)

LLVM = "llvm_ad_rgb"
SCALAR = "scalar_rgb"

# The kernel contains the two operations at which unusable versions are known to fail: a maximum,
# and the intersection of rays with a scene.
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
    """A variant of Mitsuba, and the reason why it was chosen.

    Attributes
    ----------
    variant : str
        Mitsuba's name of the variant.
    reason : str
        A clause for messages to users.
    """

    variant: str
    reason: str


def fastest_variant(kernel: str = _KERNEL, timeout: float = 60) -> Choice:
    """Find the fastest Mitsuba variant that works on this machine.

    A child process tests LLVM, because an unusable version may abort the process.

    Parameters
    ----------
    kernel : str
        Python code that the child process runs.
    timeout : float
        Seconds after which the child process is stopped, and LLVM is treated as unusable.

    Returns
    -------
    choice : Choice
        The LLVM variant if the child process ends with status 0; otherwise the scalar variant.
    """
    # The child has no home folder, where kernels of a good libLLVM may hide that this one is bad.
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
    lines = child.stderr.strip().splitlines() or ["no message"]
    return Choice(SCALAR, f"no usable libLLVM: {lines[-1].strip()}")


_cached_choice = cache(fastest_variant)


def use_variant(variant: str | None = None) -> Choice:
    """Set the variant that Mitsuba uses in this process from now on.

    Parameters
    ----------
    variant : str, optional
        Mitsuba's name of the variant; the default is the fastest that works on this machine.

    Returns
    -------
    choice : Choice
        The variant, and the reason for it.

    Raises
    ------
    ImportError
        If the requested variant does not work on this machine, or is not an RGB variant.
    """
    choice = _cached_choice()
    if variant is not None and variant != choice.variant:
        available = [name for name in mi.variants() if name.endswith("_rgb")]
        if variant not in available:
            names = ", ".join(available)
            raise ImportError(
                f"{variant or repr(variant)} is not an RGB variant; choose one of {names}"
            )
        if variant == LLVM:
            raise ImportError(f"{LLVM} does not work here: {choice.reason}")
        choice = Choice(variant, "requested")
    mi.set_variant(choice.variant)
    return choice


def ensure_variant() -> None:
    """Set Mitsuba's variant to the fastest that works on this machine, unless one is set already.

    The variant applies to the whole process, and Mitsuba needs one before most of its operations.
    """
    if mi.variant() is None:
        use_variant()
