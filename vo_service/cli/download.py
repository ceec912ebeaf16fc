"""``kinect-vo download``: download sequences of the TUM RGB-D benchmark by name."""

import argparse
import re
import urllib.parse
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drivers.core import InputError
from vo_service.cli.options import print_message
from vo_service.cli.request import CommandRequest, argument, flag, option
from vo_service.signals import InterruptedBySignal, raise_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.download.catalog import BENCHMARK_URL, SEQUENCES, find_sequence
from vo_service.tools.download.sequence_download import download_sequence

EPILOG = f"""\
examples:
  kinect-vo download --list
  kinect-vo download fr1/xyz
  kinect-vo download fr1/floor fr1/teddy --output ~/recordings
  kinect-vo download fr1/xyz --mirror http://fileserver/tum

Each sequence is verified and unpacked into its own folder below FOLDER; the path of that folder is
printed on standard output. A sequence that exists already is not downloaded again. The same command
resumes an interrupted download.

This command contacts only {BENCHMARK_URL.split("/")[2]} or the mirror. Terms of the
benchmark: CC BY 4.0; cite Sturm et al., IROS 2012.
"""
_SHA256_PATTERN = re.compile(r"[0-9a-fA-F]{64}")


def _parse_url(text: str) -> str:
    """Parse the address of a mirror."""
    with suppress(ValueError):
        parts = urllib.parse.urlsplit(text)
        if parts.scheme in ("http", "https") and parts.netloc:
            return text
    raise argparse.ArgumentTypeError(f"{text} is not a URL: give http://... or https://...")


def _parse_sha256(text: str) -> str:
    """Parse a SHA-256 digest."""
    if not _SHA256_PATTERN.fullmatch(text):
        raise argparse.ArgumentTypeError(f"{text} is not a SHA-256 digest: give its 64 digits")
    return text


@dataclass(frozen=True, kw_only=True)
class DownloadSequencesRequest(CommandRequest):
    """The sequences to download, and from where."""

    names: tuple[str, ...] = argument("a sequence, such as fr1/xyz", "NAME", default=())
    list: bool = flag("list all sequences, and download none")
    output: Path = option(
        "parent folder of the sequences (default: %(default)s)", Path("recordings"), "FOLDER"
    )
    mirror: str = option(
        "another host with the same files, below URL/freiburg1/ and so on (default: %(default)s)",
        BENCHMARK_URL,
        "URL",
        _parse_url,
    )
    sha256: str | None = option(
        "refuse the archive unless it has this digest (for one NAME)", None, "HEX", _parse_sha256
    )


def run(request: DownloadSequencesRequest) -> int:
    """Download the sequences one by one."""
    if request.list:
        print(_format_sequence_table())
        return 0
    wanted = [find_sequence(name) for name in request.names]
    if not wanted:
        raise InputError("which sequence? `kinect-vo download --list` shows them all")
    if request.sha256 and len(wanted) > 1:
        raise InputError("--sha256 is of one archive: download the sequences one by one")
    terminal = Terminal()
    try:
        with raise_on_signals():
            for sequence in wanted:
                folder = request.output / sequence.folder
                if folder.exists():
                    terminal.write_line(
                        f"{sequence.name}: exists; to download it again, remove {folder}"
                    )
                else:
                    download_sequence(sequence, folder, request.mirror, request.sha256, terminal)
                terminal.clear()
                print(folder, flush=True)
    except InterruptedBySignal as interruption:
        terminal.clear()
        print_message("interrupted; run the same command again to resume the download")
        return interruption.exit_code
    return 0


def _format_sequence_table() -> str:
    """Format all sequences as a table."""
    width = max(len(sequence.name) for sequence in SEQUENCES)
    lines = [f"{'name'.ljust(width)}  length     about  ground truth"]
    for sequence in SEQUENCES:
        length = f"{sequence.seconds} s" if sequence.seconds else "-"
        size = f"{sequence.megabytes / 1e3:.2f} GB" if sequence.megabytes else "-"
        truth = "yes" if sequence.has_ground_truth else "no"
        lines.append(f"{sequence.name.ljust(width)}  {length:>6}  {size:>8}  {truth}")
    return "\n".join(lines)
