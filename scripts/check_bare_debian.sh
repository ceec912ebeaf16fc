#!/bin/sh
# Check that the README's set-up commands need nothing but a fresh Debian 12: run each in a minimal one with the
# current security updates, made in a temporary folder (TMPDIR) and removed afterwards. Checks the last commit.
# Needs root, git, a network and 10 GB of disk; takes about 20 minutes. debootstrap is installed where it is missing.
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
trap 'say "Interrupted: removing what was made"; exit 130' INT
trap 'say "Interrupted: removing what was made"; exit 143' TERM

# Kill the first process of the job's namespace: it ends after all others there, so that nothing writes any more.
kill_job() {
    children=$(cat "/proc/$job/task/$job/children" 2>/dev/null) || true
    # shellcheck disable=SC2086  # a number with a space behind it
    kill -KILL ${children:-$job} 2>/dev/null || true
    wait "$job" 2>/dev/null || true
}

# contained COMMAND...: with mounts and processes of its own, which end with it. It runs in the background, as a trap
# waits for what is in the foreground; env gives it SIGINT back, which sh ignores in the background.
contained() {
    env --default-signal unshare --mount --pid --fork --kill-child setsid "$@" &
    job=$!
    wait "$job" && code=0 || code=$?
    job=
    return "$code"
}

# inside ROOT COMMAND...: as root on a fresh system. Of this computer's environment it has what pip and uv need to
# reach their registry from here. ROOT becomes the root of the mounts: in a chroot alone the kernel denies user namespaces.
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

# mirror SUITE DEFAULT: where this computer's apt has the suite from. Without lists apt names the address of each.
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

# What it takes to reach the registries from this computer: names of hosts, proxies, certificates and other addresses.
# apt takes certificates from a file of its own, as those of a fresh Debian come with a package.
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

# check NAME: run the README's command, and print what came of it.
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

[ -z "$changes" ] || say "Not checked: what is not committed"
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
