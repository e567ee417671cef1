from .cluster import cluster_client as cluster_client, run_cluster as run_cluster
from .cuts import Cut as Cut, find_cuts as find_cuts, is_cut as is_cut
from .jobs import (
    Job as Job,
    Plan as Plan,
    digest as digest,
    plan_frame as plan_frame,
    plan_jobs as plan_jobs,
)
from .names import (
    FrameNames as FrameNames,
    at_frame as at_frame,
    frame_number as frame_number,
    frame_ranges as frame_ranges,
    has_frame_number as has_frame_number,
    missing_frames as missing_frames,
    parse_frames as parse_frames,
    parse_names as parse_names,
    with_frame_number as with_frame_number,
    with_view as with_view,
)
from .pipeline import (
    Outcome as Outcome,
    Stage as Stage,
    run_pipeline as run_pipeline,
    run_stages as run_stages,
)
from .shared import Shared as Shared
