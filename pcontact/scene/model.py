"""The scene as plain dataclasses: the reader fills them from TOML, drivers fill them in Python.

Nothing is checked here; `pcontact.scene.validate.validate` checks every value, whoever wrote it, and turns
numbers into float and lists into tuples. Units are the user's own and must be consistent. None means
"not said": what is then assumed stands in the docstrings.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from pcontact.scene.contact_model import CONTACT_DEFAULTS as CONTACT_DEFAULTS
from pcontact.scene.contact_model import OUTER as OUTER
from pcontact.scene.contact_model import Contact, Table
from pcontact.scene.contact_model import Obstacle as Obstacle

# Poisson's ratio above which cells are too stiff, or lose the digits of the stress, as they are: those of degree 1, and
# quadrilaterals and hexahedra of degree 2 (pressure of a surface pressed flat, 8 cells in the half width: error in L2
# 0.8 % at 0.46, 13 % at 0.499; 0.4 % with the mean dilatation)
LOCKING = 0.45
# the same of triangles and tetrahedra of degree 2, whose mean dilatation is but constant (3, 5, 9 and 39 % at 0.46,
# 0.48, 0.49, 0.499; 5.5 % with it; with 16 cells 1.3, 2.0, 3.4 and 19 %; 2.8 %)
POOR = 0.49
# settings whose answers may be wrong, which `Scene.allow_unsafe` lets run: gamma0 below the bound of coercivity,
# triangles and tetrahedra of degree 1 near nu = 0.5, a coarse source on a fine target in space, friction with several
# solutions, a mesh whose bodies are cut where cells do not meet facet to facet
UNSAFE = ("gamma0", "locking", "facet_sizes", "friction", "mesh")



@dataclass
class MeshSpec:
    """Where the mesh is and how it is used.

    Parameters
    ----------
    file : str or pathlib.Path
        Mesh file, relative to the scene's folder.
    order : int or None
        Degree of the displacement, 1 or 2; None: 1, or what a preset of accuracy says.
    kinematics : str
        2D only: "plane_strain", "plane_stress" or "axisymmetric" (x is the radius, y the axis); the default says
        nothing about a 3D mesh.
    mean_dilatation : bool or None
        Cells, but for triangles and tetrahedra of degree 1, take their mean volume change, which cures locking; None:
        in bodies that are nearly incompressible, with degree 1 also in those that may yield, see
        :meth:`Scene.averages`.
    """

    file: str | Path
    order: int | None = None
    kinematics: str = "plane_strain"
    mean_dilatation: bool | None = None


@dataclass
class Material:
    """Isotropic elasticity; von Mises plasticity as well where `yield_stress` or `hardening_curve` is given.

    Parameters
    ----------
    E, nu : float
        Young's modulus [stress] and Poisson's ratio.
    yield_stress : float or None
        Uniaxial yield stress [stress]; None: elastic, or see `hardening_curve`.
    hardening : float
        Isotropic: d(yield stress) / d(equivalent plastic strain) [stress].
    kinematic_hardening : float
        Prager: d(uniaxial back stress) / d(equivalent plastic strain) [stress].
    hardening_curve : sequence of (strain, stress) or None
        Instead of `yield_stress` and `hardening`: equivalent plastic strain, from 0 on, and the uniaxial yield stress
        there [stress]; linear between the points, constant beyond the last.
    """

    E: float
    nu: float
    yield_stress: float | None = None
    hardening: float = 0.0
    kinematic_hardening: float = 0.0
    hardening_curve: Table | None = None

    @property
    def plastic(self) -> bool:
        """Whether it may yield."""
        return self.yield_stress is not None or self.hardening_curve is not None


@dataclass
class Body:
    """A group of cells and the name of the material it is made of."""

    region: str
    material: str


@dataclass
class Displacement:
    """Prescribed displacement of a group of cells, facets, edges or vertices.

    Parameters
    ----------
    region : str
        Name of the group.
    value : sequence of float or "free"
        (d,) one entry per direction [length].
    amplitude : sequence of (time, factor) or None
        None is a ramp from 0 to 1 over the run.
    """

    region: str
    value: Sequence[float | str]
    amplitude: Table | None = None


@dataclass
class Load:
    """Exactly one of pressure or traction on facets, or body force in cells.

    Parameters
    ----------
    region : str
        Name of the group of facets (pressure, traction) or cells (body_force).
    pressure : float or None
        Positive in compression [stress].
    traction : sequence of float or None
        (d,) [stress].
    body_force : sequence of float or None
        (d,) [stress / length].
    amplitude : sequence of (time, factor) or None
        None is a ramp from 0 to 1 over the run.
    """

    region: str
    pressure: float | None = None
    traction: Sequence[float] | None = None
    body_force: Sequence[float] | None = None
    amplitude: Table | None = None


@dataclass
class Steps:
    """The run from time 0 to `end` in `count` equal steps to start with.

    Parameters
    ----------
    end : float
        [time].
    count : int
        Number of equal steps that the stepper starts with.
    min_step : float or None
        Step below which a cut back gives up [time]; None is end / count / 1024.
    """

    end: float = 1.0
    count: int = 1
    min_step: float | None = None

    @property
    def smallest_step(self) -> float:
        """`min_step`, or what stands for it when it is not said [time]."""
        return self.end / self.count / 1024 if self.min_step is None else self.min_step


@dataclass
class Output:
    """What is written.

    Parameters
    ----------
    fields : bool
        Fields of every step.
    checkpoint : bool
    checkpoint_every : int
        Load steps between two checkpoints.
    probes : sequence of str
        Groups whose displacement is reported.
    smooth : bool
        With the fields those of the cells averaged at the nodes, in each body for itself.
    estimate : bool
        Estimate the error of the displacement after every step.
    """

    fields: bool = True
    checkpoint: bool = False
    checkpoint_every: int = 1
    probes: Sequence[str] = ()
    smooth: bool = False
    estimate: bool = False


@dataclass
class Scene:
    """Everything the user describes.

    Parameters
    ----------
    mesh : MeshSpec
    materials : dict of str to Material
    bodies : list of Body
    contacts : list of Contact
    displacements : list of Displacement
    loads : list of Load
    steps : Steps
    output : Output
    petsc : dict of str to str
        Options of this scene, without the leading dash; the command line wins.
    title : str
    accuracy : str or None
        Preset, see `pcontact.runtime.presets`; None: none.
    allow_unsafe : sequence of str
        Of `UNSAFE`: settings that run with a warning instead of being refused.
    path : pathlib.Path or None
        The scene file; None when the scene was built in Python.
    beside : pathlib.Path or None
        Folder of the files of a scene without a file; None: the working directory.
    """

    mesh: MeshSpec
    materials: dict[str, Material]
    bodies: list[Body]
    contacts: list[Contact] = field(default_factory=list)
    displacements: list[Displacement] = field(default_factory=list)
    loads: list[Load] = field(default_factory=list)
    steps: Steps = field(default_factory=Steps)
    output: Output = field(default_factory=Output)
    petsc: dict[str, str] = field(default_factory=dict)
    title: str = ""
    accuracy: str | None = None
    allow_unsafe: Sequence[str] = ()
    path: Path | None = None
    beside: Path | None = None

    @property
    def where(self) -> str:
        """What messages call the scene: its file, or "scene"."""
        return "scene" if self.path is None else str(self.path)

    @property
    def folder(self) -> Path:
        """Folder that the scene's files are in, see `path` and `beside`."""
        if self.path is not None:
            return Path(self.path).parent
        return Path() if self.beside is None else Path(self.beside)

    @property
    def mesh_path(self) -> Path:
        """The mesh file."""
        return self.folder / self.mesh.file

    def copy(self) -> "Scene":
        """The same in tables of its own; values that are no tables are shared."""
        contacts = [
            replace(contact, obstacle=None if contact.obstacle is None else replace(contact.obstacle))
            for contact in self.contacts
        ]
        lists = {key: [replace(item) for item in getattr(self, key)] for key in LIST_TABLES}
        return replace(
            self,
            materials={name: replace(material) for name, material in self.materials.items()},
            petsc=dict(self.petsc),
            **{key: replace(getattr(self, key)) for key in SINGLE_TABLES},
            **{**lists, "contacts": contacts},
        )

    def yields(self, body: Body) -> bool:
        """Whether a body may yield."""
        return self.materials[body.material].plastic

    def locks(self, body: Body) -> bool:
        """Whether cells are too stiff in a body: Poisson's ratio is near 0.5, and not in plane stress."""
        return self.mesh.kinematics != "plane_stress" and self.materials[body.material].nu > LOCKING

    def averages(self, body: Body, simplices: bool = False) -> bool:
        """Whether a body's quadrilaterals and hexahedra, or its triangles and tetrahedra, take their mean dilatation.

        Triangles and tetrahedra of degree 1 cannot: their dilatation is constant as it is.
        """
        if self.mesh.kinematics == "plane_stress" or (simplices and self.mesh.order != 2):
            return False
        if self.mesh.mean_dilatation is not None:
            return self.mesh.mean_dilatation
        if simplices:
            return self.materials[body.material].nu > POOR
        return self.locks(body) or (self.yields(body) and self.mesh.order != 2)


SINGLE_TABLES = {"mesh": MeshSpec, "steps": Steps, "output": Output}
LIST_TABLES = {"bodies": Body, "contacts": Contact, "displacements": Displacement, "loads": Load}
