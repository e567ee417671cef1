"""Files written whole, cache folders, compilers, text for terminals: shared by several packages.

Imports nothing of jaxblur, and neither jax nor OpenImageIO.
"""
