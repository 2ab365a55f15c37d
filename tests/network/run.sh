#!/usr/bin/env bash
# The broadcast between machines: a coordinator and 8 workers, each in a network namespace of its own, on links of 100 Mbit/s.
#
#   tests/network/run.sh [--full] DIRECTORY     DIRECTORY holds gatherlight and gatherlight-worker
#
# Needs root, ip and tc. Connections are controlled by CUBIC, as Linux does unless told otherwise; CONGESTION=bbr for another.
# Measured is the time from the map being built to the last worker having it, over the bound
# max(latency ⌈log₂ p⌉, bytes / bandwidth), which on these links is bytes / bandwidth; and what the coordinator's link sent,
# in copies of the map. The short form fails where the coordinator sends more copies than the limit below, and only tells the time; the full form prints the table of docs/scale.md.
set -euo pipefail
full=
[ "${1:-}" != --full ] || { full=yes && shift; }
programs=$(cd "${1:?the directory of the programs}" && pwd)
cd "$(dirname "$0")/../.."

WORKERS=8
MBIT=100
CONGESTION=${CONGESTION:-cubic}
NET=10.77.0
MOST_COPIES=1.5 # of the map, on the coordinator's link

work=$(mktemp -d)
pids=()
say() { printf '%s\n' "$*" >&2; }
inside() { ip netns exec "gl-$1" "${@:2}"; }
# launch NAME COMMAND…: for `&`, whose process number is then the command's own.
launch() { exec ip netns exec "gl-$1" "${@:2}"; }
stop_all() {
    [ ${#pids[@]} -eq 0 ] || kill -9 "${pids[@]}" 2>/dev/null || true
    [ ${#pids[@]} -eq 0 ] || wait "${pids[@]}" 2>/dev/null || true
    pids=()
}
clean() {
    stop_all
    for name in switch c $(seq 1 $WORKERS); do ip netns delete "gl-$name" 2>/dev/null || true; done
    rm -rf "$work"
}
trap clean EXIT

# shape DEVICE NAMESPACE: what leaves by the device is limited to the link's rate. Segments of 64 KiB pass whole, as they do with a network
# card that cuts them itself; cutting them here would fill the cores of this machine, which the machines of a cluster do not share.
shape() { inside "$2" tc qdisc add dev "$1" root tbf rate "${MBIT}mbit" burst 128kb latency 50ms; }

# plug NAME ADDRESS: a machine on the switch.
plug() {
    ip netns add "gl-$1"
    ip link add eth0 netns "gl-$1" type veth peer name "port$1" netns gl-switch
    inside switch ip link set "port$1" master bridge up
    inside "$1" ip addr add "$2/24" dev eth0
    inside "$1" ip link set lo up
    inside "$1" sysctl --quiet --write net.ipv4.tcp_congestion_control="$CONGESTION" ||
        say "connections are controlled by $(inside "$1" sysctl --values net.ipv4.tcp_congestion_control), not $CONGESTION"
    inside "$1" ip link set eth0 up
    shape eth0 "$1"
    shape "port$1" switch
}

build_network() {
    local allowed=net.ipv4.tcp_allowed_congestion_control
    sysctl --quiet --write $allowed="$(sysctl --values $allowed) $CONGESTION" 2>/dev/null || true
    ip netns add gl-switch
    inside switch ip link add bridge type bridge
    inside switch ip link set bridge up
    plug c $NET.1
    for i in $(seq 1 $WORKERS); do plug "$i" "$NET.$((i + 1))"; done
}

sent_by_coordinator() { inside c cat /sys/class/net/eth0/statistics/tx_bytes; }
# seconds LINE: the time at which a line of a log was written.
seconds() { date -d "$(cut -d' ' -f1 <<<"$1")" +%s.%N; }
calculate() { awk "BEGIN { printf \"%.${2:-2}f\", $1 }"; }

# wait_for SECONDS COMMAND…
wait_for() {
    local end=$((SECONDS + $1))
    until "${@:2}" >/dev/null 2>&1; do
        [ $SECONDS -lt $end ] || { say "waited in vain for: ${*:2}"; tail -q -n 5 "$work"/*.log >&2; exit 1; }
        sleep 0.1
    done
}
have_map() { [ "$(cat "$work"/w*.log | grep -c "payload received.* bytes=$1 complete=true")" -ge "$2" ]; }

# measure PHOTONS FATE [WORKER OPTIONS]: one job; prints bytes, seconds and bytes sent by the coordinator. FATE: a signal that the
# first worker, through which half of the map goes to the others, gets when a third of the time is over; or `none`.
measure() {
    local photons=$1 fate=$2 insecure='' have=$WORKERS line bytes built last before
    rm -rf "${work:?}"/*
    "$programs/gatherlight" serve --help | grep -q -- --insecure && insecure=--insecure
    # shellcheck disable=SC2086
    NO_COLOR=1 launch c "$programs/gatherlight" serve --listen $NET.1:7420 --store "$work/store" --threads 1 $insecure \
        2>"$work/c.log" >"$work/address" &
    pids+=($!)
    wait_for 10 test -s "$work/address"
    for i in $(seq 1 $WORKERS); do
        NO_COLOR=1 launch "$i" "$programs/gatherlight-worker" --coordinator http://$NET.1:7420 --threads 1 --memory 2G \
            --name "w$i" "${@:3}" >"$work/w$i.log" 2>&1 &
        pids+=($!)
        wait_for 10 grep -q joined "$work/w$i.log"
    done
    local first=${pids[1]}
    before=$(sent_by_coordinator)
    launch c "$programs/gatherlight" submit scenes/cornell-diffuse.glb --coordinator http://$NET.1:7420 --method photon \
        --photons "$photons" --width 128 --height 64 --samples 1 --final-gather 0 -o "$work/out.exr" >"$work/client.log" 2>&1 &
    pids+=($!)
    wait_for 300 grep -q ' built ' "$work/c.log"
    line=$(grep -m1 ' built ' "$work/c.log")
    bytes=$(grep -o 'bytes: [0-9]*' <<<"$line" | cut -d' ' -f2)
    if [ "$fate" != none ]; then
        sleep "$(calculate "$bytes * 8 / $MBIT / 1e6 / 3")"
        kill "-$fate" "$first"
        have=$((WORKERS - 1))
    fi
    wait_for 300 have_map "$bytes" $have
    built=$(seconds "$line")
    last=$(cat "$work"/w*.log | grep "payload received.* bytes=$bytes " | sort | tail -n 1)
    printf '%s %s %s\n' "$bytes" "$(calculate "$(seconds "$last") - $built" 3)" "$(($(sent_by_coordinator) - before))"
    [ "$fate" = none ] || kill -CONT "$first" 2>/dev/null || true
    stop_all
}

# row TITLE PHOTONS FATE [WORKER OPTIONS]: measures and prints one row; sets ratio and copies.
row() {
    local bytes took sent measured
    measured=$(measure "${@:2}")
    read -r bytes took sent <<<"$measured"
    local bound
    bound=$(calculate "$bytes * 8 / $MBIT / 1e6" 3)
    ratio=$(calculate "$took / $bound")
    copies=$(calculate "$sent / $bytes")
    printf '| %s | %s MB | %s s | %s s | %s | %s |\n' "$1" "$(calculate "$bytes / 1e6" 1)" "$bound" "$took" "$ratio" "$copies"
}

build_network
if [ -n "$full" ]; then
    printf '| run | map | bound | last worker has it | over the bound | copies sent by the coordinator |\n|---|---|---|---|---|---|\n'
    for photons in 2400000 6000000; do
        row "relayed" $photons none
        row "relayed" $photons none
        row "first worker killed" $photons KILL
        row "first worker frozen" $photons STOP
    done
    row "from the coordinator alone (\`--no-relay\`)" 2400000 none --no-relay
else
    row "relayed" 1600000 none
    if awk "BEGIN { exit !($copies > $MOST_COPIES) }"; then
        say "the coordinator sent $copies copies (at most $MOST_COPIES); the broadcast took $ratio of the bound"
        exit 1
    fi
fi
