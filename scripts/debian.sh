# shellcheck shell=sh
# Sourced by the other scripts, after steps.sh: Debian packages.

# The sensors' native libraries, loaded by name when a sensor is opened.
native_packages="libfreenect0.5 libopenni2-0 libusb-1.0-0"

# missing_packages PACKAGE...: print those that are not installed. Debian 13 has renamed some libraries to NAMEt64.
missing_packages() {
    command -v dpkg-query >/dev/null || return 0 # not Debian: assume that they are installed
    for package in "$@"; do
        case " $(dpkg-query --show --showformat='${db:Status-Status} ' "$package" "${package}t64" 2>/dev/null)" in
            *" installed "*) ;;
            *) printf ' %s' "$package" ;;
        esac
    done
}

# apt_get ARGUMENTS...: as root or through sudo; asks nothing, prints only errors.
apt_get() {
    set -- env DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8 apt-get -qq -o Dpkg::Use-Pty=0 "$@"
    if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi >/dev/null
}

# can_install COMMAND: fail with the command to run by hand if this user cannot install packages.
can_install() {
    [ "$(id -u)" = 0 ] || { command -v sudo >/dev/null && sudo -v; } ||
        fail "neither root nor a sudo that lets this user be root; run once as root: $1"
}

# download_packages ARCHITECTURE FOLDER NAMES: with all dependencies. apt's own state does not change; an empty list of
# installed packages makes it download everything, for another architecture too. A subshell has its own variables.
download_packages() (
    folder=$2 names=$3 apt=$2/apt
    mkdir -p "$apt/lists/partial" "$apt/archives/partial"
    : >"$apt/status"
    set -- -qq -o Dir::State="$apt" -o Dir::State::Lists="$apt/lists" -o Dir::State::status="$apt/status" \
        -o Dir::Cache="$apt" -o Dir::Cache::Archives="$apt/archives" -o APT::Architecture="$1" \
        -o APT::Architectures="$1" -o APT::Sandbox::User=root -o APT::Install-Recommends=false
    # shellcheck disable=SC2086  # a list of names
    apt-get "$@" update >/dev/null &&
        apt-get "$@" --yes --download-only install $names >/dev/null &&
        for deb in "$apt"/archives/*.deb; do
            mv "$deb" "$folder/$(basename "$deb" | sed s/%3a/./)" || exit # an epoch's colon
        done &&
        rm -r "$apt"
)
