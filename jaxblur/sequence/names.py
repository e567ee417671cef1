"""Names of sequences, such as ``beauty.####.exr``, and lists of frames, such as 1001-1240x2."""

import dataclasses
import difflib
import itertools
import os
import pathlib
import re
from collections.abc import Collection, Mapping, Sequence

PathLike = str | os.PathLike[str]

_PLACEHOLDER = re.compile(r"#|@|%0?\d*d|\$F\d*")
_SEPARATORS = (".", "_")
_LONE_HASH = re.compile(r"(?<!#)#(?!#)")


@dataclasses.dataclass(frozen=True)
class FrameNames:
    """File names of a sequence.

    Attributes:
        pattern: the pattern as given, for messages.
        before: path up to the frame number.
        digits: minimum number of digits of the frame number, padded with zeros.
        after: rest of the path after the frame number.
    """

    pattern: str
    before: str
    digits: int
    after: str

    def path(self, frame: int) -> pathlib.Path:
        """Return the path of a frame's file."""
        return pathlib.Path(f"{self.before}{frame:0{self.digits}d}{self.after}")

    def with_suffix(self, suffix: str) -> "FrameNames":
        """Return the same names with another extension."""
        return dataclasses.replace(self, after=self.after.rpartition(".")[0] + suffix)

    def frames_on_disk(self) -> list[int]:
        """List the frames that exist on disk, in order.

        Returns:
            Their numbers; files whose numbers are padded differently do not belong to the sequence.

        Raises:
            OSError: the folder cannot be listed.
        """
        return sorted(
            number for number, name in self._numbered_files() if self.path(number).name == name
        )

    def other_padding(self) -> "FrameNames | None":
        """Find files that differ from the sequence only in padding.

        Returns:
            The names that most of the files in the folder have, or None if there are no others.

        Raises:
            OSError: the folder cannot be listed.
        """
        files = self._numbered_files()
        longest = max((len(name) for _, name in files), default=0)
        others = [self._padded(digits) for digits in range(1, longest) if digits != self.digits]
        counts = [sum(names.path(n).name == name for n, name in files) for names in others]
        # Of paddings that fit as many files, the longest shows best what is there.
        most, digits = max(zip(counts, (o.digits for o in others), strict=True), default=(0, 0))
        return self._padded(digits) if most else None

    def near_patterns(self) -> list[str]:
        """Find sequences in the folder whose names are like those of this one.

        Returns:
            Patterns of at most three, the nearest first; none where there are files of this one.

        Raises:
            OSError: the folder cannot be listed.
        """
        folder, name = os.path.split(self._padded(max(self.digits, 2)).pattern)
        number = re.compile(r"\d+(?=\D*$)")
        patterns = {
            number.sub(lambda found: "#" * max(len(found[0]), 2), file)
            for file in os.listdir(folder or ".")
            if number.search(file)
        }
        near = (
            difflib.get_close_matches(name, sorted(patterns), n=3) if name not in patterns else []
        )
        return [os.path.join(folder, pattern) for pattern in near]

    def _padded(self, digits: int) -> "FrameNames":
        """Return the same names with another number of digits."""
        place = "%d" if digits == 1 else "#" * digits
        return FrameNames(f"{self.before}{place}{self.after}", self.before, digits, self.after)

    def _numbered_files(self) -> list[tuple[int, str]]:
        folder, start = os.path.split(self.before)
        pattern = re.compile(rf"{re.escape(start)}(-?\d+){re.escape(self.after)}")
        names = os.listdir(folder or ".")
        matches = [match for name in names if (match := pattern.fullmatch(name))]
        return [(int(match[1]), match[0]) for match in matches]


def has_frame_number(path: PathLike) -> bool:
    """Return whether a file name has a placeholder for the frame number.

    If a file of exactly that name exists, placeholder included, it is a single file.
    """
    return bool(_PLACEHOLDER.search(os.path.basename(path))) and not os.path.exists(path)


def parse_names(path: PathLike) -> FrameNames:
    """Parse names such as ``shots/beauty.####.exr``, ``%04d``, ``@@@@`` or ``$F4``.

    Two or more ``#`` stand for as many digits, a single one for four, as in oiiotool.

    Args:
        path: file name with a placeholder for the frame number; folder names are not parsed.

    Returns:
        The names.

    Raises:
        ValueError: there is no placeholder, or there are several.
    """
    from fileseq.constants import PAD_STYLE_HASH1
    from fileseq.filesequence import FileSequence

    folder, name = os.path.split(os.fspath(path))
    places = re.findall(r"#+|@+|%0?\d*d|\$F\d*", name)
    if len(places) != 1:
        problem = "no place" if not places else f"{len(places)} places"
        raise ValueError(
            f"{os.fspath(path)}: {problem} for the frame number; write one, such as name.####.exr."
        )
    if found := re.search(r"-?\d+-\d+(?=[#@%$])", name):
        raise ValueError(
            f"{os.fspath(path)}: {found[0]} is a range of frames; write "
            f"{name.replace(found[0], '', 1)} and --frames {found[0].lstrip('-')}."
        )
    sequence = FileSequence(_LONE_HASH.sub("####", name), pad_style=PAD_STYLE_HASH1)
    before = os.path.join(folder, str(sequence.basename()))
    return FrameNames(os.fspath(path), before, sequence.zfill(), str(sequence.extension()))


def parse_frames(text: str) -> list[int]:
    """Parse frames such as ``1001-1240``, ``1-100x2``, ``1,3,7`` or ``-4-4``.

    Args:
        text: ranges separated by commas; ``x2`` takes every second frame.

    Returns:
        Frame numbers in the order given, each once.

    Raises:
        ValueError: the text has another form, or names no frame.
    """
    from fileseq.exceptions import FileSeqException
    from fileseq.frameset import FrameSet

    try:
        frames = list(FrameSet(text))
    except FileSeqException:
        frames = []
    if not frames or any(frame != int(frame) for frame in frames):
        raise ValueError(f"expected frames such as 1001-1240, 1-100x2 or 1,3,7, got {text!r}")
    return [int(frame) for frame in frames]


def frame_number(path: PathLike) -> int | None:
    """Return the number of a frame, which is the last one in the name of its file; None without."""
    found = re.findall(r"\d+", pathlib.Path(path).stem)
    return int(found[-1]) if found else None


def with_frame_number(path: PathLike, frame: int) -> pathlib.Path:
    """Return the same name with another number of as many digits.

    Args:
        path: of a frame, with a number in its name.
        frame: the other number.
    """
    file = pathlib.Path(path)
    *_, found = re.finditer(r"\d+", file.stem)
    number = f"{frame:0{len(found[0])}d}"
    return file.with_name(
        file.stem[: found.start()] + number + file.stem[found.end() :] + file.suffix
    )


def with_view(names: FrameNames | pathlib.Path, view: str) -> FrameNames | pathlib.Path:
    """Return names with a view in them: ``out.left.png``, ``shot.left.0001.png``.

    Args:
        names: of a file or a sequence.
        view: stands before the frame number, with the same separator, where the number is a word of
            its own; else before the extension.
    """
    if isinstance(names, FrameNames):
        if (separator := names.before[-1:]) in _SEPARATORS:
            return dataclasses.replace(names, before=names.before + view + separator)
        return dataclasses.replace(names, after=f".{view}{names.after}")
    if found := re.fullmatch(r"(.*)([._])(\d+)", names.stem):
        before, separator, number = found.groups()
        return names.with_name(f"{before}{separator}{view}{separator}{number}{names.suffix}")
    return names.with_name(f"{names.stem}.{view}{names.suffix}")


def missing_frames(frames: Sequence[int]) -> str:
    """Find the gaps in a sequence.

    Args:
        frames: numbers of the existing frames, in order; their smallest difference is the step.

    Returns:
        The missing frames between the first and the last, such as ``1004,1007-1009``; empty if
        none is missing.
    """
    step = min((b - a for a, b in itertools.pairwise(frames)), default=1)
    return frame_ranges(set(range(frames[0], frames[-1], step)) - set(frames))


def frame_ranges(frames: Collection[int]) -> str:
    """Frames as text that `parse_frames` reads, such as ``1004,1007-1009``; empty without any."""
    from fileseq.frameset import FrameSet

    return str(FrameSet.framesToFrameRange(sorted(frames))) if frames else ""


def at_frame(names: Mapping[str, FrameNames | pathlib.Path], frame: int) -> dict[str, pathlib.Path]:
    """Return the files of a frame; a single file serves every frame.

    Args:
        names: sequences and files by role.
        frame: number of the frame.

    Returns:
        Paths by role.
    """
    return {
        role: name.path(frame) if isinstance(name, FrameNames) else name
        for role, name in names.items()
    }
