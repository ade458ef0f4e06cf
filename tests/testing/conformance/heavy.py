"""Options that come with a burden."""

import matplotlib  # noqa: F401
from wrong import Weighted  # noqa: F401
