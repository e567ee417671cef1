"""The cheapest filter that is expected to do for a frame, from statistics of the frame.

Imports nothing of jaxblur but `filters`, `frame`, `settings` and `vectors`.
"""

from .choice import (
    PERCEPTUAL_TOLERANCE as PERCEPTUAL_TOLERANCE,
    Plan as Plan,
    constants as constants,
    plan as plan,
)
from .statistics import FrameStatistics as FrameStatistics, frame_statistics as frame_statistics
