"""``kinect-vo certificates``: make keys and certificates for a test network."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from drivers.core import InputError
from vo_service.cli.request import CommandRequest, Option, argument, number_parser, option
from vo_service.tools.certificates import AUTHORITY_DAYS, CertificateAuthority

EPILOG = f"""\
examples:
  kinect-vo certificates keys --host robot1.local --host 192.168.1.20 --reader reader \\
      --operator operator                         a robot that others reach (robot-tls.json5)
  kinect-vo certificates keys --host router.local --robot robot1 --robot robot2 --reader reader
                                                  a router and its robots (fleet-router.json5)
  kinect-vo certificates keys --reader tablet     one more, later: the same folder signs again

FOLDER becomes a certificate authority: ca.key signs, ca.pem verifies. Each name gets a folder with
the three files to copy: ca.pem, tls.pem, tls.key. Keys are never overwritten. The Zenoh
configuration says what each name may do; see docs/guide/remote-access.md.

This is for a test network: the key of the authority has no password and is valid for
{AUTHORITY_DAYS // 365} years. To revoke a certificate, remove its name from the configuration. A
company's own authority works as well: EC keys in PKCS#8, host names in subjectAltName.
"""


_parse_days = number_parser(
    int,
    lambda value: 1 <= value <= AUTHORITY_DAYS,
    f"is not a number of days: give 1 to {AUTHORITY_DAYS}",
)


def _clients(who: str) -> Option:
    text = f"{who}; may be given several times"
    return Option(text, metavar="NAME", is_repeated=True)


@dataclass(frozen=True, kw_only=True)
class CertificatesRequest(CommandRequest):
    """Names of the certificates to make."""

    folder: Path = argument("the authority's folder, or a new one", "FOLDER")
    host: tuple[str, ...] = option(
        "name or address by which others reach the computer that listens; several are one "
        "certificate",
        (),
        "HOST",
        is_repeated=True,
    )
    robot: Annotated[
        tuple[str, ...], _clients("a robot that connects to a router; NAME is its prefix")
    ] = ()
    reader: Annotated[tuple[str, ...], _clients("a program that reads poses and status")] = ()
    viewer: Annotated[tuple[str, ...], _clients("a program that also sees the images")] = ()
    operator: Annotated[tuple[str, ...], _clients("a program that also sends commands")] = ()
    days: int = option(
        "validity of the certificates, in days (default: %(default)s)", 365, "N", _parse_days
    )


def run(request: CertificatesRequest) -> int:
    """Make the certificates, and print where to copy each."""
    clients = [(name, role) for role in _DESTINATIONS for name in getattr(request, role)]
    names = [*request.host[:1], *(name for name, _ in clients)]
    if not names:
        raise InputError("nothing to make: give --host, --robot, --reader, --viewer or --operator")
    authority = CertificateAuthority(request.folder)
    authority.check_names_free(names)
    made = []
    if request.host:
        folder = authority.issue_server_certificate(request.host, request.days)
        made.append(f"{folder}: beside robot-tls.json5 or fleet-router.json5 on {request.host[0]}")
    for name, role in clients:
        folder = authority.issue_client_certificate(name, request.days)
        made.append(f"{folder}: {_DESTINATIONS[role].format(name)}")
    print("\n".join(made))
    print(
        f"Copy ca.pem, tls.pem and tls.key of each to its place, tls.key readable by nobody else."
        "\n"
        f"{request.folder}/ca.key stays here: whoever has it can make a certificate for any name.\n"
        f"Valid for {request.days} days. "
        "This is for a test network (kinect-vo certificates --help)."
    )
    return 0


_DESTINATIONS = {
    "robot": 'beside fleet-robot.json5 on the robot with prefix = "{}"',
    "reader": "beside reader-tls.json5 where {} runs; a name among `readers` in the configuration",
    "viewer": "beside reader-tls.json5 where {} runs; a name among `readers` and `viewers`",
    "operator": "beside operator-tls.json5 where {} runs; a name among `readers` and `operators`",
}
