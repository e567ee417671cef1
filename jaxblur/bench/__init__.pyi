from .cases import (
    RENDERERS as RENDERERS,
    UNBLURRED as UNBLURRED,
    Case as Case,
    make_case as make_case,
    one_at_a_time as one_at_a_time,
    product as product,
)
from .changes import Change as Change, compare as compare
from .frames import moving_frame as moving_frame
from .fronts import (
    by_scene as by_scene,
    front as front,
    points as points,
    pooled as pooled,
    report as report,
)
from .jobs import batches as batches, catalogue_jobs as catalogue_jobs
from .measuring import measure as measure
from .programs import Programs as Programs
from .results import (
    Row as Row,
    identity as identity,
    latest as latest,
    read_rows as read_rows,
    write_rows as write_rows,
)
from .scaling import PowerLaw as PowerLaw, fit_power_law as fit_power_law
from .subjects import (
    Subject as Subject,
    catalogue_subject as catalogue_subject,
    frame_subject as frame_subject,
)
from .timing import Timing as Timing, time_in_turn as time_in_turn
