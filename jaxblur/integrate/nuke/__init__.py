"""The Nuke extension: motion blur of a node's input, or of files, by the command ``jaxblur``."""
