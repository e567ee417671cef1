"""Drawing: buffers, tiles, taps, errors, speed against error.

Imports nothing of jaxblur but `_util`, `filters`, `frame`, `metrics`, `noise`, `safe_math` and
`settings`.

Every function returns a matplotlib figure that belongs to no window and to no global state: save it
with ``figure.savefig(path)``, or make it the last line of a notebook cell. If ``axes`` are passed,
a function draws there and returns their figure. This needs the extra ``jaxblur[plot]``; matplotlib
is loaded by the first drawing.
"""

from .buffers import (
    depth_map as depth_map,
    frame_sheet as frame_sheet,
    velocity_arrows as velocity_arrows,
    velocity_wheel as velocity_wheel,
)
from .colors import velocity_colors as velocity_colors
from .comparison import (
    before_after as before_after,
    error_map as error_map,
    image_grid as image_grid,
)
from .curves import bars as bars, curves as curves
from .figures import new_figure as new_figure, show_pixels as show_pixels
from .pareto import Measurement as Measurement, pareto as pareto, pareto_front as pareto_front
from .sliders import sliders as sliders
from .tiles import (
    tap_diagram as tap_diagram,
    texel_weights as texel_weights,
    tile_overlay as tile_overlay,
    tile_velocities as tile_velocities,
)
