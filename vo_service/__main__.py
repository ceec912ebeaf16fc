"""The command ``kinect-vo``, also as ``python -m vo_service``."""

import sys
from typing import NoReturn

# The same as in `vo_service.signals`, which is not imported yet.
_EXIT_CODE_SIGINT = 130


def main() -> NoReturn:
    """Run ``kinect-vo``; handle Ctrl-C also while the command line is being imported."""
    try:
        from vo_service.cli.command_line import main as run_command

        run_command()
    except KeyboardInterrupt:
        sys.exit(_EXIT_CODE_SIGINT)


if __name__ == "__main__":
    main()
