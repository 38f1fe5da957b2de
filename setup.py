"""What pyproject.toml cannot say: the wheel carries folders of the top level inside the package."""

from setuptools import setup
from setuptools.command.build_py import build_py

CARRIED = ("conf", "sweeps", "jobs")


class BuildWithFolders(build_py):
    """``conf/``, ``sweeps/`` and ``jobs/`` to ``shift3d/_data/``; an editable installation reads them in place."""

    def run(self) -> None:
        """Build the package, and copy the folders into it."""
        super().run()
        if not self.editable_mode:
            for name in CARRIED:
                self.copy_tree(name, f"{self.build_lib}/shift3d/_data/{name}")


setup(cmdclass={"build_py": BuildWithFolders})
