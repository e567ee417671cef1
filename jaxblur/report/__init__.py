"""Result folders on disk, and the report page: one HTML file that needs no network.

Imports nothing of jaxblur but `_util`, `exr` and `metrics`.

Commands and experiments store pictures with their scores through `write_result`; `read_result` and
`build_page` make the page of ``jaxblur report`` from such a folder.
"""

from .page import Page as Page, build_page as build_page
from .reading import read_result as read_result
from .results import (
    COLORS as COLORS,
    MANIFEST as MANIFEST,
    VIEW as VIEW,
    Picture as Picture,
    Result as Result,
    Shot as Shot,
    in_view as in_view,
    sha256_of as sha256_of,
    write_result as write_result,
)
