#!/bin/sh
# Check that the README's setup commands need only a fresh Debian 12: run each in a minimal one with the current
# security updates, in a temporary folder (TMPDIR) that is removed afterwards. It checks the last commit.
# It needs root that may mount (no chroot, no unprivileged container), git, a network and 10 GB of disk, and takes
# about 20 minutes. It installs debootstrap if missing.
#
# Usage: scripts/check_bare_debian.sh [demo|test]    scripts/demo.sh or scripts/test.sh (default: both)
set -eu
checkout=$(cd "$(dirname "$0")/.." && pwd)
. "$checkout/scripts/steps.sh"
. "$checkout/scripts/debian.sh"

refuse() {
    printf '%s: %s; see the head of scripts/check_bare_debian.sh\n' "${0##*/}" "$*" >&2
    exit 2
}

case "$*" in
    '') set -- demo test ;;
    demo | test) ;;
    *) refuse "$* is unknown: name demo or test, or neither for both" ;;
esac
[ "$(id -u)" = 0 ] || refuse "run it as root: it mounts file systems and changes its root"
changes=$(git -C "$checkout" status --porcelain) || refuse "$checkout has to be a clone, to be cloned by git"

job=
work=$(realpath "$(mktemp -d)")
base=$work/debian
clean_up() {
    trap '' HUP INT TERM
    [ -z "$job" ] || kill_job
    ! grep -qF " $work/" /proc/self/mountinfo ||
        fail "$work is left, as something is mounted in it: unmount that, then remove it"
    rm -rf --one-file-system "$work"
}
trap clean_up EXIT
trap 'exit 129' HUP
trap 'say "Interrupted: removing temporary files"; exit 130' INT
trap 'say "Interrupted: removing temporary files"; exit 143' TERM

# Kill the first process of the job's namespace: all others end with it, so that nothing writes any more.
kill_job() {
    children=$(cat "/proc/$job/task/$job/children" 2>/dev/null) || true
    # shellcheck disable=SC2086  # a number with a space behind it
    kill -KILL ${children:-$job} 2>/dev/null || true
    wait "$job" 2>/dev/null || true
}

# contained COMMAND...: in its own mount and process namespaces, which end with it. It runs in the background, because
# a trap waits for a foreground command; env restores SIGINT, which sh ignores in the background.
contained() {
    env --default-signal unshare --mount --pid --fork --kill-child setsid "$@" &
    job=$!
    wait "$job" && code=0 || code=$?
    job=
    return "$code"
}

# Most containers and chroots refuse the mounts below, also to root.
check_mounts() {
    contained mount -t proc proc "$work" 2>"$work/log" ||
        refuse "root may not mount here ($(head -n 1 "$work/log")): run it outside chroots and containers, or in a" \
            "container started with --privileged"
}

# inside ROOT COMMAND...: as root on a fresh system, with the environment variables that pip and uv need to reach
# their registry from here. ROOT becomes the root of the mounts: in a chroot the kernel denies user namespaces.
inside() {
    # shellcheck disable=SC2016  # the inner shell's
    contained sh -euc '
        root=$1
        shift
        mount --bind "$root" "$root"
        mount -t proc proc "$root/proc"
        mount -t sysfs -o ro sysfs "$root/sys"
        mount -t devpts -o newinstance,ptmxmode=666,mode=620,gid=5 devpts "$root/dev/pts"
        mount -t tmpfs -o mode=1777,nosuid,nodev tmpfs "$root/dev/shm"
        for name in PIP_INDEX_URL PIP_EXTRA_INDEX_URL PIP_TRUSTED_HOST PIP_CERT PIP_PROXY UV_INDEX UV_DEFAULT_INDEX \
            SSL_CERT_FILE REQUESTS_CA_BUNDLE http_proxy https_proxy no_proxy HTTP_PROXY HTTPS_PROXY NO_PROXY; do
            value=$(printenv "$name") && set -- "$name=$value" "$@"
        done
        cd "$root"
        mount --move . /
        chroot . env -i HOME=/root LANG=C.UTF-8 TERM="${TERM:-dumb}" \
            PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin "$@" || exit' inside "$@"
}

# mirror SUITE DEFAULT: the mirror of this computer's apt for the suite. Without lists apt prints all addresses.
mirror() {
    mkdir -p "$work/lists/partial"
    found=$(apt-get --print-uris -o Dir::State::Lists="$work/lists" update 2>/dev/null |
        sed -n "s|^'\(.*\)/dists/$1/main/binary-.*|\1|p" | head -n 1) || true
    echo "${found:-$2}"
}

make_debian() {
    debian=$(mirror bookworm http://deb.debian.org/debian)
    security=$(mirror bookworm-security http://deb.debian.org/debian-security)
    http='' https=''
    eval "$(apt-config shell http Acquire::http::Proxy https Acquire::https::Proxy)"
    contained env http_proxy="${http:-${http_proxy:-}}" https_proxy="${https:-${https_proxy:-}}" \
        debootstrap --variant=minbase bookworm "$base" "$debian" >"$work/log" 2>&1 ||
        { tail -n 5 "$work/log" >&2 && return 1; }
    cat >"$base/etc/apt/sources.list" <<END
deb $debian bookworm main
deb $debian bookworm-updates main
deb $security bookworm-security main
END
}

# Copy the settings to reach the registries from this computer: hosts, proxies, certificates and other addresses.
# apt reads certificates from a separate file, because a fresh Debian gets its own with a package.
copy_settings() {
    for file in /etc/hosts /etc/resolv.conf /etc/pip.conf /etc/uv /root/.config/pip /root/.config/uv \
        /usr/local/share/ca-certificates; do
        [ ! -e "$file" ] || cp -rL --parents "$file" "$base" || return
    done
    apt-config dump Acquire >"$base/etc/apt/apt.conf.d/90here" || return
    [ -e /etc/ssl/certs/ca-certificates.crt ] || return 0
    cp -L /etc/ssl/certs/ca-certificates.crt "$base/etc/apt/certificates.crt" &&
        echo 'Acquire::https::CaInfo "/etc/apt/certificates.crt";' >>"$base/etc/apt/apt.conf.d/90here"
}

update_debian() {
    inside "$base" sh -euc 'export DEBIAN_FRONTEND=noninteractive
        apt-get -qq update
        apt-get -qq -o Dpkg::Use-Pty=0 --yes dist-upgrade
        apt-get clean
        ! command -v python3' >"$work/log"
}

copy_checkout() {
    cp -a "$base" "$work/$1" &&
        git clone --quiet --depth 1 "file://$checkout" "$work/$1/root/kinect-vo"
}

# check NAME: run the README's command, and print its result.
check() {
    step "Copying the last commit into a fresh Debian $(cat "$base/etc/debian_version")" copy_checkout "$1"
    say "Running scripts/$1.sh there"
    began=$(date +%s)
    inside "$work/$1" sh -c "cd /root/kinect-vo && scripts/$1.sh" && code=0 || code=$?
    seconds=$(($(date +%s) - began))
    python=$(dpkg-query --admindir="$work/$1/var/lib/dpkg" --show --showformat='${Version}' python3.11) || python=missing
    on="$seconds s on Debian $(cat "$base/etc/debian_version") (python3 $python)"
    [ "$code" = 0 ] || { failed=1 && say "${0##*/}: $1 failed (exit code $code) after $on" && return; }
    say "${0##*/}: $1 passed in $on"
}

check_mounts
[ -z "$changes" ] || say "Uncommitted changes are not checked"
command -v debootstrap >/dev/null || {
    step "Reading Debian's package lists" apt_get update
    step "Installing from Debian: debootstrap" apt_get install --yes --no-install-recommends debootstrap
}
step "Making a minimal Debian 12" make_debian
step "Copying this computer's network settings into it" copy_settings
step "Installing its updates" update_debian
failed=0
for name in "$@"; do
    check "$name"
done
exit "$failed"
