"""What ``load`` makes of its arguments."""

from __future__ import annotations

from pathlib import Path

import pytest
from two_view_pose import pose_estimator
from two_view_pose.pose_estimator.networks import PoseNetworks
from two_view_pose.pose_estimator.weights import save_weights


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory, networks: PoseNetworks) -> Path:
    path = tmp_path_factory.mktemp("weights") / "boxes.safetensors"
    save_weights(networks, path, {"what": "untrained"})
    return path


@pytest.mark.parametrize("method", ["single", "late", "mid"])
@pytest.mark.parametrize("solver", ["soft", "kabsch", "hard"])
def test_estimators_have_the_solver_that_is_asked_for(saved, method, solver):
    estimator = pose_estimator.load(method, saved, preset="fast", solver=solver)
    assert estimator.solver == solver
    assert type(estimator).__name__.lower().startswith(method)


def test_another_preset_names_the_training_command(saved):
    with pytest.raises(ValueError, match=r"'fast', not 'paper'.*train-estimator --preset paper"):
        pose_estimator.load("mid", saved, preset="paper")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"method": "latest"}, "unknown method 'latest'; there are single, early, late, mid, rgbd"),
        ({"preset": "quick"}, "unknown preset 'quick'; there are fast, paper"),
        ({"solver": "best"}, "unknown solver 'best'; there are soft, kabsch, hard"),
    ],
)
def test_unknown_names_are_refused(saved, wrong, message):
    with pytest.raises(ValueError, match=message):
        pose_estimator.load(**({"weights": saved} | wrong))
