"""Pictures with the mistakes that `reference/handins/mistakes.md` describes."""

from typing import Annotated as Shaped

import numpy as np

from reference.handins.drawing import FormulaCache, join_formulas, make_formula_inputs
from reference.handins.formula_functions import Array
from reference.handins.mistakes import list_mistakes
from tracer import Scene


@np.errstate(all="ignore")
def render_with_mistakes(
    scene: Scene, *keywords: str, formula: str = "codes"
) -> Shaped[Array, "height width 3"]:
    """Evaluate a formula at each pixel of a scene, as a tracer with the given mistakes would.

    The keywords are those of `list_mistakes(scene)`; without any, the formula is that of the
    reference picture.  NaN is replaced with 0.  Raise KeyError if a keyword is unknown, and
    ValueError if two mistakes replace the same formula, and so exclude each other.
    """
    mistakes, pixel_count = list_mistakes(scene), scene.width * scene.height
    replacements = join_formulas([mistakes[keyword].formulas for keyword in keywords])
    if keywords and not replacements:
        raise ValueError(f"{' and '.join(keywords)} change the same formula")
    row, column = np.divmod(np.arange(pixel_count), scene.width)
    size = {"width": scene.width, "height": scene.height}
    pixels = {"i": column, "j": row, "submitted_codes": np.zeros((3, pixel_count), np.uint8)}
    cache = FormulaCache(make_formula_inputs(scene) | size | pixels)
    values = cache.get_value(formula, replacements)
    return np.nan_to_num(values.T.reshape(scene.height, scene.width, 3))
