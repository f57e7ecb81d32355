"""What can be wrong with a dataset: each kind of damage, done to a sound one, and its finding."""

from __future__ import annotations

from helpers.damage_tools import Damage
from helpers.damaged_images import IMAGES
from helpers.damaged_poses import POSES

DAMAGES: dict[str, Damage] = POSES | IMAGES
