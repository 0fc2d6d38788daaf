#!/usr/bin/env bash
# The whole matrix of extremes, from a fresh machine on:
#
#   scripts/extremes.sh [-n RANKS] [options of drivers/studies/extremes.py]     such as --family nu units, -o DIR
#
# The table goes to the terminal, to DIR/extremes.json and DIR/extremes.md (DIR: extremes_results). The exit status is 0
# only if every cell is right, or refused with its cause.
set -uo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 2
. scripts/env.sh || exit 2

ranks=1
if [[ ${1:-} == -n ]]; then
    ranks=$2
    shift 2
fi
exec mpirun -n "$ranks" python3 drivers/studies/extremes.py "$@"
