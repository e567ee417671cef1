"""ColorVideoVDP, a metric of video quality by a model of human vision.

Imports nothing of jaxblur. From clips to one number, one file for each step:

display      pixels -> light of a screen, in three opponent channels
temporal     -> what the eye sees of changes: four channels, one of them transient
pyramid      -> bands of spatial frequency, as contrasts
sensitivity  the smallest contrast that is seen, by frequency, luminance and channel
masking      -> difference of test and reference, in multiples of what is just seen
pooling      -> one number, in JOD
model        the calibrated numbers
metric       all steps, frame by frame
"""

from .display import (
    DISPLAYS as DISPLAYS,
    Display as Display,
    find_display as find_display,
    nits_display as nits_display,
    pixels_per_degree as pixels_per_degree,
    pq_display as pq_display,
    white_display as white_display,
)
from .metric import cvvdp as cvvdp
