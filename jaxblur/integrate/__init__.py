"""Extensions of other programs that call the command ``jaxblur``: Blender, Nuke, render farms.

Imports nothing of jaxblur. The folders `blender`, `nuke` and `farm` hold what is written, `shared`
what goes into each; their Python runs in the hosts, without jaxblur.
"""

from .hosts import (
    HOSTS as HOSTS,
    blender_files as blender_files,
    farm_files as farm_files,
    nuke_files as nuke_files,
    zipped as zipped,
)
