"""What pyproject.toml cannot say: the wheel has the examples, with the package that makes their meshes, as
pcontact/examples."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
EXAMPLES = {"drivers/examples/*.toml": "examples", "meshes/*.py": "examples/meshes"}


class BuildWithExamples(build_py):
    """The modules, and the examples beside them."""

    def run(self):
        super().run()
        for pattern, place in EXAMPLES.items() if not self.editable_mode else ():
            target = Path(self.build_lib) / "pcontact" / place
            target.mkdir(parents=True, exist_ok=True)
            for path in sorted(ROOT.glob(pattern)):
                shutil.copyfile(path, target / path.name)


setup(cmdclass={"build_py": BuildWithExamples})
