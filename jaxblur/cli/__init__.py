"""The command line: parse, call, write.

Imports any part of jaxblur. `commands` has one file for each command; what several of them share
stands beside it.

Exit status: 0 done, 1 some frames of a sequence are not (or the answer is no: something is slower,
no vectors fit), 2 wrong usage or input (nothing was written), 130 interrupted, 141 the reader of
the output went away. Results go to stdout, everything else to stderr. Nothing here imports jax
before the arguments and the input files have been checked.
"""

try:
    from .main import main as main
except KeyboardInterrupt:
    # Ctrl-C before the command can answer it. A user sees a program that ends, not its imports.
    raise SystemExit(130) from None
