"""The description of the processor."""

import pytest
from two_view_pose.core import cpu_cores as cores
from two_view_pose.core import processor
from two_view_pose.core.cpu_cores import available_cores


@pytest.fixture
def cpuinfo(tmp_path, monkeypatch):
    """Pretends to have another processor."""

    def pretend(model: str, flags: str) -> None:
        core = f"processor\t: 0\nmodel name\t: {model}\nflags\t\t: fpu {flags}\n"
        (tmp_path / "cpuinfo").write_text(f"{core}\n{core}")
        monkeypatch.setattr(cores, "CPUINFO", tmp_path / "cpuinfo")
        processor.processor_name.cache_clear()
        processor.instructions.cache_clear()

    yield pretend
    processor.processor_name.cache_clear()
    processor.instructions.cache_clear()


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ("avx avx2", "AVX2"),
        ("avx avx2 avx512f avx512bw", "AVX-512"),
        ("avx avx2 avx512f avx512bw avx512_bf16 amx_bf16", "AVX-512 with bfloat16"),
    ],
)
def test_model_and_widest_instructions(cpuinfo, flags, expected):
    cpuinfo("Some Model 7", flags)
    assert processor.processor_name() == "Some Model 7"
    assert processor.instructions() == expected


def test_name_without_cpuinfo(tmp_path, monkeypatch):
    monkeypatch.setattr(cores, "CPUINFO", tmp_path / "none")
    processor.processor_name.cache_clear()
    assert processor.processor_name()
    processor.processor_name.cache_clear()


def test_a_limit_is_part_of_the_description(monkeypatch):
    for name in processor.LIMITS:
        monkeypatch.delenv(name, raising=False)
    plain = processor.describe_processor()
    assert f", {available_cores()} cores, " in plain and "ONEDNN" not in plain
    monkeypatch.setenv("ONEDNN_MAX_CPU_ISA", "AVX2")
    assert "ONEDNN_MAX_CPU_ISA=AVX2" in processor.describe_processor()
