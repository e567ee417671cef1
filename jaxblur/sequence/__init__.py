"""Sequences of frames: file names, plans, and execution in one or many processes.

Imports nothing of jaxblur but `exr`.

A sequence is a list of `Job`, one per frame. Before any work, `plan_jobs` chooses the action for
each frame from the files on disk: outputs carry a digest of all choices that made them (`digest`),
so that a run that was interrupted at any moment continues where it stopped, and never mistakes
outputs made in another way for its own. Jobs are independent of each other and may run twice: a
file appears under its name only when it is complete.

Jobs pass through the same `Stage`s wherever they run: `run_pipeline` overlaps reading, computing
and writing in one process, `run_cluster` sends frames to the workers of a Dask cluster, which
`cluster_client` connects to or starts. All load on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
