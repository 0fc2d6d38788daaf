#!/usr/bin/env bash
# Puts in place what pcontact needs, once; later calls only look at a stamp.
#
#   scripts/setup.sh          set up if needed
#   scripts/setup.sh --env    the same, and print the shell lines that env.sh evaluates
#
# In this order:
#   1. the active python imports petsc4py and mpi4py (conda, spack, an own build of PETSc): it is used as it is;
#      missing packages go into the active conda environment or venv, or else into a venv .venv over that python;
#   2. /usr/bin/python3 with the PETSc of Debian or Ubuntu, with a venv .venv over it;
#   3. the same after apt-get install, as root or with passwordless sudo;
#   4. otherwise a message that says what to install, and exit status 2.
#
# PCONTACT_VENV names another place for the venv. At the end what runs would compile at first is compiled, about a minute
# of all cores, unless PCONTACT_NO_WARM is set. Progress goes to standard error.
set -euo pipefail

root=${BASH_SOURCE[0]%/*}
[[ $root == "${BASH_SOURCE[0]}" ]] && root=.
root=$(cd "$root/.." && pwd -P)

apt_packages=(python3-petsc4py-real python3-mpi4py python3-h5py python3-h5py-mpi python3-venv openmpi-bin
              libopenblas0-serial                                                 # for direct solvers, see docs/spring.md
              libgl1 libglu1-mesa libxcursor1 libxinerama1 libxft2 libxrender1     # these are for gmsh
              libegl1)                                                            # draws pictures without a display
modules=(numba gmsh meshio h5py matplotlib tqdm pytest xdist ruff importlinter jsonschema)   # two are called otherwise, see below
petsc_glob=/usr/lib/petscdir/petsc*/*-real/lib/python3/dist-packages/petsc4py
stamp_name=pcontact-setup
venv_mark=pcontact-venv                                                           # in a venv that was made here

say() { printf 'setup: %s\n' "$*" >&2; }
fail() { printf 'setup: %s\n' "$@" >&2; exit 2; }

# Runs a command, shows what it said only if it fails.
quietly() {
    local log status=0
    log=$(mktemp)
    "$@" >"$log" 2>&1 || status=$?
    if ((status)); then cat "$log" >&2; fi
    rm -f "$log"
    return $status
}

# ---- the shell as it was before pcontact's environment (or that of another copy) was put into it
clean_environment() {
    local IFS=: part path='' python_path=''
    for part in $PATH; do
        if [[ -e ${part%/*}/$venv_mark ]]; then continue; fi
        path+=${path:+:}$part
    done
    for part in ${PYTHONPATH:-}; do
        case $part in /usr/lib/petscdir/*|"$root"|'') ;; *) python_path+=${python_path:+:}$part ;; esac
    done
    export PATH=$path PYTHONPATH=$python_path
    if [[ -z $python_path ]]; then unset PYTHONPATH; fi
    case ${PETSC_DIR:-} in /usr/lib/petscdir/*) unset PETSC_DIR PETSC_ARCH ;; esac
}

# ---- the stamp: hash of what the set-up depends on, then the kind of set-up and its PETSC_DIR
hash_inputs() {
    cksum "$root/pyproject.toml" "$root/scripts/setup.sh" 2>/dev/null | tr -s ' \n' '--'
}

# A finished set-up in the directory $1 (a venv or conda environment): sets kind, petsc_dir.
read_stamp() {
    local old
    [[ -r $1/$stamp_name ]] || return 1
    { read -r old && read -r kind && read -r petsc_dir; } <"$1/$stamp_name" || return 1
    [[ $old == "$hash" && -x $1/bin/python3 && ( $petsc_dir == - || -d $petsc_dir ) ]]
}

write_stamp() {
    printf '%s\n' "$hash" "$kind" "$petsc_dir" >"$prefix/$stamp_name"
}

# The conda environment or venv that the active python belongs to, if it can be written; empty otherwise.
active_prefix() {
    local found
    found=$(command -v python3 || true)
    case $found in
        */shims/python3) found=${VIRTUAL_ENV:-}/bin/python3 ;;                    # pyenv
    esac
    found=${found%/bin/python3}
    if [[ ( -e $found/pyvenv.cfg || -d $found/conda-meta ) && -w $found && $found != "$venv" ]]; then
        printf '%s' "$found"
    fi
}

# Is a finished set-up at hand? Sets prefix. Starts no python.
find_finished() {
    local files
    if [[ -n $active ]]; then
        prefix=$active
        read_stamp "$active" && return
        files=("$active"/lib/python3*/site-packages/petsc4py)
        [[ -e ${files[0]} ]] && return 1          # an environment that is complete but for the set-up comes first
    fi
    prefix=$venv
    read_stamp "$venv"
}

# ---- doing it
imports() { "$1" -c 'import mpi4py, numpy, petsc4py' >/dev/null 2>&1; }

find_system_petsc() {
    local files
    files=($petsc_glob)
    petsc_dir=${files[-1]%/lib/python3/dist-packages/petsc4py}
    [[ -e ${files[-1]} && -x /usr/bin/python3 ]]
}

missing_apt_packages() {
    local package
    for package in "${apt_packages[@]}"; do
        case $(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null) in
            installed) ;;
            *) printf '%s ' "$package" ;;
        esac
    done
}

apt_install() {
    local sudo=()
    if ((EUID != 0)); then
        sudo -n true 2>/dev/null || return 1
        sudo=(sudo -n)
    fi
    say "apt-get install $*"
    quietly "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get update -q || return 1
    quietly "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install --no-install-recommends -q -y "$@"
}

advise() {
    local lines=("there is no petsc4py for the active python ($(command -v python3 || echo none)). Any of these will do:")
    if command -v apt-get >/dev/null; then
        lines+=("  Debian, Ubuntu (then run this again):"
                "    sudo apt-get update && sudo apt-get install --no-install-recommends -y ${apt_packages[*]}")
    fi
    lines+=("  conda (activate the environment, then run this again):"
            "    conda install -c conda-forge petsc4py mpi4py 'h5py=*=mpi_openmpi*' numba gmsh python-gmsh meshio matplotlib tqdm"
            "  spack:  spack install py-petsc4py py-mpi4py py-h5py+mpi && spack load py-petsc4py py-mpi4py py-h5py"
            "  an own build of PETSc, with PETSC_DIR (and PETSC_ARCH) set:"
            "    pip install mpi4py && pip install --no-build-isolation petsc4py==<version of that PETSc>")
    fail "${lines[@]}"
}

# Which python to build on: sets base, kind, petsc_dir.
choose_python() {
    local missing
    kind=own petsc_dir=-
    base=$(command -v python3 || true)
    if [[ -n $base ]] && imports "$base"; then return; fi
    if [[ -n ${PETSC_DIR:-} ]]; then
        say "PETSC_DIR=$PETSC_DIR, but $base cannot import petsc4py: another PETSC is looked for."
    fi
    kind=system base=/usr/bin/python3
    if command -v dpkg-query >/dev/null && command -v apt-get >/dev/null; then
        missing=$(missing_apt_packages)
        # a system that has PETSc may lack a library that is never called: the attempt is enough there
        if [[ -n $missing ]]; then
            apt_install $missing || { find_system_petsc && say "not installed (no root): $missing"; } || advise
        fi
    fi
    find_system_petsc || advise
}

# Is the venv that is there already one over the chosen python, and was it made at this place?
venv_fits() {
    local where='import sys; print(sys.base_prefix, *sys.version_info[:2])'
    imports "$venv/bin/python3" && grep -qs '^include-system-site-packages = true' "$venv/pyvenv.cfg" &&
        head -n 1 "$venv/bin/pip" | grep -qF "$venv/bin/" &&
        [[ $("$venv/bin/python3" -c "$where") == "$("$base" -c "$where")" ]]
}

make_venv() {
    if ! venv_fits; then
        say "venv $venv over $base"
        quietly "$base" -m venv --clear --system-site-packages "$venv" ||
            fail "no venv could be made in $venv (Debian, Ubuntu: apt-get install python3-venv)"
    fi
    : >"$venv/$venv_mark"
}

# Everything that $python does not import yet; numpy stays as it is, petsc4py is compiled against it.
install_packages() {
    local wanted constraints
    constraints=$prefix/pcontact-constraints.txt
    "$python" -c 'import numpy; print(f"numpy=={numpy.__version__}")' >"$constraints"
    wanted=$("$python" - "${modules[@]}" <<'PY'
import sys
from importlib.util import find_spec

# a directory without __init__.py is found too; it is what Debian 13 leaves of an h5py that is installed by half
wanted = [name for name in sys.argv[1:] if getattr(find_spec(name), "origin", None) is None]
# what `pip install -e` builds with
if find_spec("setuptools") is None:
    wanted.append("setuptools")
elif find_spec("wheel") is None and find_spec("setuptools.command.bdist_wheel") is None:
    wanted.append("wheel")
print(*wanted)
PY
    )
    wanted=${wanted/importlinter/import-linter}
    wanted=${wanted/xdist/pytest-xdist}
    if [[ -n $wanted ]]; then
        say "pip install $wanted"
        quietly "$python" -m pip install -q --disable-pip-version-check --no-input -c "$constraints" $wanted ||
            fail "pip install failed (above)"
    fi
    install_project
}

# The project itself, editable; from a tree that cannot be written, only the command: env.sh does the rest.
install_project() {
    if [[ -w $root ]]; then
        quietly "$python" -m pip install -q --disable-pip-version-check --no-input --no-deps --no-build-isolation \
            -e "$root" || fail "pip install -e failed (above)"
    else
        printf '#!/bin/sh\nexec "%s" -m pcontact "$@"\n' "$python" >"$prefix/bin/pcontact"
        chmod +x "$prefix/bin/pcontact"
    fi
}

set_up() {
    choose_python
    if [[ $kind == system ]]; then export_petsc; fi
    if [[ $kind == own && -n $active ]]; then
        prefix=$active
        say "using $prefix as it is"
    else
        prefix=$venv
        make_venv
    fi
    python=$prefix/bin/python3
    install_packages
    quietly "$python" -c 'import numba, gmsh, meshio, h5py, matplotlib, petsc4py, mpi4py; h5py.File' ||
        fail "the set-up is not complete (above)"
    write_stamp
    fresh=yes
    say "done"
}

# Compiles what runs would compile at first. The set-up is complete without it.
warm() {
    export PYTHONPATH=$root${PYTHONPATH:+:$PYTHONPATH} OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1
    say "compiling, once (PCONTACT_NO_WARM=1 leaves it out)"
    "$prefix/bin/python3" -m pcontact warm >&2 || say "not compiled (above): runs compile what they need"
}

export_petsc() {
    local packages=$petsc_dir/lib/python3/dist-packages
    case ${PYTHONPATH:-} in "$packages"|"$packages":*) ;; *) PYTHONPATH=$packages${PYTHONPATH:+:$PYTHONPATH} ;; esac
    export PETSC_DIR=$petsc_dir PYTHONPATH
    unset PETSC_ARCH
}

# ---- what env.sh evaluates
print_env() {
    local name unset_only=(OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1
        OMPI_MCA_rmaps_base_oversubscribe=1 PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe)
    if [[ $kind == system ]]; then
        export_petsc
        printf 'unset PETSC_ARCH\nexport PETSC_DIR=%q\n' "$PETSC_DIR"
    fi
    case $PATH in "$prefix/bin":*) ;; *) PATH=$prefix/bin:$PATH ;; esac
    printf 'export PATH=%q\nexport PYTHONPATH=%q\n' "$PATH" "$root${PYTHONPATH:+:$PYTHONPATH}"
    if ((EUID == 0)); then
        unset_only+=(OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1)
        # containers forbid the copy between processes that Open MPI tries first, and it says so on every run
        if [[ -e /.dockerenv || -e /run/.containerenv || -n ${container:-} ]]; then
            unset_only+=(OMPI_MCA_btl_vader_single_copy_mechanism=none)
        fi
    fi
    for name in "${unset_only[@]}"; do
        printf 'export %s="${%s:-%s}"\n' "${name%%=*}" "${name%%=*}" "${name#*=}"
    done
}

main() {
    clean_environment
    venv=${PCONTACT_VENV:-$root/.venv}
    if [[ ! -w $root && ! -e $venv ]]; then venv=${XDG_CACHE_HOME:-$HOME/.cache}/pcontact/venv; fi
    hash=$(hash_inputs)
    active=$(active_prefix)
    if ! find_finished; then
        mkdir -p "${venv%/*}"
        # two set-ups at once (ranks of an mpirun, two terminals): the second waits, and finds it done
        if command -v flock >/dev/null; then exec 9>"${TMPDIR:-/tmp}/pcontact-setup-$EUID.lock"; flock 9; fi
        if ! find_finished; then set_up; fi
        exec 9>&-
    fi
    if [[ -n ${fresh:-} && -z ${PCONTACT_NO_WARM:-} ]]; then (warm); fi
    if [[ ${1:-} == --env ]]; then print_env; fi
}

main "$@"
