"""Types of matrices that tests can use: those that PETSc has, of accelerators where there is one."""

from pathlib import Path

from pcontact.assembly.matrix import AIJ, BESIDE
from pcontact.runtime.petsc import PETSc, known_types

DEVICES = {"aijcusparse": "/dev/nvidia0", "aijhipsparse": "/dev/kfd", "aijkokkos": "/dev/nvidia0"}
KINDS = [
    kind for kind in known_types(PETSc.Mat, (*AIJ, *BESIDE)) if kind not in DEVICES or Path(DEVICES[kind]).exists()
]
