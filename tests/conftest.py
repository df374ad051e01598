"""What holds for all tests."""

from __future__ import annotations

from hypothesis import settings

# The same examples every time, and no time limit for one: a busy machine is not a counter-example.
# To look for new ones: pytest --hypothesis-profile=search
settings.register_profile("seeded", derandomize=True, deadline=None)
settings.register_profile("search", max_examples=1000, deadline=None)
settings.load_profile("seeded")
