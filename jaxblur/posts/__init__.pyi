from .fxaa import FXAAParameters as FXAAParameters, fxaa as fxaa
from .luma import perceived_luma as perceived_luma
from .mlaa import MLAAParameters as MLAAParameters, mlaa as mlaa
