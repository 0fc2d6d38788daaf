#!/usr/bin/env bash
# All tests, from a fresh machine on:
#
#   scripts/test.sh          lint, floors, tests on 1 to 4 ranks, all drivers on 2 ranks; a test that may run on several
#                            numbers of ranks runs on one of them
#   scripts/test.sh every    the same, such a test on all of them
#   scripts/test.sh fast     lint, floors, serial tests without those marked slow
#
# TIMEOUT (seconds, default 900) bounds each run under mpirun. Ends with what failed and the line "N passed, N failed";
# the exit status is 0 only if nothing failed.
set -uo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 2
. scripts/env.sh || exit 2
# what draws is no part of the set-up; where it cannot be had, its tests are left out
python3 -c 'from pcontact.view import extra; extra.install()' ||
    printf 'without pyvista: tests of pictures are left out\n'
python3 -c 'import mkdocs, mypy' 2>/dev/null || python3 -m pip install -q --disable-pip-version-check --no-input \
    -c "$(python3 -c 'import sys; print(sys.prefix)')/pcontact-constraints.txt" mkdocs-material mypy ||
    printf 'without mkdocs or mypy: their tests are left out\n'

timeout=${TIMEOUT:-900}
# ranks that wait let others compute: three or four on two cores would wait for each other's time slices
export OMPI_MCA_mpi_yield_when_idle=${OMPI_MCA_mpi_yield_when_idle:-1}
passed=0 failed=0
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

# part NAME COUNT COMMAND...: runs, counts and times a part. COUNT: `one` (the command is one test) or `pytest`.
part() {
    local name=$1 count=$2 start=$EPOCHREALTIME status good=0 bad=0
    shift 2
    printf '== %s\n' "$name"
    "$@" 2>&1 | tee "$scratch/log"
    status=${PIPESTATUS[0]}
    if [[ $count == pytest ]]; then
        read -r good bad < <(count_pytest "$scratch/log")
        # status 5: there are no such tests
        if ((status != 0 && status != 5 && bad == 0)); then bad=1; fi
    elif ((status == 0)); then good=1; else bad=1; fi
    if ((status == 124 || status == 137)); then printf '   stopped after %s s\n' "$timeout"; fi
    passed=$((passed + good)) failed=$((failed + bad))
    if ((bad > 0)); then keep "$name" >> "$scratch/failures"; fi
    printf '== %s: %d passed, %d failed, %s s\n\n' "$name" "$good" "$bad" "$(seconds_since "$start")"
}

# What to repeat at the end of a part that failed: pytest's report without its rows of dots, else the last lines.
keep() {
    printf '== failed: %s\n' "$1"
    if grep -q '^=* \(FAILURES\|ERRORS\) =*$' "$scratch/log"; then
        sed -n '/^=* \(FAILURES\|ERRORS\) =*$/,$p' "$scratch/log" | grep -E '^(E |FAILED|ERROR|_+ |[^ ]+\.py:[0-9]+)' |
            tail -n 60
    else
        tail -n 30 "$scratch/log"
    fi
}

seconds_since() { awk -v a="$1" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.1f", b - a }'; }

# The numbers in pytest's last line; an error in a set-up is a failure.
count_pytest() {
    grep -E '(passed|failed|errors?|skipped|deselected|no tests ran).* in [0-9.]+s' "$1" | tail -n 1 |
        awk '{ for (i = 2; i <= NF; i++) {
                   if ($i ~ /^(passed|xfailed)/) good += $(i - 1)
                   if ($i ~ /^(failed|error|xpassed)/) bad += $(i - 1) } }
             END { print good + 0, bad + 0 }'
}

on_ranks() {
    local n=$1
    shift
    timeout --kill-after=10 "$timeout" mpirun -n "$n" "$@"
}

chosen=(--spread)
if [[ ${1:-} == fast ]]; then chosen=(-m "not slow"); elif [[ ${1:-} == every ]]; then chosen=(); fi
total=$EPOCHREALTIME
part "ruff" one ruff check --output-format concise .
part "floors" one lint-imports
# two workers, each on its own
part "serial" pytest python3 -m pytest -q --color=no -p no:cacheprovider -n 2 --dist worksteal "${chosen[@]}"
if [[ ${1:-} != fast ]]; then
    for n in 2 3 4; do
        part "parallel, $n ranks" pytest on_ranks "$n" python3 -m pytest -q --color=no -p no:cacheprovider -m parallel "${chosen[@]}"
    done
    for driver in drivers/{cases,studies}/[!_]*.py; do
        [[ -e $driver ]] || continue
        part "$driver" one on_ranks 2 python3 "$driver" --tiny -o "$scratch/$(basename "$driver" .py)"
    done
fi
# for the eye, not judged: what the same press takes in this tree and at the last tag
if [[ ${1:-} != fast ]] && tag=$(git describe --tags --abbrev=0 2>/dev/null); then
    printf '== times beside %s\n' "$tag"
    timeout --kill-after=10 600 python3 scripts/bench.py --against "$tag" --unknowns 5000 --repeat 2 -o "$scratch/bench" | tail -n 12
fi
if [[ -e $scratch/failures ]]; then cat "$scratch/failures"; fi
printf 'total time %s s\n%d passed, %d failed\n' "$(seconds_since "$total")" "$passed" "$failed"
((failed == 0))
