"""``kinect-vo command``: send a command to a running kinect-vo."""

import argparse
import inspect
import json

from drivers.core import InputError, UserFacingError
from drivers.core.config import typed_fields
from vo_service.cli.options import add_connection_options, parse_seconds
from vo_service.client.connection import CommandRefused, ServiceUnavailable
from vo_service.client.pose_client import REPLY_TIMEOUT_S, PoseClient
from vo_service.types.commands import COMMANDS, Command

_EPILOG = """\
examples:
  kinect-vo command reset
  kinect-vo command reset position_m=[1,0,0] quaternion_xyzw=[0,0,0,1]
  kinect-vo command pause                      no poses, until: kinect-vo command resume
  kinect-vo command tilt tilt_deg=10
  kinect-vo command led led=blink-green
  kinect-vo command start-recording name=desk  until: kinect-vo command stop-recording
  kinect-vo command save-incident
  kinect-vo command save-map name=kitchen

commands:
{commands}

A value is JSON or plain text. The reply is one JSON object on standard output. If the service
refuses a command, an error message says why.
"""


def _describe_command(command: type[Command]) -> str:
    arguments = " ".join(f"{field.name}=..." for field in typed_fields(command))
    description = (inspect.getdoc(command) or "").partition("\n")[0]
    return f"  {f'{command.command_name} {arguments}':<42} {description}"


EPILOG = _EPILOG.format(commands="\n".join(map(_describe_command, COMMANDS.values())))
# Error codes that are the sender's mistake.
_CALLER_ERRORS = ("bad-request", "unknown-command")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("name", metavar="NAME", help="the command")
    parser.add_argument(
        "arguments",
        metavar="KEY=VALUE",
        nargs="*",
        type=_parse_argument,
        default=(),
        help="its arguments",
    )
    add_connection_options(parser)
    parser.add_argument(
        "--timeout", metavar="SECONDS", type=parse_seconds, default=REPLY_TIMEOUT_S,
        help="time limit for the reply (default: %(default)g)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Send the command and print the reply.

    Raises:
        InputError: If the command or an argument is wrong.
        UserFacingError: If the command is refused, or if there is no reply.
    """
    with PoseClient(args.prefix, args.connect, args.config_file) as client:
        try:
            answer = client.command(args.name, dict(args.arguments), args.timeout)
        except CommandRefused as refused:
            kind = InputError if refused.code in _CALLER_ERRORS else UserFacingError
            raise kind(f"{args.name}: {refused} ({refused.code})") from refused
        except ServiceUnavailable as error:
            raise UserFacingError(
                f"{args.name}: {error}; start kinect-vo run there, with the same --prefix"
            ) from error
        except ValueError as error:
            raise UserFacingError(f"{args.name}: the reply cannot be read: {error}") from error
    print(json.dumps(answer))
    return 0


def _parse_argument(text: str) -> tuple[str, object]:
    key, equals, value = text.partition("=")
    if not key or not equals:
        raise argparse.ArgumentTypeError(f"{text} is not KEY=VALUE, such as tilt_deg=10")
    try:
        return key, json.loads(value)
    except (ValueError, RecursionError):
        return key, value
