#!/bin/bash
# Makes the pictures of this folder and the table of README.md anew: docs/pictures/make.sh
# Uses `gatherlight` only (GATHERLIGHT, default target/release/gatherlight); a method it does not have is left out with a note.
set -eu
cd "$(dirname "$0")/../.."
gatherlight=${GATHERLIGHT:-target/release/gatherlight} out=docs/pictures
seconds=${SECONDS_EACH:-20} # CPU seconds of the pictures made in equal time
threads=${THREADS:-1}
TIMEFORMAT='%U %S'
rows=()

has() { "$gatherlight" render --help | grep -qw -- "$1"; }

# render SCENE HEIGHT NAME OPTION… : makes NAME.png; sets `used` to the CPU seconds it took.
render() {
    local scene=$1 height=$2 name=$3
    shift 3
    local spent
    spent=$({ time "$gatherlight" render "scenes/$scene.glb" --height "$height" --threads "$threads" "$@" --quiet --no-report -o "$out/$name.png" >/dev/null 2>"$out/.log"; } 2>&1) || {
        cat "$out/.log" >&2
        exit 1
    }
    used=$(awk '{ print $1 + $2 }' <<<"$spent")
}

# note SCENE NAME WHAT : a row of the table for a picture, with its error figures.
note() {
    local json figure
    json=$("$gatherlight" compare "$out/$2.exr" "tests/reference/$1.exr" --json)
    figure() { grep -o "\"$1\": *[-+.0-9e]*" <<<"$json" | head -1 | sed 's/.*: *//'; }
    rows+=("$(printf '| %s | <img src="%s.png" width="256"> | %.1e | %.1e | %+.2f %% | %.1f s |' "$3" "$2" \
        "$(figure relative_mse)" "$(figure trimmed_relative_mse)" "$(awk "BEGIN { print 100 * $(figure bias) }")" "$used")")
    rm "$out/$2.exr"
    local size
    size=$(stat -c %s "$out/$2.png")
    [ "$size" -lt 153600 ] || echo "$2.png has $size bytes" >&2
}

# equal SCENE HEIGHT NAME WHAT METHOD OPTION : as many units of OPTION as take $seconds CPU seconds.
equal() {
    local scene=$1 height=$2 name=$3 what=$4 method=$5 option=$6 n=4 next=4
    if ! has "$method"; then
        rows+=("| $what | not made: no method \`$method\` | | | | |")
        return
    fi
    # From the second time on with the rate of the one before, which had more to start than to do.
    for _ in 1 2 3 4; do
        n=$next
        render "$scene" "$height" "$name" --method "$method" "$option" "$n"
        if awk "BEGIN { exit !($used > 0.9 * $seconds && $used < 1.1 * $seconds) }"; then break; fi
        next=$(awk "BEGIN { n = int($n * $seconds / ($used + 0.01) + 0.5); print n < 1 ? 1 : n }")
    done
    note "$scene" "$name" "$what, $n ${option#--}"
}

# given SCENE HEIGHT NAME WHAT OPTION… : with the given options.
given() {
    local scene=$1 height=$2 name=$3 what=$4
    shift 4
    for option in "$@"; do
        if [[ $option == --* ]] && ! has "$option"; then
            rows+=("| $what | not made: no option \`$option\` | | | | |")
            return
        fi
    done
    render "$scene" "$height" "$name" "$@"
    note "$scene" "$name" "$what"
}

section() { rows+=("" "### $1" "" "| | | relMSE | trimmed | bias | CPU |" "|---|---|---|---|---|---|"); }

section "Bidirectional path tracing against path tracing, equal time: all light is indirect (Veach 1997, fig. 10.3)"
equal hidden-lamp 96 hidden-lamp-path "path" path --samples
equal hidden-lamp 96 hidden-lamp-bdpt "bdpt" bdpt --samples

section "Metropolis light transport against bidirectional path tracing, equal time: a door ajar (Veach 1997, fig. 11.5)"
equal door-ajar 96 door-ajar-bdpt "bdpt" bdpt --samples
equal door-ajar 96 door-ajar-mlt "mlt" mlt --mutations

section "Photon mapping with 250,000 photons against path tracing in the same time (Jensen 1996)"
given cornell-caustic 256 cornell-caustic-photon "photon, 250,000 photons" --method photon --photons 100k --caustic-photons 150k --samples 16
seconds=$used
equal cornell-caustic 256 cornell-caustic-path "path" path --samples

section "The map looked at directly: few photons and many (Jensen 2001)"
given cornell-caustic 256 map-10k "10,000 photons, k = 50" --method photon --direct-from-map --photons 10k --k 50 --samples 16
given cornell-caustic 256 map-500k "500,000 photons, k = 500" --method photon --direct-from-map --photons 500k --k 500 --samples 16

begin='<!-- table: begin -->' end='<!-- table: end -->'
{
    sed "/$begin/q" "$out/README.md"
    printf '%s\n' "${rows[@]}" ""
    sed -n "/$end/,\$p" "$out/README.md"
} >"$out/.new"
mv "$out/.new" "$out/README.md"
rm -f "$out/.log" "$out"/*.exr
