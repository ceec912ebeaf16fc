"""``kinect-vo certificates``: make keys and certificates for a test network."""

import argparse
from pathlib import Path

from drivers.core import InputError
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "folder", metavar="FOLDER", type=Path, help="the authority's folder, or a new one"
    )
    parser.add_argument(
        "--host", metavar="HOST", action="append", default=[],
        help="name or address by which others reach the computer that listens; several are one "
        "certificate",
    )  # fmt: skip
    for role, text in (
        ("robot", "a robot that connects to a router; NAME is its prefix"),
        ("reader", "a program that reads poses and status"),
        ("viewer", "a program that also sees the images"),
        ("operator", "a program that also sends commands"),
    ):
        parser.add_argument(
            f"--{role}", metavar="NAME", action="append", default=[],
            help=f"{text}; may be given several times",
        )  # fmt: skip
    parser.add_argument(
        "--days", metavar="N", type=_parse_days, default=365,
        help="validity of the certificates, in days (default: %(default)s)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Make the certificates, and print where to copy each.

    Raises:
        UserFacingError: If a name is not valid or taken, or if a file cannot be written.
    """
    clients = [(name, role) for role in _DESTINATIONS for name in getattr(args, role)]
    names = [*args.host[:1], *(name for name, _ in clients)]
    if not names:
        raise InputError("nothing to make: give --host, --robot, --reader, --viewer or --operator")
    authority = CertificateAuthority(args.folder)
    authority.check_names_free(names)
    made = []
    if args.host:
        folder = authority.issue_server_certificate(args.host, args.days)
        made.append(f"{folder}: beside robot-tls.json5 or fleet-router.json5 on {args.host[0]}")
    for name, role in clients:
        folder = authority.issue_client_certificate(name, args.days)
        made.append(f"{folder}: {_DESTINATIONS[role].format(name)}")
    print("\n".join(made))
    print(
        f"Copy ca.pem, tls.pem and tls.key of each to its place, tls.key readable by nobody else.\n"
        f"{args.folder}/ca.key stays here: whoever has it can make a certificate for any name.\n"
        f"Valid for {args.days} days. This is for a test network (kinect-vo certificates --help)."
    )
    return 0


_DESTINATIONS = {
    "robot": 'beside fleet-robot.json5 on the robot with prefix = "{}"',
    "reader": "beside reader-tls.json5 where {} runs; a name among `readers` in the configuration",
    "viewer": "beside reader-tls.json5 where {} runs; a name among `readers` and `viewers`",
    "operator": "beside operator-tls.json5 where {} runs; a name among `readers` and `operators`",
}


def _parse_days(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= AUTHORITY_DAYS:
        raise argparse.ArgumentTypeError(
            f"{text} is not a number of days: give 1 to {AUTHORITY_DAYS}"
        )
    return int(text)
