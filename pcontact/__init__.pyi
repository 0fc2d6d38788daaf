"""What type checkers know of the names that are imported when they are first asked for."""

from pcontact.api.fields import Fields as Fields
from pcontact.api.meshes import mesh_from as mesh_from
from pcontact.api.results import ContactResult as ContactResult
from pcontact.api.results import Picture as Picture
from pcontact.api.results import Run as Run
from pcontact.api.results import load as load
from pcontact.api.running import Step as Step
from pcontact.api.running import run as run
from pcontact.api.scenes import Scene as Scene
from pcontact.api.scenes import from_dict as from_dict
from pcontact.api.scenes import new as new
from pcontact.api.scenes import read as read
from pcontact.api.study import Study as Study
from pcontact.api.study import study as study
from pcontact.assembly.item import Item as Item
from pcontact.contact.law import FrictionLaw as FrictionLaw
from pcontact.contact.law import add_law as add_law
from pcontact.runtime.errors import InputError as InputError
from pcontact.runtime.errors import NotConverged as NotConverged
from pcontact.runtime.errors import OutputError as OutputError
from pcontact.scene import Body as Body
from pcontact.scene import Contact as Contact
from pcontact.scene import Coupling as Coupling
from pcontact.scene import Displacement as Displacement
from pcontact.scene import Dynamics as Dynamics
from pcontact.scene import Load as Load
from pcontact.scene import Material as Material
from pcontact.scene import MeshSpec as MeshSpec
from pcontact.scene import Obstacle as Obstacle
from pcontact.scene import Output as Output
from pcontact.scene import Phase as Phase
from pcontact.scene import Pretension as Pretension
from pcontact.scene import Spring as Spring
from pcontact.scene import Steps as Steps
from pcontact.scene import Temperature as Temperature

__version__: str
