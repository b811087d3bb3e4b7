#!/usr/bin/env bash
# Makes every table and figure below this folder anew, one study after another, or finishes what an interruption left.
# Usage: results/run.sh [all|main] [JOBS]; "main" makes paper, optimizer_choice and measured only. It needs nfbench with the
# extra all-solvers, and for the measured studies the data that docs/recordings.md describes: their folder is NFBENCH_DATA.
# At the end of each study it prints the seconds that the study took.
set -euo pipefail
cd "$(dirname "$0")/.."
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
which=${1:-all}
jobs=${2:-2}  # worker processes
made=()

# Usage: make FOLDER MANIFEST JOBS. Exit code 1 of a study says that some runs were skipped, as its manifest intends.
make() {
    local begin=$SECONDS
    nfbench run "studies/$2.toml" --out "results/$1" --jobs "$3" --quiet --keep-skipped || [ $? -eq 1 ]
    made+=("results/$1")
    echo "$1 $((SECONDS - begin))"
}

# Usage: make_all FOLDER: the studies of a folder of manifests that are not made yet.
make_all() {
    local manifest name
    for manifest in studies/"$1"/*.toml; do
        name=$1/$(basename "$manifest" .toml)
        [[ " ${made[*]} " == *" results/$name "* ]] || make "$name" "$name" "$jobs"
    done
}

draw() {
    local options=()
    case $1 in
        */positions_*) options=(--positions) ;;
        */nlos_severity) options=(--columns 2) ;;
    esac
    nfbench figure "$1" --format svg "${options[@]}" > /dev/null
}
export -f draw

# What measures time comes first, while the machine is cool, and with one worker.
for study in runtime complexity; do make "paper/$study" "paper/$study" 1; done
make_all paper
make optimizer_choice optimizer_choice "$jobs"
[ -z "${NFBENCH_DATA:-}" ] || make measured measured "$jobs"
if [ "$which" = all ]; then
    for study in certified relaxation learned; do make "$study" "$study" "$jobs"; done
    make learned/learned_channel learned_channel "$jobs"
    make learned/learned_space learned_space "$jobs"
    nfbench landscape studies/landscape.toml --out results/landscape/landscape.csv --jobs "$jobs"
    make_all impairments
    make_all estimators
    [ -z "${NFBENCH_DATA:-}" ] || make recorded recorded "$jobs"
fi
begin=$SECONDS
printf '%s\n' "${made[@]}" | xargs -P "$jobs" -I{} bash -c 'draw "$1"' _ {}
echo "figures $((SECONDS - begin))"
echo "all $SECONDS"
