"""Choose the Mitsuba variant: by default, the fastest one that works on this machine.

A *variant* is one of the ways in which Mitsuba computes.  ``llvm_ad_rgb`` compiles the computations
to machine code, and ``scalar_rgb`` is slower but always works.  The first needs the shared library
libLLVM.  If the library is missing, Mitsuba reports an error.  But with some versions of the
library, such as 15 and 16, the first *kernel* (compiled computation) aborts the whole process.
Therefore each process that uses Mitsuba first lets a child process run a small kernel.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import cache
from math import ceil
from typing import NamedTuple

try:
    import drjit as dr
    import mitsuba as mi
except NameError as error:  # raised by Dr.Jit if a library of the system is missing
    raise ImportError(str(error.__context__ or error)) from error

__all__ = ["LLVM", "SCALAR", "VariantChoice", "ensure_variant", "find_fastest_variant", "mi"]
__all__ += ["use_variant"]

# On one processor, Mitsuba's reader and writer of EXR files would wait forever for a second thread.
if dr.thread_count() < 2:
    dr.set_thread_count(2)

LLVM, SCALAR = "llvm_ad_rgb", "scalar_rgb"

# The kernel contains the two operations at which unusable versions of libLLVM are known to fail: a
# maximum, and the intersection of rays with a scene.
_KERNEL = f"""
import drjit as dr
import mitsuba as mi
mi.set_variant({LLVM!r})
scene = mi.load_dict({{"type": "scene", "shape": {{"type": "sphere"}}}})
x = dr.maximum(dr.linspace(mi.Float, -.5, .5, 64), 0)
hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(x, 0, 3), mi.Vector3f(0, 0, -1)))
assert abs(dr.mean(hit.t)[0] - 2) < .1
"""

# The child process runs this first, so that it does not outlive its parent for long.  Ctrl-C
# reaches both.  It ends the child at once, because Dr.Jit may never end after a KeyboardInterrupt.
# If only the parent ends, an alarm ends the child after {seconds} seconds.
_CHILD_SETUP = """
from signal import *
if getsignal(SIGINT) is default_int_handler:
    signal(SIGINT, SIG_DFL)
if "alarm" in dir():  # not on Windows
    alarm({seconds})
"""


class VariantChoice(NamedTuple):
    """The name of a Mitsuba variant, and the reason for choosing it."""

    variant: str  # for example, "scalar_rgb"
    reason: str  # for messages to users: for example, "libLLVM works"


def find_fastest_variant(kernel: str = _KERNEL, timeout: float = 60) -> VariantChoice:
    """Find the fastest Mitsuba variant that works on this machine.

    A child process tries the variant `LLVM`, which is the result if this succeeds.  If the child
    process fails, is killed by a signal or does not end in time, the result is `SCALAR`, and its
    reason says what happened.

    Parameters
    ----------
    kernel
        Python code for the child process.  It must fail if the LLVM variant is unusable.
    timeout
        Maximum time, in seconds, that the child process may take.
    """
    setup = _CHILD_SETUP.format(seconds=ceil(timeout) + 1)
    command = [sys.executable, "-c", setup + kernel]
    # Kernels that are cached in the home folder could hide a bad libLLVM.
    env = os.environ | {"HOME": os.devnull}
    try:
        child = subprocess.run(command, env=env, capture_output=True, text=True, timeout=timeout)
    except subprocess.TimeoutExpired:
        return VariantChoice(variant=SCALAR, reason="the libLLVM found here hangs")
    if child.returncode == 0:
        return VariantChoice(variant=LLVM, reason="libLLVM works")
    if child.returncode < 0:  # on Unix, a signal ended the child
        signal_name = signal.Signals(-child.returncode).name
        reason = f"the libLLVM found here kills the process with {signal_name}"
        return VariantChoice(variant=SCALAR, reason=reason)
    error_lines = child.stderr.strip().splitlines() or ["no message"]
    return VariantChoice(variant=SCALAR, reason=f"no usable libLLVM: {error_lines[-1].strip()}")


_find_fastest_once = cache(find_fastest_variant)


def use_variant(variant: str | None = None) -> VariantChoice:
    """Set the variant that Mitsuba uses from now on in this process, and return the choice.

    `variant` is the name of a variant that computes with RGB colours, or None for the fastest one
    that works on this machine.  Raise ImportError for any other name, and if the variant does not
    work here.
    """
    choice = _find_fastest_once()
    if variant is not None and variant != choice.variant:
        rgb_variants = [name for name in mi.variants() if name.endswith("_rgb")]
        if variant not in rgb_variants:
            remedy = f"choose one of {', '.join(rgb_variants)}"
            raise ImportError(f"{variant or repr(variant)} is not an RGB variant; {remedy}")
        if variant == LLVM:
            raise ImportError(f"{LLVM} does not work here: {choice.reason}")
        choice = VariantChoice(variant=variant, reason="requested")
    mi.set_variant(choice.variant)
    return choice


def ensure_variant() -> None:
    """Set the fastest Mitsuba variant that works on this machine, unless a variant is already set.

    Without a variant, most functions of Mitsuba fail.
    """
    if mi.variant() is None:
        use_variant()
