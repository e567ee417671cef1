"""One file for each command, with its options and what it does; `jaxblur.cli.main` lists them.

A file named COMMAND_PART is a part of that command.
"""
