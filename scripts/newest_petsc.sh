#!/usr/bin/env bash
# Builds the newest PETSc that its source package has, with petsc4py, for tests beside the PETSc of the system (Debian, Ubuntu).
#
#   scripts/newest_petsc.sh [VERSION]      about half an hour the first time; then it only says where it is
#
# It lies in $PCONTACT_PETSC, by default ~/.cache/pcontact/petsc, and takes Open MPI, MUMPS, PT-Scotch, ScaLAPACK and HDF5
# from the system, as the system's PETSc does. The file `activate` there puts it into a shell:
#
#   . ~/.cache/pcontact/petsc/activate && scripts/test.sh
set -euo pipefail

place=${PCONTACT_PETSC:-${XDG_CACHE_HOME:-$HOME/.cache}/pcontact/petsc}
version=${1:+==$1}
system=(gfortran make python3-venv python3-dev python3-h5py-mpi python3-mpi4py libopenmpi-dev libopenblas-dev libscalapack-openmpi-dev
        libmumps-dev libscotch-dev libptscotch-dev libmetis-dev libhdf5-openmpi-dev)

say() { printf 'newest_petsc: %s\n' "$*" >&2; }

if [[ -f $place/activate ]]; then
    say "it is there: . $place/activate"
    exit 0
fi
missing=()
for package in "${system[@]}"; do dpkg -s "$package" >/dev/null 2>&1 || missing+=("$package"); done
if ((${#missing[@]})); then
    if ((EUID)); then say "missing: apt-get install ${missing[*]}"; exit 2; fi
    say "apt-get install ${missing[*]}"
    DEBIAN_FRONTEND=noninteractive apt-get install -y "${missing[@]}" >/dev/null
fi

mkdir -p "$place"
cd "$place"
/usr/bin/python3 -m venv --system-site-packages venv
export PATH=$place/venv/bin:$PATH
unset PYTHONPATH PETSC_DIR PETSC_ARCH
if ! compgen -G 'petsc-*.tar.gz' >/dev/null; then
    say 'downloading'
    # petsc4py asks for the same version
    pip download -q --no-deps --no-build-isolation --no-binary :all: "petsc$version"
fi
archive=$(compgen -G 'petsc-*.tar.gz' | sort -V | tail -1)
version=${archive#petsc-} version=${version%.tar.gz}
[[ -d petsc-$version ]] || tar xzf "$archive"
export PETSC_DIR=$place/petsc-$version PETSC_ARCH=opt
# the folder of the system's libraries, and of those for Open MPI
libraries=/usr/lib/$(gcc -print-multiarch)

if [[ ! -f $PETSC_DIR/$PETSC_ARCH/lib/libpetsc.so ]]; then
    say "configuring PETSc $version"
    (cd "$PETSC_DIR" && /usr/bin/python3 configure --with-debugging=0 COPTFLAGS=-O2 CXXOPTFLAGS=-O2 FOPTFLAGS=-O2 \
        --with-fortran-bindings=0 --with-x=0 --with-blaslapack-lib=-lopenblas --with-scalapack-lib=-lscalapack-openmpi \
        --with-mumps-include=/usr/include --with-mumps-lib='-ldmumps -lzmumps -lsmumps -lcmumps -lmumps_common -lpord' \
        --with-ptscotch-include=/usr/include/scotch --with-ptscotch-lib='-lptscotch -lptscotcherr -lscotch -lscotcherr' \
        --with-hdf5-include="/usr/include/hdf5/openmpi" --with-hdf5-lib="-L$libraries/hdf5/openmpi -lhdf5_hl -lhdf5" >configure.out)
    say 'compiling'
    make -C "$PETSC_DIR" libs >"$PETSC_DIR/make.out" 2>&1 || { tail -20 "$PETSC_DIR/make.out" >&2; exit 1; }
fi
say 'petsc4py'
pip install -q 'cython>=3' setuptools wheel 'numpy<2'
pip install -q --no-build-isolation --no-deps --no-binary petsc4py "petsc4py==$version"
cat >activate <<END
# to be sourced: PETSc $version, built by scripts/newest_petsc.sh
. "$place/venv/bin/activate"
export PETSC_DIR=$PETSC_DIR PETSC_ARCH=$PETSC_ARCH
unset PYTHONPATH
END
python -c 'from petsc4py import PETSc; print("PETSc", *PETSc.Sys.getVersion())' >&2
say "done: . $place/activate"
