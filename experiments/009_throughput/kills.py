"""Kill a run over a sequence at random moments, resume it, and compare with an undisturbed run.

python -m experiments.009_throughput.kills --kills 20
"""

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from jaxblur import exr


def make_frames(folder: Path, count: int, size: tuple[int, int]) -> Path:
    """Write frames of random color, depth and fast vectors.

    Args:
        folder: output folder.
        count: number of frames, from 1.
        size: (height, width) in pixels.

    Returns:
        Pattern of the file names.
    """
    for frame in range(1, count + 1):
        generator = np.random.default_rng(frame)
        channels = {name: generator.random(size, np.float32) for name in "RGB"}
        channels["Z"] = generator.uniform(1, 9, size).astype(np.float32)
        for axis in "XY":
            channels[f"velocity.{axis}"] = 20 * generator.normal(size=size).astype(np.float32)
        exr.write_channels(folder / f"in.{frame:04d}.exr", channels)
    return folder / "in.####.exr"


def run_with_kills(command: list[str], folder: Path, kills: int, seed: int) -> list[int]:
    """Start a command repeatedly and kill it at random moments; let the last run finish.

    A quarter of the kills are during the start, the others shortly after a frame was written.

    Args:
        command: the command and its arguments.
        folder: folder to which the command writes.
        kills: number of kills.
        seed: seed of the random moments.

    Returns:
        Number of whole frames in the folder at each kill.

    Raises:
        CalledProcessError: the last run failed.
    """
    moments, seen = random.Random(seed), []
    for _ in range(kills):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        if moments.random() < 0.25:
            time.sleep(moments.uniform(0.1, 2))
        else:
            before = len(_whole(folder))
            while process.poll() is None and len(_whole(folder)) == before:
                time.sleep(0.001)
            time.sleep(moments.uniform(0, 0.05))
        process.kill()
        process.wait()
        seen.append(len(_whole(folder)))
    subprocess.run(command, check=True, capture_output=True)
    return seen


def differences(first: Path, second: Path) -> list[str]:
    """Names of the files, hidden ones too, that differ or are in one of two folders only."""
    names = {path.name for folder in (first, second) for path in folder.iterdir()}
    return sorted(name for name in names if _bytes(first / name) != _bytes(second / name))


def _whole(folder: Path) -> list[str]:
    return [name for name in os.listdir(folder) if not name.startswith(".")]


def _bytes(path: Path) -> bytes | None:
    return path.read_bytes() if path.exists() else None


def main() -> int:
    """Kill, resume, compare; see the module docstring."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--size", type=int, nargs=2, default=(180, 320), metavar=("H", "W"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pattern = make_frames(folder, arguments.frames, tuple(arguments.size))
        outputs = folder / "undisturbed", folder / "killed"
        commands = []
        for output in outputs:
            output.mkdir()
            target = str(output / "out.####.exr")
            commands.append([sys.executable, "-m", "jaxblur", "blur", str(pattern), "-o", target])
        subprocess.run(commands[0], check=True, capture_output=True)
        seen = run_with_kills(commands[1], outputs[1], arguments.kills, arguments.seed)
        different = differences(*outputs)
        print(f"{len(seen)} kills, whole frames at each: {', '.join(map(str, seen))}")
        print(
            f"{len(_whole(outputs[1]))} of {arguments.frames} frames; files that differ: ", end=""
        )
        print(", ".join(different) or "none")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
