"""Drawing: buffers, tiles, taps, errors, speed against error. One place for all pictures.

Every function returns a matplotlib figure that belongs to no window and to no global state: save
it with ``figure.savefig(path)``, or leave it as the last line of a notebook cell. Given ``axes``,
it draws there and returns the figure of the axes. Needs the extra ``jaxblur[plot]``; matplotlib
loads when something is drawn.
"""

from .pareto import Measurement as Measurement, pareto as pareto, pareto_front as pareto_front
