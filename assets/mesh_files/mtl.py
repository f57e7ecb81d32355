"""Materials of OBJ files (MTL): the diffuse color and its texture.

Alias/Wavefront, "Object Files, Version 3.0", appendix B1, section "Material Library File (.MTL)".
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.errors import InputError
from .linked_files import decode_text
from .paint import unit_range

_SCALED = {"-o": (0.0, 0.0, 0.0), "-s": (1.0, 1.0, 1.0), "-t": (0.0, 0.0, 0.0), "-mm": (0.0, 1.0)}
"""Options of a texture with one or more numbers, and their defaults."""

_ONE_VALUE = ("-blendu", "-blendv", "-cc", "-clamp", "-imfchan", "-texres", "-bm", "-boost")

_REFUSED = {"-t": "turbulence", "-mm": "a base and a gain"}


@dataclass(frozen=True)
class MtlMaterial:
    """What a material says about color.

    Attributes:
        name: after ``newmtl``.
        color: Kd, RGB in [0, 1]; None if it has none.
        texture: the file name after map_Kd; None without one.
        scale: factor of the texture coordinates (u, v).
        offset: added to them afterwards.
        clamp: the texture does not repeat.
    """

    name: str
    color: np.ndarray | None = None
    texture: str | None = None
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamp: bool = False


def read_mtl(path: Path) -> list[MtlMaterial]:
    """Reads a material library.

    Raises:
        InputError: if a color or a texture cannot be understood.
    """
    materials: list[MtlMaterial] = []
    values: dict[str, object] = {}
    text = decode_text(path.read_bytes()).replace("\\\r\n", " ").replace("\\\n", " ")
    for line in [*text.splitlines(), "newmtl"]:
        key, _, rest = line.strip().partition(" ") if " " in line.strip() else _split_tab(line)
        key, rest = key.lower(), rest.strip()
        if key == "newmtl":
            if values:
                materials.append(MtlMaterial(**values))  # type: ignore[arg-type]
            values = {"name": rest}
        elif not values:
            continue
        elif key == "kd":
            values["color"] = _color(rest, f"{path}, material {values['name']!r}")
        elif key == "map_kd" and rest:
            values |= _texture(rest, f"{path}, material {values['name']!r}")
    return materials


def _split_tab(line: str) -> tuple[str, str, str]:
    return line.strip().partition("\t")


def _color(text: str, source: str) -> np.ndarray:
    """Kd as RGB; one number is gray."""
    words = text.split("#")[0].split()
    try:
        numbers = [float(word) for word in words[:3]]
    except ValueError:
        raise InputError(f"{source}: Kd {text} is not a color; write three numbers") from None
    if not numbers:
        raise InputError(f"{source}: Kd has no numbers")
    return unit_range(np.array([(numbers * 3)[:3]]), f"{source}: Kd")[0, :3]


def _texture(text: str, source: str) -> dict[str, object]:
    """The file of a map_Kd and the options before it."""
    words, values = text.split(), dict(_SCALED)
    found: dict[str, object] = {}
    rest = text
    while words and (words[0] in _SCALED or words[0] in _ONE_VALUE):
        option = words.pop(0)
        numbers: list[float] = []
        if option in _ONE_VALUE:
            value = words.pop(0) if words else ""
            if option == "-clamp" and value == "on":
                found["clamp"] = True
            if option == "-imfchan" and value not in ("m", "l"):
                raise InputError(f"{source}: map_Kd of channel {value!r} is not supported")
        else:
            while len(words) > 1 and len(numbers) < len(_SCALED[option]) and _is_number(words[0]):
                numbers.append(float(words.pop(0)))
            values[option] = (*numbers, *_SCALED[option][len(numbers) :])
        if option in _REFUSED and values[option] != _SCALED[option]:
            raise InputError(
                f"{source}: map_Kd with {option} ({_REFUSED[option]}) is not supported: apply it "
                "to the image and remove the option"
            )
        # Names may hold spaces, so the rest is cut from the text, not joined.
        rest = text.split(maxsplit=len(text.split()) - len(words))[-1] if words else ""
    if not rest:
        raise InputError(f"{source}: map_Kd {text} names no file")
    scale, offset = values["-s"][:2], values["-o"][:2]
    return found | {"texture": rest, "scale": scale, "offset": offset}


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
