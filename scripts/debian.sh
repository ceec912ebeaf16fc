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
