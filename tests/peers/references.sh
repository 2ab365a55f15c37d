#!/bin/bash
# references.sh [SCENE…] : makes tests/reference/*.exr of the generated scenes anew, 128 × 96, each from two independent halves.
# Needs python with the packages of README.md, and GATHERLIGHT (default target/release/gatherlight) for the pool.
set -eu
cd "$(dirname "$0")/../.."
python=${PYTHON:-python3} gatherlight=${GATHERLIGHT:-target/release/gatherlight} threads=${THREADS:-2}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# CPU seconds of each half, of Mitsuba.
declare -A seconds=([rough-gold-ring]=40 [hidden-lamp]=30 [glossy-plates]=40 [door-ajar]=100)
for scene in "${@:-rough-gold-ring hidden-lamp glossy-plates door-ajar pool}"; do
    for name in $scene; do
        for half in 1 2; do
            if [ "$name" = pool ]; then
                # No path of its light can be connected: progressive photon mapping, by rounds; 140 CPU seconds.
                "$gatherlight" render scenes/pool.glb --method progressive --height 96 --rounds 600 --photons 12M \
                    --caustic-photons 60M --threads "$threads" --seed "$half" -o "$work/$half.exr" --quiet
            else
                "$python" tests/peers/mitsuba_render.py "scenes/$name.glb" --res 96 --cpu "${seconds[$name]}" \
                    --threads "$threads" --seed "$half" --out "$work/$half.exr"
                mv "$work/$half.${seconds[$name]}.exr" "$work/$half.exr"
            fi
        done
        "$python" tests/peers/halves.py "$work/1.exr" "$work/2.exr" --out "tests/reference/$name.exr"
    done
done
