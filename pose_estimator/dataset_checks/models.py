"""Checks that the meshes agree with ``models_info.json``: units, sizes, symmetries."""

from collections.abc import Callable, Iterable

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from ...assets.mesh_files import Part
from ...assets.surface_colors import sample_colors
from ...core.geometry import make_transform
from .cameras import rigid_or_nan
from .findings import Findings
from .meshes import CheckedModel

SIZES = (0.003, 5.0)
"""Range of plausible object diameters, meters."""

SAME_SIZE = 0.03
SAME_SURFACE = 0.01
OTHER_SURFACE = 0.05
"""Mean distance, in diameters, below which two surfaces are the same, above which they are not."""

SAME_COLOR = 0.05
_POINTS = 600
_DENSE = 20_000


def check_models(models: Iterable[CheckedModel], findings: Findings) -> None:
    """Checks every object on its own."""
    for model in models:
        if model.part is None:
            continue
        if _check_units(model, findings):
            _check_sizes(model, findings)
        _check_symmetries(model, model.part, findings)


def _check_units(model: CheckedModel, findings: Findings) -> bool:
    """Whether the mesh is in millimeters, as far as its size tells."""
    low, high = SIZES
    if low <= model.measured <= high:
        return True
    small, path = model.measured < low, model.info.mesh_path
    findings.error(
        path, "vertices", "the mesh is too small" if small else "the mesh is too large",
        detail=f"{path.name} is {_length(model.measured)} across, read as millimeters",
        cause="it is in meters; BOP has millimeters" if small else "it is not in millimeters",
        remedy="multiply the vertices by 1000" if small else "scale the vertices to millimeters",
    )  # fmt: skip
    return False


def _check_sizes(model: CheckedModel, findings: Findings) -> None:
    """Compares diameter and bounding box with the mesh."""
    assert model.mesh is not None
    name = f"object {model.obj_id}"
    ratio = model.info.diameter / model.measured
    if np.isfinite(ratio) and not 1 - SAME_SIZE <= ratio <= 1 + SAME_SIZE:
        findings.error(
            model.info_path, "diameter", "differs from the mesh",
            detail=f"{name}: {_length(model.info.diameter)}, the mesh has "
            f"{_length(model.measured)}",
            cause=_wrong_unit(ratio) or "the mesh was scaled or replaced afterwards",
            remedy="write the largest distance between two vertices in millimeters",
        )  # fmt: skip
    given = np.stack([model.info.minimum, model.info.extents])
    found = np.stack([model.mesh.bounds[0], model.mesh.extents])
    off = np.abs(given - found).max()
    if np.isfinite(off) and off > SAME_SIZE * model.measured:
        ratio = float(np.median(model.info.extents / np.maximum(found[1], 1e-12)))
        findings.error(
            model.info_path, "min_x ... size_z", "the bounding box differs from the mesh",
            detail=f"{name}: off by up to {_length(off)}",
            cause=_wrong_unit(ratio) or "the mesh was moved, rotated or replaced afterwards, so "
            "that poses are of another frame",
            remedy="write minimum and size of the vertices in millimeters",
        )  # fmt: skip


def _wrong_unit(ratio: float) -> str:
    """Returns the cause of a length that is wrong by a factor of about 1000, else nothing."""
    if 0.0008 < ratio < 0.0012:
        return "it is in meters; BOP has millimeters"
    return "it was scaled by 1000 twice" if 800 < ratio < 1200 else ""


def _check_symmetries(model: CheckedModel, part: Part, findings: Findings) -> None:
    points, _, colors = sample_colors([part], _POINTS)
    dense, _, dense_colors = sample_colors([part], _DENSE)
    tree = KDTree(dense)

    def moved(T: np.ndarray) -> tuple[float, float]:
        """How far from the surface (diameters) and from its colors T moves the points."""
        distance, nearest = tree.query(points @ T[:3, :3].T + T[:3, 3])
        color = np.abs(dense_colors[nearest] - colors).mean()
        return float(distance.mean()) / model.measured, float(color)

    listed = {f"symmetries_discrete, number {i}": T for i, T in enumerate(model.info.discrete)}
    for i, (x, y, z, *offset) in enumerate(model.info.axes):
        T = _rotation_about(np.array([x, y, z]), np.array(offset), 90)
        listed[f"symmetries_continuous, number {i}"] = T
    for name, T in listed.items():
        _check_listed(model, name, T, moved, findings)
    if listed:
        return
    center = part.mesh.bounds.mean(axis=0)
    for axis, direction in zip("xyz", np.eye(3), strict=True):
        distance, color = moved(_rotation_about(direction, center, 180))
        if distance < SAME_SURFACE and color < SAME_COLOR:
            findings.warning(
                model.info_path, "symmetries_discrete", "a symmetry is missing",
                detail=f"object {model.obj_id} is symmetric under a half turn about {axis}",
                cause="equal views have different poses, so that training data is ambiguous",
                remedy="add symmetries_discrete or symmetries_continuous to models_info.json",
            )  # fmt: skip
            return


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
        if field == "symmetries_continuous":
            findings.error(
                model.info_path, field, "has no axis", detail=f"object {model.obj_id}, {name}",
                remedy="give a direction and a point on the axis",
            )  # fmt: skip
        return
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
    """Returns a rotation about an axis through a point as (4, 4); NaN for a zero axis."""
    length = np.linalg.norm(axis)
    if not length > 0:
        return np.full((4, 4), np.nan)
    rotation = Rotation.from_rotvec(np.radians(degrees) * axis / length).as_matrix()
    return make_transform(rotation, offset - rotation @ offset)


def _length(meters: float) -> str:
    """Formats a length."""
    return f"{meters:.4g} m" if meters >= 1 else f"{1e3 * meters:.4g} mm"
