"""The page of a study: one HTML file that asks, pair by pair, which picture is better."""

import base64
import dataclasses
import hashlib
import importlib.resources
import itertools
import json
from typing import Any

from ..report.png import data_uri
from .stimuli import Study

MEGABYTE = 1e6


@dataclasses.dataclass(frozen=True)
class Options:
    """How a study is shown.

    Attributes:
        title: of the page.
        question: what the observer is asked.
        repeats: how often each pair is shown.
        catch: catch trials: a picture beside its own coarse copy, where the answer is known.
        side_by_side: both pictures at once; otherwise one after the other, as in the source.
        seconds: how long a still is shown, where one follows the other.
        fps: frames a second of animations.
        max_megabytes: largest file.

    Source: Navarro 2012, chapter 5: pairs in random order, each in random order, one after the
    other, as often as the observer likes.
    """

    title: str = "Which picture is better?"
    question: str = "Which of the two has the better motion blur?"
    repeats: int = 2
    catch: int = 4
    side_by_side: bool = False
    seconds: float = 2.0
    fps: float = 24.0
    max_megabytes: float = 100.0

    def __post_init__(self) -> None:
        if self.repeats < 1 or self.catch < 0:
            raise ValueError(
                f"`repeats` must be at least 1 and `catch` 0 or more, got {self.repeats} and "
                f"{self.catch}."
            )
        for name in ("seconds", "fps", "max_megabytes"):
            if not getattr(self, name) > 0:
                raise ValueError(f"`{name}` must be above 0, got {getattr(self, name):g}.")


def trial_count(study: Study, options: Options) -> int:
    """How many pairs an observer sees, without the catch trials.

    Args:
        study: what is compared.
        options: how it is shown.

    Returns:
        Pairs times repetitions times scenes.
    """
    pairs = len(list(itertools.combinations(study.stimuli, 2)))
    return pairs * options.repeats * len(study.scenes)


def build_study(study: Study, options: Options = Options()) -> str:
    """Make the page.

    Args:
        study: what is compared.
        options: how it is shown.

    Returns:
        HTML that needs no network. It shows the pairs in random order and saves a CSV file, which
        `read_votes` reads.

    Raises:
        ValueError: it would be larger than allowed.
    """
    import jinja2
    from markupsafe import Markup

    script, style = (_template(name) for name in ("study.js", "study.css"))
    content = {
        "key": study.key,
        "question": options.question,
        "repeats": options.repeats,
        "catch": options.catch,
        "beside": options.side_by_side,
        "seconds": options.seconds,
        "fps": options.fps,
        "stimuli": list(study.stimuli),
        "scenes": [
            {"name": s.name, "frames": [[data_uri(f) for f in frames] for frames in s.frames]}
            for s in study.scenes
        ],
    }
    text = json.dumps(content, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        # So that no name can close the script element.
        text = text.replace(character, f"\\u{ord(character):04x}")
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("jaxblur.perception"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    html = environment.get_template("study.html").render(
        options=options,
        trials=trial_count(study, options) + options.catch,
        script=Markup(script),
        script_hash=_integrity(script),
        style=Markup(style),
        style_hash=_integrity(style),
        data=Markup(text),
    )
    size = len(html.encode("utf-8")) / MEGABYTE
    if size > options.max_megabytes:
        raise ValueError(
            f"`max_megabytes` of {options.max_megabytes:g} is too small for this study "
            f"({size:.0f} MB); allow more, or give fewer or smaller pictures."
        )
    return html


def _template(name: str) -> str:
    folder: Any = importlib.resources.files("jaxblur.perception")
    return (folder / "templates" / name).read_text(encoding="utf-8")


def _integrity(text: str) -> str:
    """Hash a script or style, so that the content security policy allows it and no other."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()
