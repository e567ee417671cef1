"""Files written whole, cache folders, text for terminals, fronts: shared by several packages.

Imports nothing of jaxblur, and neither jax nor OpenImageIO.
"""
