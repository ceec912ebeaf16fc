"""Keys and Zenoh files of a fleet, made from the provided profiles."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vo_service.tools.certificates.authority import CertificateAuthority

TEMPLATES = Path(__file__).parents[1] / "config" / "zenoh"
HOST = "127.0.0.1"
VALIDITY_DAYS = 2


@dataclass(frozen=True)
class FleetFiles:
    """Zenoh files of the router, the reader and the robots; each is beside its keys."""

    router: Path
    reader: Path
    robots: Sequence[Path]


def write_fleet_files(folder: Path, robots: Sequence[str], port: int) -> FleetFiles:
    """Create all keys, and write the files for a router at a port of 127.0.0.1."""
    authority = CertificateAuthority(folder)
    router = authority.issue_server_certificate([HOST], VALIDITY_DAYS)
    reader = authority.issue_client_certificate("reader", VALIDITY_DAYS)
    homes = [authority.issue_client_certificate(name, VALIDITY_DAYS) for name in robots]
    text = (TEMPLATES / "fleet-router.json5").read_text().replace("0.0.0.0:7447", f"{HOST}:{port}")
    at_router = ("robot1.local:7451", "router.local:7447")
    return FleetFiles(
        router=_write(router / "router.json5", _add_robots(text, robots)),
        reader=_write(reader / "reader.json5", _redirect("reader-tls.json5", at_router, port)),
        robots=[
            _write(home / "robot.json5", _redirect("fleet-robot.json5", at_router, port))
            for home in homes
        ],
    )


def _add_robots(text: str, robots: Sequence[str]) -> str:
    """Repeat each line for robot1 in the router's file for each robot."""
    lines = []
    for line in text.splitlines():
        if line.lstrip().startswith(('{ id: "robot1"', '{ subjects: ["robot1"]')):
            lines += [line.replace("robot1", name) for name in robots]
        elif '"robot2"' not in line:
            lines.append(line)
    return "\n".join(lines)


def _redirect(name: str, addresses: Sequence[str], port: int) -> str:
    """Change a provided profile to connect to our router and not to listen."""
    text = (TEMPLATES / name).read_text().replace('"tcp/127.0.0.1:7450"', "")
    for address in addresses:
        text = text.replace(address, f"{HOST}:{port}")
    return text


def _write(file: Path, text: str) -> Path:
    file.write_text(text)
    return file
