"""Results on disk, and the page that shows them: one HTML file that needs no network.

`write_result` is the one way in which commands and experiments leave pictures with their scores;
`read_result` and `build_page` make the page of ``jaxblur report`` from such a folder.
"""

from .page import Page as Page, build_page as build_page
from .results import (
    MANIFEST as MANIFEST,
    Picture as Picture,
    Result as Result,
    Shot as Shot,
    read_result as read_result,
    sha256_of as sha256_of,
    write_result as write_result,
)
