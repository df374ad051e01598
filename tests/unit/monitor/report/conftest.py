"""Import matplotlib before the tests: its first import runs fc-list, which a unit test may not."""

import matplotlib.font_manager  # noqa: F401
