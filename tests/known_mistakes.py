"""Pictures with the mistakes that `reference/handins/mistakes.md` describes."""

import numpy as np

from reference.handins.drawing import FormulaCache, join_formulas, make_formula_inputs
from reference.handins.formulas import Array
from reference.handins.mistakes import list_mistakes
from tracer import Scene


@np.errstate(all="ignore")
def render_with_mistakes(scene: Scene, *keywords: str, formula: str = "codes") -> Array:
    """Render a scene as a tracer with the given mistakes would.

    Parameters
    ----------
    scene : Scene
        The scene.
    *keywords : str
        Keywords of the mistakes, such as "gamma-none", as in `list_mistakes(scene)`.  Without
        keywords, the reference picture is rendered.
    formula : str
        Name of the formula to evaluate, such as "radiance"; by default, the 8-bit codes.

    Returns
    -------
    (h, w, 3) array
        The values of the formula at each pixel, with 0 in place of NaN.

    Raises
    ------
    KeyError
        If a keyword is unknown.
    ValueError
        If two mistakes replace the same formula, and so exclude each other.
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
