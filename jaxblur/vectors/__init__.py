"""Motion-vector conventions: recognize them, convert them, measure them.

Imports nothing of jaxblur but `frame` and `safe_math`, both in `vectors.sky` and
`vectors.encoding`, which alone load jax.

Every renderer stores motion vectors in its own way: channels, axes, signs, units and time spans
differ. Here a convention is data (`PRESETS`), and all are converted to one:

    displacement of the surface point, in **pixels** of the full picture, over **one full
    frame**, **x right, y down**, either to the next frame or to the previous one,

and then, for an exposure of ``shutter`` frames, to the convention of `jaxblur.frame`:

    half-spread = 1/2 * shutter * (displacement per frame).

If a file holds both directions (Blender, Nuke), the path of a point is the arc through its
previous, current and next positions, and the frame stores the ends of that path too
(`to_half_spread`).

If the convention of a file is unknown, `rank_conventions` warps the next frame back under each
candidate and ranks the candidates by how well the pictures agree. `check_convention` tests one, by
the rules of the README, `measure_span` finds the time that vectors cover, and `difference_left`
tells how much of the difference of two frames they leave.
"""

from .conformance import Finding as Finding, check_convention as check_convention
from .convert import (
    Displacements as Displacements,
    check_shutter as check_shutter,
    from_path as from_path,
    to_displacements as to_displacements,
    to_half_spread as to_half_spread,
)
from .guess import (
    Guess as Guess,
    NoVectorsError as NoVectorsError,
    assign_channels as assign_channels,
    describe_names as describe_names,
    find_channels as find_channels,
    guess_preset as guess_preset,
    known_preset as known_preset,
    match_preset as match_preset,
)
from .presets import (
    PRESETS as PRESETS,
    DepthKind as DepthKind,
    Layout as Layout,
    Preset as Preset,
    VectorPair as VectorPair,
)
from .rank import (
    UNITS as UNITS,
    Candidate as Candidate,
    Ranking as Ranking,
    rank_conventions as rank_conventions,
)
from .span import difference_left as difference_left, measure_span as measure_span
from .statistics import (
    SpeedStatistics as SpeedStatistics,
    speed_statistics as speed_statistics,
    speed_statistics_of_blocks as speed_statistics_of_blocks,
)
