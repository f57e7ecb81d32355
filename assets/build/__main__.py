"""Builds the objects; see `command`."""

import tyro

from .command import BuildCommand

if __name__ == "__main__":
    tyro.cli(BuildCommand, prog="python -m two_view_pose.assets.build").run()
