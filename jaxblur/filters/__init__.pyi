from ._arguments import (
    GuertinSettings as GuertinSettings,
    LayeredSettings as LayeredSettings,
    McGuireSettings as McGuireSettings,
    Settings as Settings,
    takes as takes,
)
from ._masking import honoring_mask as honoring_mask
from .guertin2014 import (
    GuertinParameters as GuertinParameters,
    guertin2014 as guertin2014,
)
from .layered import (
    Layer as Layer,
    LayeredParameters as LayeredParameters,
    blur_layers as blur_layers,
    layered as layered,
)
from .luma_hint import luma_hint as luma_hint
from .mcguire2012 import McGuireParameters as McGuireParameters, mcguire2012 as mcguire2012
from .parameters import ParameterInfo as ParameterInfo, parameter as parameter
from .pixel_velocity import pixel_velocity as pixel_velocity
from .registry import (
    FILTERS as FILTERS,
    Filter as Filter,
    FilterInfo as FilterInfo,
    Parameters as Parameters,
    filter_info as filter_info,
    load_filter as load_filter,
    names as names,
    register as register,
    unregister as unregister,
)
