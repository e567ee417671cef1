"""Read and write frames as image files, through OpenImageIO.

Imports nothing of jaxblur but `_util`, `frame`, `nonfinite`, `srgb` and `vectors`.

`read_frame` returns a frame for the filters, in the conventions of `jaxblur.frame`, whatever
renderer wrote the file: channels are recognized by name, motion vectors are converted by the
presets of `jaxblur.vectors`, background depth becomes ``+inf``. Values are checked when they are
read: a `JaxblurIOError` names file, channel and remedy in one line.

    import jaxblur

    frame = jaxblur.read_frame("shot.0011.exr", shutter=0.5)
    blurred = jaxblur.guertin2014(frame, jaxblur.GuertinParameters())
    jaxblur.write_image("blurred.0011.exr", blurred, like="shot.0011.exr")

`write_image` keeps windows, metadata, timecode and every other channel of a model file; files
appear under their name only when they are complete. `inspect` lists the contents of a file. Reading
and listing do not load jax; only `read_frame` does, at its end.

Files are opened by `opening`, listed by `listing`, and their pixels read by `channels`; `choose`,
`passes`, `cameras`, `color` and `cryptomatte` find what channels and headers mean; `checks` and
`convert` make of stored values those of a frame. `read` puts frames together, `deep` the layers of
deep files; `windows` puts what was read into another data window. `write` writes files,
`write_like` those that keep what a model holds, `pictures` PNG, TIFF and JPEG, over `output`;
`notes` holds metadata that a format has no place for.

Pixels are those of the data window: overscan is filtered and written like the rest, but pictures
are of the display window. Color is linear and, where there is alpha, premultiplied; it is neither
clipped nor converted. Only previews are: `conversion_of` finds the color space of a file,
`Conversion.light` converts to what a screen shows.
"""

from .._util.errors import (
    JaxblurIOError as JaxblurIOError,
    JaxblurIOWarning as JaxblurIOWarning,
)
from .blurred_ranks import PLANES as PLANES, blur_ranks as blur_ranks
from .cameras import (
    CameraFile as CameraFile,
    CameraView as CameraView,
    has_camera as has_camera,
    header_camera as header_camera,
    read_camera_file as read_camera_file,
)
from .channels import read_channels as read_channels, read_values as read_values
from .choose import (
    ColorGroup as ColorGroup,
    borrowed_from as borrowed_from,
    choose_color as choose_color,
    choose_depth as choose_depth,
    choose_vectors as choose_vectors,
    colored_views as colored_views,
    views_of as views_of,
)
from .color import (
    COLORS as COLORS,
    Conversion as Conversion,
    check_color_space as check_color_space,
    check_view as check_view,
    conversion_of as conversion_of,
)
from .convert import DEPTH_KINDS as DEPTH_KINDS, SKY as SKY
from .cryptomatte import (
    CryptomatteLayer as CryptomatteLayer,
    cryptomatte_layers as cryptomatte_layers,
    identifier_of as identifier_of,
    identifiers_in as identifiers_in,
    names_in as names_in,
    read_cryptomatte as read_cryptomatte,
)
from .deep import is_deep as is_deep, read_deep_layers as read_deep_layers
from .listing import (
    Channel as Channel,
    FileInfo as FileInfo,
    Part as Part,
    inspect as inspect,
)
from .opening import FileStates as FileStates
from .output import is_complete as is_complete
from .passes import choose_passes as choose_passes
from .pictures import BITS as BITS, LINEAR_BITS as LINEAR_BITS, bits_of as bits_of
from .ranks import (
    ChannelChange as ChannelChange,
    Ranks as Ranks,
    layers_of_picture as layers_of_picture,
    read_ranks as read_ranks,
    unchanged_ranks as unchanged_ranks,
)
from .read import (
    Buffers as Buffers,
    read_buffers as read_buffers,
    read_depth as read_depth,
    read_frame as read_frame,
    read_image as read_image,
)
from .survey import count_not_finite as count_not_finite, measure_speeds as measure_speeds
from .windows import (
    Windows as Windows,
    blur_window as blur_window,
    buffers_in as buffers_in,
    common_window as common_window,
    is_element as is_element,
    known_in as known_in,
    overlap as overlap,
    put_into as put_into,
    ranks_in as ranks_in,
    union as union,
    warn_cropped as warn_cropped,
    window_words as window_words,
    windows_of as windows_of,
)
from .write import (
    WRITABLE as WRITABLE,
    refuse_overwrite as refuse_overwrite,
    write_channels as write_channels,
    write_frame as write_frame,
    write_image as write_image,
)
