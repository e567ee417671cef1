"""Motion-vector conventions: recognize them, convert them, measure them.

Every renderer stores motion vectors in its own way: other channels, axes, signs, units, time
spans. Here a convention is data (`PRESETS`), and everything is converted to one:

    displacement of the surface point, in **pixels** of the full picture, over **one full
    frame**, **x right, y down**, either to the next frame or to the previous one,

and from there, for an exposure of ``shutter`` frames, to what `jaxblur.frame` asks for:

    half-spread = 1/2 * shutter * (displacement per frame).

Where a file holds both sides (Blender, Nuke), the path of a point is the parabola through its
previous, present and next positions, and the frame gets its ends too (`to_half_spread`).

Not sure which convention a file follows? `rank_conventions` warps the next frame back under
each candidate and ranks them by how well the pictures agree.
"""

from .convert import Displacements as Displacements
from .convert import check_shutter as check_shutter
from .convert import to_displacements as to_displacements
from .convert import to_half_spread as to_half_spread
from .guess import Guess as Guess
from .guess import assign_channels as assign_channels
from .guess import describe_names as describe_names
from .guess import find_channels as find_channels
from .guess import guess_preset as guess_preset
from .guess import known_preset as known_preset
from .guess import match_preset as match_preset
from .presets import PRESETS as PRESETS
from .presets import DepthKind as DepthKind
from .presets import Layout as Layout
from .presets import Preset as Preset
from .presets import VectorPair as VectorPair
from .rank import Candidate as Candidate
from .rank import Ranking as Ranking
from .rank import rank_conventions as rank_conventions
from .statistics import SpeedStatistics as SpeedStatistics
from .statistics import speed_statistics as speed_statistics
