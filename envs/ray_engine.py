"""Scenes made on a Ray cluster: many machines that share one folder.

Ray does the work of an engine: it places the scenes, and makes one again whose worker or machine
was lost (https://docs.ray.io/en/latest/ray-core/fault_tolerance/tasks.html). A scene appears in the
shared folder under its final name only when it is whole, so it does not matter how often one was
begun. Every machine needs this package, the objects' files and the folder under the same paths;
pictures have the same bytes where the machines draw with the same OpenGL driver.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any

from . import worker_pool
from .worker_pool import TRIES, quiet_threads

if TYPE_CHECKING:
    from .generate import GenerateConfig

SCENES_IN_FLIGHT = 1000
"""Scenes that Ray is given at once; more would make waiting for them slow."""

SCENES_A_WORKER = 256
"""A worker is replaced by a fresh one after so many scenes, and gives back its memory."""


def make_scenes(config: GenerateConfig, scene_ids: Sequence[int]) -> Iterator[int]:
    """Makes scenes on a cluster and yields the number of each that is ready.

    Args:
        config: its ``ray`` says which cluster: "local" starts one on this machine with
            ``config.workers`` workers; anything else is an address that ``ray.init`` takes, such
            as "auto", "head:6379" or "ray://head:10001". A cluster that this program is connected
            to already is used as it is.
        scene_ids: which scenes.

    Raises:
        ValueError: if Ray is not installed.
        ConnectionError: if there is no cluster at the address.
        ChildProcessError: if the workers of one scene died again and again.
    """
    try:
        import ray
        import ray.exceptions
    except ImportError as error:
        raise ValueError(
            "ray is given, but Ray is not installed: pip install 'two-view-pose[ray]'"
        ) from error
    connected = ray.is_initialized()
    if not connected:
        ray.init(**_cluster(config))
    try:
        remote = ray.remote(num_cpus=1, max_retries=TRIES, max_calls=SCENES_A_WORKER)
        make = remote(_make_one)
        shared = ray.put(_for_all_machines(config))
        queue = iter(scene_ids)
        waiting = [make.remote(shared, i) for i in islice(queue, SCENES_IN_FLIGHT)]
        while waiting:
            (done,), waiting = ray.wait(waiting)
            yield ray.get(done)
            waiting += [make.remote(shared, i) for i in islice(queue, 1)]
    except ray.exceptions.WorkerCrashedError as error:
        raise ChildProcessError(
            f"a scene's workers died {TRIES + 1} times; often memory is why: {error}"
        ) from error
    finally:
        if not connected:
            ray.shutdown()


def _make_one(config: GenerateConfig, scene_id: int) -> int:
    """On a worker, which Ray keeps for many scenes."""
    if _started != [config]:
        worker_pool.start_worker(config)
        _started[:] = [config]
    worker_pool.make_one(scene_id)
    return scene_id


_started: list[GenerateConfig] = []
"""What this worker is ready for."""


def _cluster(config: GenerateConfig) -> dict[str, Any]:
    """How ``ray.init`` gets to the cluster."""
    how: dict[str, Any] = {"address": config.ray, "runtime_env": {"env_vars": quiet_threads()}}
    if config.ray == "local":
        how |= {"num_cpus": config.workers, "include_dashboard": False}
    return how | {"log_to_driver": False}


def _for_all_machines(config: GenerateConfig) -> GenerateConfig:
    """The configuration with paths that do not depend on the folder that a program runs in."""
    from ..assets import OBJECT_NAMES, split_name

    def absolute(item: str) -> str:
        name, path = split_name(item)
        if item in OBJECT_NAMES or not path.exists():
            return item
        return f"{name}={path.resolve()}" if name is not None else str(path.resolve())

    return replace(
        config,
        out=config.out.resolve(),
        objects=tuple(absolute(item) for item in config.objects),
        distractors=tuple(absolute(item) for item in config.distractors),
    )
