"""Derivatives of a filter beside central differences, on anybody's frame.

Imports nothing of jaxblur but `_util`, `filters`, `frame`, `noise` and `settings`.

`quantities` is what the filter is differentiated by, `measure` takes derivatives and differences,
`check` makes the `table` of them.
"""

from .check import check_gradient as check_gradient, squared_error as squared_error
from .quantities import fastest_object as fastest_object
from .table import GradientCheck as GradientCheck, GradientRow as GradientRow
