"""`Lens` as an argument of jax functions: its registration as a pytree, and its check."""

from .frame import register_record
from .lens import Lens

register_record(Lens)


def check_lens_record(lens: object) -> None:
    """Reject what is no lens, and values that cannot be those of one where they are known.

    Args:
        lens: as given.

    Raises:
        ValueError: it is no `Lens`, or a value is out of range. Traced values pass.
    """
    if not isinstance(lens, Lens):
        raise ValueError(
            f"`lens` must be a jaxblur.posts.Lens, got {type(lens).__name__}; pass "
            "jaxblur.posts.Lens(focus)."
        )
    lens.check()
