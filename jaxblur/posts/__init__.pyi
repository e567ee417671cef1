from .defocus import (
    PRESETS as PRESETS,
    Lens as Lens,
    circle_of_confusion as circle_of_confusion,
    defocus as defocus,
)
from .fxaa import FXAAParameters as FXAAParameters, fxaa as fxaa
from .luma import perceived_luma as perceived_luma
from .mlaa import MLAAParameters as MLAAParameters, mlaa as mlaa
from .reblur import ReblurParameters as ReblurParameters, reblur as reblur
