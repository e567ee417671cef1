"""The engine: runs programs of one pixel for all pixels, with derivatives; knows nothing of blur.

Imports nothing of jaxblur but `settings`, `safe_math` and `_util`. The README says how it works.
"""

from .gathers import cond_of_values as cond_of_values, unchanged as unchanged
from .passes import (
    Pass as Pass,
    each_pixel as each_pixel,
    largest_in_tiles as largest_in_tiles,
    largest_marks as largest_marks,
    passes_as_equations as passes_as_equations,
    recorded_passes as recorded_passes,
)
from .program import (
    At as At,
    Image as Image,
    Outcome as Outcome,
    mark_over as mark_over,
    sum_over as sum_over,
)
from .reads import nearest_place as nearest_place, still_place as still_place
