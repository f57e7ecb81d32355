"""The commands that are killed, each with small settings, and what must be equal in the end."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from helpers.small_sets import file_bytes

Contents = Mapping[str, str]
"""Name -> digest of what a command wrote."""

TEMPORARY = "."
"""First letter of the names of files that are not finished."""


@dataclass(frozen=True)
class Case:
    """A command that resumes.

    Attributes:
        options: of the command; ``{out}`` is what it writes, ``{data}`` the folder of ``needs``.
        contents: reads what must be equal in the end.
        needs: commands that prepare ``{data}``, in order.
        by_files: whether files with a final name never change, so that each is compared after each
            kill.
    """

    options: str
    contents: Callable[[Path], Contents]
    needs: tuple[str, ...] = ()
    by_files: bool = False


def _all_files(out: Path) -> Contents:
    return {
        str(path): hashlib.sha256(data).hexdigest()
        for path, data in file_bytes(out).items()
        if not any(part.startswith(TEMPORARY) for part in path.parts)
    }


def _one_file(pattern: str) -> Callable[[Path], Contents]:
    def read(out: Path) -> Contents:
        return {
            path.name: hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(out.parent.glob(f"{out.name}/{pattern}"))
        }

    return read


def _bank(out: Path) -> Contents:
    path = out / "bank.npz"
    if not path.is_file():
        return {}
    with np.load(path, allow_pickle=False) as bank:
        return {name: hashlib.sha256(bank[name].tobytes()).hexdigest() for name in bank.files}


def _study(out: Path) -> Contents:
    """The records but for the times, and the outcomes in any order."""
    found = {}
    for path in sorted((out / "outcomes").glob("*.jsonl")):
        lines = sorted(path.read_text().splitlines()[1:])
        found[path.name] = hashlib.sha256("\n".join(lines).encode()).hexdigest()
    results = out / "results.json"
    if results.is_file():
        records = json.loads(results.read_text())["records"]
        timeless = [r for r in records if r["metric"] != "seconds_per_pair"]
        text = json.dumps(timeless, sort_keys=True)
        found["results.json"] = hashlib.sha256(text.encode()).hexdigest()
    return found


_IMAGES = (
    "generate --out {data}/images --scenes 8 --views 2 --objects ape duck --width 320 --height 240 "
    "--workers 1 --seed 3"
)
_BANK = "record-bank --out {data}/bank.npz --scenes 4 --seed 4 --objects duck --workers 1"
_TEST = (
    "generate --out {data}/tests/%s --scenes 2 --views 12 --objects duck --split test "
    "--sampling hand-held --references 1 --workers 1 --seed 5"
)

CASES = {
    "generate": Case(
        "generate --out {out} --views 2 --objects ape duck --width 160 --height 120 --depth --coco "
        "--split test --scenes 6 --workers 2",
        _all_files,
        by_files=True,
    ),
    "record-bank": Case(
        "record-bank --out {out}/bank.npz --scenes 4 --seed 7 --objects duck --no-estimates "
        "--workers 2",
        _bank,
    ),
    "train-estimator": Case(
        "train-estimator --data {data}/images --out {out} --init linemod --objects ape duck "
        "--stages detector decoders --detector-steps 4 --decoder-steps 6 --checkpoint-every 0 "
        "--validation 0.25 --threads 1 --workers 0",
        _one_file("weights.*"),
        (_IMAGES,),
    ),
    "train-agent": Case(
        "train-agent --algo ppo --bank {data}/bank.npz --out {out} --validation 1 --steps 4096 "
        "--checkpoint-every 1",
        _one_file("policy.safetensors"),
        (_BANK,),
    ),
    "compare": Case(
        "compare --out {out} --data {data}/tests --methods single pnp --noise-pairs 1 --images 1 "
        "--threads 1",
        _study,
        (_TEST % "linemod", _TEST % "occlusion"),
    ),
}
