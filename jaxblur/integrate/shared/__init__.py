"""What the extensions of all hosts share; the standard library of Python 3.10 is enough for it."""
