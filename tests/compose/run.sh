#!/usr/bin/env bash
# The cluster as users run it: docker-compose brings up a coordinator and three workers as containers, a job is
# submitted, one worker is killed with SIGKILL while it gathers, and the image must equal, byte for byte, the one that
# `gatherlight render` makes on this machine.
#
# Usage: tests/compose/run.sh PATH/TO/gatherlight
set -euo pipefail
cd "$(dirname "$0")/../.."
gatherlight=$(realpath "$1")

PORT=$((20000 + $$ % 10000))
UP_TIMEOUT_S=120
JOB_TIMEOUT_S=300
SETTINGS=(scenes/cornell-caustic.glb --width 192 --samples 128 --photons 200k --caustic-photons 200k --seed 7)

export COMPOSE_PROJECT_NAME=gatherlight-test-$$ GATHERLIGHT_PUBLISH=127.0.0.1:$PORT
export GATHERLIGHT_COORDINATOR=http://127.0.0.1:$PORT
if docker compose version >/dev/null 2>&1; then
    compose() { docker compose "$@"; }
else
    compose() { docker-compose "$@"; }
fi

work=$(mktemp -d)
tear_down() {
    code=$?
    if [ "$code" -ne 0 ]; then
        echo "--- logs of the containers" >&2
        compose logs --tail=60 >&2 || true
        [ -f "$work/submit.log" ] && cat "$work/submit.log" >&2
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

compose config --quiet
compose up -d --no-build --scale worker=3
wait_for "$UP_TIMEOUT_S" "three workers" workers_are 3
"$gatherlight" workers

"$gatherlight" submit "${SETTINGS[@]}" -o "$work/cluster.exr" >"$work/submit.log" 2>&1 &
submitted=$!
wait_for "$JOB_TIMEOUT_S" "gather phase" gathering
victim=$(compose ps -q worker | sed -n 1p)
docker kill --signal KILL "$victim" >/dev/null
echo "killed one of three workers while it gathered"
wait_for 30 "loss of the worker" workers_are 2
wait "$submitted"

"$gatherlight" render "${SETTINGS[@]}" -o "$work/render.exr"
cmp "$work/cluster.exr" "$work/render.exr"
echo "the image of the cluster equals the image of one machine: $(sha256sum <"$work/render.exr" | cut -c1-16)…"

# Not root, and healthy by their own checks.
for container in $(compose ps -q); do
    user=$(docker inspect --format '{{.Config.User}}' "$container")
    [ "$user" = gatherlight ] || { echo "container $container runs as '$user'" >&2; exit 1; }
done
running() { compose ps -q | xargs docker inspect --format '{{.State.Running}} {{.State.Health.Status}}' | grep true; }
all_healthy() { [ "$(running | sort -u)" = "true healthy" ]; }
wait_for 60 "healthy containers" all_healthy
docker images --format '{{.Repository}} {{.Size}}' | grep -E '^gatherlight(-worker)? ' | sort -u
