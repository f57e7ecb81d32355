"""What is installed: all that is needed, nothing undeclared, and quick to import."""

import ast
import re
import subprocess
import sys
import tomllib
import zlib
from importlib import metadata
from pathlib import Path

import gymnasium as gym
import pytest
import two_view_pose
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from two_view_pose.assets import OBJECT_NAMES

CHECKOUT = Path(__file__).resolve().parents[1]
INSTALLED = Path(two_view_pose.__file__).parent
FOLDERS = ("agents", "assets", "core", "envs", "pose_estimator")
MODELLING = CHECKOUT / "assets" / "build"
"""Makes what ships, and is no part of the wheel itself."""
PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())


def requirements(*extras: str) -> dict[str, Requirement]:
    """Declared requirements by canonical name, those of the extras included."""
    project = PROJECT["project"]
    lines = list(project["dependencies"])
    for extra in extras:
        lines += project["optional-dependencies"][extra]
    return {canonicalize_name(r.name): r for r in map(Requirement, lines)}


def third_parties(path: Path) -> set[str]:
    """Top-level names of the third-party modules that a file imports anywhere."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.split(".")[0])
    return names - set(sys.stdlib_module_names) - {"two_view_pose"}


def loaded(statement: str, modules: list[str]) -> list[str]:
    """Which of the modules a fresh interpreter has loaded after a statement."""
    code = f"import sys; {statement}; print(*[m for m in {modules} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return run.stdout.split()


def test_importing_the_package_is_cheap():
    heavy = ["torch", "mujoco", "stable_baselines3", "cv2", "scipy", "trimesh"]
    assert loaded("import two_view_pose", heavy) == []


@pytest.mark.slow
def test_files_and_arrays_need_no_torch():
    statement = "from two_view_pose import assets; from two_view_pose.core import geometry; "
    statement += "from two_view_pose.pose_estimator.bop import dataset, writer; "
    statement += "from two_view_pose.pose_estimator.evaluation import metrics"
    assert loaded(statement, ["torch", "mujoco", "stable_baselines3"]) == []


def test_ids_are_registered():
    assert {"TwoViewPose-v0", "TwoViewPoseDiscrete-v0"} <= set(gym.registry)


def test_every_folder_with_code_is_a_package_of_the_wheel():
    with_code = {
        ".".join(("two_view_pose", *path.parent.relative_to(CHECKOUT).parts))
        for folder in FOLDERS
        for path in (CHECKOUT / folder).rglob("*.py")
        if not path.is_relative_to(MODELLING)
    }
    assert with_code | {"two_view_pose"} == set(PROJECT["tool"]["setuptools"]["packages"])


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_file_of_the_checkout_is_installed(folder):
    files = [
        path.relative_to(CHECKOUT)
        for path in (CHECKOUT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and not path.name.startswith(".")
        if not path.is_relative_to(MODELLING)
    ]
    assert files
    assert [str(file) for file in files if not (INSTALLED / file).exists()] == []


def test_type_checkers_are_told():
    assert (INSTALLED / "py.typed").exists()


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_objects_are_installed(name):
    folder = INSTALLED / "assets" / "objects" / name
    assert {"model.glb", "object.json"} <= {path.name for path in folder.iterdir()}


def check_size(sizes: dict[str, int], limit: float, what: str):
    """Fails with the names of the largest files if their sum in bytes is above so many MiB."""
    total = sum(sizes.values()) / 2**20
    largest = sorted(sizes, key=sizes.__getitem__, reverse=True)[:8]
    listed = "\n".join(f"{sizes[name] / 2**20:8.2f} MiB  {name}" for name in largest)
    assert total <= limit, f"{what}: {total:.1f} MiB instead of {limit} at most; largest:\n{listed}"


def test_a_clone_is_light():
    if not (CHECKOUT / ".git").exists():
        pytest.skip("not a clone")
    command = ["git", "ls-files", "-z"]
    listed = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True, check=True)
    files = [name for name in listed.stdout.split("\0") if (CHECKOUT / name).is_file()]
    assert "tests/test_packaging.py" in files
    # As file systems count, in blocks of 4 KiB.
    blocks = {name: -(-(CHECKOUT / name).stat().st_size // 4096) * 4096 for name in files}
    check_size(blocks, 35, "working tree of a clone")


@pytest.mark.slow
def test_the_wheel_is_light():
    files = {
        f"{folder}/{path.relative_to(INSTALLED / folder)}": path
        for folder in FOLDERS
        for path in (INSTALLED / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {"assets/weights/linemod.safetensors", "assets/weights/lmo.safetensors"} <= set(files)
    packed = {name: len(zlib.compress(path.read_bytes())) for name, path in files.items()}
    check_size(packed, 30, "wheel")


def test_a_file_that_is_too_large_is_named():
    with pytest.raises(AssertionError, match=r"wheel: 32.0 MiB .*\n +31.00 MiB  films/a.gif"):
        check_size({"b.py": 2**20, "films/a.gif": 31 * 2**20}, 30, "wheel")


def test_console_script():
    (script,) = metadata.entry_points(group="console_scripts", name="two-view-pose")
    assert script.load()(["--version"]) == 0


def test_mujoco_with_the_wrong_accelerations_is_refused():
    allowed = requirements()["mujoco"].specifier
    assert "4.0.0" not in allowed
    assert "3.17.0" in allowed


def test_tested_versions_are_allowed_and_complete():
    lines = (CHECKOUT / "requirements-lock.txt").read_text().splitlines()
    pins = dict(line.split("==") for line in lines if not line.startswith("#"))
    for name, requirement in requirements("build", "dev", "train").items():
        assert pins[name] in requirement.specifier


@pytest.mark.slow
def test_imports_are_declared():
    providers = {"pygame": ["pygame-ce"], **metadata.packages_distributions()}

    def undeclared(paths: list[Path], declared: set[str]) -> set[str]:
        imported = set().union(*map(third_parties, paths))
        return {
            name
            for name in imported
            if declared.isdisjoint(canonicalize_name(d) for d in providers.get(name, [name]))
        }

    package = [path for folder in FOLDERS for path in (CHECKOUT / folder).rglob("*.py")]
    assert undeclared(package, set(requirements("build", "train", "window"))) == set()
    benchmarks = set((CHECKOUT / "tests" / "benchmarks").rglob("*.py"))
    # An extra that named pyrender would bring PyOpenGL 3.1.0, with which MuJoCo cannot use EGL.
    extras = set(requirements("bench", "dev"))
    assert undeclared([*benchmarks], extras) - {"benchmarks"} == {"pyrender"}
    tests = [path for path in (CHECKOUT / "tests").rglob("*.py") if path not in benchmarks]
    # pytest brings packaging along; a test may import what stands beside it.
    own = {"benchmarks", "fuzz", "helpers", "kills", *(path.stem for path in tests)}
    assert undeclared(tests, set(requirements("dev")) | {"packaging"}) - own == set()


def test_no_machine_paths_in_the_documents():
    for name in ("README.md", "Makefile", ".ci/run", ".ci/setup", "pyproject.toml"):
        assert not re.search(r"(?<![\w./])/(root|home|work)/", (CHECKOUT / name).read_text())
