"""Smoke with known truth: ray marched, single scattering, with bodies before, in and behind it.

After Navarro 2012, chapter 2. `puff` has density and flow, `volume` voxels and their distance map,
`environment` an HDR map reduced to lights, `lighting` the light that reaches smoke, `march` the
passes along rays, `frames` sharp frames and truth, `layers` the same in layers. Like all of
`scenes` it shares no code with the filters.
"""

from .catalogue import ball_in_smoke as ball_in_smoke
from .environment import (
    Lights as Lights,
    environment_map as environment_map,
    median_cut as median_cut,
)
from .frames import accumulate_smoke as accumulate_smoke, render_smoke as render_smoke
from .layers import SmokeLayers as SmokeLayers, smoke_layers as smoke_layers
from .lighting import Marching as Marching, Medium as Medium
from .puff import Flow as Flow, Puff as Puff
from .scene import SmokeScene as SmokeScene
