"""Entry point of ``kinect-vo``: it handles Ctrl-C also while the program is being imported."""

import sys
from collections.abc import Sequence
from typing import NoReturn

# The same as in `vo_service.signals`, which is not imported yet.
EXIT_CODE_SIGINT = 130


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run a command; never returns.

    Args:
        argv: Arguments of the command line, without the program; None: those of the process.
    """
    try:
        from vo_service.cli.dispatch import run_command

        run_command(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt:
        sys.exit(EXIT_CODE_SIGINT)


if __name__ == "__main__":
    main()
