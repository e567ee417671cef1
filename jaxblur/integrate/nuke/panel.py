"""The panel that blurs files with vectors as they lie on disk, and reads the result."""

# pyright: reportAttributeAccessIssue=false
# `nuke` is the module of Nuke, not this folder.

import os
import re

import nuke
import nukescripts  # pyright: ignore[reportMissingImports]

from ..shared.command import FILTERS, POSITIONS, Options
from ..shared.frames import Frames
from .blur import run, tell


class JaxblurPanel(nukescripts.PythonPanel):
    """Asks for frames on disk and how to blur them."""

    def __init__(self, file="", first=1, last=1):
        """Make the panel.

        Args:
            file: names of the frames, with %04d or ####; those of a Read.
            first: frame.
            last: frame.
        """
        nukescripts.PythonPanel.__init__(self, "Motion blur (jaxblur)")
        self.asked = {
            "file": nuke.File_Knob("file", "Frames"),
            "first": nuke.Int_Knob("first", "First"),
            "last": nuke.Int_Knob("last", "Last"),
            "filter": nuke.Enumeration_Knob("filter", "Filter", list(FILTERS)),
            "shutter": nuke.Double_Knob("shutter", "Shutter"),
            "position": nuke.Enumeration_Knob("position", "Position", list(POSITIONS)),
            "samples": nuke.Int_Knob("samples", "Samples"),
            "options": nuke.String_Knob("options", "Options"),
            "command": nuke.File_Knob("command", "Command"),
        }
        usual = Options()
        values = {
            **{"file": file, "first": first, "last": last, "filter": usual.filter},
            **{"shutter": usual.shutter, "position": usual.position, "samples": usual.samples},
            **{"options": "--radius auto", "command": ""},
        }
        for name, knob in self.asked.items():
            knob.setValue(values[name])
            self.addKnob(knob)

    def blur(self):
        """Blur what was asked for.

        Returns:
            The blurred frames, or None if the user has cancelled.

        Raises:
            RuntimeError: the command failed.
            ValueError: a value is wrong.
            OSError: the folder of the results cannot be made.
        """
        value = {name: knob.value() for name, knob in self.asked.items()}
        sharp = frames_of(value["file"], int(value["first"]), int(value["last"]))
        blurred = sharp.results()
        os.makedirs(os.path.dirname(blurred.before), exist_ok=True)
        options = Options(
            shutter=value["shutter"],
            position=value["position"],
            filter=value["filter"],
            samples=int(value["samples"]),
            more=value["options"],
        )
        return run(sharp, blurred, options, value["command"] or "")


def frames_of(names, first, last):
    """The frames that a file name of Nuke stands for.

    Raises:
        ValueError: none of them exists.
    """
    number = re.search(r"%0?(\d*)d|(#+)", names)
    if number is None:
        found = Frames(names)
        there = os.path.isfile(names)
    else:
        digits = int(number[1] or 1) if number[2] is None else len(number[2])
        ends = names[: number.start()], names[number.end() :]
        found = Frames(ends[0], digits, ends[1], tuple(range(first, last + 1))).on_disk()
        there = bool(found.numbers)
    if not there:
        raise ValueError(f"{names}: no such frames from {first} to {last}.")
    return found


def show():
    """Ask, blur, and read the result; the values are those of a Read that is selected."""
    reads = [node for node in nuke.selectedNodes() if node.Class() == "Read"]
    given = {name: reads[0][name].value() for name in ("file", "first", "last")} if reads else {}
    panel = JaxblurPanel(**given)
    if not panel.showModalDialog():
        return
    try:
        result = panel.blur()
    except (OSError, RuntimeError, ValueError) as error:
        tell(f"jaxblur: {error}")
        return
    if result is not None:
        ends = {"first": result.numbers[0], "last": result.numbers[-1]} if result.digits else {}
        nuke.nodes.Read(file=result.names.replace("\\", "/"), **ends)
