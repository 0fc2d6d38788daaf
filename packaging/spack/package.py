"""Package of Spack's; the source is a path: spack develop --path DIR py-pcontact@main."""

from spack.package import PythonPackage, depends_on, license, variant, version


class PyPcontact(PythonPackage):
    """Parallel finite element contact mechanics with Nitsche's method, on PETSc."""

    has_code = True
    license("MIT")
    version("main", branch="main")

    variant("view", default=False, description="Pictures by VTK")

    depends_on("python@3.11:", type=("build", "run"))
    depends_on("py-setuptools@64:", type="build")
    depends_on("petsc@3.18:3.26 ~complex +mumps", type="run")
    for package in ("py-petsc4py", "py-mpi4py", "py-numpy", "py-numba", "py-tqdm", "py-matplotlib", "py-meshio"):
        depends_on(package, type=("build", "run"))
    depends_on("py-h5py +mpi", type="run")
    depends_on("gmsh +python", type="run")
    depends_on("py-pyvista", type="run", when="+view")
