"""What commands tell the user."""

from __future__ import annotations


def told(err: str) -> str:
    """What a command wrote to stderr, without Dr.Jit's lines there if it has found no libLLVM."""
    return "".join(line for line in err.splitlines(True) if not line.startswith("jit"))
