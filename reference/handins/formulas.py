"""Compile the formulas of `mistakes.md`.

A formula is a Python expression.  It becomes a function whose parameters are the names in the
expression, so that `reference.handins.drawing` can compute it from the values of other formulas.
Names of functions that formulas may call, which `_FUNCTIONS` lists, do not become parameters.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import cache, partial
from typing import Any, TypeAlias

import numpy as np

from reference.handins import formula_functions

Formulas: TypeAlias = dict[str, Callable[..., Any]]
"""Maps the name of a value to the function of `compile_formula` that computes it."""

_OWN_NAMES = """normalize dot select_vectors intersect_spheres intersect_boxes
    make_scaled_intersect make_far_intersect make_intersect find_first_crossing
    intersect_shadow_rays find_blocking_surfaces select_last_value compute_box_normals
    convert_to_grey find_background_color compute_median fit_exponent interpolate_light
    guess_hits"""
_NUMPY_NAMES = """abs arange arccos array ceil clip cos cross exp floor full_like gcd inf int64
    isfinite log logical_and maximum minimum nan_to_num pi repeat round sign sin sqrt
    take_along_axis trunc uint8 where zeros"""
_FUNCTIONS: dict[str, Callable[..., Any]] = {"len": len, "partial": partial}
_FUNCTIONS |= {name: getattr(formula_functions, name) for name in _OWN_NAMES.split()}
_FUNCTIONS |= {name: getattr(np, name) for name in _NUMPY_NAMES.split()}


@cache
def compile_formula(expression: str) -> Callable[..., Any]:
    """Compile a Python expression, such as "dot(n, l)", into a function of its variables.

    The variables are all names that are not in `_FUNCTIONS`, in alphabetical order.  They include
    builtins of Python, such as `sum`, which formulas therefore cannot call.  Equal expressions give
    the same function object.  Raise SyntaxError if the text is not an expression.

    The expression is executed without any restriction.  It must come from this project, and never
    from a scene or a submission.
    """
    nodes = ast.walk(ast.parse(expression, mode="eval"))
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    variables = ", ".join(sorted(names - _FUNCTIONS.keys()))
    function: Callable[..., Any] = eval(f"lambda {variables}: {expression}", _FUNCTIONS)
    return function


@cache
def list_parameters(function: Callable[..., Any]) -> tuple[str, ...]:
    """List the parameter names, in order, of a function of `compile_formula`."""
    code = function.__code__
    return code.co_varnames[: code.co_argcount]


def collect_parameters(formulas: Formulas) -> set[str]:
    """Collect the parameters of several formulas: the names of the values that they use."""
    return {name for formula in formulas.values() for name in list_parameters(formula)}
