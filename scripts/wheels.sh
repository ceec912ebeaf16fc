#!/bin/sh
# Make a folder that installs kinect-vo on a computer without a network: every locked wheel, kinect-vo's own,
# Debian's packages and the script that installs them. It runs the setup of this checkout first, if needed.
#
# Usage: scripts/wheels.sh [--machine x86_64|aarch64] [--python 3.11|3.12|3.13] [--without-rerun] FOLDER
#
# Without options it is for a computer like this one, with Debian 12's own Python, 3.11. A FOLDER that this script
# made before is replaced when the new one is complete.
set -eu
checkout=$(cd "$(dirname "$0")/.." && pwd)
. "$checkout/scripts/steps.sh"
. "$checkout/scripts/debian.sh"

refuse() {
    printf '%s: %s; see the head of scripts/wheels.sh\n' "${0##*/}" "$*" >&2
    exit 2
}

machine=$(uname -m) python=3.11 extra=rerun folder=
while [ $# != 0 ]; do
    case $1 in
        --machine) [ $# != 1 ] || refuse "--machine needs a value" && machine=$2 && shift ;;
        --python) [ $# != 1 ] || refuse "--python needs a value" && python=$2 && shift ;;
        --without-rerun) extra= ;;
        -*) refuse "$1 is unknown" ;;
        *) [ -z "$folder" ] || refuse "two folders: $folder and $1" && folder=$1 ;;
    esac
    shift
done
case $machine in x86_64 | aarch64) ;; *) refuse "no wheels for the machine $machine, only x86_64 and aarch64" ;; esac
case $python in 3.11 | 3.12 | 3.13) ;; *) refuse "no wheels for Python $python, only 3.11, 3.12 and 3.13" ;; esac
[ -n "$folder" ] || refuse "name the folder to make"
folder=${folder%/}
if [ -e "$folder" ] && [ ! -f "$folder/made_for.sh" ] && ! rmdir "$folder" 2>/dev/null; then
    refuse "$folder exists and was not made by this script: name another"
fi
parent=$(cd "$(dirname "$folder")" 2>/dev/null && pwd) && [ -w "$parent" ] ||
    refuse "cannot create $folder: $(dirname "$folder") is not a writable folder"
folder=$parent/$(basename "$folder")

# The folder is made under a temporary name and renamed at the end, so that it is always complete.
partial=$(mktemp -d "$folder.XXXXXX")
trap 'rm -rf "$partial"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
chmod 755 "$partial"

"$checkout/scripts/setup.sh"
cd "$checkout"

write_requirements() {
    PYTHONPATH=. .venv/bin/python scripts/locked_wheels.py "$machine" "$python" >"$partial/requirements.txt"
    [ -z "$extra" ] || PYTHONPATH=. .venv/bin/python scripts/locked_wheels.py "$machine" "$python" "$extra" \
        >"$partial/requirements-rerun.txt"
}

download_wheels() {
    tag=cp$(printf %s "$python" | tr -d .)
    # Debian 12 has glibc 2.36. uv, which installs the wheels there, is pinned as for this checkout.
    # shellcheck disable=SC2046  # a list of options
    .tools/bin/python -m pip download --quiet --disable-pip-version-check --no-deps --require-hashes \
        --only-binary :all: --implementation cp --python-version "$python" --abi "$tag" --abi abi3 --abi none \
        $(seq -f "--platform=manylinux_2_%g_$machine" 36 -1 5) --platform "manylinux2014_$machine" \
        --requirement "$1" --requirement scripts/uv.txt --dest "$partial/wheels"
}

build_own_wheel() {
    .tools/bin/uv build --quiet --wheel --no-create-gitignore --python .venv/bin/python --out-dir "$partial/wheels" &&
        for wheel in "$partial"/wheels/kinect_vo-*.whl; do
            version=$(basename "$wheel" | cut -d- -f2)
            hash=$(sha256sum "$wheel" | cut -d' ' -f1)
            for list in "$partial"/requirements*.txt; do
                echo "kinect-vo==$version --hash=sha256:$hash" >>"$list"
            done
        done
}

# As an archive for the robot's apt-get.
download_debian_packages() {
    download_packages "$(debian_name "$machine")" "$partial/debian" "$native_packages python3" &&
        (cd "$partial/debian" && for deb in *.deb; do describe "$deb"; done >Packages)
}

debian_name() {
    case $1 in x86_64) echo amd64 ;; aarch64) echo arm64 ;; esac
}

# describe DEB: its entry in the archive's index.
describe() {
    dpkg-deb --field "$1"
    printf 'Filename: ./%s\nSize: %s\nSHA256: %s\n\n' "$1" "$(stat -c %s "$1")" "$(sha256sum "$1" | cut -d' ' -f1)"
}

write_the_rest() {
    cp scripts/offline/install.sh scripts/offline/README.txt scripts/steps.sh scripts/debian.sh "$partial" &&
        cat >"$partial/made_for.sh" <<END &&
# Read by install.sh: what this folder is for.
machine=$machine
python_version=$python
debian_release=$release
END
        (cd "$partial" && find . -type f ! -name SHA256SUMS -exec sha256sum {} + >SHA256SUMS)
}

step "Listing the wheels for Python $python on $machine" write_requirements
step "Downloading the wheels" download_wheels "$partial/requirements${extra:+-$extra}.txt"
step "Building kinect-vo's own wheel" build_own_wheel
release=
# Debian's packages are only useful for the same Debian release with its own Python.
if command -v apt-get >/dev/null && /usr/bin/python3 -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$python')"; then
    release=$(. /etc/os-release && echo "$VERSION_CODENAME")
    step "Downloading Debian's packages ($release)" download_debian_packages
fi
step "Writing the check sums" write_the_rest

rm -rf "$folder.before"
[ ! -e "$folder" ] || mv "$folder" "$folder.before"
mv "$partial" "$folder"
rm -rf "$folder.before"
say "$folder is ready ($(du -sh "$folder" | cut -f1)). Copy it to the robot, and run there: ${folder##*/}/install.sh"
