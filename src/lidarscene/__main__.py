"""`python -m lidarscene` is the command `lidarscene`."""

import sys

from .cli.main import main

if __name__ == "__main__":
    sys.exit(main())
