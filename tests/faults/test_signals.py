"""Each command that starts processes, ended by each signal once; `signals.py` does it 20 times."""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
import signals

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc"),
]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """What the commands read."""
    folder = tmp_path_factory.mktemp("signals")
    signals.prepare(folder)
    yield folder


@pytest.mark.parametrize("command", [c for c in signals.COMMANDS if c not in signals.FROM_REGISTRY])
def test_nothing_outlives_its_command(command: str, files: Path) -> None:
    chance = random.Random(command)  # Python has begun after .3 s, and compilers run from 1 s on
    for number in signals.SIGNALS:
        assert signals.stopped(command, number, files, chance.uniform(0.3, 2.5)) == [], number
