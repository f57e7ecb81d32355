"""Objects of a dataset and of an estimator are matched by size and name, not by number alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.solid_scenes import IDS, solid
from two_view_pose.assets import load_object
from two_view_pose.core.errors import InputError
from two_view_pose.pose_estimator.bop.matching import match_objects
from two_view_pose.pose_estimator.bop.models import write_models
from two_view_pose.pose_estimator.training.objects import training_objects

YCBV = {
    5: (196.5, (97, 67, 191)),
    6: (89.8, (86, 86, 34)),
    9: (129.5, (102, 60, 84)),
    10: (198.4, (109, 178, 37)),
}
"""Diameters and sides in millimeters of four of YCB-V's objects, from its models_info.json."""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    write_models(tmp_path, [solid(name) for name in IDS])
    return tmp_path


def test_numbers_of_other_objects_do_not_match(tmp_path):
    infos = {}
    for obj_id, (diameter, sides) in YCBV.items():
        entry = {"diameter": diameter}
        for side, axis in zip(sides, "xyz", strict=True):
            entry |= {f"min_{axis}": -side / 2, f"size_{axis}": side}
        infos[str(obj_id)] = entry
    (tmp_path / "models").mkdir()
    (tmp_path / "models/models_info.json").write_text(json.dumps(infos))
    names = ("can", "cat", "duck", "eggbox", "lamp")
    matches = match_objects(tmp_path, {name: load_object(name) for name in names})
    assert matches.objects == {}
    assert list(matches.different) == ["can", "cat", "duck", "eggbox"]
    text = str(matches)
    assert "can is left out: object 5 of the dataset is 196 mm across (97 x 67 x 191), not" in text
    assert "not in the dataset: lamp (14)" in text


def test_equal_objects_match_by_number_or_name(root):
    own = {
        "bracket": solid("bracket"),
        "steps": replace(solid("stairs"), name="steps"),
        "crate": replace(solid("crate"), obj_id=123_456),
    }
    matches = match_objects(root, own)
    assert {name: m.obj_id for name, m in matches.objects.items()} == {
        "bracket": 1, "steps": 4, "crate": 7
    }  # fmt: skip
    assert str(matches) == ""


def test_a_name_wins_over_a_number_of_the_same_size(root):
    twins = [replace(solid("crate"), name=name, obj_id=i) for i, name in ((7, "a"), (8, "b"))]
    write_models(root, twins)
    matches = match_objects(root, {"b": replace(twins[1], obj_id=7)})
    assert matches.objects["b"].obj_id == 8
    both = match_objects(root, {"b": twins[1], "c": replace(twins[1], name="c")})
    assert "object 8 of the dataset is b" in both.different["c"]


@pytest.mark.parametrize(
    ("change", "scale", "words"),
    [
        (lambda v: 1.2 * v, 1.2, "not 229 mm across (168 x 60 x 144)"),
        (lambda v: v[:, [1, 0, 2]], 1.0, "not 191 mm across (50 x 140 x 120)"),
        (lambda v: v + np.array([0.05, 0, 0]), 1.0, "origin elsewhere, 50 mm off"),
    ],
)
def test_scaled_turned_and_shifted_meshes_are_other_objects(root, change, scale, words):
    model = solid("bracket")
    diameter = scale * model.diameter
    other = replace(model, vertices=change(model.vertices), diameter=diameter)
    assert words in match_objects(root, {"bracket": other}).different["bracket"]


def test_without_models_numbers_alone_match_and_it_is_said(tmp_path):
    matches = match_objects(tmp_path, {"can": load_object("can")})
    assert list(matches.objects) == ["can"]
    assert "matched by their numbers alone, can is 5" in str(matches)


def test_training_refuses_objects_that_are_not_the_datasets(root):
    write_models(root, [replace(solid("stairs"), obj_id=5)])
    with pytest.raises(InputError, match=r"can is not in .*object 5 of the dataset is .* across"):
        training_objects(root, ["can"])
    assert training_objects(root, ["duck"])["duck"].obj_id == 9
