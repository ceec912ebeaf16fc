#!/bin/sh
# Check on a Debian for x86_64 that kinect-vo runs on aarch64: replay ten frames of the virtual Kinect here and under
# qemu's emulation of that processor, with Debian's Python and the locked packages for it, and compare the poses.
# They must be equal within 0.1 mm and 0.01 degrees. It runs the setup of this checkout first, if needed.
# It needs a network and 2 GB of disk, but no root: Debian's packages, qemu among them, are unpacked into a temporary
# folder (TMPDIR) that is removed afterwards. It checks the files of this checkout, committed or not.
#
# Usage: scripts/check_aarch64.sh [METHOD...]    odometry methods: direct, surf, icp, sfm (default: direct)
#
# Most of its time, for direct a quarter of an hour of a processor, goes into compiling the kernels. Emulation is many
# times slower than a board: neither that time nor those of the frames say anything about one.
set -eu
checkout=$(cd "$(dirname "$0")/.." && pwd)
. "$checkout/scripts/steps.sh"
. "$checkout/scripts/debian.sh"

refuse() {
    printf '%s: %s; see the head of scripts/check_aarch64.sh\n' "${0##*/}" "$*" >&2
    exit 2
}

[ $# != 0 ] || set -- direct
for method in "$@"; do
    case $method in direct | surf | icp | sfm) ;; *) refuse "the method $method is unknown" ;; esac
done
[ "$(uname -m)" = x86_64 ] || refuse "run it on x86_64: this computer is $(uname -m)"
for program in apt-get dpkg-deb; do
    command -v $program >/dev/null || refuse "$program is missing: run it on a Debian"
done

work=$(realpath "$(mktemp -d)")
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

"$checkout/scripts/setup.sh"
cd "$checkout"
export TMPDIR="$work" # uv leaves locks there

# An installed qemu is as good. Unpacking it, unlike installing, leaves alone what this computer can run.
get_qemu() {
    command -v qemu-aarch64-static >"$work/qemu" && return
    download_packages amd64 "$work/amd64" qemu-user-static && unpack "$work/amd64" "$work/here" &&
        echo "$work/here/usr/bin/qemu-aarch64-static" >"$work/qemu"
}

get_python() {
    download_packages arm64 "$work/arm64" "$native_packages python3" && unpack "$work/arm64" "$work/board"
}

# unpack FOLDER ROOT: Debian's packages of a folder. Those of a Debian that has only /usr/lib need /lib as a link.
unpack() {
    mkdir "$2" && ln -s usr/lib "$2/lib" &&
        for deb in "$1"/*.deb; do
            dpkg-deb --extract "$deb" "$2" || return
        done
}

# A Python that runs as a program of this computer, so that processes which it starts with sys.executable run too:
# that is the name after -0, in a virtual environment the link to this file.
write_emulated_python() {
    python=$work/board/usr/bin/$(readlink "$work/board/usr/bin/python3") && [ -x "$python" ] &&
        cat >"$work/python3" <<SCRIPT && chmod +x "$work/python3" && "$work/python3" -c ''
#!/bin/sh
exec '$(cat "$work/qemu")' -L '$work/board' -0 "\$0" '$python' "\$@"
SCRIPT
}

# As setup.sh does, without the tools of the development.
sync() {
    UV_PYTHON_DOWNLOADS=never UV_PROJECT_ENVIRONMENT="$work/venv" .tools/bin/uv sync --quiet \
        --python "$work/python3" --frozen --all-extras --no-default-groups
}

load_libraries() {
    "$work/venv/bin/python" - <<'PYTHON'
import ctypes
import importlib
import platform
from importlib.metadata import files, packages_distributions

assert platform.machine() == "aarch64", platform.machine()
for library in ("libfreenect.so.0.5", "libOpenNI2.so.0", "libusb-1.0.so.0"):
    ctypes.CDLL(library)
for package, (distribution, *_) in packages_distributions().items():
    if any(file.suffix == ".so" for file in files(distribution) or ()):
        importlib.import_module(package)
PYTHON
}

record() {
    .venv/bin/kinect-vo record --camera synthetic --seconds 0.33 "$work/frames"
}

# replay NAME PROGRAM: with all outputs. It has folders of its own, so that nothing learned before is used.
replay() {
    CACHE_DIRECTORY=$work/$1.cache STATE_DIRECTORY=$work/$1.state "$2" replay "$work/frames" --method "$method" \
        --trajectory "$work/$1.txt" --mcap "$work/$1.mcap" --rerun "$work/$1.rrd" >"$work/$1.summary"
}

compare() {
    .venv/bin/python -m scripts.compare_poses "$work/x86_64.txt" "$work/aarch64.txt"
}

step "Unpacking qemu" get_qemu
step "Unpacking Debian's Python and libraries for aarch64" get_python
step "Starting that Python" write_emulated_python
step "Installing the locked Python packages for aarch64" sync
step "Loading all libraries there" load_libraries
step "Recording the virtual Kinect" record
for method in "$@"; do
    step "Replaying with $method on x86_64" replay x86_64 .venv/bin/kinect-vo
    step "Replaying with $method on aarch64, emulated" replay aarch64 "$work/venv/bin/kinect-vo"
    step "Comparing the poses" compare
done
say "kinect-vo runs on aarch64, with the poses of x86_64"
