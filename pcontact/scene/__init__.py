"""Scene as the user describes it: dataclasses, the TOML reader and the checks. Neither PETSc nor MPI."""
