"""``python -m avrare``."""

import sys

from avrare.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
