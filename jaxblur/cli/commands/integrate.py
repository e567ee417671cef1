"""``jaxblur integrate``: extensions of Blender and Nuke, job templates for farms."""

import argparse
import os
import pathlib
import shutil
import sys
import sysconfig
from typing import Any

from jaxblur import integrate
from jaxblur._util.atomic import replacing

from ..arguments import CommandError, add_command, check_folder, check_outputs, file_path
from ..console import print_line

HELP = """\
blender  OUT.zip, an extension for Blender 4.2 or newer: Edit > Preferences > Get Extensions >
         Install from Disk; then Properties > Output > Motion blur (jaxblur)
nuke     a folder for NUKE_PATH: a gizmo and a panel in the menu Filter (not run in Nuke)
farm     a folder with an Open Job Description template and a job type of Flamenco"""


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "integrate", "Write an extension that calls jaxblur from another program.", run
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = HELP
    parser.add_argument("host", choices=integrate.HOSTS, help="the other program; see below")
    parser.add_argument(
        "-o", "--output", type=file_path, required=True, metavar="OUT", help="what to write"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace existing files")
    parser.add_argument(
        "--executable",
        metavar="PATH",
        help="command that the extension calls (default: that of this installation, else the one "
        "on the PATH); `jaxblur` means the one on the PATH, for an extension on many machines",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the files; see `add_parser`."""
    output: pathlib.Path = arguments.output
    files = _files(arguments, output)
    check_folder(output.parent)
    check_outputs(files, arguments.overwrite)
    for path, content in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            pathlib.Path(temporary).write_bytes(content)
        print_line(path)
    return 0


def _files(arguments: argparse.Namespace, output: pathlib.Path) -> dict[pathlib.Path, bytes]:
    """The content of each file."""
    if arguments.host == "blender":
        if output.suffix.lower() != ".zip":
            raise CommandError(
                f"{output}: the extension for Blender is a .zip; end the name in .zip."
            )
        own = arguments.executable or _own_executable()
        return {output: integrate.zipped(integrate.blender_files(own))}
    if output.exists() and not output.is_dir():
        raise CommandError(f"{output}: is a file; give the name of a folder.")
    if arguments.host == "nuke":
        files = integrate.nuke_files(arguments.executable or _own_executable())
    else:
        # The machines of a farm have the command elsewhere.
        files = integrate.farm_files(arguments.executable or "jaxblur")
    return {output / name: text.encode() for name, text in files.items()}


def _own_executable() -> str:
    """The command of this installation; its bare name if it has none."""
    started = shutil.which(sys.argv[0]) if os.path.basename(sys.argv[0]) == "jaxblur" else None
    beside = shutil.which("jaxblur", path=sysconfig.get_path("scripts"))
    return os.path.abspath(started) if started else beside or "jaxblur"
