"""How much memory the process holds while something runs."""

import pathlib
from collections.abc import Callable
from typing import Any

_STATUS = pathlib.Path("/proc/self/status")
_CLEAR = pathlib.Path("/proc/self/clear_refs")
_RESET_PEAK = "5"
"""Sets the peak back to what is resident now, see proc(5)."""


def peak_resident_megabytes(run: Callable[[], Any]) -> float | None:
    """Run a function; the most memory that the whole process held meanwhile, in MB (10^6 bytes).

    Args:
        run: function without arguments.

    Returns:
        Resident set size at its peak, or None where the system does not tell (it is Linux that
        does).
    """
    try:
        _CLEAR.write_text(_RESET_PEAK, encoding="ascii")
    except OSError:
        run()
        return None
    run()
    for line in _STATUS.read_text(encoding="ascii", errors="replace").splitlines():
        name, _, value = line.partition(":")
        if name == "VmHWM":
            return int(value.split()[0]) * 1024 / 1e6
    return None
