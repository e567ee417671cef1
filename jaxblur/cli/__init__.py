"""The command line: parse, call, write.

Imports any part of jaxblur. `commands` has one file for each command; what they share stands beside
it, and imports none of them:

- `main` parses the command line and reports errors; `arguments`, `console`, `progress`, `errors`,
  `interrupts`, `isolation` and `compute` serve every command;
- options, with what is done by them: `sources`, `colors`, `filtering`, `shutter`, `strength` (over
  `selections` and `camera_share`), `mattes`, `posts`, `results`;
- a frame goes through `loading` (with layers through `layer_reading` and `stack`), `choice`,
  `blurring`, `outputs` and `scores`: one frame by `single`, many by `sequence`.

Exit status: 0 done, 1 some frames of a sequence are not (or the answer is no: something is slower,
no vectors fit), 2 wrong usage or input (nothing was written), 130 interrupted, 141 the reader of
the output went away. Results go to stdout, everything else to stderr. Nothing here imports jax
before the arguments and the input files have been checked; `programs` blurs without it.
"""

try:
    from .main import main as main
except KeyboardInterrupt:
    # Ctrl-C before the command can answer it. A user sees a program that ends, not its imports.
    raise SystemExit(130) from None
