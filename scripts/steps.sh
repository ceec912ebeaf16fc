# shellcheck shell=sh
# Sourced by the other scripts: their messages.

say() {
    printf '\n==> %s\n' "$*"
}

fail() {
    printf '\n%s: %s\n' "${0##*/}" "$*" >&2
    exit 1
}

# step DESCRIPTION COMMAND...: announce the command, run it, stop at a failure and name it.
step() {
    description=$1
    shift
    say "$description"
    "$@" || fail "this step failed: $description"
}
