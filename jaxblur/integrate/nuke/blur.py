"""What the button of the gizmo does: writes sharp frames, blurs them, shows the result."""

# pyright: reportAttributeAccessIssue=false
# `nuke` is the module of Nuke, not this folder.

import os
import tempfile
import time

import nuke

from ..shared.command import Job, Options, blur_command, find_executable
from ..shared.frames import Frames

MOTION = ("forward.u", "backward.u")
SECONDS_BETWEEN_LOOKS = 0.1


def blur(node):
    """Blur the input of a gizmo over its frames, and show the result.

    Args:
        node: the gizmo.
    """
    try:
        result = _blur(node)
    except (OSError, RuntimeError, ValueError) as error:
        tell(f"jaxblur: {error}")
        return
    if result is not None:
        node["result"].setValue(result.names)
        node["show"].setValue(True)
        node.node("Blurred")["reload"].execute()


def _blur(node):
    """Write and blur; the result, or None if the user has cancelled."""
    if not set(MOTION) & set(node.channels()):
        raise ValueError(
            "the input has neither the layer forward nor backward. Render motion vectors, or put "
            "them there by a Shuffle."
        )
    first, last = int(node["first"].value()), int(node["last"].value())
    if last < first:
        raise ValueError(f"the last frame, {last}, is before the first, {first}.")
    options = Options(
        shutter=node["shutter"].value(),
        position=node["position"].value(),
        filter=node["filter"].value(),
        samples=int(node["samples"].value()),
        more=f"--preset nuke {node['options'].value()}",
    )
    name = node.name()
    # Two gizmos of different scripts may have one name.
    folder = node["folder"].evaluate() or tempfile.mkdtemp(prefix=f"jaxblur_{name}_")
    os.makedirs(folder, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="jaxblur_") as temporary:
        start = os.path.join(temporary, f"{name}.").replace("\\", "/")
        sharp = Frames(start, 4, ".exr", tuple(range(first, last + 1)))
        node["sharp"].setValue(sharp.names)
        nuke.execute(node.node("Sharp"), first, last, 1)
        return run(sharp, sharp.within(folder), options, node["command"].evaluate() or "")


def run(sharp, blurred, options, chosen):
    """Blur files, with a bar of progress that can be cancelled.

    Args:
        sharp: `Frames` to read.
        blurred: `Frames` to write.
        options: `Options` of the command.
        chosen: path of the command by the user, or "".

    Returns:
        The blurred frames, or None if the user has cancelled.

    Raises:
        RuntimeError: the command failed, with its errors.
        ValueError: there is no command, or an option cannot be read.
    """
    job = Job([blur_command(find_executable(chosen), sharp, blurred, options)], [sharp.count])
    task = nuke.ProgressTask("jaxblur")
    while job.poll():
        task.setMessage(f"{job.done} of {job.total} frames")
        task.setProgress(int(100 * job.done / job.total))
        if task.isCancelled() and not job.cancelled:
            job.cancel()
        time.sleep(SECONDS_BETWEEN_LOOKS)
    for text in job.warnings:
        nuke.warning(f"jaxblur: {text}")
    if job.cancelled:
        return None
    lost = [path for path in blurred.paths() if not os.path.isfile(path)]
    if lost and not job.errors:
        job.errors.append(f"{lost[0]} was not written; is the command really jaxblur?")
    if job.errors:
        raise RuntimeError("\n".join(job.errors))
    return blurred


def tell(text):
    """Show an error; without a window it ends the script."""
    if not nuke.GUI:
        raise RuntimeError(text)
    nuke.message(text)
