"""Sequences of frames: file names, plans, and execution in one or many processes.

Imports nothing of jaxblur but `exr`.

A sequence is a list of `Job`, one per frame. Before any work, `plan_jobs` chooses the action for
each frame from the files on disk: outputs carry a digest of all choices that made them (`digest`),
so that a run that was interrupted at any moment continues where it stopped, and never mistakes
outputs made in another way for its own. Jobs are independent of each other and may run twice: a
file appears under its name only when it is complete.

Jobs pass through the same `Stage`s wherever they run: `run_pipeline` overlaps reading, computing
and writing in one process, `run_cluster` sends frames to the workers of a Dask cluster.
"""

from .cluster import run_cluster as run_cluster
from .cuts import Cut as Cut, find_cuts as find_cuts, is_cut as is_cut
from .jobs import (
    Job as Job,
    Plan as Plan,
    digest as digest,
    plan_jobs as plan_jobs,
)
from .names import (
    FrameNames as FrameNames,
    at_frame as at_frame,
    frame_number as frame_number,
    has_frame_number as has_frame_number,
    missing_frames as missing_frames,
    parse_frames as parse_frames,
    parse_names as parse_names,
    with_frame_number as with_frame_number,
)
from .pipeline import (
    Outcome as Outcome,
    Stage as Stage,
    run_pipeline as run_pipeline,
    run_stages as run_stages,
)
from .shared import Shared as Shared
