"""On a new machine matplotlib asks fc-list for fonts when it is first imported, which a unit test may not."""

import matplotlib.font_manager  # noqa: F401
