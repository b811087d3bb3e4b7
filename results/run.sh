#!/usr/bin/env bash
# Makes every table and figure below this folder anew, one study after another, or finishes what an interruption left. It needs
# nfbench with the extra all-solvers, and for the measured studies the data that docs/recordings.md describes: their folder is
# NFBENCH_DATA. At the end of each study it prints the seconds that the study took.
set -euo pipefail
cd "$(dirname "$0")/.."
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
jobs=${1:-2}  # worker processes

# Usage: make FOLDER MANIFEST JOBS. Exit code 1 of a study says that some runs were skipped, as its manifest intends.
make() {
    local begin=$SECONDS
    nfbench run "studies/$2.toml" --out "results/$1" --jobs "$3" --quiet --keep-skipped || [ $? -eq 1 ]
    nfbench figure "results/$1" --format svg
    echo "$1 $((SECONDS - begin))"
}

# What measures time comes first, while the machine is cool, and with one worker.
for study in runtime complexity; do make "paper/$study" "paper/$study" 1; done
make optimizer_choice optimizer_choice "$jobs"
make certified certified "$jobs"
make relaxation relaxation "$jobs"
make learned learned "$jobs"
make learned/learned_channel learned_channel "$jobs"
make learned/learned_space learned_space "$jobs"
nfbench landscape studies/landscape.toml --out results/landscape/landscape.csv --jobs "$jobs"
for manifest in studies/paper/*.toml; do
    study=$(basename "$manifest" .toml)
    make "paper/$study" "paper/$study" "$jobs"
done
for manifest in studies/impairments/*.toml; do
    study=$(basename "$manifest" .toml)
    make "impairments/$study" "impairments/$study" "$jobs"
done
for manifest in studies/estimators/*.toml; do
    study=$(basename "$manifest" .toml)
    make "estimators/$study" "estimators/$study" "$jobs"
done
if [ -n "${NFBENCH_DATA:-}" ]; then
    make measured measured "$jobs"
    make recorded recorded "$jobs"
fi
