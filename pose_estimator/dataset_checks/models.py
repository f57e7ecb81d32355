"""Checks that the meshes agree with ``models_info.json``: units, sizes, symmetries."""

from collections.abc import Callable, Iterable

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from ...assets.mesh_files import Part
from ...assets.surface_colors import sample_colors
from ...core.geometry import make_transform
from ..bop.fields import MM
from ..bop.objects import PLAUSIBLE_DIAMETERS
from .cameras import rigid_or_nan
from .findings import Findings
from .meshes import CheckedModel
from .units import format_length, unit_of_factor

SIZES = PLAUSIBLE_DIAMETERS
SAME_SIZE = 0.03
SAME_SURFACE = 0.01
OTHER_SURFACE = 0.05
"""Mean distance, in diameters, below which two surfaces are the same, above which they are not."""

SAME_COLOR = 0.05
_POINTS = 600
DENSE_POINTS = 20_000
"""Points of a surface to measure distances from it."""

TURNS = (90.0, 137.5, 68.75)
"""Turns in degrees that test a continuous symmetry: no prism looks the same after all of them."""

MAX_LISTED = 100
"""Discrete symmetries of an object to check; more are a continuous one in many steps."""


def check_models(
    models: Iterable[CheckedModel], findings: Findings, *, colored: bool = True
) -> None:
    """Checks every object on its own.

    Without color, as in ``models_eval``, objects look symmetric that are not: then only those
    symmetries are checked that are listed.
    """
    for model in models:
        if model.part is None:
            continue
        if _check_units(model, findings):
            _check_sizes(model, findings)
        if len(model.part.mesh.faces):
            _check_symmetries(model, model.part, findings, missing=colored)


def _check_units(model: CheckedModel, findings: Findings) -> bool:
    """Whether the mesh is in millimeters, as far as its size tells."""
    low, high = SIZES
    if low <= model.measured <= high:
        return True
    small, path = model.measured < low, model.info.mesh_path
    findings.error(
        path, "vertices", "the mesh is too small" if small else "the mesh is too large",
        detail=f"{path.name} is {format_length(model.measured)} across, read as millimeters",
        cause="it is in meters; BOP has millimeters" if small else "it is not in millimeters",
        remedy="multiply the vertices by 1000" if small else "scale the vertices to millimeters",
    )  # fmt: skip
    return False


def _check_sizes(model: CheckedModel, findings: Findings) -> None:
    """Compares diameter and bounding box with the mesh."""
    name = f"object {model.obj_id}"
    ratio = model.info.diameter / model.measured
    if np.isfinite(ratio) and not 1 - SAME_SIZE <= ratio <= 1 + SAME_SIZE:
        findings.error(
            model.info_path, "diameter", "differs from the mesh",
            detail=f"{name}: {format_length(model.info.diameter)}, the mesh has "
            f"{format_length(model.measured)}",
            cause=_wrong_unit(ratio) or "the mesh was scaled or replaced afterwards",
            remedy="write the largest distance between two vertices in millimeters",
        )  # fmt: skip
    given = np.stack([model.info.minimum, model.info.extents])
    found = np.stack([model.bounds[0], np.ptp(model.bounds, axis=0)])
    off = np.abs(given - found).max()
    if np.isfinite(off) and off > SAME_SIZE * model.measured:
        ratio = float(np.median(model.info.extents / np.maximum(found[1], 1e-12)))
        findings.error(
            model.info_path, "min_x ... size_z", "the bounding box differs from the mesh",
            detail=f"{name}: off by up to {format_length(off)}",
            cause=_wrong_unit(ratio) or "the mesh was moved, rotated or replaced afterwards, so "
            "that poses are of another frame",
            remedy="write minimum and size of the vertices in millimeters",
        )  # fmt: skip


def _wrong_unit(ratio: float) -> str:
    """Returns the cause of a length that is ``ratio`` times that of the mesh, else nothing."""
    if (unit := unit_of_factor(ratio)) is not None:
        return f"it is in {unit[0]}; BOP has millimeters"
    if 800 < ratio < 1200:
        return "it was scaled by 1000 twice"
    if (unit := unit_of_factor(1 / max(ratio, 1e-12))) is not None:
        return f"the mesh is in {unit[0]}; BOP has millimeters"
    return ""


def _check_symmetries(
    model: CheckedModel, part: Part, findings: Findings, *, missing: bool
) -> None:
    points, _, colors = sample_colors([part], _POINTS)
    dense, _, dense_colors = sample_colors([part], DENSE_POINTS)
    tree = KDTree(dense)

    def moved(T: np.ndarray) -> tuple[float, float]:
        """How far from the surface (diameters) and from its colors T moves the points."""
        distance, nearest = tree.query(points @ T[:3, :3].T + T[:3, 3])
        color = np.abs(dense_colors[nearest] - colors).mean()
        return float(distance.mean()) / model.measured, float(color)

    discrete = model.info.discrete
    if len(discrete) > MAX_LISTED:
        findings.warning(
            model.info_path, "symmetries_discrete", "lists very many symmetries",
            detail=f"object {model.obj_id}: {len(discrete)}, of which {MAX_LISTED} were checked",
            cause="a continuous symmetry was written in small steps",
            remedy="write its axis and offset as symmetries_continuous instead",
        )  # fmt: skip
    chosen = np.linspace(0, len(discrete) - 1, min(len(discrete), MAX_LISTED)).astype(int)
    listed = {f"symmetries_discrete, number {i}": discrete[i] for i in chosen.tolist()}
    for i, (x, y, z, *offset) in enumerate(model.info.axes):
        axis, point = np.array([x, y, z]), np.array(offset)
        turned = [_rotation_about(axis, point, degrees) for degrees in TURNS]
        farthest = max(turned, key=lambda T: 0 if np.isnan(T).any() else moved(T)[0])
        listed[f"symmetries_continuous, number {i}"] = farthest
    for name, T in listed.items():
        _check_listed(model, name, T, moved, findings)
    if listed or not missing:
        return
    _check_missing(model, part.mesh.bounds.mean(axis=0), moved, findings)


def _check_missing(
    model: CheckedModel,
    center: np.ndarray,
    moved: Callable[[np.ndarray], tuple[float, float]],
    findings: Findings,
) -> None:
    """Reports that an object looks the same after turns about its center, and lists none."""

    def same(direction: np.ndarray, degrees: float) -> bool:
        distance, color = moved(_rotation_about(direction, center, degrees))
        return distance < SAME_SURFACE and color < SAME_COLOR

    axes = dict(zip("xyz", np.eye(3), strict=True))
    halves = [axis for axis, direction in axes.items() if same(direction, 180)]
    if not halves:
        return
    every = [axis for axis in halves if all(same(axes[axis], degrees) for degrees in TURNS)]
    if every:
        point = " ".join(f"{MM * x:.4g}" for x in center)
        shape = "a sphere" if len(every) == 3 else "a body of revolution"
        about = f"every turn about {', '.join(every)}: it is {shape} around {point} mm"
        field, remedy = "symmetries_continuous", "add axis and offset as symmetries_continuous"
    else:
        about, field = f"a half turn about {halves[0]}", "symmetries_discrete"
        remedy = "add symmetries_discrete to models_info.json"
    findings.warning(
        model.info_path, field, "a symmetry is missing",
        detail=f"object {model.obj_id} is symmetric under {about}",
        cause="equal views have different poses, so that training data is ambiguous",
        remedy=remedy,
    )  # fmt: skip


def _check_listed(
    model: CheckedModel,
    name: str,
    T: np.ndarray,
    moved: Callable[[np.ndarray], tuple[float, float]],
    findings: Findings,
) -> None:
    """Whether a listed symmetry is a motion that maps the object onto itself."""
    field = name.split(",")[0]
    if np.isnan(T).any():
        return  # it is a finding already
    rotation = T[:3, :3]
    if not rigid_or_nan(T[None])[0]:
        findings.error(
            model.info_path, field, "is not a rigid motion",
            detail=f"object {model.obj_id}, {name}: determinant {np.linalg.det(rotation):.3f}",
            cause="a reflection is not a rigid symmetry"
            if np.linalg.det(rotation) < 0 else "numbers in another order, or no unit axis",
            remedy="write 4x4 rigid transforms, row-major",
        )  # fmt: skip
        return
    distance, _ = moved(T)
    if distance > OTHER_SURFACE:
        findings.error(
            model.info_path, field, "does not map the object onto itself",
            detail=f"object {model.obj_id}, {name}: the surface moves by "
            f"{100 * distance:.0f} % of the diameter",
            cause="another axis, another object's entry, or a changed mesh frame",
            remedy="write the symmetry in the frame of the mesh, its translation in millimeters",
        )  # fmt: skip


def _rotation_about(axis: np.ndarray, offset: np.ndarray, degrees: float) -> np.ndarray:
    """Returns a rotation about an axis through a point as (4, 4); NaN for an axis of NaN."""
    if np.isnan([*axis, *offset]).any():
        return np.full((4, 4), np.nan)
    rotation = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix()
    return make_transform(rotation, offset - rotation @ offset)
