#!/usr/bin/env bash
# pcontact with everything it needs, from a fresh machine on:
#
#   scripts/pcontact.sh run SCENE.toml [-o DIR] [options]            as `pcontact run ...`
#   scripts/pcontact.sh -n 4 run SCENE.toml [-o DIR] [options]       the same on 4 ranks, under mpirun
#   scripts/pcontact.sh [-n 4] run drivers/cases/hertz.py [options]  a .py file is run as a driver
#   scripts/pcontact.sh check SCENE.toml | view DIR | --help
#
# Paths are those of the current directory; a driver that is not found there is looked for in the repository, by its path
# and then by its name: hertz.py is drivers/cases/hertz.py.
# MPIRUN names another launcher (default mpirun). The exit status is that of pcontact.
set -euo pipefail

scripts=$(dirname "${BASH_SOURCE[0]}")
. "$scripts/env.sh"

launch=()
case ${1:-} in
    -n|-np) [[ ${2:-} =~ ^[1-9][0-9]*$ ]] || { echo "pcontact.sh: -n needs a number of ranks, found '${2:-}'" >&2; exit 2; }
            launch=(${MPIRUN:-mpirun} -n "$2")
            shift 2 ;;
esac

if [[ ${1:-} == run && ${2:-} == *.py ]]; then
    driver=$2
    shift 2
    for place in "$driver" "$scripts/../$driver" "$scripts"/../drivers/*/"${driver##*/}"; do
        [[ ! -e $place ]] || break
    done
    [[ -e $place ]] || { echo "pcontact.sh: no driver $driver" >&2; exit 2; }
    exec "${launch[@]}" python3 "$place" "$@"
fi
exec "${launch[@]}" python3 -m pcontact "$@"
