#!/usr/bin/env bash
# The cluster as users run it: docker-compose brings up a coordinator and three workers as containers, which prove themselves
# by a generated token. Jobs are submitted; while they gather, a worker is cut off from the network, another is killed with
# SIGKILL, and at last the coordinator is killed and started again: the job and the waiting `submit` have to go on. The
# images must equal, byte for byte, those that `gatherlight render` makes on this machine.
#
# Usage: tests/compose/run.sh PATH/TO/gatherlight
set -euo pipefail
cd "$(dirname "$0")/../.."
gatherlight=$(realpath "$1")

PORT=$((20000 + $$ % 10000))
UP_TIMEOUT_S=120
JOB_TIMEOUT_S=300
LOSS_TIMEOUT_S=60
SETTINGS=(scenes/cornell-caustic.glb --width 192 --samples 64 --photons 200k --caustic-photons 200k)

work=$(mktemp -d)
export COMPOSE_PROJECT_NAME=gatherlight-test-$$
export GATHERLIGHT_PUBLISH=127.0.0.1:$PORT GATHERLIGHT_PUBLISH_METRICS=127.0.0.1:$((PORT + 1))
export GATHERLIGHT_COORDINATOR=http://127.0.0.1:$PORT
# Readable in the container, whose user is another; on this machine the directory keeps others out.
export GATHERLIGHT_TOKEN=$work/token GATHERLIGHT_TOKEN_FILE=$work/token
"$gatherlight" token >"$work/token"
chmod 644 "$work/token"
if docker compose version >/dev/null 2>&1; then
    compose() { docker compose "$@"; }
else
    compose() { docker-compose "$@"; }
fi

tear_down() {
    code=$?
    if [ "$code" -ne 0 ]; then
        echo "--- logs of the containers" >&2
        compose logs --tail=60 >&2 || true
        cat "$work"/*.log >&2 || true
    fi
    compose down --volumes --timeout 5 >/dev/null 2>&1 || true
    rm -rf "$work"
    exit "$code"
}
trap tear_down EXIT

# wait_for SECONDS WHAT COMMAND…: until the command succeeds.
wait_for() {
    local limit=$1 what=$2 begin=$SECONDS
    shift 2
    until "$@" >/dev/null 2>&1; do
        if [ $((SECONDS - begin)) -ge "$limit" ]; then
            echo "no $what within $limit s" >&2
            return 1
        fi
        sleep 0.2
    done
}
workers_are() { [ "$("$gatherlight" workers --json | grep -o '"name"' | wc -l)" -eq "$1" ]; }
gathering() { "$gatherlight" jobs --json | grep '"state": *"gather"' >/dev/null; }
nth_worker() { compose ps -q worker | sed -n "${1}p"; }

# cluster_image SEED FATE: submits a job, lets FATE happen while it gathers, and compares the image.
cluster_image() {
    local seed=$1 fate=$2 submitted
    "$gatherlight" submit "${SETTINGS[@]}" --seed "$seed" -o "$work/cluster-$seed.exr" >"$work/submit-$seed.log" 2>&1 &
    submitted=$!
    wait_for "$JOB_TIMEOUT_S" "gather phase" gathering
    "$fate"
    wait "$submitted"
    "$gatherlight" render "${SETTINGS[@]}" --seed "$seed" -o "$work/render-$seed.exr"
    cmp "$work/cluster-$seed.exr" "$work/render-$seed.exr"
    echo "the image of the cluster equals the image of one machine: $(sha256sum <"$work/render-$seed.exr" | cut -c1-16)…"
}

cut_off() {
    local victim network
    victim=$(nth_worker 2)
    network=$(docker inspect --format '{{range $name, $_ := .NetworkSettings.Networks}}{{$name}}{{end}}' "$victim")
    docker network disconnect "$network" "$victim"
    echo "cut one of three workers off from the network while it gathered"
    wait_for "$LOSS_TIMEOUT_S" "loss of the worker" workers_are 2
    docker network connect "$network" "$victim"
    wait_for "$LOSS_TIMEOUT_S" "return of the worker" workers_are 3
    echo "it came back by itself"
}

kill_worker() {
    docker kill --signal KILL "$(nth_worker 1)" >/dev/null
    echo "killed one of three workers while it gathered"
    wait_for "$LOSS_TIMEOUT_S" "loss of the worker" workers_are 2
}

kill_coordinator() {
    local coordinator
    coordinator=$(compose ps -q coordinator)
    docker kill --signal KILL "$coordinator" >/dev/null
    docker start "$coordinator" >/dev/null
    echo "killed the coordinator while a job gathered, and started it again"
    wait_for "$LOSS_TIMEOUT_S" "return of the workers" workers_are 2
}

compose config --quiet
compose up -d --no-build --scale worker=3
wait_for "$UP_TIMEOUT_S" "three workers" workers_are 3
"$gatherlight" workers

# Whoever has no token, or another one, sees nothing; and no secret is shown by what everyone may look at.
if env -u GATHERLIGHT_TOKEN_FILE "$gatherlight" jobs >"$work/stranger.log" 2>&1; then
    echo "jobs are shown to someone without a token" >&2
    exit 1
fi
grep -q -- '--token-file' "$work/stranger.log"
containers=$(compose ps -q)
# shellcheck disable=SC2086 # one argument a container
if { docker inspect $containers && compose logs && for c in $containers; do docker top "$c"; done; } 2>&1 |
    grep -qFf "$work/token"; then
    echo "the token is shown by docker inspect, docker top or the logs" >&2
    exit 1
fi

cluster_image 7 cut_off
cluster_image 8 kill_worker
cluster_image 9 kill_coordinator

metrics=$(curl --silent --fail "http://$GATHERLIGHT_PUBLISH_METRICS/metrics")
grep -q '^gatherlight_leases_done_total [1-9]' <<<"$metrics"
grep -q '^process_resident_memory_bytes [1-9]' <<<"$metrics"

# Not root, limited, and healthy by their own checks.
for container in $containers; do
    user=$(docker inspect --format '{{.Config.User}}' "$container")
    [ "$user" = gatherlight ] || { echo "container $container runs as '$user'" >&2; exit 1; }
    limit=$(docker inspect --format '{{.HostConfig.Memory}}' "$container")
    [ "$limit" -gt 0 ] || { echo "container $container has no memory limit" >&2; exit 1; }
done
running() { compose ps -q | xargs docker inspect --format '{{.State.Running}} {{.State.Health.Status}}' | grep true; }
all_healthy() { [ "$(running | sort -u)" = "true healthy" ]; }
wait_for 60 "healthy containers" all_healthy
docker images --format '{{.Repository}} {{.Size}}' | grep -E '^gatherlight(-worker)? ' | sort -u
