"""``jaxblur blur`` and ``jaxblur layers`` on sequences.

`options` are what only sequences have; `plan` says which frames are blurred, kept or passed, after
all checks; `recognition` finds what their vectors mean; `frame_work` is the work on one frame;
`run` does it for all of them; `report` prints what will be or was done.
"""

from .options import (
    add_options as add_options,
    is_asked_for as is_asked_for,
    pattern_of as pattern_of,
    refuse_options as refuse_options,
    refuse_shell_pattern as refuse_shell_pattern,
)
from .plan import (
    check_truth as check_truth,
    frames_on_disk as frames_on_disk,
    hint_of as hint_of,
    names_of as names_of,
    options_that_count as options_that_count,
    refuse_existing as refuse_existing,
    with_all_frames as with_all_frames,
)
from .report import print_scores as print_scores, scores_record as scores_record
from .run import WRITE_FAILURES as WRITE_FAILURES, blur_sequence as blur_sequence
