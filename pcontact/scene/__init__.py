"""What the user describes: dataclasses, the TOML reader and the checks. Neither PETSc nor MPI."""
