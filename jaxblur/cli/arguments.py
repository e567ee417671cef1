"""Arguments that several commands share, and the messages for mistakes in them."""

import argparse
import difflib
import itertools
import math
import os
import pathlib
import re
import sys
import textwrap
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NoReturn

from jaxblur._util.text import printable

HELP_WIDTH = 98


class CommandError(Exception):
    """A mistake on the command line; the message is one line with the remedy."""


class Parser(argparse.ArgumentParser):
    """Argument parser that raises its errors, and can end its help with text made on demand.

    Attributes:
        more_help: function that gives text to show below the options.
        elsewhere: options of another command that this one has not, each with the remedy.
        instead_of_more: function of the names given and of those left over, for a command that
            takes one: says how to give several.
    """

    more_help: Any = None
    elsewhere: Mapping[str, str] = types.MappingProxyType({})
    instead_of_more: Callable[[Sequence[str], Sequence[str]], str] | None = None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, and reject what is unknown here, where the command's own help can be named.

        The result has the defaults of a command's options by name in ``option_defaults``.

        Raises:
            CommandError: an option is unknown, or something is left over.
        """
        texts = sys.argv[1:] if args is None else list(args)
        self._refuse_unknown_options(texts)
        found, left = super().parse_known_args(texts, namespace)
        if left:
            remedy = ""
            if self.instead_of_more is not None:
                given = [text for text in texts if text not in left and text[:1] != "-"]
                remedy = f": {self.instead_of_more(given, left)}"
            self.error(f"unexpected {' '.join(left)}{remedy}")
        if self._subparsers is None:
            found.option_defaults = {name: self.get_default(name) for name in vars(found)}
        return found, left

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Reject what is not among the choices, with the nearest one."""
        choices = action.choices
        if choices is not None and value not in choices:
            names = list(map(str, choices))
            hint = did_you_mean(str(value), names)
            raise argparse.ArgumentError(
                action, f"invalid choice: {value!r}{hint}; choose from {', '.join(names)}"
            )

    def _refuse_unknown_options(self, texts: Sequence[str]) -> None:
        """Reject a mistyped option by name, before its value is taken for something else."""
        known = self._option_string_actions
        for before, text in itertools.pairwise(("", *texts)):
            if text == "--" or (self._subparsers is not None and text[:1] != "-"):
                return
            name = text.partition("=")[0]
            looks = text[:1] == "-" and " " not in text
            looks = looks and not self._negative_number_matcher.match(text)
            if not looks or text == "-":
                continue
            if name in known or (name[:2] != "--" and name[:2] in known):
                continue
            if name[:2] == "--" and any(option.startswith(name) for option in known):
                continue
            if name[:2] != "--" and before in known and known[before].nargs != 0:
                self.error(
                    f"{before} {text}: a value that begins with - is given as {before}={text}"
                )
            if name in self.elsewhere:
                self.error(f"{name}: {self.elsewhere[name]}")
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            self.error(f"unknown option {name}{hint}")

    def error(self, message: str) -> NoReturn:
        """Raise the error instead of printing the usage and exiting."""
        end = " see" if message.endswith("?") else "; see"
        raise CommandError(f"{message.removesuffix('.')}{end} `{self.prog} --help`")

    def format_help(self) -> str:
        """Append ``more_help``, which may be slow to make."""
        text = super().format_help()
        return f"{text}\n{self.more_help()}\n" if self.more_help else text


def add_command(commands: Any, name: str, summary: str, run: Any) -> Parser:
    """Add a command with the options that all commands have.

    Args:
        commands: what ``add_subparsers`` returned.
        name: of the command.
        summary: one line for the help.
        run: function of the parsed arguments that gives the exit status.

    Returns:
        The command's parser.
    """
    parser = commands.add_parser(name, help=summary, description=summary)
    parser.set_defaults(run=run)
    loudness = parser.add_mutually_exclusive_group()
    loudness.add_argument(
        "-v",
        "--verbose",
        action="count",
        default=0,
        help="say more on stderr, and where an error in a filter of your own came from; -vv also "
        "where others did",
    )
    loudness.add_argument("-q", "--quiet", action="store_true", help="errors only on stderr")
    return parser


def add_compute_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of commands that compile something."""
    parser.add_argument(
        "--no-compile-cache",
        action="store_true",
        help="do not keep compiled code between runs (it is kept in the user's cache folder)",
    )


_OPTIONS = {"budget_ms": "budget", "tolerance_db": "tolerance", "tolerance_jod": "tolerance"}
"""Arguments of the library whose options have another name."""


def in_option_names(message: str, options: Mapping[str, Any]) -> str:
    """Replace the library's argument names by the options of the command line.

    Of two alternatives of which the command has one, that one is left.

    Args:
        message: an error message of the library.
        options: what the command can be given, by argument name.

    Returns:
        The message in the words of the command line.
    """

    def flag(name: str) -> str:
        return f"--{name.replace('_', '-')}"

    def rename(match: re.Match[str]) -> str:
        name, value = match["quoted"] or match["name"], match["value"]
        name = name.removeprefix("settings.")
        if name == "extra":
            return "--drop-extra"
        name = _OPTIONS.get(name, name)
        if name not in options:
            return match[0]
        return f"{flag(name)}={value}" if value else flag(name)

    def choose(match: re.Match[str]) -> str:
        known = [name for name in match.groups() if name in options]
        return f"`{known[0]}`" if len(known) == 1 else match[0]

    message = re.sub(r"`(\w+)` or `(\w+)`", choose, message)
    return re.sub(r"`(?P<quoted>[\w.]+)`|\b(?P<name>\w+)='(?P<value>[^']*)'", rename, message)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Suggest the known name nearest to a mistyped one, or nothing."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def preset_name(text: str) -> str:
    """Parse the name of a vector convention.

    Raises:
        ArgumentTypeError: no convention has that name.
    """
    from jaxblur.vectors import PRESETS

    return one_of(text, ("auto", *PRESETS), "preset")


def one_of(text: str, known: Sequence[str], what: str) -> str:
    """Parse one of some names.

    Raises:
        ArgumentTypeError: the name is unknown; the message suggests the nearest and lists all.
    """
    if text in known:
        return text
    raise argparse.ArgumentTypeError(
        f"no {what} {text!r}{did_you_mean(text, known)}; there are {', '.join(known)}"
    )


def file_path(text: str) -> pathlib.Path:
    """Parse the name of a file or folder.

    Raises:
        ArgumentTypeError: its bytes are not text, and the image library accepts only text.
    """
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise argparse.ArgumentTypeError(
            f"{printable(text)} is not a name in UTF-8; rename it"
        ) from error
    return pathlib.Path(text)


def channel_names(text: str) -> list[str]:
    """Parse channel names separated by commas.

    Raises:
        ArgumentTypeError: one of them is empty.
    """
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise argparse.ArgumentTypeError(f"expected names separated by commas, got {text!r}")
    return names


def positive_number(text: str) -> float:
    """Parse a finite number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"expected a number above 0, got {text!r}")
    return value


def positive_integer(text: str) -> int:
    """Parse a whole number from 1.

    Raises:
        ArgumentTypeError: it is not one.
    """
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1, got {text!r}")
    return int(text)


def from_zero(text: str) -> float:
    """Parse a finite number from 0.

    Raises:
        ArgumentTypeError: it is not one.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"expected a number from 0, got {text!r}")
    return value


def whole_from_zero(text: str) -> int:
    """Parse a whole number from 0.

    Raises:
        ArgumentTypeError: it is not one.
    """
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"expected a whole number from 0, got {text!r}")
    return int(text)


def frame_numbers(text: str) -> list[int]:
    """Parse frames such as ``1001-1240``, ``1-100x10`` or ``1,3,7``.

    Raises:
        ArgumentTypeError: it is something else.
    """
    from jaxblur.sequence import parse_frames

    try:
        return parse_frames(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def check_outputs(outputs: Iterable[pathlib.Path], overwrite: bool) -> None:
    """Reject outputs that must not be written, before any work is done.

    Args:
        outputs: files to write.
        overwrite: existing files may be replaced.

    Raises:
        CommandError: a file exists, or it is a folder.
    """
    for output in outputs:
        if output.is_dir():
            raise CommandError(f"{output}: is a folder; give a file name.")
        if output.exists() and not overwrite:
            raise CommandError(f"{output}: exists; pass --overwrite to replace it.")


def check_folder(folder: pathlib.Path) -> None:
    """Reject a folder that neither exists nor can be created.

    Raises:
        CommandError: something on its path is not a folder, or not writable.
    """
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    if not existing.is_dir():
        which = "" if existing == folder else f"{existing} "
        raise CommandError(f"{folder}: {which}is not a folder; choose another name.")
    if not os.access(existing, os.W_OK):
        raise CommandError(f"{folder}: the folder {existing} is not writable.")


def check_parent(output: pathlib.Path) -> None:
    """Reject a file whose folder does not exist, or is not writable.

    Raises:
        CommandError: it is so.
    """
    if not output.parent.exists():
        raise CommandError(f"{output}: no folder {output.parent}; create it first.")
    check_folder(output.parent)


def describe_presets() -> str:
    """List the vector conventions for the help; unverified ones say so."""
    from jaxblur.vectors import PRESETS

    lines = ["presets of motion vectors (`auto` recognizes those marked *):"]
    for preset in PRESETS.values():
        mark = "*" if preset.named else " "
        doubt = "" if preset.verified else "UNVERIFIED. "
        entry = f"  {mark} {preset.name:<10} {doubt}{preset.source}"
        lines.append(textwrap.fill(entry, HELP_WIDTH, subsequent_indent=" " * 15))
    lines.append("Check an unverified one on two frames: jaxblur vectors FRAME --next NEXT.")
    return "\n".join(lines)
