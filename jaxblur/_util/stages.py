"""What long work of the library tells its caller about: the stage that it is in."""

import dataclasses
from collections.abc import Callable


@dataclasses.dataclass(frozen=True)
class Stage:
    """The argument of ``on_stage``: what a fit or a check is doing.

    Attributes:
        name: a stage begins when the name changes; of a fit it is one of `jaxblur.fitting.STAGES`.
        done: number of its parts that are done.
        total: number of its parts, at most: a stage may end earlier.
    """

    name: str
    done: int
    total: int


Tell = Callable[[Stage], None]


def untold(stage: Stage) -> None:
    """Report a stage to nobody."""
