"""Ground truth: scenes with exact buffers, and the true motion-blurred image.

This part imports nothing from the package but the frame and the sRGB curve: it shares no code with
the filters that are judged by it.
"""

from .accumulation import accumulate as accumulate
from .catalogue import SCENES as SCENES
from .materials import Material as Material
from .mesh import Mesh as Mesh
from .mesh import load_mesh as load_mesh
from .motion import Camera as Camera
from .motion import Motion as Motion
from .motion import camera as camera
from .motion import rigid as rigid
from .motion_paths import MotionPathStatistics as MotionPathStatistics
from .motion_paths import motion_paths as motion_paths
from .rendering import displacement as displacement
from .rendering import object_ids as object_ids
from .rendering import render as render
from .scene import Body as Body
from .scene import Light as Light
from .scene import Scene as Scene
from .scene import Wave as Wave
from .scene import daylight as daylight
from .scene import make_scene as make_scene
from .shutter import shutter_curve as shutter_curve
from .stochastic import stochastic as stochastic
