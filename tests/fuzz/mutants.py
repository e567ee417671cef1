"""Mutants of the corpus: each is fixed by a seed and a number."""

import importlib
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

mutations = importlib.import_module("experiments.008_hard_cases.mutations")

ANYWHERE = ("bit flips", "bytes", "truncation", "block")
"""Damage that needs no intact header."""


def make(corpus: Sequence[Path], seed: int, number: int) -> tuple[str, bytes]:
    """The mutant with this number.

    Args:
        corpus: files, of which those named ``mutant_*`` may be damaged already.
        seed: of the run.
        number: of the mutant.

    Returns:
        What was done to which file, and the contents.
    """
    generator = np.random.default_rng((seed, number))
    intact = [path for path in corpus if not path.name.startswith("mutant_")]
    path, other = (files[int(generator.integers(len(files)))] for files in (corpus, intact))
    data = path.read_bytes()
    ways = []
    if path in intact:
        if generator.random() < 0.25:
            way = ("header of", "attributes of")[generator.integers(2)]
            ways.append(f"{way} {other.name}")
            splice = _other_header if way == "header of" else _more_attributes
            data = splice(data, other.read_bytes(), generator)
        else:
            way, data = mutations.mutate(data, generator)
            ways.append(way)
    # One fault often hides another.
    for _ in range(max(0, generator.integers(6) - 3) if ways else 1):
        way = str(generator.choice(ANYWHERE))
        changed = bytearray(data or b"\0")
        result = mutations.MUTATIONS[way](changed, generator)
        data = bytes(changed if result is None else result)
        ways.append(way)
    return f"{path.name}: {', '.join(ways)}", data


def _end(data: bytes) -> int:
    """End of the last attribute."""
    return max(a.value + a.size for a in mutations.attributes(data))


def _other_header(data: bytes, other: bytes, _: np.random.Generator) -> bytes:
    return other[: _end(other)] + data[_end(data) :]


def _more_attributes(data: bytes, other: bytes, generator: np.random.Generator) -> bytes:
    """Put some attributes of another file, with sizes or values changed, before the own ones."""
    found = list(mutations.attributes(other))
    added = b""
    for index in generator.integers(len(found), size=generator.integers(1, 5)):
        value = bytearray(other[found[index].value : found[index].value + found[index].size])
        if generator.random() < 0.5:
            value = value[: generator.integers(len(value) + 1)]
        if generator.random() < 0.5:
            value += bytes(generator.integers(256, size=generator.integers(1, 40), dtype=np.uint8))
        name, kind = found[index].name, found[index].kind
        added += name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + bytes(value)
    return data[:8] + added + data[8:]
