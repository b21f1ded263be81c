"""`python -m lidarscene` is the command `lidarscene`."""

import sys


def run() -> int:
    """Run the command line; an interrupt while it is imported ends it, too, without a traceback."""
    try:
        from .cli.main import main
    except KeyboardInterrupt:
        return 130
    return main()


if __name__ == "__main__":
    sys.exit(run())
