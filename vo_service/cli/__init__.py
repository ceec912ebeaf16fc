"""The entry point of ``kinect-vo``, so small that Ctrl-C finds no moment before it is heeded."""

import sys
from collections.abc import Sequence
from typing import NoReturn

# As `vo_service.signals` has it, which is not imported yet.
EXIT_CODE_SIGINT = 130


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command that `argv` names; never returns."""
    try:
        from vo_service.cli.dispatch import run_command

        run_command(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt:
        sys.exit(EXIT_CODE_SIGINT)


if __name__ == "__main__":
    main()
