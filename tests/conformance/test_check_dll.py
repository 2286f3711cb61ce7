"""`interarea check` of IEEE/CIGRE DLLs: each defect seeded into a lag is found, and nothing else is told."""

from __future__ import annotations

import re
import struct
import sys
from pathlib import Path

import pytest
from zig_compiler import lag_dll

from interarea.fmu_build.check.check import CheckError, check_file
from interarea.fmu_build.open.real_code import REQUIRED
from interarea.fmu_build.write.real_code import build_dll
from interarea.models.blocks.channel import channel_block

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the defects are compiled for Linux")
SOURCE = Path(__file__).parent / "blocks" / "lag_dll.c"
DEFECTS = re.findall(r"[A-Z_]+", SOURCE.read_text().split("enum {")[1].split("}")[0])
#: defect -> rule that tells it, words of the message
REPORTED = {
    "PACKED": ("DLL alignment", "runs otherwise with other bytes between its ports"),
    "NAME": ("DLL names", "is no C identifier"),
    "RANGE": ("DLL ranges", "default 2 lies outside 3 to 10"),
    "GLOBAL": ("DLL instances", "runs otherwise beside another instance"),
    "CALLS": ("DLL repeated calls", "runs otherwise after five calls of Model_Initialize"),
    "TIME_BACK": ("DLL restart", "runs otherwise begun again at time 0"),
    "NOT_A_NUMBER": ("DLL errors", "after finite inputs with return code 0"),
    "NO_TERMINATE": ("DLL functions", "it does not have Model_Terminate"),
    "LEAK": ("DLL memory", "an instance started and terminated loses 2"),
    "SHARED_TEXT": ("DLL messages", "one text that all instances share"),
    "OUTSIDE_STATES": ("DLL snapshots", "runs otherwise continued from its state arrays"),
    "WRITES_TIME": ("DLL time", "Model_Outputs changes Time"),
    "BEYOND_STATES": ("DLL states", "is written beyond its declared number"),
    "CRASH": ("run: bounds", "the binary crashes (SIGABRT)"),
    "CRASH_ON_LOAD": ("run: description", "the binary crashes (SIGABRT)"),
    "LEAK_STEP": ("DLL memory", "a call of Model_Outputs loses"),
    "HANG": ("run: bounds", "the binary hangs: no answer after 5 s"),
}


@pytest.mark.slow  # two seconds each
@pytest.mark.parametrize("defect", list(REPORTED))
def test_a_defect_is_found(defect: str, tmp_path: Path, cache: Path) -> None:
    rule, words = REPORTED[defect]
    report = check_file(lag_dll(defect, tmp_path, cache), timeout_s=5.0 if defect == "HANG" else 60.0)
    reported = [f for f in report.findings if f.rule == rule]
    assert any(words in f.message for f in reported), report
    assert "\n" not in reported[0].line()


@pytest.mark.slow
@pytest.mark.parametrize("defect", ["NONE", "NO_PARAMETERS"])
def test_a_good_one_is_clean(defect: str, tmp_path: Path, cache: Path) -> None:
    assert check_file(lag_dll(defect, tmp_path, cache)).verdict == "clean"


def test_every_defect_of_the_source_is_tried() -> None:
    assert set(DEFECTS) == set(REPORTED) | {"NONE", "NO_PARAMETERS", "BITS"}


def windows_dll(functions: tuple[str, ...]) -> bytes:
    """Return the headers of a 32-bit Windows DLL that exports these functions, and nothing else."""
    names = b"".join(name.encode() + b"\0" for name in functions)
    at = [
        0x100 + 40 + 4 * len(functions) + sum(len(n) + 1 for n in functions[:k])
        for k in range(len(functions))
    ]
    table = struct.pack("<10I", *[0] * 6, len(functions), 0, 0x100 + 40, 0) + struct.pack(f"<{len(at)}I", *at)
    optional = struct.pack("<H", 0x10B) + bytes(94) + struct.pack("<I", 0x100) + bytes(12)
    section = bytes(8) + struct.pack("<4I", 0x1000, 0x100, 0x1000, 0x100) + bytes(16)
    coff = struct.pack("<HHIIIHH", 0x14C, 1, 0, 0, 0, len(optional), 0x2000)
    head = b"MZ" + bytes(58) + struct.pack("<I", 64) + b"PE\0\0" + coff + optional + section
    return head + bytes(0x100 - len(head)) + table + names


def test_a_library_for_another_machine_is_read_by_its_header(tmp_path: Path) -> None:
    """32 bits where 64 belong, and functions that are not there."""
    (tmp_path / "win64").mkdir()
    file = tmp_path / "win64" / "lag.dll"
    file.write_bytes(windows_dll(REQUIRED))
    (finding,) = check_file(file).findings
    assert finding.rule == "DLL bits" and "has 32 bits; its name or folder says 64" in finding.message
    file = tmp_path / "lag.dll"
    file.write_bytes(windows_dll(REQUIRED))
    words = "not run (a library for win32 cannot be loaded here)"
    assert check_file(file).verdict.startswith(words)
    file.write_bytes(windows_dll(REQUIRED[:-1]))
    (finding,) = check_file(file).findings
    assert finding.rule == "DLL functions" and finding.message.endswith("does not have Model_Terminate")


def test_files_that_are_no_dll(tmp_path: Path) -> None:
    text = tmp_path / "x.dll"
    for content in (b"hello", b"MZ" + bytes(62), windows_dll(REQUIRED)[:0x110]):
        text.write_bytes(content)
        (finding,) = check_file(text).findings
        assert finding.rule == "DLL file" and "cannot be read: " in finding.message
    with pytest.raises(CheckError):
        check_file(tmp_path / "missing.dll")


@pytest.mark.slow
def test_the_package_own_is_clean(tmp_path: Path, cache: Path) -> None:
    file = build_dll(channel_block(capacity=64), tmp_path, platform="linux64", cache=cache)
    assert check_file(file).verdict == "clean"
    head, mark, rest = file.read_bytes().partition(b"interarea-record")
    file.with_name("empty.so").write_bytes(head + mark + bytes(64) + rest[64:])  # no export has completed it
    (finding,) = check_file(file.with_name("empty.so")).findings
    assert "Model_GetInfo gives no description" in finding.message
