from . import exr as exr
from . import fitting as fitting
from . import metrics as metrics
from . import scenes as scenes
from . import vectors as vectors
from .exr import read_frame as read_frame
from .exr import write_image as write_image
from .filters import FILTERS as FILTERS
from .filters import GuertinParameters as GuertinParameters
from .filters import McGuireParameters as McGuireParameters
from .filters import guertin2014 as guertin2014
from .filters import mcguire2012 as mcguire2012
from .filters import pixel_velocity as pixel_velocity
from .fitting import FitResult as FitResult
from .fitting import fit as fit
from .frame import Frame as Frame
from .noise import Noise as Noise
from .settings import Settings as Settings
from .tiles import neighbor_max as neighbor_max
from .tiles import tile_max as tile_max
from .tiles import tile_variance as tile_variance

__version__: str
