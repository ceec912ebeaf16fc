"""``kinect-vo command``: send a command to a running kinect-vo."""

import argparse
import inspect
import json
from dataclasses import dataclass

from drivers.core import InputError, UserFacingError
from drivers.core.config import typed_fields
from vo_service.cli.options import (
    DEFAULT_PREFIX,
    ClientConfigFile,
    ClientPrefix,
    Connect,
    parse_seconds,
)
from vo_service.cli.request import CommandRequest, argument, option
from vo_service.client.connection import CommandRefused, ServiceUnavailable
from vo_service.client.pose_client import REPLY_TIMEOUT_S, PoseClient
from vo_service.config_tables import DEFAULT_ENDPOINT
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


def _parse_argument(text: str) -> tuple[str, object]:
    key, equals, value = text.partition("=")
    if not key or not equals:
        raise argparse.ArgumentTypeError(f"{text} is not KEY=VALUE, such as tilt_deg=10")
    try:
        return key, json.loads(value)
    except (ValueError, RecursionError):
        return key, value


@dataclass(frozen=True, kw_only=True)
class SendCommandRequest(CommandRequest):
    """The command to send, and the service."""

    name: str = argument("the command", "NAME")
    arguments: tuple[tuple[str, object], ...] = argument(
        "its arguments", "KEY=VALUE", default=(), parse=_parse_argument
    )
    connect: Connect = DEFAULT_ENDPOINT
    prefix: ClientPrefix = DEFAULT_PREFIX
    config_file: ClientConfigFile = None
    timeout: float = option(
        "time limit for the reply (default: %(default)g)", REPLY_TIMEOUT_S, "SECONDS", parse_seconds
    )


def run(request: SendCommandRequest) -> int:
    """Send the command and print the reply."""
    with PoseClient(request.prefix, request.connect, request.config_file) as client:
        try:
            answer = client.command(request.name, dict(request.arguments), request.timeout)
        except CommandRefused as refused:
            kind = InputError if refused.code in _CALLER_ERRORS else UserFacingError
            raise kind(f"{request.name}: {refused} ({refused.code})") from refused
        except ServiceUnavailable as error:
            raise UserFacingError(
                f"{request.name}: {error}; start kinect-vo run there, with the same --prefix"
            ) from error
        except ValueError as error:
            raise UserFacingError(f"{request.name}: the reply cannot be read: {error}") from error
    print(json.dumps(answer))
    return 0
