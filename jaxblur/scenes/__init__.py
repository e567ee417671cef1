"""Ground truth: scenes with exact buffers, and the true motion-blurred image.

Imports nothing of jaxblur but `frame` and `srgb`, so that ground truth shares no code with the
filters that it judges.
"""

from .accumulation import accumulate as accumulate
from .catalogue import SCENES as SCENES
from .lens import ThinLens as ThinLens
from .materials import Material as Material
from .mesh import Mesh as Mesh, load_mesh as load_mesh
from .motion import (
    Camera as Camera,
    Motion as Motion,
    camera as camera,
    rigid as rigid,
    twisting as twisting,
)
from .motion_paths import MotionPathStatistics as MotionPathStatistics, motion_paths as motion_paths
from .rendering import displacement as displacement, object_ids as object_ids, render as render
from .scene import (
    Body as Body,
    Light as Light,
    Scene as Scene,
    Wave as Wave,
    daylight as daylight,
    make_scene as make_scene,
)
from .shutter import shutter_curve as shutter_curve
from .smoke import (
    Flow as Flow,
    Lights as Lights,
    Marching as Marching,
    Medium as Medium,
    Puff as Puff,
    SmokeLayers as SmokeLayers,
    SmokeScene as SmokeScene,
    accumulate_smoke as accumulate_smoke,
    ball_in_smoke as ball_in_smoke,
    environment_map as environment_map,
    median_cut as median_cut,
    render_smoke as render_smoke,
    smoke_layers as smoke_layers,
)
from .stereo import disparity as disparity, stereo as stereo
from .stochastic import stochastic as stochastic
