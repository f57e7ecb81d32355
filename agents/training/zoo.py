"""The hyper-parameters of PPO as a Python module for rl-zoo3's ``--conf-file``.

rl-zoo3 trains by environment id, for example with recorded views::

    python -m rl_zoo3.train --algo ppo --env TwoViewPoseReplay-v0 --gym-packages two_view_pose \\
      --conf-file two_view_pose.agents.training.zoo --env-kwargs bank:'"bank.npz"'

Class names in ``hyperparameters.yml`` are converted to classes.
"""

import yaml

from ..networks.algorithms import policy_kwargs
from .hyperparameters import SHIPPED, load_hyperparameters

hyperparams = {
    env_id: (entry := load_hyperparameters("ppo", env_id)) | {"policy_kwargs": policy_kwargs(entry)}
    for env_id in yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))["ppo"]
}
