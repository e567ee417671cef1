"""The scenes of BlurBench, built in code. Importable inside Blender or with the bpy wheel only."""

# Only after bpy can bmesh and mathutils be imported.
import bpy as bpy  # pyright: ignore[reportMissingImports]
