#!/usr/bin/env bash
# Strong and weak scaling on a cluster with SLURM: drivers/studies/scaling.py on 1, 2, 4, ... ranks up to all of the job.
#
#   sbatch [--nodes 4 --ntasks-per-node 32 --partition NAME --account NAME] scripts/slurm/scaling.sh [options]
#
# To be submitted from the repository, after `. scripts/env.sh` has set everything up once on a machine with network
# access. Options go to the driver (default: --unknowns 400000 1600000 --per-rank 50000) and to PETSc.
# Environment: RESULTS (default results/scaling), FIRST (fewest ranks, default 1), LAUNCH (default srun; or mpirun).
# Jobs with the same RESULTS add their rows to the same scaling.json; one after the other, not at once.

#SBATCH --job-name=pcontact-scaling
#SBATCH --nodes=1
#SBATCH --ntasks-per-node=8
#SBATCH --cpus-per-task=1
#SBATCH --time=02:00:00
#SBATCH --exclusive
#SBATCH --output=pcontact-scaling-%j.log

set -euo pipefail

# the script itself runs as a copy somewhere else
cd "${SLURM_SUBMIT_DIR:-$PWD}"
[[ -e drivers/studies/scaling.py ]] || { echo "scaling.sh: submit it from the repository, found $PWD" >&2; exit 2; }
. scripts/env.sh

# one thread a rank; kernels for the nodes' processors, compiled once and kept where all nodes see them
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1
results=${RESULTS:-results/scaling}
export NUMBA_CACHE_DIR=${NUMBA_CACHE_DIR:-$PWD/results/numba_cache}
mkdir -p "$results" "$NUMBA_CACHE_DIR"

ranks=${SLURM_NTASKS:-8}
options=("$@")
((${#options[@]})) || options=(--unknowns 400000 1600000 --per-rank 50000)

# cores are bound: ranks that wander between sockets lose their memory bandwidth
launch() {
    if [[ ${LAUNCH:-srun} == srun ]]; then
        srun --ntasks="$1" --cpu-bind=cores --distribution=block:cyclic "${@:2}"
    else
        "$LAUNCH" -n "$1" "${@:2}"
    fi
}

status=0
for ((n = ${FIRST:-1}; n <= ranks; n *= 2)); do
    echo "== $n ranks, $(date)"
    launch "$n" python3 drivers/studies/scaling.py -o "$results" "${options[@]}" \
        -log_view ":$results/log_view_$n.txt" || { status=$?; echo "== $n ranks: exit status $status"; }
done
exit "$status"
