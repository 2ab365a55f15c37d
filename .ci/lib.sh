# Shared by the scripts of .ci: sections with timings, skips that are said out loud, missing packages.
# shellcheck shell=bash

# A step that cannot run on this machine writes its reason and exits with this code: not a failure, never silent.
SKIPPED=77
CI_SUMMARY=()
CI_START=$SECONDS

say() { printf '%s\n' "$*" >&2; }
fail() {
    say "FAILED: $*"
    exit 1
}
skip() {
    say "SKIPPED: $*"
    [ -z "${CI_SKIP_FILE:-}" ] || printf '%s\n' "$*" >"$CI_SKIP_FILE"
    exit "$SKIPPED"
}

# section TITLE COMMAND…: runs the command without standard input; a failure ends the run with the summary so far.
section() {
    local title=$1 begin=$SECONDS code=0 reason
    shift
    reason=$(mktemp)
    printf '\n=== %s\n' "$title"
    CI_SKIP_FILE=$reason "$@" </dev/null || code=$?
    local took=$((SECONDS - begin))
    if [ "$code" -eq 0 ]; then
        CI_SUMMARY+=("ok       $(printf '%5d' "$took") s  $title")
    elif [ "$code" -eq "$SKIPPED" ] && [ -s "$reason" ]; then
        CI_SUMMARY+=("skipped  $(printf '%5d' "$took") s  $title: $(cat "$reason")")
    else
        CI_SUMMARY+=("FAILED   $(printf '%5d' "$took") s  $title (exit code $code)")
        summary
        exit 1
    fi
    rm -f "$reason"
}

summary() {
    printf '\n=== summary (%d s in total)\n' $((SECONDS - CI_START))
    printf '%s\n' "${CI_SUMMARY[@]}"
}

# need COMMAND PACKAGE: installs the Debian package unless the command is there. False where that is not possible.
need() {
    command -v "$1" >/dev/null && return 0
    [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null || return 1
    say "installing $2 for $1"
    if [ -z "${CI_APT_UPDATED:-}" ]; then
        apt-get update -qq || return 1
        CI_APT_UPDATED=1
    fi
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$2" >/dev/null || return 1
    command -v "$1" >/dev/null
}
