"""Small generated datasets, and all their bytes."""

from __future__ import annotations

from pathlib import Path

from two_view_pose.envs.datagen.generate import GenerateConfig, generate


def file_bytes(folder: Path) -> dict[Path, bytes]:
    """What every file below a folder holds, by its path there."""
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def apes(out: Path, scenes: int) -> GenerateConfig:
    """A finished dataset of few small images, made by one process."""
    config = GenerateConfig(
        out, scenes=scenes, views=2, objects=("ape",), width=160, height=120, workers=1
    )
    generate(config)
    return config
