from . import (
    bench as bench,
    devices as devices,
    export as export,
    exr as exr,
    filters as filters,
    fitting as fitting,
    kernels as kernels,
    metrics as metrics,
    noise as noise,
    perception as perception,
    posts as posts,
    report as report,
    safe_math as safe_math,
    scenes as scenes,
    sequence as sequence,
    show as show,
    vectors as vectors,
)
from .batch import blur_batch as blur_batch, blur_subframes as blur_subframes
from .camera import (
    CameraMove as CameraMove,
    Intrinsics as Intrinsics,
    camera_path as camera_path,
    camera_velocity as camera_velocity,
    path_between_cameras as path_between_cameras,
)
from .exr import read_frame as read_frame, write_image as write_image
from .filters import (
    FILTERS as FILTERS,
    FilterInfo as FilterInfo,
    GuertinParameters as GuertinParameters,
    GuertinSettings as GuertinSettings,
    Layer as Layer,
    LayeredParameters as LayeredParameters,
    LayeredSettings as LayeredSettings,
    McGuireParameters as McGuireParameters,
    McGuireSettings as McGuireSettings,
    ParameterInfo as ParameterInfo,
    Settings as Settings,
    blur_layers as blur_layers,
    filter_info as filter_info,
    guertin2014 as guertin2014,
    layered as layered,
    luma_hint as luma_hint,
    mcguire2012 as mcguire2012,
    parameter as parameter,
    pixel_velocity as pixel_velocity,
    register as register,
)
from .filters.tiles import (
    neighbor_max as neighbor_max,
    tile_max as tile_max,
    tile_variance as tile_variance,
)
from .fitting import FitResult as FitResult, fit as fit
from .frame import Frame as Frame
from .gradient_check import (
    GradientCheck as GradientCheck,
    GradientRow as GradientRow,
    check_gradient as check_gradient,
)
from .noise import Noise as Noise, shared_noise as shared_noise
from .nonfinite import finite_frame as finite_frame
from .planning import (
    FrameStatistics as FrameStatistics,
    Plan as Plan,
    frame_statistics as frame_statistics,
    plan as plan,
)
from .shutter import Shutter as Shutter
from .strength import (
    MOTION_LIMITS as MOTION_LIMITS,
    MotionLimits as MotionLimits,
    SplitMotion as SplitMotion,
    add_velocity as add_velocity,
    limit_motion as limit_motion,
    replace_camera_motion as replace_camera_motion,
    scale_motion as scale_motion,
    split_motion as split_motion,
    within_limits as within_limits,
    without_camera as without_camera,
)
from .vectors.encoding import (
    decode_velocity as decode_velocity,
    encode_velocity as encode_velocity,
)
from .vectors.sky import (
    CameraFit as CameraFit,
    fit_camera_motion as fit_camera_motion,
    turning_sky as turning_sky,
)

__version__: str
