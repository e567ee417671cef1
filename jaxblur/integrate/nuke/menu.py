"""Adds gizmo and panel to the menus; Nuke runs this file of a folder on its path."""

# pyright: reportAttributeAccessIssue=false
# `nuke` is the module of Nuke, not this folder.

import nuke

_FILTER = nuke.menu("Nodes").addMenu("Filter")
_FILTER.addCommand("Motion blur (jaxblur)", "nuke.createNode('jaxblur')")
_FILTER.addCommand(
    "Motion blur of files (jaxblur)", "import jaxblur_nuke; jaxblur_nuke.show_panel()"
)
